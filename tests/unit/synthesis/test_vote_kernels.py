"""Votes and choices as their plain twins make them, and a settling that never makes anything dearer."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis.patch_kernels import CHANNELS, PATCH_PX
from tilefab.synthesis.vote_kernels import (
    choose,
    choose_plain,
    seam_step,
    settle,
    tally,
    tally_plain,
    tally_weighted,
)

ROWS, COLS = 23, 27
EXEMPLAR = (19, 21)
EACH = pytest.mark.parametrize(
    ("toroidal", "stride"), [(True, 1), (True, 2), (False, 1), (False, 2)], ids=["torus", "torus/2", "flat", "flat/2"]
)


class Scene:
    """An exemplar, a field of random places of it, and where its patches begin."""

    def __init__(self, toroidal: bool, stride: int, seed: int = 3) -> None:
        random = np.random.default_rng(seed)
        self.exemplar = random.integers(-1020, 2041, (*EXEMPLAR, CHANNELS)).astype(np.int16)
        self.weights = random.integers(1, 600, EXEMPLAR)
        ends = (ROWS, COLS) if toroidal else (ROWS - PATCH_PX + 1, COLS - PATCH_PX + 1)
        self.rows_px, self.cols_px = (np.arange(0, end, stride) for end in ends)
        rows = random.integers(0, EXEMPLAR[0] - PATCH_PX + 1, (len(self.rows_px), len(self.cols_px)))
        cols = random.integers(0, EXEMPLAR[1] - PATCH_PX + 1, rows.shape)
        self.field = (rows * EXEMPLAR[1] + cols).astype(np.int32)
        self.period_rows = ROWS if toroidal else 0
        self.wide_cols = COLS + PATCH_PX - 1 if toroidal else COLS
        self.covering = tuple(
            self._covering(begins, length) for begins, length in ((self.rows_px, ROWS), (self.cols_px, COLS))
        )

    def _covering(self, begins: NDArray[np.int64], length: int) -> NDArray[np.int64]:
        found = np.full((length, PATCH_PX), -1, dtype=np.int64)
        for number, begin in enumerate(begins):
            for k in range(PATCH_PX):
                found[(begin + k) % length, k] = number
        return found

    def folded(self, sums: NDArray[np.integer]) -> NDArray[np.int64]:
        total = sums[:, :COLS].astype(np.int64)
        total[:, : self.wide_cols - COLS] += sums[:, COLS:]
        return total


def bands(edges: tuple[int, ...]) -> list[tuple[int, int]]:
    return list(pairwise(edges))


@pytest.mark.parametrize("edges", [(0, ROWS), (0, 5, 6, ROWS)])
@EACH
def test_votes_are_those_of_the_plain_twin(toroidal: bool, stride: int, edges: tuple[int, ...]) -> None:
    scene = Scene(toroidal, stride)
    expected, _ = tally_plain(
        scene.exemplar, np.ones(EXEMPLAR, np.int64), scene.field, scene.rows_px, scene.cols_px, (ROWS, COLS)
    )
    sums = np.zeros((ROWS, scene.wide_cols * CHANNELS), dtype=np.int32)
    for begin, end in bands(edges):
        tally(
            scene.exemplar.reshape(-1), EXEMPLAR[1], scene.field, scene.rows_px, scene.cols_px, scene.period_rows,
            begin, end, sums[begin:end],
        )  # fmt: skip
    assert_array_equal(scene.folded(sums.reshape(ROWS, scene.wide_cols, CHANNELS)), expected)


@pytest.mark.parametrize("edges", [(0, ROWS), (0, 5, 6, ROWS)])
@EACH
def test_weighted_votes_are_those_of_the_plain_twin(toroidal: bool, stride: int, edges: tuple[int, ...]) -> None:
    scene = Scene(toroidal, stride)
    expected, weights = tally_plain(
        scene.exemplar, scene.weights, scene.field, scene.rows_px, scene.cols_px, (ROWS, COLS)
    )
    sums = np.zeros((ROWS, scene.wide_cols * CHANNELS), dtype=np.int64)
    totals = np.zeros((ROWS, scene.wide_cols), dtype=np.int64)
    for begin, end in bands(edges):
        tally_weighted(
            scene.exemplar.reshape(-1), scene.weights.reshape(-1), EXEMPLAR[1], scene.field, scene.rows_px,
            scene.cols_px, scene.period_rows, begin, end, sums[begin:end], totals[begin:end],
        )  # fmt: skip
    assert_array_equal(scene.folded(sums.reshape(ROWS, scene.wide_cols, CHANNELS)), expected)
    assert_array_equal(scene.folded(totals[..., None])[..., 0], weights)


@pytest.mark.parametrize("grey", [False, True])
@EACH
def test_choices_are_those_of_the_plain_twin(toroidal: bool, stride: int, grey: bool) -> None:
    scene = Scene(toroidal, stride)
    if grey:  # few values, so that many pixels are equally near: the first in the exemplar is taken
        scene.exemplar = (scene.exemplar[..., :1] // 700 * np.ones(CHANNELS, dtype=np.int16)).astype(np.int16)
    mean = np.random.default_rng(8).integers(-600, 1500, (ROWS, COLS, CHANNELS)).astype(np.int16)
    if grey:
        mean //= 700
    expected = choose_plain(scene.exemplar, scene.field, scene.rows_px, scene.cols_px, mean)
    padded = np.ascontiguousarray(np.pad(mean, ((0, 3), (0, 5), (0, 0)), mode="wrap"))
    source = np.full((ROWS, COLS), -7, dtype=np.int32)
    for begin, end in bands((0, 4, ROWS)):
        choose(
            scene.exemplar.reshape(-1), EXEMPLAR[1], scene.field, padded.reshape(-1), COLS + 5, *scene.covering, begin,
            end, source,
        )  # fmt: skip
    # With a stride of two, a flat result's last column has no patch.
    covered = np.outer(*((covering >= 0).any(axis=1) for covering in scene.covering))
    assert covered.mean() > 0.9
    assert_array_equal(source[covered], expected[covered])
    assert (source[~covered] == -1).all()


def seam_step_plain(exemplar: NDArray[np.int16], here: int, there: int, down: int, right: int) -> int:
    """By coordinates: what each piece would show on the other's side, its own last pixel where it ends."""
    rows, cols = exemplar.shape[:2]

    def beside(place: int, sign: int) -> int:
        row, col = place // cols + sign * down, place % cols + sign * right
        return row * cols + col if 0 <= row < rows and 0 <= col < cols else place

    def step(first: int, second: int) -> int:
        pixels = exemplar.reshape(-1, CHANNELS).astype(np.int64)
        return int(((pixels[first] - pixels[second]) ** 2).sum())

    if beside(here, 1) == there != here:
        return 0
    return step(beside(here, 1), there) + step(beside(there, -1), here)


