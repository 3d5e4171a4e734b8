"""Defects are found where they are, as what they are, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sim import defects as seeded
from tests.unit.inspection.defect_tiles import (
    PX_PER_MM,
    defects_of,
    drifted_light,
    photographed,
    press_lab,
    press_light,
    stone_inks,
)
from tilefab.inspection.defect_classes import ShapeLimits
from tilefab.inspection.defects import DefectSettings, find_defects
from tilefab.inspection.records import DefectKind, Grade
from tilefab.types import FloatImage

# Seeded marks multiply light: X, Y and Z over the white's stand in for red, green and blue.
Make = Callable[..., tuple[FloatImage, seeded.SeededDefect]]


@pytest.mark.parametrize("seed", range(4))
def test_good_tiles_have_none(seed: int) -> None:
    inks = stone_inks(seed)
    assert defects_of(inks, press_light(inks), seed) == ()


@pytest.mark.parametrize("seed", range(4))
def test_drift_light_and_shift_are_no_defects(seed: int) -> None:
    inks = stone_inks(10 + seed)
    assert defects_of(inks, drifted_light(inks), seed) == ()


@pytest.mark.parametrize(("ink", "seed"), [(0, 1), (1, 2), (2, 3), (3, 4)])
def test_nozzle_line(ink: int, seed: int) -> None:
    inks = stone_inks(seed)
    data = np.rint(65535.0 * inks).astype(np.uint16)
    wrong, truth = seeded.nozzle_line(data, ink, np.random.default_rng(seed), px_per_mm=PX_PER_MM)
    found = defects_of(inks, drifted_light(wrong / 65535.0))
    assert [defect.kind for defect in found] == [DefectKind.NOZZLE_LINE]
    assert found[0].x_mm == pytest.approx(truth.x_mm, abs=0.2)
    assert found[0].height_mm == pytest.approx(truth.height_mm)
    assert found[0].grade is not Grade.FIRST


@pytest.mark.parametrize("seed", range(3))
def test_spot(seed: int) -> None:
    inks = stone_inks(20 + seed)
    light = drifted_light(inks).astype(np.float32)
    fired, truth = seeded.spot(light, np.random.default_rng(seed), px_per_mm=PX_PER_MM, diameter_mm=0.8, factor=0.5)
    (found,) = defects_of(inks, fired)
    assert found.kind is DefectKind.SPOT
    assert (found.x_mm, found.y_mm) == pytest.approx((truth.x_mm, truth.y_mm), abs=0.2)
    assert 0.4 < found.width_mm < 1.4
    assert found.severity > 1.0


@pytest.mark.parametrize(("make", "kind"), [(seeded.crack, DefectKind.CRACK), (seeded.scratch, DefectKind.SCRATCH)])
@pytest.mark.parametrize("seed", range(2))
def test_lines(make: Make, kind: DefectKind, seed: int) -> None:
    inks = stone_inks(30 + seed)
    light = press_light(inks).astype(np.float32)
    fired, truth = make(light, np.random.default_rng(seed), px_per_mm=PX_PER_MM, length_mm=12.0)
    (found,) = defects_of(inks, fired)
    assert found.kind is kind
    assert np.hypot(found.width_mm, found.height_mm) == pytest.approx(
        np.hypot(truth.width_mm, truth.height_mm), rel=0.2
    )


def test_chip() -> None:
    inks = stone_inks(40)
    fired, truth = seeded.chip(press_light(inks).astype(np.float32), np.random.default_rng(2), px_per_mm=PX_PER_MM)
    (found,) = defects_of(inks, fired)
    assert found.kind is DefectKind.CHIP
    assert (found.x_mm, found.y_mm) == pytest.approx((truth.x_mm, truth.y_mm), abs=0.8)


def test_bands() -> None:
    inks = stone_inks(41)
    data = np.rint(65535.0 * inks).astype(np.uint16)
    wrong, _ = seeded.banding(data, 0.25, np.random.default_rng(1), px_per_mm=PX_PER_MM, pitch_mm=12.0)
    found = defects_of(inks, press_light(wrong / 65535.0))
    assert DefectKind.BANDING in {defect.kind for defect in found}


@pytest.mark.parametrize("ink", range(4))
def test_missing_ink(ink: int) -> None:
    inks = stone_inks(50 + ink)
    without = inks.copy()
    without[..., ink] = 0.0
    (found,) = defects_of(inks, press_light(without))
    assert found.kind is DefectKind.MISSING_INK
    assert found.grade is Grade.SCRAP
    assert (found.width_mm, found.height_mm) == (256 / PX_PER_MM, 256 / PX_PER_MM)


def test_a_faded_ink_is_not_missing() -> None:
    inks = stone_inks(55)
    weak = inks * np.array([0.7, 1.0, 1.0, 1.0])
    assert DefectKind.MISSING_INK not in {defect.kind for defect in defects_of(inks, press_light(weak))}


@pytest.mark.parametrize("ink", [1, 3])
def test_misregistration(ink: int) -> None:
    inks = stone_inks(60 + ink)
    data = np.rint(65535.0 * inks).astype(np.uint16)
    wrong, _ = seeded.misregistered(data, ink, (0.3, -0.2), px_per_mm=PX_PER_MM)
    (found,) = defects_of(inks, press_light(wrong / 65535.0))
    assert found.kind is DefectKind.MISREGISTRATION


def test_double_print() -> None:
    inks = stone_inks(65)
    data = np.rint(65535.0 * inks).astype(np.uint16)
    wrong, _ = seeded.double_print(data, (2.0, 1.0), 0.3, px_per_mm=PX_PER_MM)
    (found,) = defects_of(inks, press_light(wrong / 65535.0), with_press=False)
    assert found.kind is DefectKind.DOUBLE_PRINT


def test_a_turned_tile_has_the_same_spot() -> None:
    inks = stone_inks(70)
    fired, _ = seeded.spot(
        press_light(inks).astype(np.float32), np.random.default_rng(3), px_per_mm=PX_PER_MM, factor=0.4, diameter_mm=1.0
    )
    side = inks.shape[0] / PX_PER_MM
    (upright,) = defects_of(inks, fired)
    (turned,) = defects_of(np.ascontiguousarray(inks[::-1, ::-1]), fired[::-1, ::-1])
    assert (turned.x_mm, turned.y_mm) == pytest.approx((side - upright.x_mm, side - upright.y_mm), abs=0.1)


def test_what_is_not_seen_is_not_judged() -> None:
    inks = stone_inks(71)
    predicted = press_lab(inks.astype(np.float64)).astype(np.float32)
    fired = photographed(press_light(inks), 1)
    valid = np.ones(inks.shape[:2], dtype=bool)
    fired[100:160, 80:200] = (95.0, 0.0, 0.0)
    valid[100:160, 80:200] = False
    assert find_defects(predicted, fired, valid, PX_PER_MM, inks=inks) == ()


def test_missing_tile_is_a_chip() -> None:
    inks = stone_inks(72)
    predicted = press_lab(inks.astype(np.float64)).astype(np.float32)
    fired = photographed(press_light(inks), 1)
    tile = np.ones(inks.shape[:2], dtype=bool)
    tile[:24, :30] = False
    fired[~tile] = (15.0, 0.0, 0.0)
    (found,) = find_defects(predicted, fired, tile, PX_PER_MM, tile_mask=tile, inks=inks)
    assert found.kind is DefectKind.CHIP
    assert found.area_mm2 == pytest.approx(24 * 30 / PX_PER_MM**2, rel=0.01)
    assert found.grade is Grade.SCRAP


def test_a_print_off_the_middle_is_no_chip() -> None:
    inks = stone_inks(73)
    predicted = press_lab(inks.astype(np.float64)).astype(np.float32)
    fired = photographed(press_light(inks), 1)
    tile = np.ones(inks.shape[:2], dtype=bool)
    tile[:, :12] = False
    tile[-9:] = False
    fired[~tile] = (15.0, 0.0, 0.0)
    assert find_defects(predicted, fired, tile, PX_PER_MM, tile_mask=tile, inks=inks) == ()


def test_worst_comes_first() -> None:
    inks = stone_inks(74)
    fired = press_light(inks).astype(np.float32)
    random = np.random.default_rng(9)
    fired, _ = seeded.spot(fired, random, px_per_mm=PX_PER_MM)
    fired, _ = seeded.crack(fired, random, px_per_mm=PX_PER_MM)
    grades = [defect.grade for defect in defects_of(inks, fired)]
    assert grades == [Grade.SCRAP, Grade.SECOND]


def test_limits_are_heeded() -> None:
    inks = stone_inks(75)
    fired, _ = seeded.spot(
        press_light(inks).astype(np.float32), np.random.default_rng(3), px_per_mm=PX_PER_MM, factor=0.7, diameter_mm=1.0
    )
    predicted = press_lab(inks.astype(np.float64)).astype(np.float32)
    seen, full = photographed(fired, 1), np.ones(inks.shape[:2], dtype=bool)
    blind = DefectSettings(shapes=ShapeLimits(spot_delta_e=20.0))
    assert len(find_defects(predicted, seen, full, PX_PER_MM, inks=inks)) == 1
    assert find_defects(predicted, seen, full, PX_PER_MM, inks=inks, settings=blind) == ()


def test_misuse() -> None:
    image, full = np.zeros((40, 50, 3), dtype=np.float32), np.ones((40, 50), dtype=bool)
    with pytest.raises(ValueError, match="must fit the mask"):
        find_defects(image, image[:30], full, PX_PER_MM)
    with pytest.raises(ValueError, match="too little"):
        find_defects(image, image, np.zeros_like(full), PX_PER_MM)


def _with_islands(recipe: tuple[float, ...], places: list[tuple[int, int]]) -> FloatImage:
    """A stone with small round islands of one recipe."""
    inks = stone_inks(76)
    down, across = np.mgrid[: inks.shape[0], : inks.shape[1]]
    for row, col in places:
        inks[np.hypot(down - row, across - col) < 4.0] = recipe
    return inks


def test_a_colour_that_fires_otherwise_is_no_defect() -> None:
    places = [(60, 60), (60, 190), (190, 70), (200, 200), (120, 130)]
    inks = _with_islands((0.0, 0.9, 0.9, 0.0), places)
    island = (inks == np.array([0.0, 0.9, 0.9, 0.0], dtype=np.float32)).all(axis=2)
    light = press_light(inks)
    light[island] *= 0.7
    assert defects_of(inks, light) == ()


def test_one_of_many_alike_that_differs_is_a_defect() -> None:
    places = [(60, 60), (60, 190), (190, 70), (200, 200), (120, 130)]
    inks = _with_islands((0.0, 0.9, 0.9, 0.0), places)
    light = press_light(inks)
    light[56:65, 56:65] *= 0.6
    (found,) = defects_of(inks, light)
    assert (found.x_mm, found.y_mm) == pytest.approx((60.5 / PX_PER_MM, 60.5 / PX_PER_MM), abs=0.2)
