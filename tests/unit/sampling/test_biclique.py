"""Overlaps between shifted masks, and the division into sets A and B."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.sampling.biclique import overlap_matrix, pseudo_biclique
from tilefab.sampling.tile_builder import _runs


@given(st.data())
def test_overlaps_are_those_of_the_painted_masks(data: st.DataObject) -> None:
    masks, places = [], []
    for _ in range(data.draw(st.integers(1, 4))):
        shape = data.draw(st.tuples(st.integers(1, 4), st.integers(1, 5)))
        masks.append(data.draw(hnp.arrays(bool, shape)))
        places.append(data.draw(st.tuples(st.integers(-4, 4), st.integers(-4, 4))))
    shift = data.draw(st.tuples(st.integers(-5, 5), st.integers(-5, 5)))
    runs = [_runs(mask) for mask in masks]
    result = overlap_matrix(
        np.array([p[0] for p in places]),
        np.array([p[1] for p in places]),
        np.array([m.shape[0] for m in masks]),
        np.array([m.shape[1] for m in masks]),
        np.cumsum([0] + [len(r) for r in runs]),
        np.concatenate(runs),
        *shift,
    )
    pixels = [
        {(r + int(i), c + int(j)) for i, j in np.argwhere(mask)} for mask, (r, c) in zip(masks, places, strict=True)
    ]
    for i, fixed in enumerate(pixels):
        for j, moved in enumerate(pixels):
            assert result[i, j] == bool(fixed & {(r + shift[0], c + shift[1]) for r, c in moved})


@given(hnp.arrays(bool, st.tuples(st.integers(1, 6), st.integers(1, 9))))
def test_runs_are_the_mask_in_reading_order(mask: NDArray[np.bool_]) -> None:
    runs = _runs(mask)
    painted = np.zeros(mask.shape, dtype=int)
    for row, col, length in runs:
        assert length > 0
        painted[row, col : col + length] += 1
    assert_array_equal(painted, mask.astype(int))
    assert_array_equal(runs, runs[np.lexsort((runs[:, 1], runs[:, 0]))])


@given(st.integers(1, 12), st.integers(2, 14), st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_no_member_clashes_with_one_of_the_other_set(n: int, limit: int, seed: int, density: float) -> None:
    random = np.random.default_rng(seed)
    upper = np.triu(random.random((n, n)) < density, 1)
    compatible = upper | upper.T
    before = compatible.copy()
    in_a, in_b = pseudo_biclique(compatible, limit, np.random.default_rng(seed), tries=4)
    assert_array_equal(compatible, before)
    if not compatible.any():
        assert len(in_a) == len(in_b) == 0
        return
    assert in_a.dtype == in_b.dtype == np.int64
    assert compatible[np.ix_(in_a, in_b)].all()
    assert len(in_a) > 0
    assert len(in_b) > 0
    assert len(in_a) + len(in_b) <= limit
    both = np.concatenate([in_a, in_b])
    assert len(set(both.tolist())) == len(both)
    assert_array_equal(in_a, np.sort(in_a))
    assert_array_equal(in_b, np.sort(in_b))
    if len(both) < limit:
        # It ends early only where neither set can grow.
        rest = np.setdiff1d(np.arange(n), both)
        assert not compatible[np.ix_(rest, in_b)].all(axis=1).any()
        assert not compatible[np.ix_(rest, in_a)].all(axis=1).any()


def test_all_compatible_divide_evenly_up_to_the_limit() -> None:
    compatible = ~np.eye(20, dtype=bool)
    in_a, in_b = pseudo_biclique(compatible, 9, np.random.default_rng(0))
    assert sorted((len(in_a), len(in_b))) == [4, 5]


def test_the_same_stream_gives_the_same_division() -> None:
    upper = np.triu(np.random.default_rng(5).random((30, 30)) < 0.7, 1)
    first, second = (pseudo_biclique(upper | upper.T, 20, np.random.default_rng(6)) for _ in range(2))
    assert_array_equal(first[0], second[0])
    assert_array_equal(first[1], second[1])