@pytest.mark.parametrize(("down", "right"), [(0, 1), (0, -1), (1, 0), (-1, 0)])
def test_a_seam_costs_what_both_pieces_would_have_shown(down: int, right: int) -> None:
    exemplar = np.random.default_rng(4).integers(-1020, 2041, (5, 6, CHANNELS)).astype(np.int16)
    flat = exemplar.reshape(-1)
    none = 0
    for here in range(30):
        for there in range(30):
            cost = seam_step(flat, 6, 30, here, there, down, right)
            assert cost == seam_step_plain(exemplar, here, there, down, right), (here, there)
            # From the other side it is the same seam.
            assert cost == seam_step(flat, 6, 30, there, here, -down, -right)
            none += cost == 0
    assert none == (25 if right else 24)


class Patchwork:
    """A map of places made of pieces, with everything that settling looks at."""

    def __init__(self, wraps: bool, seed: int, size: tuple[int, int] = (20, 24)) -> None:
        random = np.random.default_rng(seed)
        self.wraps = wraps
        self.exemplar = random.integers(-300, 1200, (*EXEMPLAR, CHANNELS)).astype(np.int16)
        self.valid = random.random(EXEMPLAR) < 0.93
        self.dearness = 1 + random.integers(0, 256, EXEMPLAR)
        self.mean = random.integers(-300, 1200, (*size, CHANNELS)).astype(np.int16)
        places = np.flatnonzero(self.valid)
        self.source = random.choice(places, size).astype(np.int32)
        # Some whole pieces too.
        for _ in range(4):
            row, col = random.integers(0, EXEMPLAR[0] - 6), random.integers(0, EXEMPLAR[1] - 6)
            piece = (row + np.arange(6)[:, None]) * EXEMPLAR[1] + col + np.arange(6)
            at = (random.integers(0, size[0] - 6), random.integers(0, size[1] - 6))
            inside = self.source[at[0] : at[0] + 6, at[1] : at[1] + 6]
            np.copyto(inside, piece.astype(np.int32), where=self.valid.reshape(-1)[piece])

    def settled(self, source: NDArray[np.int32], colour: int, seam_weight: int, *edges: int) -> NDArray[np.int32]:
        after = source.copy()
        for begin, end in bands((0, *edges, len(source))):
            settle(
                self.exemplar.reshape(-1), EXEMPLAR[1], self.valid.reshape(-1), self.dearness.reshape(-1),
                self.mean.reshape(-1), source.shape[1], self.wraps, seam_weight, colour, begin, end, source, after,
            )  # fmt: skip
        return after

    def cost(self, source: NDArray[np.int32], seam_weight: int) -> int:
        """Of all pixels and all seams, each seam once."""
        colours = self.exemplar.reshape(-1, CHANNELS)[source].astype(np.int64)
        total = int(((colours - self.mean) ** 2).sum())
        dearness = self.dearness.reshape(-1)
        rows, cols = source.shape
        for row in range(rows):
            for col in range(cols):
                for down, right in ((0, 1), (1, 0)):
                    i, j = row + down, col + right
                    if not self.wraps and (i == rows or j == cols):
                        continue
                    here, there = int(source[row, col]), int(source[i % rows, j % cols])
                    dear = int(max(dearness[here], dearness[there]))
                    total += seam_weight * dear * seam_step_plain(self.exemplar, here, there, down, right)
        return total


