"""Graphcut textures: cheap seams, honest repeats, only what is valid, the same texture every time."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis import graphcut_canvas, graphcut_places
from tilefab.synthesis.graphcut import GraphcutOptions, _Grower, graphcut
from tilefab.synthesis.graphcut_canvas import Canvas, Exemplar, Placement, gradients
from tilefab.synthesis.graphcut_kernels import UNSET
from tilefab.synthesis.protocol import Step, SynthesisRequest
from tilefab.synthesis.quilting import quilt
from tilefab.texture.matching import TemplateSearch, matching_image, overlap_differences
from tilefab.texture.seam_cost import seam_cost
from tilefab.types import SizePx

Stone = Callable[[int, int, int], NDArray[np.float32]]
SIZE = SizePx(64, 80)


def request_of(lab: NDArray[np.float32], size: SizePx = SIZE, **options: Any) -> SynthesisRequest:
    return SynthesisRequest(
        **{"exemplar": lab, "valid": np.ones(lab.shape[:2], bool), "size": size, "seed": 7, **options}
    )


def grown(request: SynthesisRequest, **options: Any) -> _Grower:
    grower = _Grower(request, GraphcutOptions(**options))
    grower.grow(lambda _: True)
    return grower


def digest(source: NDArray[np.int32]) -> str:
    return hashlib.sha256(source.astype("<i4").tobytes()).hexdigest()[:32]


@pytest.mark.parametrize("toroidal", [True, False])
@pytest.mark.parametrize("seed", [1, 2])
def test_seams_are_cheaper_than_a_quilts(stone: Stone, seed: int, toroidal: bool) -> None:
    lab = stone(96, 112, seed)
    request = request_of(lab, SizePx(110, 130), seed=seed, toroidal=toroidal)
    ours, quilts = (seam_cost(m(request).source, lab, toroidal=toroidal) for m in (graphcut, quilt))
    assert ours.mean_delta_e < 0.93 * quilts.mean_delta_e


def test_the_texture_is_pinned(stone: Stone) -> None:
    result = graphcut(request_of(stone(96, 112, 1)))
    assert result.complete
    assert result.source.shape == (64, 80)
    assert result.source.dtype == np.int32
    assert digest(result.source) == "3325c8813a4f50702aba43011765f2e2"


@pytest.mark.parametrize("toroidal", [True, False])
def test_a_torus_closes(stone: Stone, toroidal: bool) -> None:
    lab = stone(96, 112, 1)
    picture = lab.reshape(-1, 3)[graphcut(request_of(lab, toroidal=toroidal)).source]
    for axis in (0, 1):
        step = np.sqrt(((np.roll(picture, -1, axis=axis) - picture) ** 2).sum(axis=2)).mean(axis=1 - axis)
        if toroidal:
            assert step[-1] <= 1.35 * np.median(step[:-1])
        else:
            assert step[-1] > 2 * np.median(step[:-1])


@pytest.mark.parametrize("placement", ["sub-patch", "entire-patch", "random"])
@pytest.mark.parametrize("toroidal", [True, False])
def test_costs_and_uses_are_kept_count_of(stone: Stone, placement: str, toroidal: bool) -> None:
    lab, valid = stone(50, 44, 3), np.ones((50, 44), dtype=bool)
    valid[20:23, 9:14] = valid[40, 30] = False
    request = request_of(lab, SizePx(71, 66), valid=valid, toroidal=toroidal, feature_px=13)
    grower = grown(request, placement=placement)
    canvas = grower.canvas
    assert valid.ravel()[canvas.source].all()
    padded = np.pad(canvas.source, (0, 1), mode="wrap")
    anew = canvas.exemplar.costs(padded)[:-1, :-1] if toroidal else canvas.exemplar.costs(canvas.source)
    assert_array_equal(canvas.costs, anew)
    assert_array_equal(grower.cells, grower._cell_costs(*(np.arange(n) for n in grower.cells.shape)))
    assert grower.cells.sum() == anew.sum()
    assert canvas._total_cost == anew.sum()
    assert canvas._seam_px == np.count_nonzero(anew)
    assert_array_equal(canvas._usage, np.bincount(canvas.source.ravel(), minlength=50 * 44))


def test_entire_patches_continue_a_regular_texture() -> None:
    row, col = np.indices((40, 44))
    lab = np.zeros((40, 44, 3), dtype=np.float32)
    lab[..., 0] = np.where((row // 7 + col // 8) % 2, 80, 20)
    result = graphcut(request_of(lab, SizePx(98, 96)), options=GraphcutOptions("entire-patch"))
    picture = lab[..., 0].ravel()[result.source]
    begin = divmod(int(result.source[0, 0]), 44)
    row, col = np.indices((98, 96))
    expected = np.where(((row + begin[0]) // 7 + (col + begin[1]) // 8) % 2, 80, 20)
    assert_array_equal(picture, expected)
    assert (
        np.mean(
            lab[..., 0].ravel()[graphcut(request_of(lab, SizePx(98, 96)), options=GraphcutOptions("random")).source]
            == expected
        )
        < 0.9
    )


def test_same_request_same_texture_another_seed_another(stone: Stone) -> None:
    lab = stone(60, 64, 2)
    first = graphcut(request_of(lab, threads=1)).source
    assert_array_equal(graphcut(request_of(lab.copy(), threads=4)).source, first)
    assert np.mean(graphcut(request_of(lab, seed=8)).source == first) < 0.2


@pytest.mark.parametrize("shape", [(16, 16), (16, 40), (5, 9), (1, 1)])
@pytest.mark.parametrize("size", [SizePx(1, 1), SizePx(2, 30), SizePx(17, 16), SizePx(50, 21)])
@pytest.mark.parametrize("toroidal", [True, False])
def test_small_exemplars_and_outputs(stone: Stone, shape: tuple[int, int], size: SizePx, toroidal: bool) -> None:
    lab = stone(*shape, 4)
    source = graphcut(request_of(lab, size, toroidal=toroidal)).source
    assert source.shape == (size.rows, size.cols)
    assert 0 <= source.min() <= source.max() < shape[0] * shape[1]


def test_one_colour() -> None:
    lab = np.full((24, 20, 3), (62.0, 1.5, 7.0), dtype=np.float32)
    source = graphcut(request_of(lab)).source
    assert seam_cost(source, lab).mean_delta_e == 0.0


@pytest.mark.parametrize("channels", [1, 2, 5])
def test_any_number_of_channels(stone: Stone, channels: int) -> None:
    lab = np.concatenate([stone(60, 64, 2), stone(60, 64, 3)], axis=2)[:, :, :channels]
    source = graphcut(request_of(np.ascontiguousarray(lab))).source
    at_random = np.random.default_rng(1).permutation(60 * 64)[: source.size % 3840].astype(np.int32).reshape(-1, 10)
    assert seam_cost(source, lab).mean_delta_e < 0.5 * seam_cost(at_random, lab).mean_delta_e


def test_patches_shrink_to_fit_the_mask(stone: Stone) -> None:
    lab, valid = stone(90, 100, 4), np.zeros((90, 100), dtype=bool)
    valid[40:53, 10:90] = True
    lab[~valid] = (100, 100, -100)
    result = graphcut(request_of(lab, SizePx(40, 44), valid=valid))
    assert valid.ravel()[result.source].all()
    assert result.notes == ("Patches have 13 pixels a side, not 22: the mask leaves no larger square",)
    assert graphcut(request_of(lab, SizePx(40, 44))).notes == ()


def test_a_mask_of_single_pixels(stone: Stone) -> None:
    lab, valid = stone(20, 20, 4), np.zeros((20, 20), dtype=bool)
    valid[::3, ::4] = True
    assert valid.ravel()[graphcut(request_of(lab, SizePx(20, 22), valid=valid)).source].all()


def test_seams_keep_out_of_what_is_marked(stone: Stone) -> None:
    lab, marked = stone(96, 112, 6), np.zeros((96, 112), dtype=np.uint8)
    marked[20:60, 30:70] = 255
    shares = []
    for weights in (None, marked):
        source = graphcut(request_of(lab, SizePx(120, 140), weights=weights)).source
        on_seam = (np.roll(source, -1, axis=1) != source + 1) | (np.roll(source, -1, axis=0) != source + 112)
        there = marked.ravel()[source] > 0
        shares.append(on_seam[there].mean())
    assert shares[1] < 0.6 * shares[0]


def test_mending_lowers_what_seams_cost(stone: Stone) -> None:
    request = request_of(stone(96, 112, 6))
    before = grown(request, mends_per_patch=0).canvas
    after = grown(request).canvas
    assert after.costs.sum() < 0.85 * before.costs.sum()


def test_usage_is_spread_over_the_exemplar(stone: Stone, monkeypatch: pytest.MonkeyPatch) -> None:
    request = request_of(stone(60, 64, 7), SizePx(150, 150))
    spread = graphcut(request).source
    monkeypatch.setattr(graphcut_canvas.Canvas, "_count_use", lambda *_: None)
    greedy = graphcut(request).source
    used = [np.bincount(source.ravel(), minlength=60 * 64) for source in (spread, greedy)]
    assert used[0].max() < 0.7 * used[1].max()
    assert (used[0] > 0).mean() > (used[1] > 0).mean()


@pytest.mark.parametrize("masked", [False, True])
def test_large_exemplars_are_searched_at_reduced_size(
    stone: Stone, masked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab, valid = stone(96, 112, 1), np.ones((96, 112), dtype=bool)
    if masked:
        valid[::33] = valid[:, ::31] = False
    monkeypatch.setattr(graphcut_places, "_MAX_SEARCH_AREA_PX", 96 * 112 // 3)
    request = request_of(lab, valid=valid, feature_px=32)
    grower = grown(request)
    assert grower.squares._factor == 2
    assert valid.ravel()[grower.canvas.source].all()
    assert seam_cost(grower.canvas.source, lab, toroidal=True).mean_delta_e < 3.2


@pytest.mark.parametrize("after", [1, 3, 5])
def test_what_is_stopped_is_whole(stone: Stone, after: int) -> None:
    request, told = request_of(stone(60, 64, 7), SizePx(90, 90)), []

    def watch(step: Step) -> bool:
        told.append(step)
        return len(told) < after

    result = graphcut(request, watch)
    assert not result.complete
    assert len(told) == after
    assert 0 <= result.source.min() <= result.source.max() < 60 * 64
    assert np.mean(np.roll(result.source, -1, axis=1) == result.source + 1) > 0.75
    assert told[-1].draft is not None
    assert_array_equal(told[-1].draft(), result.source)


@pytest.mark.parametrize("fast", [False, True])
def test_watching_changes_nothing(stone: Stone, fast: bool) -> None:
    request, told = request_of(stone(60, 64, 7), fast=fast), []

    def watch(step: Step) -> bool:
        told.append(step.share)
        return True

    result = graphcut(request, watch)
    assert told == sorted(told)
    assert told[0] > 0
    assert told[-1] == 1.0
    assert_array_equal(graphcut(request).source, result.source)
    assert (digest(result.source) == digest(graphcut(request_of(stone(60, 64, 7))).source)) is not fast


def test_a_patch_is_laid_only_where_it_pays(stone: Stone) -> None:
    base = matching_image(stone(40, 40, 1))
    canvas = Canvas(Exemplar.of(base, np.ones((40, 40), dtype=bool)), SizePx(40, 40), toroidal=False)
    canvas.lay(canvas.try_patch(Placement(0, 0, 0, 0, 40, 40)))
    assert_array_equal(canvas.source, np.arange(1600).reshape(40, 40))
    # Any other patch would bring seams where there are none.
    trial = canvas.try_patch(Placement(5, 6, 11, 3, 20, 20))
    assert not trial.taken.any()
    assert trial.price == canvas.cost_around(trial.placement) == 0
    # A scratch of other stone is covered by what belongs there.
    canvas.source[15:18, 10:30] = 77
    scratched = canvas.cost_around(Placement(5, 5, 5, 5, 30, 30))
    trial = canvas.try_patch(Placement(5, 5, 5, 5, 30, 30))
    assert trial.price == 0 < scratched
    canvas.lay(trial)
    assert_array_equal(canvas.source, np.arange(1600).reshape(40, 40))


def test_gradients_by_hand() -> None:
    base = np.zeros((5, 6, 2), dtype=np.int16)
    base[:, :, 0] = 3 * np.arange(6)
    base[:, :, 1] = 4 * np.arange(6) + 10 * np.arange(5)[:, None]
    across, down = gradients(base)
    assert (across[:, 1:-1] == 8 * 5).all()
    assert (down[1:-1] == 8 * 10).all()


def test_overlaps_differ_by_the_true_sums() -> None:
    random = np.random.default_rng(4)
    image = random.integers(-250, 250, (17, 13, 4)).astype(np.int16)
    template = random.integers(-250, 250, (6, 7, 4)).astype(np.int16)
    inside, mask = random.random((17, 13)) < 0.6, random.random((6, 7)) < 0.7
    sums, counts = overlap_differences(image, inside, template, mask)
    assert sums.shape == counts.shape == (12, 7)
    for r, c in np.ndindex(12, 7):
        both = inside[r : r + 6, c : c + 7] & mask
        squares = (image[r : r + 6, c : c + 7].astype(np.int64) - template) ** 2
        assert sums[r, c] == squares[both].sum()
        assert counts[r, c] == np.count_nonzero(both)
    with pytest.raises(ValueError, match="doesn't fit"):
        overlap_differences(template, mask, image, inside)


def test_weighted_differences_are_the_true_sums() -> None:
    random = np.random.default_rng(5)
    image = random.integers(-250, 250, (15, 16, 3)).astype(np.int16)
    template = random.integers(-250, 250, (4, 5, 3)).astype(np.int16)
    weights = random.integers(0, 6, (4, 5)).astype(np.uint8)
    found = TemplateSearch(image).squared_differences(template, weights)
    for r, c in np.ndindex(12, 12):
        squares = (image[r : r + 4, c : c + 5].astype(np.int64) - template) ** 2
        assert found[r, c] == (squares * weights[..., None]).sum()


def test_the_rest_of_a_draft_is_tiled(stone: Stone) -> None:
    base = matching_image(stone(20, 20, 1))
    canvas = Canvas(Exemplar.of(base, np.ones((20, 20), dtype=bool)), SizePx(9, 8), toroidal=True)
    canvas.source[2, 3] = 5
    draft = canvas.with_rest(Placement(0, 0, 4, 6, 5, 3))
    assert draft[2, 3] == 5
    assert draft[0, 0] == draft[5, 3] == 4 * 20 + 6
    assert draft[8, 7] == (4 + 3) * 20 + 6 + 1
    assert canvas.source[0, 0] == UNSET
