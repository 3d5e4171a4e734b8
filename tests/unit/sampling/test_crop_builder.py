"""Building crop maps: sizes, places, masks, drops and turns, prices; and the walls that come of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.rng import stream_key
from tilefab.sampling import CropMap, CropOptions, Feature, SlabArea, build_crop_map, render
from tilefab.sampling.crop_builder import barred_crops, crop_geometry, guide_image, rations, spread_places
from tilefab.sampling.crop_choice import choose_crops
from tilefab.sampling.crop_map import BARRED, halved_guide
from tilefab.sampling.crop_prices import crop_usage
from tilefab.sampling.crop_tables import JoiningCosts
from tilefab.texture.repetition import gather_cells, lattice_ghost, static_share, usage
from tilefab.types import Mask

Stone = Callable[[int, int, int], NDArray[np.float32]]
SIDE = 240
OPTIONS = CropOptions(crops=500, candidates=250, feature_px=28, threads=1)


def build(lab: NDArray[np.float32], options: CropOptions, valid: Mask | None = None, **more: Any) -> CropMap:
    """Map over the pixels' own places, so that what is rendered tells where it comes from."""
    index = np.arange(lab.shape[0] * lab.shape[1], dtype=np.int32).reshape(*lab.shape[:2], 1)
    fields: dict[str, Any] = {"stored": index, "space": "index", "channels": ("i",), "dpi": 100.0, **more}
    return build_crop_map(lab, np.ones(lab.shape[:2], dtype=bool) if valid is None else valid, options, **fields)


@pytest.fixture(scope="module")
def lab(stone: Stone) -> NDArray[np.float32]:
    return stone(SIDE, SIDE, 5)


@pytest.fixture(scope="module")
def built(lab: NDArray[np.float32]) -> CropMap:
    return build(lab, OPTIONS)


@pytest.fixture(scope="module")
def wall(built: CropMap) -> NDArray[np.int32]:
    """50 x 50 cells, as the places in the slab that they show."""
    picture: NDArray[np.int32] = render(built, 0, 0, 50 * built.pitch_px, 50 * built.pitch_px, seed=1)[..., 0]
    return picture


# Walls.


