"""Bands and threads: they change nothing, and nothing is written to that was only given to read."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tilefab.slab import bands as module
from tilefab.slab import lighting, squaring
from tilefab.slab.bands import over_bands
from tilefab.slab.lighting import LightingModel, remove_lighting
from tilefab.slab.match import SlabColour, match_slabs
from tilefab.slab.resampling import resample
from tilefab.slab.squaring import SquaringOptions, square_slab

TILTED = LightingModel((0.1, -0.05, 0.02, 0.01, 0.03), (0.0,) * 5, (0.0,) * 5, 1, "")


def picture() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    image = np.full((300, 340, 3), 0.01, np.float32)
    image[30:270, 25:310] = rng.uniform(0.2, 0.7, (240, 285, 1)).astype(np.float32) * (0.96, 1.0, 0.82)
    return image, rng.random(image.shape[:2]) > 0.001


@pytest.mark.parametrize("rows", [0, 1, 7, 8, 9])
@pytest.mark.parametrize("threads", [1, 3])
def test_bands_cover_all_rows_in_order(rows: int, threads: int) -> None:
    covered = over_bands(lambda band: list(range(band.start, band.stop)), rows, 4, threads)
    assert [row for band in covered for row in band] == list(range(rows))
    assert all(len(band) <= 4 for band in covered)


def test_there_must_be_a_thread() -> None:
    with pytest.raises(ValueError, match="1 or more"):
        over_bands(lambda band: band, 4, 2, 0)


def test_what_fails_in_a_thread_is_told() -> None:
    def fail(band: slice) -> None:
        raise ArithmeticError(f"rows {band.start}")

    with pytest.raises(ArithmeticError, match="rows 0"):
        over_bands(fail, 4, 2, 2)


def test_threads_don_t_show(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(squaring, "_BAND_ROWS", 16)
    monkeypatch.setattr(lighting, "_BAND_ROWS", 16)
    image, valid = picture()
    before, before_valid = image.copy(), valid.copy()
    labs = [100 * image, 80 * image[:200]]
    masks = [valid, valid[:200]]
    for one, three in (
        (square_slab(image, valid, SquaringOptions(5)), square_slab(image, valid, SquaringOptions(5), threads=3)),
        (resample(image, valid, 0.7), resample(image, valid, 0.7, threads=3)),
        (remove_lighting(image, valid, TILTED), remove_lighting(image, valid, TILTED, threads=3)),
    ):
        assert_array_equal(three[0], one[0])
        assert_array_equal(three[1], one[1])
        assert three[2] == one[2]
        assert not np.shares_memory(one[0], image)
    for a, b in zip(match_slabs(labs, masks)[0], match_slabs(labs, masks, threads=3)[0], strict=True):
        assert_array_equal(a, b)
    assert_array_equal(image, before)
    assert_array_equal(valid, before_valid)


def test_lighting_is_removed_in_place_if_asked_for() -> None:
    image, valid = picture()
    apart, _, record = remove_lighting(image, valid, TILTED)
    out, _, same = remove_lighting(image, valid, TILTED, out=image)
    assert out is image
    assert_array_equal(image, apart)
    assert same == record


def test_slabs_are_matched_in_place_if_asked_for() -> None:
    image, valid = picture()
    lab = 100 * image
    apart, records = match_slabs([lab], [valid], SlabColour((50.0, 3.0, 7.0)))
    assert apart[0] is not lab
    out, same = match_slabs([lab], [valid], SlabColour((50.0, 3.0, 7.0)), in_place=True)
    assert out[0] is lab
    assert_array_equal(lab, apart[0])
    assert same == records


def test_examples() -> None:
    assert doctest.testmod(module).failed == 0
