"""What many tiles say together."""

from __future__ import annotations

import pytest

from tilefab.inspection.records import Defect, DefectKind, Grade, Recognition, TileInspection
from tilefab.pipeline.inspection.noticing import (
    DefectsOfTile,
    ImageHealth,
    defect_runs,
    is_over,
    kept_defects,
    repeating_defects,
)

CLEAN: DefectsOfTile = ()


def nozzle(x_mm: float) -> DefectsOfTile:
    return (("nozzle_line", x_mm),)


def inspection(*defects: Defect) -> TileInspection:
    recognition = Recognition(1, 0, (), 1.0, 1.0, 0.0, 1.0, None, "")
    return TileInspection(recognition, None, None, defects, Grade.SECOND, ())


def defect(kind: DefectKind, x_mm: float = 0.0, grade: Grade = Grade.SECOND) -> Defect:
    return Defect(kind, x_mm, 50.0, 1.0, 1.0, 1.0, 5.0, 2.0, grade)


def health(*seen: tuple[str, bool]) -> ImageHealth:
    found = ImageHealth()
    for problem, recognised in seen:
        found.saw(problem, recognised=recognised)
    return found


def test_a_few_bad_images_are_nothing_and_many_are_told_by_kind() -> None:
    assert health(*[("black", False)] * 4, ("", True)).unusable == ""
    mixed = health(*[("black", False), ("", True)] * 7, *[("two_tiles", False), ("", True)] * 3)
    assert mixed.unusable == "10 of the last 20 images can't be used: 7 black, 3 two tiles"


def test_five_bad_images_in_a_row_are_told_at_once_until_they_are_over() -> None:
    found = health(*[("", True)] * 10, *[("blown_out", False)] * 5)
    assert found.unusable == "5 of the last 15 images can't be used: 5 blown out"
    assert not found.usable
    for _ in range(18):
        found.saw("", recognised=True)
    assert found.unusable == ""
    assert found.usable
    assert health().usable


def test_strangers_in_a_row_are_told_until_one_is_recognised() -> None:
    found = health(("", True), *[("", False)] * 3, ("black", False), ("", False))
    assert found.strange == ""
    found.saw("", recognised=False)
    assert "5 tiles in a row" in found.strange
    found.saw("", recognised=True)
    assert found.strange == ""


def test_only_defects_that_can_come_again_are_kept() -> None:
    found = repeating_defects(
        inspection(
            defect(DefectKind.NOZZLE_LINE, 40.25, Grade.FIRST),
            defect(DefectKind.CHIP, 3.0),
            defect(DefectKind.CHIP, 90.0),
            defect(DefectKind.SPOT, 10.0, Grade.FIRST),
        )
    )
    assert found == (("nozzle_line", 40.25), ("chip", 0.0))


def test_the_latest_ten_tiles_are_kept() -> None:
    tiles: tuple[DefectsOfTile, ...] = ()
    for number in range(14):
        tiles = kept_defects(tiles, nozzle(number))
    assert [tile[0][1] for tile in tiles] == list(range(4, 14))


@pytest.mark.parametrize(
    ("tiles", "told"),
    [
        ([], False),
        ([nozzle(40), nozzle(40)], False),
        ([nozzle(40), CLEAN, nozzle(41), nozzle(40)], True),
        ([nozzle(40), nozzle(40), CLEAN, CLEAN, CLEAN, nozzle(40)], False),
        ([nozzle(40), nozzle(40), nozzle(40), CLEAN], False),
        ([nozzle(40), nozzle(60), nozzle(80)], False),
        ([nozzle(38), nozzle(40), nozzle(42)], False),
    ],
)
def test_a_nozzle_is_told_when_it_is_missing_on_three_of_five_tiles(tiles: list[DefectsOfTile], told: bool) -> None:
    assert bool(defect_runs(tiles)) is told


def test_where_the_nozzle_is_is_told() -> None:
    (found,) = defect_runs([nozzle(40.0), nozzle(40.6), nozzle(40.2)])
    assert found.subject == "nozzle_line 40"
    assert "40.3 mm" in found.text
    assert "3 of the last 3 tiles" in found.text


def test_other_defects_are_told_from_five_of_ten_on() -> None:
    chip: DefectsOfTile = (("chip", 0.0),)
    assert defect_runs([chip] * 4) == []
    (found,) = defect_runs([chip, CLEAN] * 4 + [chip])
    assert (found.subject, found.text) == ("chip", "5 of the last 9 tiles have this defect: chip")


def test_a_run_is_over_when_ten_tiles_have_nothing_of_it() -> None:
    assert not is_over("nozzle_line 40", [CLEAN] * 9)
    assert is_over("nozzle_line 40", [nozzle(50.0)] * 10)
    assert not is_over("nozzle_line 40", [nozzle(40.5), *[CLEAN] * 9])
    assert is_over("chip", [CLEAN] * 10)
    assert not is_over("chip", [*[CLEAN] * 9, (("chip", 0.0),)])
