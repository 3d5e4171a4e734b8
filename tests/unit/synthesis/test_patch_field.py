"""Fields of patches: any number of threads, from a map and back to one, offsets that keep their shapes."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis.patch_field import WEIGHT_UNIT, PatchField, Workers, nearest_allowed
from tilefab.synthesis.patch_kernels import PATCH_PX
from tilefab.synthesis.pyramid import Scale, features, scales
from tilefab.synthesis.usage import NO_SHIFTS, Usage, UsageOptions
from tilefab.synthesis.vote_kernels import choose_plain, tally_plain
from tilefab.types import SizePx

Stone = Callable[[int, int, int], NDArray[np.float32]]
SHAPE = (90, 110)
ALONE = Workers(1)


@pytest.fixture(scope="module")
def found(stone: Stone) -> list[Scale]:
    return scales_of(stone(*SHAPE, 1), np.ones(SHAPE, dtype=bool))


@pytest.fixture(scope="module")
def with_holes(stone: Stone) -> list[Scale]:
    valid = np.ones(SHAPE, dtype=bool)
    valid[40:44, 50:57] = valid[10, 90] = False
    return scales_of(stone(*SHAPE, 1), valid)


def scales_of(lab: NDArray[np.float32], valid: NDArray[np.bool_]) -> list[Scale]:
    return scales(features(lab, None, 0.0), valid, None, None)


def random_map(scale: Scale, size: SizePx, seed: int) -> NDArray[np.int32]:
    places = np.flatnonzero(scale.valid)
    return np.random.default_rng(seed).choice(places, (size.rows, size.cols)).astype(np.int32)


@pytest.mark.parametrize("rows", [1, 5, 16, 33, 640])
@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_bands_make_up_all_rows(threads: int, rows: int) -> None:
    workers, done, lock = Workers(threads), [], threading.Lock()

    def work(begin: int, end: int) -> None:
        with lock:
            done.extend(range(begin, end))

    workers.over(rows, work)
    workers.close()
    assert sorted(done) == list(range(rows))


def test_what_goes_wrong_in_a_thread_is_told() -> None:
    workers = Workers(2)

    def work(begin: int, end: int) -> None:
        raise ZeroDivisionError(f"{begin}")

    with pytest.raises(ZeroDivisionError):
        workers.over(100, work)
    workers.close()


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("toroidal", [True, False])
def test_all_threads_find_the_same(found: list[Scale], toroidal: bool, stride: int) -> None:
    scale, size = found[0], SizePx(151, 133)
    results = []
    for threads in (1, 2, 5):
        workers = Workers(threads)
        field = PatchField(scale, size, toroidal, stride, workers)
        field.start_from(random_map(scale, size, 3))
        usage = Usage(scale.allowed, UsageOptions())
        target = field.vote()
        for colour in (0, 1):
            prices = usage.prices(field.places, raise_prices=True)
            shifts = usage.shifts(field.places) if colour else NO_SHIFTS
            field.search(target, prices, shifts, colour, np.uint64(11 + colour), 3)
        weighted = field.vote(np.random.default_rng(1).integers(1, 500, scale.valid.shape))
        results.append((field.places, field.difference, target, weighted, field.chosen(weighted, 2, 8)))
        workers.close()
    for other in results[1:]:
        for one, another in zip(results[0], other, strict=True):
            assert_array_equal(one, another)


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("size", [SizePx(40, 53), SizePx(41, 52), SizePx(20, 20)])
def test_every_pixel_has_votes(found: list[Scale], size: SizePx, stride: int) -> None:
    for toroidal in (True, False):
        field = PatchField(found[0], size, toroidal, stride, ALONE)
        field.start_from(random_map(found[0], size, 4))
        target = field.vote()
        extra = PATCH_PX - 1 if toroidal else 0
        assert target.shape[0] >= size.rows + extra
        assert target.shape[1] >= size.cols + extra
        assert target.shape[0] <= size.rows + extra + (stride - 1)
        assert target.flags.c_contiguous
        source = field.chosen(target, 0, 8)
        assert source.shape == (size.rows, size.cols)
        assert source.min() >= 0


@pytest.mark.parametrize("stride", [1, 2])
def test_votes_are_rounded_means_of_the_patches(found: list[Scale], stride: int) -> None:
    scale, size = found[0], SizePx(31, 28)
    field = PatchField(scale, size, True, stride, ALONE)
    field.start_from(random_map(scale, size, 5))
    weights = np.random.default_rng(2).integers(1, 9 * WEIGHT_UNIT, scale.valid.shape)
    for given in (None, weights):
        base = np.ones_like(weights) if given is None else given
        sums, totals = tally_plain(scale.image, base, field.places, field.rows_px, field.cols_px, (31, 28))
        mean = np.floor(sums / totals[..., None] + 0.5).astype(np.int16)
        target = field.vote(given)
        assert_array_equal(target[:31, :28], mean)
        assert_array_equal(target, np.pad(mean, ((0, 9), (0, 9), (0, 0)), mode="wrap"))
    chosen = choose_plain(scale.image, field.places, field.rows_px, field.cols_px, target[:31, :28])
    assert_array_equal(field.chosen(target, 0, 8), chosen)


def test_equal_weights_are_no_weights(found: list[Scale]) -> None:
    field = PatchField(found[0], SizePx(40, 45), True, 1, ALONE)
    field.start_from(random_map(found[0], field.size, 6))
    assert_array_equal(field.vote(np.full(found[0].valid.shape, WEIGHT_UNIT)), field.vote())


@pytest.mark.parametrize("stride", [1, 2])
def test_the_exemplar_itself_comes_back(found: list[Scale], stride: int) -> None:
    size = SizePx(*SHAPE)
    whole = np.arange(SHAPE[0] * SHAPE[1], dtype=np.int32).reshape(SHAPE)
    field = PatchField(found[0], size, False, stride, ALONE)
    field.start_from(whole)
    expected = field.rows_px[:, None] * SHAPE[1] + field.cols_px
    assert_array_equal(field.places, expected)
    target = field.vote()
    assert_array_equal(target, found[0].image)
    # Equal colours may be taken from elsewhere; settling puts them back where they belong.
    assert_array_equal(found[0].image.reshape(-1, 4)[field.chosen(target, 0, 8)], found[0].image)
    assert np.mean(field.chosen(target, 3, 8) == whole) > 0.98


@pytest.mark.parametrize("toroidal", [True, False])
def test_only_allowed_patches_are_begun_with(with_holes: list[Scale], toroidal: bool) -> None:
    scale, size = with_holes[0], SizePx(50, 60)
    field = PatchField(scale, size, toroidal, 1, ALONE)
    field.start_from(random_map(scale, size, 7))
    assert scale.allowed.reshape(-1)[field.places].all()
    usage = Usage(scale.allowed, UsageOptions())
    target = field.vote()
    for colour in (0, 1):
        field.search(target, usage.prices(field.places, raise_prices=False), NO_SHIFTS, colour, np.uint64(3), 6)
    assert scale.allowed.reshape(-1)[field.places].all()
    assert scale.valid.reshape(-1)[field.chosen(field.vote(), 4, 8)].all()
    for other in with_holes[1:3]:
        assert other.valid.reshape(-1)[field.shown_at(other, SizePx(53, 66))].all()


def test_searching_brings_patches_nearer(found: list[Scale]) -> None:
    scale, size = found[0], SizePx(60, 60)
    field = PatchField(scale, size, True, 1, ALONE)
    field.start_from(random_map(scale, size, 8))
    usage = Usage(scale.allowed, UsageOptions(price=0.0, barrier=0.0, gain=0.0))
    target, totals = field.vote(), []
    for number in range(4):
        for colour in (0, 1):
            prices = usage.prices(field.places, raise_prices=False)
            field.search(target, prices, NO_SHIFTS, colour, np.uint64(number * 2 + colour), 4)
        totals.append(int(field.difference.sum()))
    assert totals == sorted(totals, reverse=True)
    assert totals[-1] < 0.8 * totals[0]


def offsets(source: NDArray[np.int32], cols: int) -> NDArray[np.int64]:
    """Where each pixel lies in the exemplar, seen from where it lies in the result."""
    rows, columns = np.divmod(source.astype(np.int64), cols)
    return np.stack([rows - np.arange(source.shape[0])[:, None], columns - np.arange(source.shape[1])], axis=2)


@pytest.mark.parametrize("stride", [1, 2])
def test_one_piece_is_still_one_at_a_finer_scale(found: list[Scale], stride: int) -> None:
    fine, coarse = found[0], found[2]
    size = SizePx(coarse.valid.shape[0] - 4, coarse.valid.shape[1] - 6)
    field = PatchField(coarse, size, False, stride, ALONE)
    whole = np.arange(coarse.valid.size, dtype=np.int32).reshape(coarse.valid.shape)
    field.start_from(whole[3:-1, 4:-2])
    ratios = [f / c for f, c in zip(fine.valid.shape, coarse.valid.shape, strict=True)]
    large = SizePx(*(round(side * ratio) for side, ratio in zip((size.rows, size.cols), ratios, strict=True)))
    shown = field.shown_at(fine, large)
    assert shown.dtype == np.int32
    moved = offsets(shown, SHAPE[1])
    assert np.unique(moved.reshape(-1, 2), axis=0).tolist() == [[round(3 * ratios[0]), round(4 * ratios[1])]]


def test_pieces_keep_their_borders_at_a_finer_scale(found: list[Scale]) -> None:
    fine, coarse = found[0], found[1]
    size = SizePx(40, 40)
    field = PatchField(coarse, size, False, 1, ALONE)
    whole = np.arange(coarse.valid.size, dtype=np.int32).reshape(coarse.valid.shape)
    field.start_from(np.concatenate([whole[20:60, 30:50], whole[5:45, 20:40]], axis=1))
    shown = field.shown_at(fine, SizePx(52, 52))
    moved = offsets(shown, SHAPE[1])
    kinds = np.unique(moved.reshape(-1, 2), axis=0)
    assert len(kinds) == 2
    # Two pieces, side by side, with the border where it was.
    left = (moved == moved[0, 0]).all(axis=2)
    assert_array_equal(left, np.broadcast_to(np.arange(52) < left[0].sum(), (52, 52)))
    assert abs(int(left[0].sum()) - 26) <= 1
    ratio_down, ratio_right = (f / c for f, c in zip(fine.valid.shape, coarse.valid.shape, strict=True))
    assert moved[0, 0].tolist() == [round(20 * ratio_down), round(30 * ratio_right)]
    assert moved[0, -1].tolist() == [round(5 * ratio_down), 0]


@pytest.mark.parametrize("toroidal", [True, False])
def test_a_map_survives_being_started_from(found: list[Scale], toroidal: bool) -> None:
    scale, size = found[0], SizePx(44, 48)
    first = PatchField(scale, size, toroidal, 1, ALONE)
    # Pieces larger than a patch, well inside the exemplar.
    whole = np.arange(scale.valid.size, dtype=np.int32).reshape(SHAPE)
    source = np.block([[whole[20:42, 30:54], whole[60:82, 20:44]], [whole[24:46, 70:94], whole[50:72, 60:84]]])
    first.start_from(source)
    again = PatchField(scale, size, toroidal, 1, ALONE)
    again.start_from(first.shown_at(scale, size))
    if toroidal:
        assert np.mean(again.places == first.places) > 0.7
    else:
        assert_array_equal(again.places, first.places)


def test_the_nearest_allowed_is_near() -> None:
    allowed = np.zeros((9, 12), dtype=bool)
    allowed[2, 3] = allowed[7, 9] = True
    rows, cols = nearest_allowed(allowed)
    for row, col in np.ndindex(9, 12):
        first, second = (row - 2) ** 2 + (col - 3) ** 2, (row - 7) ** 2 + (col - 9) ** 2
        if first != second:
            assert (rows[row, col], cols[row, col]) == ((2, 3) if first < second else (7, 9))