@pytest.mark.parametrize("seam_weight", [0, 1, 8])
@pytest.mark.parametrize("wraps", [True, False])
@pytest.mark.parametrize("seed", [1, 2])
def test_settling_never_makes_anything_dearer(seed: int, wraps: bool, seam_weight: int) -> None:
    patchwork = Patchwork(wraps, seed)
    source = patchwork.source
    costs = [patchwork.cost(source, seam_weight)]
    for turn in range(8):
        before, source = source, patchwork.settled(source, turn & 1, seam_weight)
        other = (np.indices(source.shape).sum(axis=0) & 1) != (turn & 1)
        assert_array_equal(source[other], before[other])
        assert patchwork.valid.reshape(-1)[source].all()
        costs.append(patchwork.cost(source, seam_weight))
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < 0.9 * costs[0]


def test_a_flat_patchwork_of_odd_size_settles_too() -> None:
    patchwork = Patchwork(False, 5, (17, 21))
    costs, source = [patchwork.cost(patchwork.source, 8)], patchwork.source
    for turn in range(6):
        source = patchwork.settled(source, turn & 1, 8)
        costs.append(patchwork.cost(source, 8))
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0]


@pytest.mark.parametrize("wraps", [True, False])
def test_bands_settle_as_the_whole_does(wraps: bool) -> None:
    patchwork = Patchwork(wraps, 6)
    for colour in (0, 1):
        whole = patchwork.settled(patchwork.source, colour, 8)
        assert_array_equal(patchwork.settled(patchwork.source, colour, 8, 1, 2, 9), whole)
        assert (whole != patchwork.source).any()


@pytest.mark.parametrize("wraps", [True, False])
def test_one_piece_stays_as_it_is(wraps: bool) -> None:
    patchwork = Patchwork(wraps, 7, EXEMPLAR)
    patchwork.valid[:] = True
    whole = np.arange(EXEMPLAR[0] * EXEMPLAR[1], dtype=np.int32).reshape(EXEMPLAR)
    patchwork.mean = patchwork.exemplar
    # A pixel from elsewhere is taken back, whatever its neighbours: they all agree on what belongs there.
    spoiled = whole.copy()
    spoiled[9, 9] = 3
    inside = (slice(1, -1), slice(1, -1))
    for colour in (0, 1):
        assert_array_equal(patchwork.settled(whole, colour, 8)[inside], whole[inside])
        spoiled = patchwork.settled(spoiled, colour, 8)
    assert_array_equal(spoiled[inside], whole[inside])
