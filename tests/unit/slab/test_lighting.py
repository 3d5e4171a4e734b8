"""Lighting: taken out where it is, left where the stone made it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tilefab.slab.lighting import estimate_lighting, lighting_log_gain, remove_lighting

ROWS, COLS = 360, 480
WHITE = np.array([0.9642, 1.0, 0.8249])


def clouds(seed: int, slope: float, from_cycles: float = 0.0) -> np.ndarray:
    """A quarter of a random field whose power falls with frequency ** -slope; standard deviation about 1."""
    field = np.fft.fft2(np.random.default_rng(seed).standard_normal((2 * ROWS, 2 * COLS)))
    row, col = np.fft.fftfreq(2 * ROWS) * 2 * ROWS, np.fft.fftfreq(2 * COLS) * 2 * COLS
    cycles = np.hypot(row[:, None], col[None, :])
    cycles[0, 0] = np.inf
    field *= np.where(cycles >= from_cycles, cycles ** (-slope / 2), 0.0)
    light = np.fft.ifft2(field).real
    return (light / light.std())[:ROWS, :COLS]


def grain(seed: int) -> np.ndarray:
    return 0.08 * clouds(seed, 1.0, 40.0)


def stone(log_y: np.ndarray, tint: np.ndarray | float = 0.0) -> np.ndarray:
    colour = np.asarray(tint)[..., None] * np.array([-0.02, 0.0, -0.15])
    return (0.4 * WHITE * np.exp(log_y[..., None] + colour)).astype(np.float32)


def flat(seed: int) -> np.ndarray:
    return stone(grain(seed))


def veined(seed: int) -> np.ndarray:
    """Grey marble whose dark veins are denser in some parts."""
    veins = np.exp(-((clouds(seed, 2.6) / (0.06 * np.exp(0.9 * clouds(seed + 3, 3.0)))) ** 2))
    return stone(-0.9 * veins + grain(seed + 1))


def patched(seed: int) -> np.ndarray:
    """Stone with large areas half as bright again and of a warmer colour."""
    area = 1.0 / (1.0 + np.exp(-8.0 * clouds(seed, 3.2)))
    return stone(0.5 * area + grain(seed + 1), 0.7 * area)


def cloudy(seed: int) -> np.ndarray:
    """The hardest: soft clouds of pure grey with one contrast throughout, just as lighting would be."""
    return stone(0.3 * clouds(seed, 3.0) + grain(seed + 1))


def vignette() -> np.ndarray:
    y, x = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLS), indexing="ij")
    gain = np.log(1.0 - 0.15 * (x**2 + y**2)) + 0.04 * x
    return gain - gain.mean()


def lit(image: np.ndarray, log_gain: np.ndarray) -> np.ndarray:
    return (image * np.exp(log_gain)[..., None]).astype(np.float32)


def all_valid(count: int = 1) -> list[np.ndarray]:
    return [np.ones((ROWS, COLS), np.bool_)] * count


def error_of(images: list[np.ndarray], log_gain: np.ndarray) -> float:
    """Root mean square error of the estimated log gain."""
    model = estimate_lighting(images, all_valid(len(images)))
    return float(np.std(lighting_log_gain(model, (ROWS, COLS), slice(None)) - log_gain))


def test_a_vignette_on_flat_stone_is_removed() -> None:
    assert np.std(vignette()) == pytest.approx(0.076, abs=0.005)
    assert error_of([lit(flat(1), vignette())], vignette()) < 0.008


@pytest.mark.parametrize("make", [veined, patched])
@pytest.mark.parametrize("seed", [0, 20])
def test_a_large_pattern_without_lighting_is_left_alone(make, seed: int) -> None:
    assert error_of([make(seed)], np.zeros((ROWS, COLS))) < 0.004


@pytest.mark.parametrize("make", [veined, patched])
@pytest.mark.parametrize("seed", [0, 20])
def test_lighting_is_taken_out_of_a_large_pattern(make, seed: int) -> None:
    assert error_of([lit(make(seed), vignette())], vignette()) < 0.035


def test_grey_clouds_are_not_eaten() -> None:
    errors = [error_of([cloudy(seed)], np.zeros((ROWS, COLS))) for seed in (0, 10, 20, 30)]
    own = [np.std(np.log(cloudy(seed)[..., 1])) for seed in (0, 10, 20, 30)]
    assert np.mean(errors) < 0.1 * np.mean(own)


def test_what_scans_have_in_common_stands_out() -> None:
    scans = [lit(make(seed), vignette()) for make in (veined, patched) for seed in (0, 10, 20)]
    assert error_of(scans, vignette()) < 0.012
    assert error_of([cloudy(seed) for seed in (0, 10, 20, 30)], np.zeros((ROWS, COLS))) < 0.03


def test_removal_keeps_the_mean_luminance_and_the_colour() -> None:
    image = lit(patched(5), vignette())
    valid = all_valid()[0].copy()
    valid[:40, :60] = False
    model = estimate_lighting([image], [valid])
    out, out_valid, record = remove_lighting(image, valid, model)
    assert_array_equal(out_valid, valid)
    assert out.dtype == np.float32
    assert float(out[valid][:, 1].mean(dtype=np.float64)) == pytest.approx(record.mean_y, rel=1e-5)
    assert float(image[valid][:, 1].mean(dtype=np.float64)) == pytest.approx(record.mean_y, rel=1e-6)
    assert_allclose(out[..., 2] / out[..., 1], image[..., 2] / image[..., 1], rtol=1e-4)
    assert record.removed
    assert 0.3 < record.unevenness_frac < 0.7
    assert "% removed" in record.summary


def test_masked_surround_does_not_count() -> None:
    image = flat(3)
    image[:, :50] = 0.002
    valid = all_valid()[0].copy()
    valid[:, :50] = False
    model = estimate_lighting([image], [valid])
    assert not any(model.coefficients)


def test_nothing_is_done_without_lighting() -> None:
    image, valid = flat(2), all_valid()[0]
    model = estimate_lighting([image], [valid])
    out, _, record = remove_lighting(image, valid, model)
    assert_array_equal(out, image)
    assert out is image
    assert not record.removed
    assert record.summary == "nothing, because no lighting stands out from the stone's own pattern"


def test_bands_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    image, valid = lit(flat(2), vignette()), all_valid()[0]
    model = estimate_lighting([image], [valid])
    whole = remove_lighting(image, valid, model)[0]
    monkeypatch.setattr("tilefab.slab.lighting._BAND_ROWS", 37)
    assert_allclose(remove_lighting(image, valid, model)[0], whole, rtol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (30, 200), (50, 60)])
def test_tiny_and_black_scans_do_no_harm(shape: tuple[int, int]) -> None:
    valid = np.ones(shape, np.bool_)
    for value in (0.0, 0.4):
        image = np.full((*shape, 3), value, np.float32)
        model = estimate_lighting([image], [valid])
        out, _, record = remove_lighting(image, valid, model)
        assert_array_equal(out, image)
        assert record.summary.startswith("nothing, because")


def test_a_scan_masked_for_the_most_part_is_not_judged() -> None:
    valid = np.zeros((ROWS, COLS), np.bool_)
    valid[:, : COLS // 2] = True
    model = estimate_lighting([lit(flat(1), vignette())], [valid])
    assert not any(model.coefficients)
    assert "masked" in model.reason


def test_refuses_misuse() -> None:
    image, valid = flat(1), all_valid()[0]
    with pytest.raises(ValueError, match="at least one"):
        estimate_lighting([], [])
    with pytest.raises(ValueError, match="masks"):
        estimate_lighting([image], [])
    with pytest.raises(ValueError, match="nearly the same size"):
        estimate_lighting([image, image[:200].copy()], [valid, valid[:200].copy()])
    with pytest.raises(ValueError, match="no pixel"):
        remove_lighting(image, ~valid, estimate_lighting([image], [valid]))


@pytest.mark.parametrize("make", [veined, patched, cloudy])
def test_two_scans_of_one_pattern_are_no_better_evidence_than_one(make) -> None:
    image = make(3)
    alone = estimate_lighting([image], all_valid())
    twice = estimate_lighting([image, image.copy()], all_valid(2))
    assert np.abs(twice.coefficients).max() <= np.abs(alone.coefficients).max() + 1e-12


def test_scans_that_disagree_share_no_lighting() -> None:
    model = estimate_lighting([lit(flat(1), vignette()), flat(2)], all_valid(2))
    assert not any(model.coefficients)
    assert any(estimate_lighting([lit(flat(1), vignette()), lit(flat(2), vignette())], all_valid(2)).coefficients)
