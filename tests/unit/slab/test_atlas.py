"""The atlas: every pixel traceable, slabs apart, packing compact and repeatable."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from tilefab.slab.atlas import SlabPlacement, build_atlas, locate, pack
from tilefab.types import SizePx

SIZES = st.lists(st.tuples(st.integers(1, 30), st.integers(1, 30)), min_size=1, max_size=8)


def slabs(sizes: list[tuple[int, int]]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    rng = np.random.default_rng(7)
    labs = [(100 * rng.random((rows, cols, 3))).astype(np.float32) for rows, cols in sizes]
    return labs, [np.ones(lab.shape[:2], np.bool_) for lab in labs]


@given(SIZES, st.integers(1, 4))
@settings(max_examples=60, deadline=None)
def test_every_pixel_is_traceable_and_slabs_stay_apart(sizes: list[tuple[int, int]], gap_px: int) -> None:
    labs, valids = slabs(sizes)
    lab, valid, record = build_atlas(labs, valids, gap_px)
    assert valid.shape == (record.size.rows, record.size.cols) == lab.shape[:2]
    assert int(valid.sum()) == sum(rows * cols for rows, cols in sizes)
    assert [place.slab_index for place in record.placements] == list(range(len(sizes)))
    for place in record.placements:
        inner = np.s_[place.row : place.row + place.rows, place.col : place.col + place.cols]
        assert_array_equal(lab[inner], labs[place.slab_index])
        corner = (place.row + place.rows - 1, place.col + place.cols - 1)
        assert locate(record.placements, *corner) == (place.slab_index, place.rows - 1, place.cols - 1)
    pieces = ndimage.label(valid, np.ones((3, 3)))[1]
    assert pieces == len(sizes)
    assert build_atlas(labs, valids, gap_px)[2] == record


@given(SIZES)
@settings(max_examples=60, deadline=None)
def test_gap_holds_in_both_directions(sizes: list[tuple[int, int]]) -> None:
    _, places = pack([SizePx(*size) for size in sizes], 3)
    for i, one in enumerate(places):
        for other in places[:i]:
            rows_apart = max(other.row - (one.row + one.rows), one.row - (other.row + other.rows))
            cols_apart = max(other.col - (one.col + one.cols), one.col - (other.col + other.cols))
            assert max(rows_apart, cols_apart) >= 3


def test_one_slab_is_its_own_atlas() -> None:
    labs, valids = slabs([(5, 9)])
    valids[0][2, 3] = False
    lab, valid, record = build_atlas(labs, valids)
    assert_array_equal(lab, labs[0])
    assert_array_equal(valid, valids[0])
    assert record.padding_frac == 0.0
    assert record.summary.startswith("nothing, because")


def test_equal_slabs_waste_only_their_gaps() -> None:
    size, places = pack([SizePx(100, 60)] * 4, 1)
    assert size.rows * size.cols <= 1.02 * 4 * 6000
    assert len({(place.row, place.col) for place in places}) == 4


def test_slabs_of_mixed_sizes_fill_most_of_the_atlas() -> None:
    sizes = [SizePx(100, 60), SizePx(90, 70), SizePx(40, 130), SizePx(100, 66), SizePx(38, 60)]
    size, _ = pack(sizes, 1)
    assert sum(s.rows * s.cols for s in sizes) / (size.rows * size.cols) > 0.75


def test_padding_is_invalid_and_of_mean_colour() -> None:
    labs, valids = slabs([(10, 4), (3, 5)])
    lab, valid, record = build_atlas(labs, valids)
    mean = np.mean([slab.reshape(-1, 3).mean(axis=0) for slab in labs], axis=0)
    assert_allclose(lab[~valid], np.broadcast_to(mean, lab[~valid].shape), rtol=1e-4)
    row, col = np.argwhere(~valid)[0]
    assert locate(record.placements, int(row), int(col)) is None
    assert locate(record.placements, -1, 0) is None
    assert "padding" in record.summary


def test_placements_compare_by_value() -> None:
    assert pack([SizePx(2, 3)], 1) == (SizePx(2, 3), (SlabPlacement(0, 0, 0, 2, 3),))


def test_refuses_misuse() -> None:
    labs, valids = slabs([(4, 4), (3, 3)])
    with pytest.raises(ValueError, match="at least one"):
        build_atlas([], [])
    with pytest.raises(ValueError, match="masks"):
        build_atlas(labs, valids[:1])
    with pytest.raises(ValueError, match="apart"):
        build_atlas(labs, valids, 0)
    with pytest.raises(ValueError, match="no pixel"):
        build_atlas(labs, [valids[0], ~valids[1]])