def test_no_part_of_the_lattice_is_static(built: CropMap, wall: NDArray[np.int32]) -> None:
    for origin in ((0, 0), (built.pitch_px // 2, built.pitch_px // 3)):
        cells = gather_cells(wall, built.pitch_px, origin)
        assert len(cells) > 1000
        assert static_share(cells[:1000]) == 0
    # Nor at twice or five times the pitch, where classes and turns recur.
    for factor in (2, 5):
        assert static_share(gather_cells(wall, factor * built.pitch_px)) == 0


def test_the_slab_is_covered_evenly(wall: NDArray[np.int32]) -> None:
    used = usage(wall, (SIDE, SIDE))
    assert used.coverage >= 0.95
    # Over patches as large as a crop's core; single pixels vary with the seams.
    patches = used.count[: SIDE // 20 * 20, : SIDE // 20 * 20].reshape(SIDE // 20, 20, -1, 20).mean(axis=(1, 3))
    inner = patches[1:-1, 1:-1]
    assert inner.max() <= 2 * inner.mean()
    assert inner.min() >= 0.3 * inner.mean()


def test_the_lattice_leaves_no_more_ghost_than_crops_drawn_at_random(built: CropMap, lab: NDArray[np.float32]) -> None:
    """However crops are chosen, a dictionary of so many leaves a ghost: the choice must add little to it."""
    pitch = built.pitch_px
    random = np.random.default_rng(0)
    chosen, drawn = [], []
    for seed in range(4):
        where = render(built, 0, 0, 20 * pitch, 25 * pitch, seed=seed)[..., 0]
        chosen.append(lattice_ghost(gather_cells(lab.reshape(-1, 3)[where], pitch), lab))
        k = random.integers(len(built.crop_row), size=500)
        corners = zip(built.crop_row[k], built.crop_col[k], strict=True)
        drawn.append(lattice_ghost(np.array([lab[r : r + pitch, c : c + pitch] for r, c in corners]), lab))
    assert np.mean(chosen) <= 1.4 * np.mean(drawn)
    assert np.mean(chosen) <= 2.5


def test_prices_make_use_more_even(built: CropMap) -> None:
    def unevenness(crop_map: CropMap) -> tuple[float, float]:
        crops = choose_crops(crop_map, stream_key(3, "crops"), 0, 0, 70, 70)
        used = crop_usage(crop_map, np.bincount(crops.ravel(), minlength=len(crop_map.price)), 4)
        inner = used[8:-8, 8:-8]
        return float(inner.max() / inner.mean()), float(inner.std() / inner.mean())

    free, priced = (unevenness(m) for m in (replace(built, price=np.zeros(len(built.price), dtype=np.int32)), built))
    assert priced[0] < 0.8 * free[0]
    assert priced[1] < 0.7 * free[1]
    assert priced[0] < 2


def test_usage_counts_the_middles_of_crops(crop_maps: dict[str, CropMap]) -> None:
    crop_map = crop_maps["inks"]
    counts = np.random.default_rng(0).integers(0, 9, 40)
    expected = np.zeros((96, 112))
    for r, c, n in zip(crop_map.crop_row, crop_map.crop_col, counts, strict=True):
        expected[r + 4 : r + 20, c + 4 : c + 20] += n
    assert_array_equal(crop_usage(crop_map, counts, 1), expected)
    assert crop_usage(crop_map, counts, 5).shape == (20, 23)


def test_threads_do_not_change_a_map(lab: NDArray[np.float32]) -> None:
    maps = [build(lab[:120, :130], CropOptions(crops=90, candidates=40, threads=threads)) for threads in (1, 2)]
    assert maps[0].hash == maps[1].hash


def test_the_job_seed_is_all_that_is_drawn_from(lab: NDArray[np.float32]) -> None:
    maps = [build(lab[:120, :130], CropOptions(crops=90, candidates=40, seed=seed, threads=1)) for seed in (0, 0, 1)]
    assert maps[0].hash == maps[1].hash
    assert maps[0].hash != maps[2].hash


def test_progress_runs_to_1(lab: NDArray[np.float32]) -> None:
    shares: list[float] = []
    build(lab[:100, :100], CropOptions(crops=40, candidates=20, threads=1), progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert len(shares) > 10


# Masks and slabs.


def holes(rows: int, cols: int) -> Mask:
    row, col = np.arange(rows)[:, None], np.arange(cols)[None, :]
    valid = (row - rows // 3) ** 2 + (col - cols // 4) ** 2 > (min(rows, cols) // 10) ** 2
    valid &= row + col > 12
    valid[rows - 5, cols - 9] = valid[2, cols - 2] = False
    return valid


@pytest.mark.parametrize("feature_px", [16, 40])
def test_only_valid_stone_is_shown(lab: NDArray[np.float32], feature_px: int) -> None:
    part = lab[:161, :183]
    valid = holes(161, 183)
    crop_map = build(part, CropOptions(crops=150, candidates=60, feature_px=feature_px, threads=1), valid)
    for seed in (0, 1):
        shown = render(crop_map, -300, -300, 700, 700, seed=seed)[..., 0]
        assert valid.ravel()[shown].all()
    # Nor in the parts of crops that this wall's seams cut off.
    for r, c in zip(crop_map.crop_row, crop_map.crop_col, strict=True):
        assert valid[r : r + crop_map.crop_px, c : c + crop_map.crop_px].all()


def test_several_slabs_feed_one_map(stone: Stone) -> None:
    """Slabs lie in one base with a gap between them; no crop spans it, and all of them are shown."""
    base, valid = np.zeros((120, 260, 3), dtype=np.float32), np.zeros((120, 260), dtype=bool)
    slabs = (SlabArea("a", 0, 0, 120, 124), SlabArea("b", 0, 128, 100, 132))
    for number, s in enumerate(slabs):
        area = np.s_[s.base_row : s.base_row + s.rows, s.base_col : s.base_col + s.cols]
        base[area], valid[area] = stone(s.rows, s.cols, number), True
    crop_map = build(base, CropOptions(crops=160, candidates=80, feature_px=24, threads=1), valid, slabs=slabs)
    shown = render(crop_map, 0, 0, 900, 900, seed=0)[..., 0]
    assert valid.ravel()[shown].all()
    from_first = (shown % 260 < 124).mean()
    share = slabs[0].rows * slabs[0].cols / valid.sum()
    assert abs(from_first - share) < 0.15
    for r, c in zip(crop_map.crop_row, crop_map.crop_col, strict=True):
        inside = [
            s.base_row <= r
            and s.base_col <= c
            and r + crop_map.crop_px <= s.base_row + s.rows
            and c + crop_map.crop_px <= s.base_col + s.cols
            for s in slabs
        ]
        assert sum(inside) == 1


def test_a_flat_slab_is_one_colour() -> None:
    flat = np.full((100, 90, 3), 50, dtype=np.float32)
    crop_map = build(flat, CropOptions(crops=60, candidates=30, threads=1))
    again = crop_map.with_base(flat.copy(), "lab", ("L", "a", "b"))
    assert (render(again, -50, -50, 300, 300, seed=0) == 50).all()


def test_the_smallest_slab(stone: Stone) -> None:
    crop_map = build(stone(4, 5, 0), CropOptions(threads=1))
    assert (crop_map.pitch_px, crop_map.overlap_px) == (2, 2)
    assert render(crop_map, 0, 0, 20, 20, seed=0).shape == (20, 20, 1)


# Drops and turns.


@pytest.mark.parametrize(
    "lists",
    [{"drop": (0, 5, 59)}, {"keep": (3, 7, 11)}, {"keep": tuple(range(30)), "drop": (2, 3)}, {"keep": (58,)}],
    ids=["drop", "keep", "both", "keep one"],
)
def test_lists_are_honoured_wherever_one_looks(lab: NDArray[np.float32], lists: dict[str, tuple[int, ...]]) -> None:
    options = CropOptions(crops=60, candidates=15, feature_px=20, threads=1, **lists)  # type: ignore[arg-type]
    crop_map = build(lab[:120, :120], options)
    allowed = set(lists.get("keep", range(60))) - set(lists.get("drop", ()))
    shown = set(np.unique(choose_crops(crop_map, stream_key(0, "crops"), -30, 99, 60, 60)).tolist())
    assert shown <= allowed
    assert len(shown) > 0.8 * len(allowed)
    assert_array_equal(crop_map.price == BARRED, [k not in allowed for k in range(60)])


def test_costs_of_an_earlier_build_serve_another_list(lab: NDArray[np.float32]) -> None:
    part = lab[:120, :120]
    plain = CropOptions(crops=60, candidates=30, feature_px=20, threads=1)
    first = build(part, plain)
    kept = JoiningCosts(first.side_cost.copy(), first.below_cost.copy(), 1.0)
    dropped = replace(plain, drop=(4, 9))
    assert build(part, dropped, costs=kept).hash == build(part, dropped).hash
    with pytest.raises(ValueError, match="don't fit"):
        build(part, replace(plain, crops=50), costs=kept)


@pytest.mark.parametrize(
    ("lists", "match"),
    [
        ({"drop": (60,)}, "no crop 60"),
        ({"keep": (-1,)}, "no crop -1"),
        ({"drop": tuple(range(60))}, "every crop"),
        ({"keep": (3,), "drop": (3,)}, "every crop"),
    ],
)
def test_impossible_lists_are_refused(lists: dict[str, tuple[int, ...]], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        barred_crops(60, CropOptions(**lists))  # type: ignore[arg-type]


def test_crops_that_show_a_feature_take_turns(lab: NDArray[np.float32]) -> None:
    features = tuple(
        Feature(row, col, 5) for row, col in ((40, 40), (60, 160), (200, 90), (180, 200), (100, 100), (120, 30))
    )
    options = CropOptions(crops=200, candidates=100, feature_px=28, threads=1)
    crop_map = build(lab, options, features=features)
    half, pitch = crop_map.overlap_px // 2, crop_map.pitch_px
    showing = [
        (crop_map.crop_row + half <= f.row)
        & (f.row < crop_map.crop_row + half + pitch)
        & (crop_map.crop_col + half <= f.col)
        & (f.col < crop_map.crop_col + half + pitch)
        for f in features
    ]
    assert_array_equal(crop_map.ration >= 0, np.any(showing, axis=0))
    for number, of_feature in enumerate(showing):
        alone = of_feature & (np.sum(showing, axis=0) == 1)
        assert (crop_map.ration[alone] == number % 5).all()
    crops = choose_crops(crop_map, stream_key(0, "crops"), -50, -50, 100, 100)
    turn = crop_map.ration[crops]
    rows, cols = np.nonzero(turn >= 0)
    assert len(rows) > 50
    assert_array_equal(turn[rows, cols], ((rows - 50) // 2 + 2 * ((cols - 50) // 2)) % 5)


def test_no_features_no_turns() -> None:
    geometry = crop_geometry((100, 100), 100, 20)
    assert (rations(np.arange(5), np.arange(5), geometry, ()) == -1).all()


# Sizes and places.


@given(st.integers(4, 3000), st.integers(4, 3000), st.one_of(st.none(), st.integers(1, 4000)))
def test_sizes_suit_the_slab(rows: int, cols: int, feature_px: int | None) -> None:
    square = min(rows, cols)
    geometry = crop_geometry((rows, cols), square, feature_px)
    quantum = 2 << (geometry.guide_shift + geometry.seam_levels)
    assert 0 < geometry.overlap_px <= geometry.pitch_px < 1 << 15
    assert geometry.overlap_px % quantum == geometry.pitch_px % quantum == 0
    assert geometry.pitch_px + geometry.overlap_px <= square


def test_a_large_slab_has_a_smaller_guide() -> None:
    geometry = crop_geometry((12000, 12000), 12000, 1000)
    assert (12000 >> geometry.guide_shift) ** 2 <= 1 << 26
    assert geometry.guide_shift >= 1


@pytest.mark.parametrize(("square", "feature_px"), [(0, None), (3, None), (3, 1), (1, 50)])
def test_a_slab_too_small_is_refused(square: int, feature_px: int | None) -> None:
    with pytest.raises(ValueError, match="too small"):
        crop_geometry((50, 50), square, feature_px)


def test_places_are_different_valid_and_spread() -> None:
    geometry = crop_geometry((300, 320), 300, 40)
    valid = np.ones((300, 320), dtype=bool)
    valid[100:140, 100:150] = False
    row, col = spread_places(valid, geometry, 400)
    side = geometry.pitch_px + geometry.overlap_px
    assert len(row) == len(set(zip(row.tolist(), col.tolist(), strict=True))) == 400
    for r, c in zip(row, col, strict=True):
        assert valid[r : r + side, c : c + side].all()
        assert (r + side, c + side) <= (300, 320 + side)
    # Any hundred in a row are spread over all quarters.
    for first in (0, 150, 300):
        quarters = 2 * (row[first : first + 100] > (300 - side) / 2) + (col[first : first + 100] > (320 - side) / 2)
        assert np.bincount(quarters, minlength=4).min() >= 10
    # The rim is reached, or nearly.
    assert max(row.min(), col.min()) < side / 4
    assert row.max() + side > 300 - side / 4
    assert col.max() + side > 320 - side / 4


def test_few_places_are_all_taken() -> None:
    geometry = crop_geometry((60, 60), 60, 20)
    side = geometry.pitch_px + geometry.overlap_px
    valid = np.zeros((60, 60), dtype=bool)
    valid[10 : 10 + side + 2, 20 : 20 + side + 1] = True
    row, col = spread_places(valid, geometry, 100)
    assert sorted(zip(row.tolist(), col.tolist(), strict=True)) == [
        (10 + i, 20 + j) for i in range(3) for j in range(2)
    ]


def test_a_mask_that_leaves_nothing_is_refused() -> None:
    geometry = crop_geometry((60, 60), 60, 20)
    valid = np.ones((60, 60), dtype=bool)
    valid[::8] = False
    with pytest.raises(ValueError, match="leaves nothing"):
        spread_places(valid, geometry, 100)


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_the_guide_is_the_slab_in_half_units(stone: Stone, shift: int) -> None:
    lab = stone(37, 46, 3)
    weights = np.zeros((37, 46), dtype=np.uint8)
    weights[9, 11], weights[36, 45] = 200, 90
    guide = guide_image(lab, weights, shift)
    factor = 1 << shift
    assert guide.shape == (-(-37 // factor), -(-46 // factor), 4)
    for r, c in ((0, 0), (3, 5), (guide.shape[0] - 1, guide.shape[1] - 1)):
        rows = np.minimum(np.arange(r * factor, (r + 1) * factor), 36)
        cols = np.minimum(np.arange(c * factor, (c + 1) * factor), 45)
        mean = lab[np.ix_(rows, cols)].astype(np.float64).mean(axis=(0, 1))
        assert np.abs(guide[r, c, :3] - 2 * (mean + np.array([0, 64, 64]))).max() <= 0.51
    # A weight stays at its full size however small the guide.
    assert guide[9 >> shift, 11 >> shift, 3] == 200
    assert guide[-1, -1, 3] == 90
    assert np.count_nonzero(guide[..., 3]) == 2
    assert guide_image(lab, None, shift).shape[2] == 3


# What is refused.


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"crops": 0}, "crops"),
        ({"candidates": 0}, "candidates"),
        ({"sweeps": -1}, "sweeps"),
        ({"sweeps": 9}, "sweeps"),
        ({"threads": 0}, "threads"),
        ({"feature_px": 0}, "features"),
    ],
)
def test_impossible_options_are_refused(changes: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        CropOptions(**changes)


def test_images_of_different_sizes_are_refused(lab: NDArray[np.float32]) -> None:
    options = CropOptions(crops=10, threads=1)
    with pytest.raises(ValueError, match="differ in size"):
        build(lab, options, np.ones((SIDE, SIDE - 1), dtype=bool))
    with pytest.raises(ValueError, match="differ in size"):
        build(lab, options, stored=np.zeros((SIDE - 1, SIDE, 1), dtype=np.uint8))
    with pytest.raises(ValueError, match="weights"):
        build(lab, options, weights=np.zeros((SIDE, SIDE + 1), dtype=np.uint8))


def test_a_mask_without_a_square_is_refused(lab: NDArray[np.float32]) -> None:
    valid = np.zeros((SIDE, SIDE), dtype=bool)
    valid[::3] = True
    with pytest.raises(ValueError, match="too small"):
        build(lab, CropOptions(threads=1), valid)


def test_weights_are_kept_in_the_guide(lab: NDArray[np.float32]) -> None:
    weights = np.zeros((100, 100), dtype=np.uint8)
    weights[20:40, 50:70] = 255
    crop_map = build(lab[:100, :100], CropOptions(crops=30, candidates=20, threads=1), weights=weights)
    assert crop_map.guide.shape[2] == 4
    assert crop_map.guide[25, 60, 3] == 255


@pytest.mark.parametrize(("side", "times", "crops"), [(40, 7, 16), (64, 6, 16), (40, 7, 2)])
def test_a_slab_that_repeats_itself_gives_as_many_crops_as_asked_for(side: int, times: int, crops: int) -> None:
    noise = np.random.default_rng(2).normal(50, 15, (side, side)).astype(np.float32)
    lightness = np.tile(noise, (times, times))
    lab = np.stack([lightness, 0 * lightness, 0 * lightness], axis=2)
    built = build(lab, CropOptions(crops=crops, candidates=crops, threads=1))
    assert len(set(zip(built.crop_row.tolist(), built.crop_col.tolist(), strict=True))) == crops
    # All of one phase: what lies under any two crops is the same stone, so that their joins can't be seen.
    assert len(set((built.crop_row % side).tolist())) == len(set((built.crop_col % side).tolist())) == 1


def test_weights_keep_their_strength_when_the_guide_is_halved() -> None:
    guide = np.zeros((6, 9, 4), dtype=np.uint8)
    guide[3, 4] = (100, 60, 20, 255)
    half = halved_guide(guide)
    assert half.shape == (3, 4, 4)
    assert half[1, 2].tolist() == [25, 15, 5, 255]
    assert half[..., 3].sum() == 255
    assert_array_equal(halved_guide(guide[..., :3]), half[..., :3])
