"""Tests of sizes and shapes read from an outline."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from tilefab.inspection.dimensions import measure_dimensions
from tilefab.types import SizeMm

PX_PER_MM = 4.0
MARGIN_MM = 8.0
READ_MM = 0.04
"""The standard reads to 0.1 mm."""


def tile_image(width, height, *, turn_deg=0.0, bow=(0, 0, 0, 0), skew=0.0, seed=3, hidden=None, noise=0.004):
    """Image, its mask, and corners of a tile: sides may bow outwards, the upper side may be shifted sideways, in mm."""
    random = np.random.default_rng(seed)
    across_mm, down_mm = width + 2 * MARGIN_MM, height + 2 * MARGIN_MM
    rows, cols = round(down_mm * PX_PER_MM), round(across_mm * PX_PER_MM)
    turn = np.radians(turn_deg)
    down, across = np.meshgrid(np.arange(rows) + 0.5, np.arange(cols) + 0.5, indexing="ij")
    x, y = across / PX_PER_MM - across_mm / 2, down / PX_PER_MM - down_mm / 2
    x, y = np.cos(turn) * x + np.sin(turn) * y + width / 2, -np.sin(turn) * x + np.cos(turn) * y + height / 2
    x = x - skew * (1 - y / height)
    along_x, along_y = 4 * x / width * (1 - x / width), 4 * y / height * (1 - y / height)
    within = [y + bow[0] * along_x, width + bow[1] * along_y - x, height + bow[2] * along_x - y, x + bow[3] * along_y]
    cover = np.prod([np.clip(PX_PER_MM * side + 0.5, 0, 1) for side in within], axis=0)
    stone = ndimage.gaussian_filter(random.standard_normal((rows, cols)), 6)
    light = 0.03 + cover * (0.42 + 0.08 * stone / stone.std() - 0.03)
    if hidden is not None:
        light[hidden] = 0.03
        cover[hidden] = 0
    light = ndimage.gaussian_filter(light, 0.6) + noise * random.standard_normal((rows, cols))
    xyz = np.repeat(light[:, :, np.newaxis], 3, axis=2).astype(np.float32)
    middle = np.array([cols, rows]) / 2
    box = np.array([[-width, -height], [width, -height], [width, height], [-width, height]]) / 2 * PX_PER_MM
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return xyz, middle + box @ rotation.T + random.uniform(-2, 2, (4, 2)), cover > 0.5


@pytest.mark.parametrize("turn_deg", [0.0, 2.7, -88.5, 180.0])
def test_a_true_tile_has_its_size(turn_deg: float) -> None:
    size = SizeMm(151.2, 99.6) if abs(turn_deg) < 45 else SizeMm(120.0, 120.0)
    xyz, corners, mask = tile_image(size.width, size.height, turn_deg=turn_deg)
    found = measure_dimensions(xyz, corners, mask, size, PX_PER_MM)
    assert found is not None
    assert found.sides_mm == pytest.approx([size.width, size.height, size.width, size.height], abs=READ_MM)
    assert abs(found.size_deviation_percent) < READ_MM
    assert abs(found.straightness_mm) < READ_MM
    assert abs(found.rectangularity_mm) < READ_MM
    assert found.scale_known


def test_size_deviates_by_the_larger_of_width_and_height_with_its_sign() -> None:
    xyz, corners, mask = tile_image(120.6, 119.1)
    found = measure_dimensions(xyz, corners, mask, SizeMm(120.0, 120.0), PX_PER_MM)
    assert found is not None
    assert found.width_mm == pytest.approx(120.6, abs=READ_MM)
    assert found.height_mm == pytest.approx(119.1, abs=READ_MM)
    assert found.size_deviation_percent == pytest.approx(-0.75, abs=READ_MM)


def test_without_calibration_only_proportions_count() -> None:
    xyz, corners, mask = tile_image(121.2, 119.988)
    found = measure_dimensions(xyz, corners, mask, SizeMm(120.0, 120.0), None)
    assert found is not None
    assert not found.scale_known
    assert (found.width_mm / 120 + found.height_mm / 120) / 2 == pytest.approx(1.0, abs=1e-6)
    assert found.width_mm / found.height_mm == pytest.approx(1.0101, abs=3e-4)


@pytest.mark.parametrize("side", range(4))
@pytest.mark.parametrize("bow", [0.6, -0.6])
def test_a_bowed_side_shows_in_its_middle(side: int, bow: float) -> None:
    width, height = 140.0, 110.0
    bows = [0.0] * 4
    bows[side] = bow
    xyz, corners, mask = tile_image(width, height, bow=bows, turn_deg=1.5)
    found = measure_dimensions(xyz, corners, mask, SizeMm(width, height), PX_PER_MM)
    assert found is not None
    length = (width, height)[side % 2]
    # The chord is between points 5 mm from the corners, where the side has already bowed out a little.
    at_stud = 4 * 5 / length * (1 - 5 / length)
    assert found.straightness_mm == pytest.approx(bow * (1 - at_stud), abs=READ_MM)
    assert found.straightness_percent == pytest.approx(100 * found.straightness_mm / length)


@pytest.mark.parametrize("skew", [0.9, -0.9])
def test_a_skewed_tile_is_off_the_right_angle(skew: float) -> None:
    width, height = 120.0, 150.0
    xyz, corners, mask = tile_image(width, height, skew=skew)
    found = measure_dimensions(xyz, corners, mask, SizeMm(width, height), PX_PER_MM)
    assert found is not None
    # Held against the upper or lower side, the far stud of a neighbour is 140 mm away; against a long side, 110 mm.
    assert abs(found.rectangularity_mm) == pytest.approx(0.9 / 150 * 140, abs=READ_MM)
    assert abs(found.rectangularity_percent) == pytest.approx(100 * abs(found.rectangularity_mm) / 150, abs=1e-9)


def test_a_chip_away_from_the_studs_does_not_count() -> None:
    xyz, corners, mask = tile_image(120.0, 120.0, hidden=np.s_[28:40, 130:150])
    found = measure_dimensions(xyz, corners, mask, SizeMm(120.0, 120.0), PX_PER_MM)
    assert found is not None
    assert found.sides_mm == pytest.approx([120.0] * 4, abs=READ_MM)


@pytest.mark.parametrize(
    "hidden",
    [np.s_[28:70, 28:70], np.s_[28:40, 250:290], np.s_[300:, :], np.s_[28:60, 60:380]],
    ids=["corner", "middle of a side", "a third broken off", "along a side"],
)
def test_where_a_place_of_measuring_is_gone_nothing_is_measured(hidden: tuple[slice, slice]) -> None:
    xyz, corners, mask = tile_image(120.0, 120.0, hidden=hidden)
    assert measure_dimensions(xyz, corners, mask, SizeMm(120.0, 120.0), PX_PER_MM) is None


def test_a_tile_as_dark_as_the_belt_has_no_outline() -> None:
    xyz, corners, mask = tile_image(120.0, 120.0)
    assert measure_dimensions(np.full_like(xyz, 0.03), corners, mask, SizeMm(120.0, 120.0), PX_PER_MM) is None


def test_tiles_too_small_for_the_standards_places_are_left_alone() -> None:
    xyz, corners, mask = tile_image(18.0, 18.0)
    assert measure_dimensions(xyz, corners, mask, SizeMm(18.0, 18.0), PX_PER_MM) is None


def test_misuse_is_refused() -> None:
    xyz, corners, mask = tile_image(40.0, 40.0)
    with pytest.raises(ValueError, match="float32"):
        measure_dimensions(xyz.astype(np.float64), corners, mask, SizeMm(40, 40), PX_PER_MM)
    with pytest.raises(ValueError, match="4 finite"):
        measure_dimensions(xyz, corners[:3], mask, SizeMm(40, 40), PX_PER_MM)
    with pytest.raises(ValueError, match="more than 0"):
        measure_dimensions(xyz, corners, mask, SizeMm(40, 40), 0.0)
