"""The guidance channel: edges whose places are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from skimage import filters

from tilefab.synthesis.edges import edge_response, fill_holes
from tilefab.synthesis.guidance import (
    SAFE_WEIGHT,
    STRONG_WEIGHT,
    Guidance,
    guidance_channel,
    otsu_threshold,
    signed_distance_px,
)
from tilefab.types import Mask


def everywhere(exemplar: NDArray[np.float32]) -> Mask:
    return np.ones(exemplar.shape[:2], dtype=bool)


def guide(exemplar: NDArray[np.float32]) -> Guidance:
    return guidance_channel(exemplar, everywhere(exemplar))


def halves(side: int = 64, channels: int = 3, step: float = 40.0) -> NDArray[np.float32]:
    """Two colours, the border between columns side / 2 - 1 and side / 2."""
    exemplar = np.full((side, side, channels), 30.0, dtype=np.float32)
    exemplar[:, side // 2 :, 0] += step
    return exemplar


def cracks(side: int = 128) -> NDArray[np.float32]:
    """One stone with dark lines: both sides of each line look alike."""
    rng = np.random.default_rng(5)
    exemplar = np.stack([rng.normal(mean, 0.7, (side, side)) for mean in (70.0, 2.0, 8.0)], axis=2)
    exemplar[::32, :, 0] = exemplar[1::32, :, 0] = 20.0
    return exemplar.astype(np.float32)


def test_the_channel_rises_with_the_distance_from_the_border() -> None:
    guidance = guide(halves())
    row = guidance.channel[32]
    assert guidance.edges[:, 31:33].all()
    assert not guidance.edges[:, :26].any()
    assert row[31] == guidance.channel.min()
    inner = np.flatnonzero(~guidance.edges[32, :31])[-1]
    assert (np.diff(row[: inner + 1]) <= 0).all()
    assert row[inner - 3] > row[inner]


@pytest.mark.parametrize("channels", [1, 2, 3, 5])
def test_it_takes_the_range_of_lightness(channels: int) -> None:
    exemplar = halves(channels=channels)
    channel = guide(exemplar).channel
    assert channel.shape == (64, 64)
    assert channel.dtype == np.float32
    assert channel.min() == pytest.approx(30.0, abs=1 / 16)
    assert channel.max() == pytest.approx(70.0, abs=1 / 16)
    assert (channel * 16 == np.rint(channel * 16)).all()


@pytest.mark.parametrize("side", [16, 40])
def test_one_colour_has_no_edges(side: int) -> None:
    guidance = guide(np.full((side, side, 3), 42.0, dtype=np.float32))
    assert not guidance.edges.any()
    assert (guidance.channel == 42.0).all()
    assert guidance.weight == SAFE_WEIGHT


def test_faint_grain_has_no_edges() -> None:
    grain = np.random.default_rng(1).normal(50, 0.8, (64, 64, 3)).astype(np.float32)
    assert not guide(grain).edges.any()


def test_noise_does_not_drown_the_colours() -> None:
    noise = np.random.default_rng(2).uniform(0, 100, (96, 96, 1)).astype(np.float32)
    channel = guide(noise).channel
    assert np.abs(np.diff(channel, axis=0)).max() <= 2 * 100 / 8
    assert channel.min() >= 0
    assert channel.max() <= 100


def test_sixteen_pixels_are_enough() -> None:
    guidance = guide(halves(16))
    assert guidance.edges[:, 7:9].all()
    assert not guidance.edges.all()


def test_alike_on_both_sides_is_guided_strongly() -> None:
    guidance = guide(cracks())
    assert guidance.edges[32].mean() > 0.9
    assert guidance.weight == STRONG_WEIGHT


def test_two_materials_are_guided_cautiously() -> None:
    grain = np.random.default_rng(3).normal(0, 0.7, (64, 64, 3)).astype(np.float32)
    assert guide(halves() + grain).weight == SAFE_WEIGHT


def test_the_rim_of_a_hole_is_no_edge() -> None:
    exemplar = halves()
    whole = guide(exemplar)
    valid = everywhere(exemplar)
    valid[5:20, 5:20] = False
    exemplar[~valid] = np.nan
    holed = guidance_channel(exemplar, valid)
    np.testing.assert_array_equal(holed.edges, whole.edges & valid)
    np.testing.assert_array_equal(holed.channel, whole.channel)


def test_another_detector_is_taken_as_it_is() -> None:
    exemplar = halves()
    response = np.zeros((64, 64), dtype=np.float32)
    response[10] = 9.0
    guidance = guidance_channel(exemplar, everywhere(exemplar), response)
    np.testing.assert_array_equal(guidance.edges, response > 0)
    with pytest.raises(ValueError, match="shape"):
        guidance_channel(exemplar, everywhere(exemplar), response[1:])


def test_turning_the_exemplar_turns_the_channel() -> None:
    exemplar = cracks()
    np.testing.assert_array_equal(
        guide(np.ascontiguousarray(np.rot90(exemplar))).channel, np.rot90(guide(exemplar).channel)
    )


def test_signed_distance_by_brute_force() -> None:
    edges = np.random.default_rng(4).random((20, 23)) < 0.1
    edges[3:9, 4:12] = True
    places = np.argwhere(np.ones_like(edges))
    expected = np.empty(edges.shape)
    for row, col in places:
        other = np.argwhere(edges != edges[row, col])
        distance = np.sqrt(((other - [row, col]) ** 2).sum(axis=1)).min()
        expected[row, col] = np.clip(-distance if edges[row, col] else distance, -4, 4)
    np.testing.assert_allclose(signed_distance_px(edges, 4.0), expected)


def test_otsu_as_others_have_it() -> None:
    rng = np.random.default_rng(6)
    values = np.concatenate([rng.normal(10, 2, 4000), rng.normal(30, 4, 1500)]).astype(np.float32)
    width = float(values.max() - values.min()) / 256
    # The library gives the middle of the last bin of the lower class, we the border above it.
    assert otsu_threshold(values) == pytest.approx(float(filters.threshold_otsu(values)), abs=0.51 * width)
    assert otsu_threshold(np.full(7, 3.5, dtype=np.float32)) == 3.5


def test_a_step_has_the_strength_that_is_promised() -> None:
    response = edge_response(halves(step=30.0), everywhere(halves()))
    # A step s blurred by σ has the slope s / (σ √(2π)); between two pixels half a pixel from either.
    slopes = [30 / np.sqrt(2 * np.pi) * np.exp(-0.125 / sigma**2) for sigma in (1, 2, 4)]
    assert response[32, 31] == pytest.approx(np.mean(slopes), rel=0.05)
    assert response[32, 5] < 0.1


def test_edges_of_colour_alone_are_seen() -> None:
    exemplar = np.full((48, 48, 3), 50.0, dtype=np.float32)
    exemplar[:, 24:, 1] = 30.0
    response = edge_response(exemplar, everywhere(exemplar))
    assert response[20].argmax() in (23, 24)


def test_holes_take_the_nearest_colour() -> None:
    exemplar = np.arange(25, dtype=np.float32).reshape(5, 5, 1)
    valid = np.ones((5, 5), dtype=bool)
    valid[:, 3:] = False
    filled = fill_holes(exemplar, valid)
    np.testing.assert_array_equal(filled[:, 3:, 0], exemplar[:, [2, 2], 0])


@pytest.mark.parametrize(
    ("exemplar", "valid", "message"),
    [
        (np.zeros((8, 8), np.float32), np.ones((8, 8), bool), "rows, cols, channels"),
        (np.zeros((8, 8, 3), np.float32), np.ones((8, 9), bool), "shape"),
        (np.zeros((8, 8, 3), np.float32), np.zeros((8, 8), bool), "no valid pixel"),
        (np.full((8, 8, 3), np.inf, np.float32), np.ones((8, 8), bool), "finite"),
    ],
)
def test_misuse_is_refused(exemplar: NDArray[np.float32], valid: Mask, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        guidance_channel(exemplar, valid)


def test_slow_shading_is_no_edge() -> None:
    shaded = np.repeat(np.linspace(20, 80, 128, dtype=np.float32)[None, :, None], 128, axis=0)
    blob = ndimage.gaussian_filter(np.pad(np.full((16, 16), 30.0), 56), 1.0)
    exemplar = (shaded + blob[..., None]).astype(np.float32)
    edges = guide(exemplar).edges
    assert edges[56:72, 56:72].any()
    assert not edges[:40].any()
