"""Quilting on a torus: repeats without a seam, uses only what is valid, gives the same tile every time."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis import METHODS, Step, SynthesisRequest, quilting
from tilefab.synthesis.quilting import Quilt, lay_quilt
from tilefab.synthesis.seam_jumps import seam_delta_e, seam_jumps
from tilefab.texture.matching import matching_image
from tilefab.types import Mask, SizePx

Stone = Callable[[int, int, int], NDArray[np.float32]]


def everything(lab: NDArray[np.float32]) -> Mask:
    return np.ones(lab.shape[:2], dtype=bool)


def digest(source: NDArray[np.int32]) -> str:
    return hashlib.sha256(source.astype("<i4").tobytes()).hexdigest()[:32]


def line_steps(picture: NDArray[np.floating], axis: int) -> NDArray[np.float64]:
    """Mean colour step from each row (or column) of a tile to the next, the last one being that of the wrap."""
    step = np.roll(picture, -1, axis=axis).astype(np.float64) - picture
    return np.asarray(np.sqrt((step**2).sum(axis=2)).mean(axis=1 - axis))


SIZES = [SizePx(64, 80), SizePx(71, 53), SizePx(100, 33), SizePx(24, 150)]


@pytest.fixture(scope="module")
def quilts(stone: Stone) -> dict[SizePx, Quilt]:
    lab = stone(96, 112, 1)
    return {size: lay_quilt(SynthesisRequest(lab, everything(lab), size, 7)) for size in SIZES}


@pytest.mark.parametrize(
    ("size", "hashed"),
    [
        (SIZES[0], "f4d1cd53a4d7423efba214c849b902fa"),
        (SIZES[1], "ab2e6eccd926ece5dfe6f0d5316d2d87"),
        (SIZES[2], "96e492c4131791c5b1e736290078eac5"),
        (SIZES[3], "30df928a79463300856f5d35614e9bb6"),
    ],
)
def test_tiles_are_pinned(quilts: dict[SizePx, Quilt], size: SizePx, hashed: str) -> None:
    source = quilts[size].source
    assert source.shape == (size.rows, size.cols)
    assert source.dtype == np.int32
    assert digest(source) == hashed


@pytest.mark.parametrize("size", SIZES)
def test_the_wrap_is_no_worse_than_the_inside(stone: Stone, quilts: dict[SizePx, Quilt], size: SizePx) -> None:
    lab = stone(96, 112, 1)
    tile = lab.reshape(-1, 3)[quilts[size].source]
    for axis in (0, 1):
        steps = line_steps(tile, axis)
        assert steps[-1] <= steps[:-1].max()
        assert steps[-1] <= 1.35 * np.median(steps[:-1])
        # The same bound fails by far where nothing was done for the wrap.
        plain = line_steps(stone(96, 112, 1)[3:70, 5:80], axis)
        assert plain[-1] > 2.5 * np.median(plain[:-1])


@pytest.mark.parametrize("size", SIZES)
def test_seams_cost_little_and_are_told_truly(stone: Stone, quilts: dict[SizePx, Quilt], size: SizePx) -> None:
    lab, quilt = stone(96, 112, 1), quilts[size]
    base = matching_image(lab).astype(np.float64)
    jumps = []
    rows, cols = quilt.source.shape
    for r in range(rows):
        for c in range(cols):
            here = divmod(int(quilt.source[r, c]), 112)
            jump = 0.0
            for dr, dc in ((1, 0), (0, 1)):
                there = divmod(int(quilt.source[(r + dr) % rows, (c + dc) % cols]), 112)
                ahead, behind = (here[0] + dr, here[1] + dc), (there[0] - dr, there[1] - dc)
                if there != ahead and ahead[0] < 96 and ahead[1] < 112 and min(behind) >= 0:
                    jump += (((base[ahead] - base[there]) ** 2).sum() + ((base[behind] - base[here]) ** 2).sum()) / 2
            jumps.append(np.sqrt(jump) / 2)
    told = [jump for jump in jumps if jump > 0]
    worst, mean = seam_delta_e(matching_image(lab), quilt.source)
    assert mean == pytest.approx(np.mean(told), rel=0.01)
    assert worst >= max(told) * (1 - 1e-12)
    # Pieces laid at random would differ by as much as any two pixels of this stone.
    at_random = np.sqrt(((base[3:50, 7:60] - base[-47:, -53:]) ** 2).sum(axis=2)).mean() / 2
    assert mean < 0.45 * at_random


def test_a_tile_is_a_patchwork_of_whole_pieces(quilts: dict[SizePx, Quilt]) -> None:
    source = quilts[SIZES[0]].source
    assert np.count_nonzero(np.roll(source, -1, axis=1) == source + 1) > 0.8 * source.size
    assert np.count_nonzero(np.roll(source, -1, axis=0) == source + 112) > 0.8 * source.size


def test_same_arguments_same_tile_another_seed_another(stone: Stone, quilts: dict[SizePx, Quilt]) -> None:
    lab, size = stone(96, 112, 1), SIZES[0]
    again = lay_quilt(SynthesisRequest(lab.copy(), everything(lab), size, 7))
    assert_array_equal(again.source, quilts[size].source)
    other = lay_quilt(SynthesisRequest(lab, everything(lab), size, 8))
    assert np.mean(other.source == again.source) < 0.2


def test_only_valid_pixels_are_used(stone: Stone) -> None:
    lab = stone(90, 100, 4)
    valid = np.random.default_rng(3).random((90, 100)) > 0.002
    valid[:, 47:52] = valid[60:, :30] = False
    lab[~valid] = (100, 100, -100)
    quilt = lay_quilt(SynthesisRequest(lab, valid, SizePx(60, 75), 1))
    assert valid.ravel()[quilt.source].all()
    assert 8 <= quilt.block_px <= 24
    # Pieces come from both sides of the gap.
    cols = quilt.source % 100
    assert (cols < 47).any()
    assert (cols > 51).any()


def test_blocks_shrink_to_fit_the_mask(stone: Stone) -> None:
    lab = stone(90, 100, 4)
    valid = np.zeros((90, 100), dtype=bool)
    valid[40:53, 10:90] = True
    quilt = lay_quilt(SynthesisRequest(lab, valid, SizePx(40, 40), 1))
    assert valid.ravel()[quilt.source].all()
    assert quilt.block_px == 13  # 24 and 18 don't fit into the strip of 13 rows


@pytest.mark.parametrize("side", [16, 24, 8])
def test_one_colour(side: int) -> None:
    lab = np.full((side, side, 3), (62.0, 1.5, 7.0), dtype=np.float32)
    quilt = lay_quilt(SynthesisRequest(lab, everything(lab), SizePx(40, 37), 0))
    assert quilt.source.shape == (40, 37)
    assert quilt.source.min() >= 0
    assert quilt.source.max() < side * side
    assert seam_delta_e(matching_image(lab), quilt.source) == (0.0, 0.0)
    assert quilt.block_px == side
    assert quilt.overlap_px == max(3, side // 3)


def test_a_tile_smaller_than_the_exemplars_blocks(stone: Stone) -> None:
    lab = stone(60, 60, 5)
    quilt = lay_quilt(SynthesisRequest(lab, everything(lab), SizePx(10, 8), 0, feature_px=30))
    assert quilt.block_px == 8
    assert quilt.source.shape == (10, 8)


@pytest.mark.parametrize(
    ("shape", "size", "block_px", "match"),
    [
        ((7, 40), SizePx(40, 40), None, "needs 8 pixels"),
        ((40, 7), SizePx(40, 40), None, "needs 8 pixels"),
        ((40, 40), SizePx(7, 40), None, "needs 8 pixels"),
        ((40, 40), SizePx(40, 7), None, "needs 8 pixels"),
    ],
)
def test_too_little_is_refused(shape: tuple[int, int], size: SizePx, block_px: int | None, match: str) -> None:
    lab = np.zeros((*shape, 3), dtype=np.float32)
    with pytest.raises(ValueError, match=match):
        lay_quilt(SynthesisRequest(lab, everything(lab), size, 0, feature_px=block_px))


def test_blocks_have_eight_pixels_at_least() -> None:
    lab = np.zeros((40, 40, 3), dtype=np.float32)
    assert lay_quilt(SynthesisRequest(lab, everything(lab), SizePx(40, 40), 0, feature_px=1)).block_px == 8
    thin = quilting.quilt(SynthesisRequest(lab, everything(lab), SizePx(3, 40), 0, toroidal=False))
    assert thin.source.shape == (3, 40)


def test_a_mask_that_leaves_too_little_is_refused() -> None:
    lab = np.zeros((40, 40, 3), dtype=np.float32)
    valid = np.zeros((40, 40), dtype=bool)
    valid[::9] = valid[:, ::9] = True
    valid = ~valid  # squares of 8 x 8 are left
    assert lay_quilt(SynthesisRequest(lab, valid, SizePx(30, 30), 0)).block_px == 8
    valid[4::9] = False
    with pytest.raises(ValueError, match="8 x 8"):
        lay_quilt(SynthesisRequest(lab, valid, SizePx(30, 30), 0))


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_out_of_range_is_refused(seed: int) -> None:
    lab = np.zeros((40, 40, 3), dtype=np.float32)
    with pytest.raises(ValueError, match="seed"):
        lay_quilt(SynthesisRequest(lab, everything(lab), SizePx(30, 30), seed))


def test_shares_rise_to_one(stone: Stone) -> None:
    lab, told = stone(60, 60, 5), []

    def watch(step: Step) -> bool:
        told.append(step.share)
        return True

    lay_quilt(SynthesisRequest(lab, everything(lab), SizePx(50, 50), 0), watch)
    assert told == sorted(told)
    assert told[0] > 0
    assert told[-1] == 1.0


@pytest.mark.parametrize("toroidal", [True, False])
@pytest.mark.parametrize("stop_at", [0.01, 0.25, 0.7])
def test_stopped_it_gives_what_there_is(stone: Stone, stop_at: float, toroidal: bool) -> None:
    lab, drafts = stone(60, 64, 5), []
    valid = np.random.default_rng(3).random((60, 64)) > 0.001

    def watch(step: Step) -> bool:
        assert step.draft is not None
        drafts.append(step.draft())
        return step.share < stop_at

    request = SynthesisRequest(lab, valid, SizePx(90, 70), 1, toroidal=toroidal)
    result = METHODS["quilting"](request, watch)
    assert not result.complete
    assert result.source.shape == (90, 70)
    assert valid.ravel()[result.source].all()
    assert_array_equal(result.source, drafts[-1])
    assert all(valid.ravel()[draft].all() for draft in drafts)
    assert len(result.notes) == (stop_at < 1 / 3)
    if stop_at < 1 / 3:
        assert (
            f"Stopped when {100 * lay_quilt(request, lambda step: step.share < stop_at).laid:.0f} %" in result.notes[0]
        )


def test_one_that_ends_is_complete(stone: Stone) -> None:
    lab = stone(40, 40, 5)
    request = SynthesisRequest(lab, everything(lab), SizePx(40, 40), 0)
    # Asked to stop when nothing is left to do, it has stopped nothing.
    result = METHODS["quilting"](request, lambda step: step.share < 1.0)
    assert result.complete
    assert result.notes == ()
    assert_array_equal(result.source, METHODS["quilting"](request).source)


def test_laying_over_bad_seams_betters_them(stone: Stone, monkeypatch: pytest.MonkeyPatch) -> None:
    lab, size = stone(96, 112, 6), SizePx(64, 80)
    base = matching_image(lab)
    repaired = lay_quilt(SynthesisRequest(lab, everything(lab), size, 2))
    monkeypatch.setattr(quilting._Quilter, "repair", lambda _: None)
    plain = lay_quilt(SynthesisRequest(lab, everything(lab), size, 2))
    before = seam_jumps(base, plain.source).sum()
    after = seam_jumps(base, repaired.source).sum()
    assert after < 0.85 * before


def test_usage_is_spread_over_the_exemplar(stone: Stone, monkeypatch: pytest.MonkeyPatch) -> None:
    lab, size = stone(60, 64, 7), SizePx(150, 150)
    spread = lay_quilt(SynthesisRequest(lab, everything(lab), size, 2))
    monkeypatch.setattr(quilting, "_USAGE_PRICE", 0.0)
    greedy = lay_quilt(SynthesisRequest(lab, everything(lab), size, 2))
    used = [np.bincount(q.source.ravel(), minlength=60 * 64) for q in (spread, greedy)]
    assert used[0].max() < used[1].max()
    assert (used[0] > 0).mean() > (used[1] > 0).mean()


@pytest.mark.parametrize("masked", [False, True])
def test_large_exemplars_are_searched_at_reduced_size(
    stone: Stone, masked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab, valid = stone(96, 112, 1), np.ones((96, 112), dtype=bool)
    if masked:
        valid[::33] = valid[:, ::31] = False
    monkeypatch.setattr(quilting, "_MAX_SEARCH_AREA_PX", 96 * 112 // 10)
    quilt = lay_quilt(SynthesisRequest(lab, valid, SizePx(64, 80), 7, feature_px=32))
    assert valid.ravel()[quilt.source].all()
    assert seam_delta_e(matching_image(lab), quilt.source)[1] < 3.2
    tile = lab.reshape(-1, 3)[quilt.source]
    for axis in (0, 1):
        steps = line_steps(tile, axis)
        assert steps[-1] <= 1.35 * np.median(steps[:-1])


def test_reduced_search_where_no_reduced_block_is_whole(stone: Stone, monkeypatch: pytest.MonkeyPatch) -> None:
    lab, valid = stone(96, 112, 1), np.zeros((96, 112), dtype=bool)
    for row in range(1, 70, 23):
        for col in range(1, 90, 21):
            valid[row : row + 16, col : col + 16] = True  # never aligned with blocks of 4: none is whole at a quarter
    monkeypatch.setattr(quilting, "_MAX_SEARCH_AREA_PX", 96 * 112 // 10)
    quilt = lay_quilt(SynthesisRequest(lab, valid, SizePx(40, 50), 7, feature_px=16))
    assert quilt.block_px == 16
    assert valid.ravel()[quilt.source].all()


def test_the_method_of_that_name_is_this_one(stone: Stone) -> None:
    lab = stone(60, 60, 5)
    request = SynthesisRequest(lab, everything(lab), SizePx(50, 40), seed=9, feature_px=20)
    quilt = lay_quilt(request)
    assert quilt.block_px == 20
    assert_array_equal(METHODS["quilting"](request).source, quilt.source)


@pytest.fixture(scope="module")
def flat_quilts(stone: Stone) -> dict[SizePx, Quilt]:
    lab = stone(96, 112, 1)
    return {size: lay_quilt(SynthesisRequest(lab, everything(lab), size, 7, toroidal=False)) for size in SIZES}


@pytest.mark.parametrize(
    ("size", "hashed"),
    [
        (SIZES[0], "eaf47e755d15e579cc750561cb587e48"),
        (SIZES[1], "10ad146317771eacfb8431d06ebb9443"),
        (SIZES[2], "e67022864b35f5b0bb4f7221a374e7bc"),
        (SIZES[3], "ec5495aa0acb53e777466b6a584915d5"),
    ],
)
def test_flat_quilts_are_pinned(flat_quilts: dict[SizePx, Quilt], size: SizePx, hashed: str) -> None:
    source = flat_quilts[size].source
    assert source.shape == (size.rows, size.cols)
    assert digest(source) == hashed


@pytest.mark.parametrize("size", SIZES)
def test_a_flat_quilt_has_edges_and_better_seams(
    stone: Stone, quilts: dict[SizePx, Quilt], flat_quilts: dict[SizePx, Quilt], size: SizePx
) -> None:
    lab, source = stone(96, 112, 1), flat_quilts[size].source
    picture = lab.reshape(-1, 3)[source]
    base = matching_image(lab)
    inside = seam_jumps(base, source, toroidal=False).sum()
    # Nothing has to be found that joins on to the other edge.
    assert inside < seam_jumps(base, quilts[size].source, toroidal=False).sum() * 1.25
    assert inside < 0.5 * seam_jumps(base, source).sum()
    for axis in (0, 1):
        steps = line_steps(picture, axis)
        assert steps[:-1].max() < 2.2 * np.median(steps[:-1])
        assert steps[-1] > 1.5 * np.median(steps[:-1])


def test_the_edge_of_a_flat_quilt_is_cut_like_its_inside(stone: Stone) -> None:
    lab = stone(96, 112, 1)
    source = lay_quilt(SynthesisRequest(lab, everything(lab), SizePx(150, 160), 4, toroidal=False)).source
    jumps = seam_jumps(matching_image(lab), source, toroidal=False)
    edge = np.ones(source.shape, dtype=bool)
    edge[4:-4, 4:-4] = False
    assert jumps[edge].mean() < jumps[~edge].mean()


def test_seams_keep_out_of_what_is_marked(stone: Stone) -> None:
    lab = stone(96, 112, 1)
    weights = np.zeros((96, 112), dtype=np.uint8)
    weights[20:36, 30:46] = weights[60:76, 80:96] = 255
    base = matching_image(lab)

    def crossings(given: NDArray[np.uint8] | None, toroidal: bool) -> float:
        cut = 0.0
        for seed in range(3):
            request = SynthesisRequest(
                lab, everything(lab), SizePx(100, 120), seed, toroidal=toroidal, weights=given, feature_px=32
            )
            source = lay_quilt(request).source
            on_seam = seam_jumps(base, source, toroidal=toroidal) > 0
            cut += float(on_seam[weights.ravel()[source] > 0].mean())
        return cut

    for toroidal in (True, False):
        assert crossings(weights, toroidal) < 0.75 * crossings(None, toroidal)


@pytest.mark.parametrize("toroidal", [True, False])
def test_weights_of_nothing_change_nothing(stone: Stone, toroidal: bool) -> None:
    lab, nothing = stone(60, 60, 5), np.zeros((60, 60), dtype=np.uint8)
    plain, weighted = (
        lay_quilt(SynthesisRequest(lab, everything(lab), SizePx(50, 40), 3, toroidal=toroidal, weights=weights)).source
        for weights in (None, nothing)
    )
    assert_array_equal(plain, weighted)


@pytest.mark.parametrize("channels", [1, 2, 5])
def test_any_number_of_channels(stone: Stone, channels: int) -> None:
    lab = stone(60, 60, 5)
    many = np.concatenate([lab, lab[..., ::-1]], axis=2)[..., :channels]
    request = SynthesisRequest(np.ascontiguousarray(many), everything(lab), SizePx(70, 50), 3)
    worst, mean = seam_delta_e(matching_image(many), lay_quilt(request).source)
    at_random = np.sqrt(((many[3:40] - many[-37:]) ** 2).sum(axis=2)).mean()
    assert 0 < mean < 0.5 * at_random
    assert mean < worst


def test_jumps_at_the_wrap_are_of_the_torus_only() -> None:
    base = np.zeros((4, 5, 1), dtype=np.int16)
    base[..., 0] = np.arange(20).reshape(4, 5) ** 2
    source = np.arange(20, dtype=np.int32).reshape(4, 5)
    assert not seam_jumps(base, source, toroidal=False).any()
    wrapped = seam_jumps(base, source) > 0
    expected = np.zeros((4, 5), dtype=bool)
    expected[-1] = True
    assert_array_equal(wrapped[:, :-1], expected[:, :-1])


def test_jumps_weigh_what_is_marked() -> None:
    base = np.array([[[0], [10], [50], [70]]], dtype=np.int16)
    source = np.array([[0, 2]], dtype=np.int32)
    plain = seam_jumps(base, source, toroidal=False)
    # Where 10 would have followed 0, there is 50; where 10 would have come before 50, there is 0.
    assert plain.tolist() == [[(40**2 + 10**2) / 2, 0.0]]
    weights = np.array([[16, 255, 32, 255]], dtype=np.uint8)
    assert_array_equal(seam_jumps(base, source, toroidal=False, weights=weights), plain * 3)
