"""The crop map: what it refuses, its derived tables, and halving."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tilefab.sampling import CropMap
from tilefab.sampling.crop_map import BARRED, RATION_PENALTY, halved, overlap_penalty, seam_cost_table
from tilefab.sampling.crop_reference import seam_cost_reference


def test_derived_sizes(crop_maps: dict[str, CropMap]) -> None:
    crop_map = crop_maps["shifted"]
    assert crop_map.design == "crops"
    assert crop_map.cell_shape == (32, 32)
    assert crop_map.crop_px == 48
    assert crop_map.coarsest_level == 3
    assert crop_map.reach_cells == 9
    assert set(crop_map.arrays()) == {"base", *crop_map.design_arrays()}


def test_a_map_is_made_again_from_its_parts(crop_map: CropMap) -> None:
    fields = CropMap.design_fields(crop_map.parameters(), {k: v.copy() for k, v in crop_map.arrays().items()})
    again = CropMap(
        base=crop_map.base,
        space=crop_map.space,
        channels=crop_map.channels,
        dpi=crop_map.dpi,
        slabs=crop_map.slabs,
        provenance=crop_map.provenance,
        **fields,  # type: ignore[arg-type]
    )
    assert again.hash == crop_map.hash


def test_everything_that_decides_pixels_is_in_the_hash(crop_map: CropMap) -> None:
    seen = {crop_map.hash}
    for name, array in crop_map.design_arrays().items():
        changed = array.copy()
        if name in ("crop_row", "crop_col"):
            changed.flat[0] = 0 if changed.flat[0] else 1 << crop_map.guide_shift
        else:
            changed.flat[0] = 1 if changed.flat[0] != 1 else 2
        seen.add(replace(crop_map, **{name: changed}).hash)
    for name, value in crop_map.parameters().items():
        if name in ("candidates", "sweeps"):
            seen.add(replace(crop_map, **{name: value + 1 if name == "sweeps" else value - 1}).hash)
    assert len(seen) == 1 + len(crop_map.design_arrays()) + 2


def bad(crop_map: CropMap) -> dict[str, dict[str, Any]]:
    n = len(crop_map.crop_row)
    row = crop_map.crop_row
    return {
        "no crops": {"crop_row": row[:0], "crop_col": row[:0], "price": crop_map.price[:0], "ration": row[:0]},
        "columns": {"crop_col": crop_map.crop_col[1:]},
        "prices": {"price": crop_map.price[:-1]},
        "rations": {"ration": crop_map.ration[:-1]},
        "side costs": {"side_cost": crop_map.side_cost[1:]},
        "below costs": {"below_cost": crop_map.below_cost[:, 1:]},
        "guide shift": {"guide_shift": -1},
        "guide shift beyond all": {"guide_shift": 16},
        "levels": {"seam_levels": -1},
        "levels beyond all": {"seam_levels": 16},
        "overlap": {"overlap_px": 0},
        "overlap wider than a cell": {"overlap_px": crop_map.pitch_px + 8},
        "overlap that isn't halved": {"overlap_px": crop_map.overlap_px - 2},
        "pitch that isn't halved": {"pitch_px": crop_map.pitch_px + 2},
        "pitch beyond all": {"pitch_px": 1 << 15},
        "guide of another size": {"guide": crop_map.guide[1:]},
        "guide of two channels": {"guide": crop_map.guide[..., :2]},
        "guide without channels": {"guide": crop_map.guide[..., 0]},
        "row above": {"crop_row": np.where(np.arange(n) == 3, -1, row)},
        "row below": {"crop_row": np.where(np.arange(n) == 3, 96 - 24 + 1, row)},
        "column left": {"crop_col": np.where(np.arange(n) == 0, -4, crop_map.crop_col)},
        "column right": {"crop_col": np.where(np.arange(n) == 39, 112 - 24 + 1, crop_map.crop_col)},
        "nothing tried": {"candidates": 0},
        "more tried than there are": {"candidates": n + 1},
        "sweeps": {"sweeps": -1},
        "sweeps beyond all": {"sweeps": 9},
        "turn": {"ration": np.full(n, 5, dtype=np.int8)},
        "turn below none": {"ration": np.full(n, -2, dtype=np.int8)},
        "price too high": {"price": np.full(n, BARRED + 1, dtype=np.int32)},
        "price too low": {"price": np.full(n, -BARRED - 1, dtype=np.int32)},
        "least price of all": {"price": np.full(n, -(2**31), dtype=np.int32)},
        "channels": {"channels": ("a",)},
        "base as read backwards": {"base": crop_map.base[::-1]},
    }


MESSAGES = {
    "no crops": "length",
    "columns": "length",
    "prices": "length",
    "rations": "length",
    "side costs": "joining costs",
    "below costs": "joining costs",
    "guide shift": "halvings",
    "guide shift beyond all": "halvings",
    "levels": "halvings",
    "levels beyond all": "halvings",
    "overlap": "isn't possible",
    "overlap wider than a cell": "isn't possible",
    "overlap that isn't halved": "multiples",
    "pitch that isn't halved": "multiples",
    "pitch beyond all": "isn't possible",
    "guide of another size": "guide",
    "guide of two channels": "guide",
    "guide without channels": "guide",
    "row above": "outside the base: rows",
    "row below": "outside the base",
    "column left": "outside the base: cols",
    "column right": "outside the base",
    "nothing tried": "candidates",
    "more tried than there are": "candidates",
    "sweeps": "sweeps",
    "sweeps beyond all": "sweeps",
    "turn": "rations",
    "turn below none": "rations",
    "price too high": "price",
    "price too low": "price",
    "least price of all": "price",
    "channels": "names",
    "base as read backwards": "C-contiguous",
}


@pytest.mark.parametrize("what", MESSAGES)
def test_parts_that_do_not_fit_are_refused(crop_maps: dict[str, CropMap], what: str) -> None:
    crop_map = crop_maps["inks"]
    changes = bad(crop_map)
    assert set(changes) == set(MESSAGES)
    with pytest.raises(ValueError, match=MESSAGES[what]):
        replace(crop_map, **changes[what])


def test_crops_lie_in_the_base_itself_and_on_whole_pixels_of_the_guide(crop_maps: dict[str, CropMap]) -> None:
    crop_map = crop_maps["shifted"]
    # 131 rows make 66 of the guide: a crop that ends with the guide's last row ends beyond the base's.
    for name, place in (("crop_row", 132 - 48), ("crop_col", 204 - 48), ("crop_row", 3)):
        changed = getattr(crop_map, name).copy()
        changed[5] = place
        with pytest.raises(ValueError, match="outside the base"):
            replace(crop_map, **{name: changed})


def test_a_base_of_another_size_is_refused(crop_maps: dict[str, CropMap]) -> None:
    with pytest.raises(ValueError, match="can't replace"):
        crop_maps["inks"].with_base(np.zeros((95, 112, 1), dtype=np.uint8), "ink8", ("K",))


def test_choice_tables_are_what_they_say(crop_maps: dict[str, CropMap]) -> None:
    crop_map = crop_maps["rationed"]
    tables = crop_map.choice_tables
    assert_array_equal(tables.side, tables.side_back.T)
    assert_array_equal(tables.below, tables.below_back.T)
    assert tables.rationed
    for turn in range(5):
        expected = [RATION_PENALTY if k >= 0 and k != turn else 0 for k in crop_map.ration.tolist()]
        assert tables.ration[turn].tolist() == expected


def test_which_crops_continue_which(crop_maps: dict[str, CropMap]) -> None:
    crop_map = crop_maps["inks"]
    places = list(zip(crop_map.crop_row.tolist(), crop_map.crop_col.tolist(), strict=True))
    tables = crop_map.choice_tables
    assert (tables.follows >= 0).sum() > 40
    for crop, (row, col) in enumerate(places):
        for to, (down, right) in zip(tables.follows[crop], ((0, 16), (0, -16), (16, 0), (-16, 0)), strict=True):
            wanted = (row + down, col + right)
            assert (places[to] == wanted) if to >= 0 else (wanted not in places)
    # Where one crop continues another there is no seam to see.
    for direction, cost in ((0, crop_map.side_cost), (2, crop_map.below_cost)):
        at = np.flatnonzero(tables.follows[:, direction] >= 0)
        assert not cost[at, tables.follows[at, direction]].any()


def test_a_square_of_the_slab_does_not_recur_whole(crop_maps: dict[str, CropMap]) -> None:
    """Corners of four cells that would show the slab as it is cost most of all."""
    crop_map = crop_maps["inks"]
    near = overlap_penalty(crop_map.crop_row, crop_map.crop_col, crop_map.pitch_px)
    corner = crop_map.choice_tables.corner
    dearer = corner != near
    apart_row = np.abs(crop_map.crop_row[:, None] - crop_map.crop_row)
    apart_col = np.abs(crop_map.crop_col[:, None] - crop_map.crop_col)
    assert dearer.any()
    assert (apart_row[dearer] == 16).all()
    assert (apart_col[dearer] == 16).all()
    assert (corner[dearer] > near.max()).all()


def test_joining_costs_never_wrap(crop_map_of: Callable[..., CropMap]) -> None:
    most = np.full((40, 40), 65535, dtype=np.uint16)
    tables = crop_map_of(side_cost=most, below_cost=most).choice_tables
    assert tables.side.min() == tables.below_back.min() == 65535


def test_overlap_penalty_by_counting_pixels() -> None:
    rows, cols = np.array([0, 3, 5, 20, 0], dtype=np.int32), np.array([0, 1, 9, 20, 0], dtype=np.int32)
    penalty = overlap_penalty(rows, cols, 10)
    for a in range(5):
        for b in range(5):
            shown = [np.zeros((40, 40), dtype=bool) for _ in range(2)]
            for image, k in zip(shown, (a, b), strict=True):
                image[rows[k] : rows[k] + 10, cols[k] : cols[k] + 10] = True
            assert penalty[a, b] == np.count_nonzero(shown[0] & shown[1]) * 1000 // 100


def test_seam_costs_are_the_same_on_every_machine() -> None:
    table = seam_cost_table()
    assert len(table) == 1 << 14
    for squared in (0, 1, 2, 16, 81, 1000, 16383):
        # Colours whose squared difference, in quarters, is as wanted.
        whole = 4 * squared
        a = int(whole**0.5)
        rest = [a, int((whole - a * a) ** 0.5)]
        rest.append(int((whole - rest[0] ** 2 - rest[1] ** 2) ** 0.5))
        got = sum(x * x for x in rest) >> 2
        assert table[got] == seam_cost_reference(rest, [0, 0, 0])
    # A power function that is off in its last bits must not matter: no value lies near a half.
    exact = 4 * np.arange(1 << 14, dtype=np.float64) ** 0.75
    assert np.abs(exact % 1 - 0.5).min() > 1e-7
    assert (np.diff(table) >= 0).all()
    assert table[0] == 1


def halved_plainly(image: np.ndarray[Any, Any]) -> list[list[list[int]]]:
    rows, cols = max(image.shape[0] // 2, 1), max(image.shape[1] // 2, 1)

    def at(r: int, c: int, k: int) -> int:
        # Of an image one pixel wide or high, that pixel counts twice.
        return int(image[min(r, image.shape[0] - 1), min(c, image.shape[1] - 1), k])

    return [
        [
            [(sum(at(2 * r + i, 2 * c + j, k) for i in (0, 1) for j in (0, 1)) + 2) // 4 for k in range(image.shape[2])]
            for c in range(cols)
        ]
        for r in range(rows)
    ]


@settings(max_examples=60)
@given(
    rows=st.integers(2, 9),
    cols=st.integers(2, 9),
    seed=st.integers(0, 99),
    dtype=st.sampled_from([np.uint8, np.uint16, np.uint32, np.int16, np.int32]),
)
def test_halving_rounds_half_up_and_never_wraps(rows: int, cols: int, seed: int, dtype: type) -> None:
    info = np.iinfo(dtype)
    image = np.random.default_rng(seed).integers(info.min, info.max, (rows, cols, 2), dtype=dtype, endpoint=True)
    image[: rows // 2] = image.max()
    result = halved(image)
    assert result.dtype == dtype
    assert result.tolist() == halved_plainly(image)


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (7, 1)])
def test_halving_what_is_one_pixel_wide(shape: tuple[int, int]) -> None:
    image = np.arange(shape[0] * shape[1] * 2, dtype=np.uint8).reshape(*shape, 2)
    result = halved(image)
    assert result.shape == (max(shape[0] // 2, 1), max(shape[1] // 2, 1), 2)
    assert image.min() <= result.min() <= result.max() <= image.max()


def test_halving_floats_takes_means() -> None:
    image = np.arange(5 * 4, dtype=np.float32).reshape(5, 4, 1)
    assert halved(image)[..., 0].tolist() == [[2.5, 4.5], [10.5, 12.5]]
    assert halved(image).dtype == np.float32


def test_halving_in_strips_changes_nothing() -> None:
    image = np.random.default_rng(0).integers(0, 65536, (1031, 6, 1)).astype(np.uint16)
    expected = (image[:1030].astype(np.int64).reshape(515, 2, 3, 2, 1).sum(axis=(1, 3)) + 2) // 4
    assert_array_equal(halved(image), expected)


def test_levels_of_the_base(crop_maps: dict[str, CropMap]) -> None:
    crop_map = crop_maps["shifted"]
    assert crop_map.base_level(0) is crop_map.base
    assert_array_equal(crop_map.base_level(2), halved(halved(crop_map.base)))
    assert crop_map.base_level(2) is crop_map.base_level(2)
