"""Self-tuning texture optimisation: the same map from any number of threads, seamless, even, and only what is valid."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis import METHODS, Step, SynthesisRequest, SynthesisResult
from tilefab.synthesis.quilting import quilt
from tilefab.synthesis.seam_jumps import seam_jumps
from tilefab.synthesis.self_tuning import self_tuning
from tilefab.texture.lattice_error import lattice_error
from tilefab.texture.matching import matching_image
from tilefab.types import SizePx

Stone = Callable[[int, int, int], NDArray[np.float32]]
SHAPE = (72, 80)
SIZE = SizePx(96, 90)
GOLDEN = "c87722da2495a7998e9c51064ff5f964"
"""SHA-256 of the map of `test_the_map_is_pinned`, little-endian int32; its first half."""


def request_of(lab: NDArray[np.float32], size: SizePx = SIZE, **options: Any) -> SynthesisRequest:
    return SynthesisRequest(
        **{"exemplar": lab, "valid": np.ones(lab.shape[:2], bool), "size": size, "seed": 7, **options}
    )


def check(result: SynthesisResult, request: SynthesisRequest) -> None:
    assert result.source.shape == (request.size.rows, request.size.cols)
    assert result.source.dtype == np.int32
    assert request.valid.reshape(-1)[result.source].all()


@pytest.fixture(scope="module")
def grown(stone: Stone) -> SynthesisResult:
    return self_tuning(request_of(stone(*SHAPE, 1), threads=1))


def test_the_map_is_pinned(stone: Stone, grown: SynthesisResult) -> None:
    check(grown, request_of(stone(*SHAPE, 1)))
    assert grown.complete
    assert hashlib.sha256(grown.source.astype("<i4").tobytes()).hexdigest()[:32] == GOLDEN
    assert METHODS["self-tuning"] is self_tuning


@pytest.mark.parametrize("threads", [2, 4])
def test_threads_change_nothing(stone: Stone, grown: SynthesisResult, threads: int) -> None:
    assert_array_equal(self_tuning(request_of(stone(*SHAPE, 1), threads=threads)).source, grown.source)


@pytest.mark.parametrize("toroidal", [True, False])
def test_threads_change_nothing_with_everything_asked_for(stone: Stone, toroidal: bool) -> None:
    lab, (valid, weights) = stone(*SHAPE, 2), marked()
    sources = [
        self_tuning(
            request_of(
                lab, SizePx(131, 77), valid=valid, weights=weights, toroidal=toroidal, threads=threads, fast=True,
                feature_px=14,
            )
        ).source
        for threads in (1, 3)
    ]  # fmt: skip
    assert_array_equal(*sources)


def test_another_seed_gives_another_map(stone: Stone, grown: SynthesisResult) -> None:
    other = self_tuning(request_of(stone(*SHAPE, 1), seed=8))
    assert np.mean(other.source != grown.source) > 0.9


def test_no_seam_is_worse_where_the_result_repeats(stone: Stone, grown: SynthesisResult) -> None:
    lab = stone(*SHAPE, 1)
    picture = lab.reshape(-1, 3)[grown.source]
    flat = lab.reshape(-1, 3)[self_tuning(request_of(lab, toroidal=False)).source]
    for axis in (0, 1):
        for image, closes in ((picture, True), (flat, False)):
            step = np.sqrt(((np.roll(image, -1, axis=axis) - image) ** 2).sum(axis=2)).mean(axis=1 - axis)
            if closes:
                assert step[-1] <= 1.1 * step[:-1].max()
            else:
                assert step[-1] > 1.4 * step[:-1].max()


@pytest.mark.parametrize("toroidal", [True, False])
def test_seams_are_cheaper_than_a_quilts(stone: Stone, toroidal: bool) -> None:
    lab = stone(*SHAPE, 3)
    request = request_of(lab, toroidal=toroidal)
    ours, quilts = (
        seam_jumps(matching_image(lab), method(request).source, toroidal=toroidal) for method in (self_tuning, quilt)
    )
    assert np.sqrt(ours[ours > 0]).mean() < np.sqrt(quilts[quilts > 0]).mean()


def test_the_exemplar_is_shown_evenly(stone: Stone) -> None:
    lab = stone(*SHAPE, 1)
    source = self_tuning(request_of(lab, SizePx(120, 128))).source
    shown = np.bincount(source.ravel(), minlength=SHAPE[0] * SHAPE[1])
    assert np.mean(shown > 0) > 0.85
    # Each block of it about as often as any other; the edges, which fewer patches reach, a little less.
    blocks = shown.reshape(6, 12, 8, 10).sum(axis=(1, 3))
    assert blocks.max() < 3 * blocks.mean()
    assert blocks.min() > 0.2 * blocks.mean()


def marked() -> tuple[NDArray[np.bool_], NDArray[np.uint8]]:
    valid, weights = np.ones(SHAPE, dtype=bool), np.zeros(SHAPE, dtype=np.uint8)
    valid[20:26, 30:41] = valid[50, 7] = valid[71, 79] = False
    weights[45:65, 45:70] = 255
    return valid, weights


@pytest.mark.parametrize("toroidal", [True, False])
def test_holes_are_never_shown(stone: Stone, toroidal: bool) -> None:
    lab, (valid, _) = stone(*SHAPE, 4), marked()
    garish = lab.copy()
    garish[~valid] = 1000, -500, 500
    drafts = []

    def watch(step: Step) -> bool:
        if step.draft is not None:
            drafts.append(step.draft())
        return True

    request = request_of(garish, valid=valid, toroidal=toroidal, fast=not toroidal)
    result = self_tuning(request, watch)
    check(result, request)
    assert drafts
    assert all(valid.reshape(-1)[draft].all() for draft in drafts)
    # What lies in a hole is of no account.
    clean = request_of(lab, valid=valid, toroidal=toroidal, fast=not toroidal)
    assert_array_equal(self_tuning(clean).source, result.source)


def test_fewer_seams_pass_through_what_is_marked(stone: Stone) -> None:
    lab, (_, weights) = stone(*SHAPE, 5), marked()

    def seams_in_marked(request: SynthesisRequest) -> float:
        source = self_tuning(request).source
        inside = weights.reshape(-1)[source] > 0
        assert inside.mean() > 0.02
        seams = (np.roll(source, -1, axis=1) != source + 1) | (np.roll(source, -1, axis=0) != source + SHAPE[1])
        return float(seams[inside].mean())

    assert seams_in_marked(request_of(lab, weights=weights, fast=True)) < 0.7 * seams_in_marked(
        request_of(lab, fast=True)
    )


@pytest.mark.parametrize("channels", [1, 3, 5])
def test_one_colour_works(channels: int) -> None:
    request = request_of(np.full((40, 45, channels), 50.0, dtype=np.float32), SizePx(60, 70))
    result = self_tuning(request)
    check(result, request)
    assert result.complete


@pytest.mark.parametrize("channels", [1, 2, 5])
def test_any_number_of_channels_works(stone: Stone, channels: int) -> None:
    lab = np.concatenate([stone(48, 50, 1), stone(48, 50, 2)], axis=2)[..., :channels]
    request = request_of(np.ascontiguousarray(lab), SizePx(60, 70))
    check(self_tuning(request), request)


@pytest.mark.parametrize("size", [SizePx(20, 20), SizePx(60, 45), SizePx(33, 128)])
def test_a_small_exemplar_works(stone: Stone, size: SizePx) -> None:
    request = request_of(stone(16, 16, 1), size)
    result = self_tuning(request)
    check(result, request)
    assert len(np.unique(result.source)) > 100


@pytest.mark.parametrize("size", [SizePx(20, 64), SizePx(50, 31)])
def test_an_exemplar_larger_than_the_result_works(stone: Stone, size: SizePx) -> None:
    request = request_of(stone(120, 130, 1), size)
    check(self_tuning(request), request)


@pytest.mark.parametrize("size", [SizePx(1, 1), SizePx(7, 40), SizePx(19, 12)])
def test_tiny_results_need_not_repeat(stone: Stone, size: SizePx) -> None:
    request = request_of(stone(40, 44, 1), size, toroidal=False)
    check(self_tuning(request), request)
    with pytest.raises(ValueError, match="20 pixels a side"):
        self_tuning(request_of(stone(40, 44, 1), size))


def test_nothing_grows_from_crumbs(stone: Stone) -> None:
    valid = np.zeros((40, 44), dtype=bool)
    valid[5:14, :] = True
    with pytest.raises(ValueError, match="10 x 10"):
        self_tuning(request_of(stone(40, 44, 1), valid=valid))


def test_watching_changes_nothing(stone: Stone, grown: SynthesisResult) -> None:
    told: list[float] = []
    drafts: list[NDArray[np.int32]] = []

    def watch(step: Step) -> bool:
        told.append(step.share)
        if step.draft is not None:
            drafts.append(step.draft())
        return True

    result = self_tuning(request_of(stone(*SHAPE, 1)), watch)
    assert told == sorted(told)
    assert told[0] > 0
    assert told[-1] == 1.0
    assert len(told) > 10
    assert_array_equal(result.source, grown.source)
    assert_array_equal(drafts[-1], grown.source)
    assert len(drafts) > 2


@pytest.mark.parametrize("toroidal", [True, False])
@pytest.mark.parametrize("stop_at", [0.0, 0.5, 0.97])
def test_stopped_it_gives_the_last_finished_level(stone: Stone, stop_at: float, toroidal: bool) -> None:
    drafts: list[NDArray[np.int32]] = []
    told: list[float] = []

    def watch(step: Step) -> bool:
        assert not told or told[-1] < stop_at
        told.append(step.share)
        if step.draft is not None:
            drafts.append(step.draft())
        return step.share < stop_at

    lab, (valid, _) = stone(*SHAPE, 1), marked()
    request = request_of(lab, SizePx(97, 91), valid=valid, toroidal=toroidal)
    result = self_tuning(request, watch)
    check(result, request)
    assert not result.complete
    assert stop_at <= told[-1] < 1.0
    assert bool(drafts) is (stop_at > 0)
    if drafts:
        assert_array_equal(result.source, drafts[-1])


@pytest.mark.parametrize("toroidal", [True, False])
def test_a_checkerboard_keeps_its_lattice(toroidal: bool) -> None:
    rows, cols = np.indices((85, 85))
    grain = np.random.default_rng(3).normal(scale=1.5, size=(85, 85))
    board = np.where((rows // 16 + cols // 16) % 2, 80.0, 20.0) + grain
    lab = np.stack([board, np.zeros_like(board), np.zeros_like(board)], axis=2).astype(np.float32)
    result = self_tuning(request_of(lab, SizePx(192, 224), toroidal=toroidal))
    error = lattice_error(lab[..., 0], lab[..., 0].reshape(-1)[result.source])
    assert error is not None
    assert error.rms_px <= 0.6
    assert error.p95_px <= 1.0
    if toroidal:
        assert result.notes == ()
        assert self_tuning(request_of(lab, SizePx(200, 224), fast=True)).notes


def test_fast_is_another_way(stone: Stone, grown: SynthesisResult) -> None:
    request = request_of(stone(*SHAPE, 1), fast=True)
    result = self_tuning(request)
    check(result, request)
    assert result.complete
    assert (result.source != grown.source).any()
