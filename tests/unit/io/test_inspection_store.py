"""The store of inspections keeps what it is given, in SQLite and in PostgreSQL, and tells it as it is asked."""

from __future__ import annotations

import re
import sqlite3
import threading
import uuid
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import create_engine, text

from tests import postgres_server
from tilefab.errors import JournalError
from tilefab.inspection.records import (
    ColourFigures,
    Defect,
    DefectKind,
    Grade,
    ImageProblem,
    Recognition,
    TileDimensions,
    TileInspection,
)
from tilefab.io import inspection_store as module
from tilefab.io.inspection_database import _FOLDER, InspectionDatabase
from tilefab.io.inspection_json import inspection_from_json, inspection_text
from tilefab.io.inspection_records import InnovationRecord, Pictures, SeenTile, SkippedImage
from tilefab.io.inspection_schema import HEAD, metadata
from tilefab.io.inspection_store import InspectionStore
from tilefab.io.journal import Journal, sqlite_url

NO_SERVER = postgres_server.missing()
LINE = "line 1"
NOW = datetime(2026, 11, 24, 12, 0, 0, 250_000, tzinfo=UTC)
COLOUR = ColourFigures(
    delta_e_mean=1.25,
    delta_e_p95=2.5,
    delta_e_worst=4.0,
    worst_at_mm=(12.5, 140.0),
    cmc_mean=1.0,
    cmc_p95=2.0,
    lightness=-0.5,
    chroma=0.25,
    hue=0.125,
    fired_lab=(61.0, 2.0, 9.5),
    predicted_lab=(61.5, 2.0, 9.0),
)
SIZE = TileDimensions(
    sides_mm=(150.1, 150.0, 149.9, 150.2),
    width_mm=150.0,
    height_mm=150.1,
    size_deviation_percent=0.05,
    straightness_mm=0.1,
    straightness_percent=0.07,
    rectangularity_mm=-0.2,
    rectangularity_percent=-0.13,
    scale_known=True,
)
LINE_DEFECT = Defect(DefectKind.NOZZLE_LINE, 40.0, 75.0, 0.2, 150.0, 30.0, 3.0, 2.5, Grade.SECOND)
SPOT = Defect(DefectKind.SPOT, 10.0, 20.0, 0.5, 0.5, 0.2, 6.0, 1.5, Grade.FIRST)


def inspected(
    face: int | None = 7,
    *,
    problem: ImageProblem | None = None,
    defects: tuple[Defect, ...] = (),
    grade: Grade = Grade.FIRST,
    colour: ColourFigures | None = COLOUR,
) -> TileInspection:
    corners = ((1.5, 2.0), (600.0, 2.5), (601.0, 602.0), (0.5, 600.0)) if problem is None else ()
    seen = Recognition(face, 3, corners, 0.99, 0.9, 0.2, 0.98, problem, "" if problem is None else "no tile there")
    measured = face is not None
    return TileInspection(
        seen, colour if measured else None, SIZE if measured else None, defects, grade, ("why",), (0.1, -0.2), 0.5
    )


def tile(number: int, inspection: TileInspection | None = None, **changes: object) -> SeenTile:
    found = inspected(number) if inspection is None else inspection
    facts: dict[str, object] = {
        "image": f"{number:04}.png",
        "taken_at": NOW + timedelta(seconds=number),
        "inspection": found,
        "run_id": None if found.recognition.face is None else 3,
        "arm_id": None if found.recognition.face is None else 100 + number,
        "correction": 0,
        "printed_at": NOW - timedelta(minutes=50),
        "shade_lot": "A" if found.colour is not None else "",
    }
    return SeenTile(**{**facts, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def postgres() -> Iterator[str]:
    with postgres_server.serving() as url:
        yield url


@pytest.fixture(params=["sqlite"] if NO_SERVER else ["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Of a database that is still empty."""
    if request.param == "sqlite":
        return sqlite_url(tmp_path / "inspection.db")
    server: str = request.getfixturevalue("postgres")
    name = f"inspection_{uuid.uuid4().hex}"
    engine = create_engine(server.replace("postgresql:", "postgresql+psycopg:"), isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    engine.dispose()
    return f"{server}&dbname={name}"


@pytest.fixture
def store(url: str) -> Iterator[InspectionStore]:
    with InspectionStore.open(url, line=LINE, now=lambda: NOW) as opened:
        yield opened


def test_a_tile_comes_out_as_it_went_in(store: InspectionStore) -> None:
    inspection = inspected(5, defects=(LINE_DEFECT, SPOT), grade=Grade.SECOND)
    seen = tile(5, inspection, correction=2, repeat=True)
    number = store.add_tile(seen, Pictures(1002.5, "run_3/5_predicted.png", "run_3/5_fired.png"))
    (record,) = store.tiles()
    assert store.full(number) == inspection
    assert record == store.tile_of_image("0005.png")
    assert record.inspection_id == number
    assert (record.run_id, record.face, record.arm_id, record.correction, record.repeat) == (3, 5, 105, 2, True)
    assert (record.taken_at, record.inspected_at, record.printed_at) == (seen.taken_at, NOW, seen.printed_at)
    assert (record.problem, record.grade, record.shade_lot) == (None, Grade.SECOND, "A")
    assert record.colour == COLOUR
    assert record.sizes == (150.0, 150.1, 0.05, 0.07, -0.13)
    assert record.pictures == Pictures(1002.5, "run_3/5_predicted.png", "run_3/5_fired.png")


def test_an_image_without_a_tile_has_neither_colour_nor_face(store: InspectionStore) -> None:
    inspection = inspected(None, problem=ImageProblem.BLACK, grade=Grade.SCRAP)
    number = store.add_tile(tile(1, inspection))
    (record,) = store.tiles()
    assert (record.problem, record.face, record.colour, record.sizes) == (ImageProblem.BLACK, None, None, None)
    assert store.full(number) == inspection
    assert sum(store.grades().values()) == 0


def test_an_image_is_put_down_once(store: InspectionStore) -> None:
    store.add_tile(tile(1, inspected(1, defects=(SPOT,))))
    with pytest.raises(JournalError, match="contradict"):
        store.add_tile(tile(1, inspected(1, defects=(LINE_DEFECT,))))
    assert [record.defect for record in store.defects()] == [SPOT]


def test_what_is_done_together_is_done_wholly_or_not_at_all(store: InspectionStore) -> None:
    def fail() -> None:
        with store.together("inspect"):
            store.add_tile(tile(1))
            store.remember("press", "{}")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert (store.tiles(), store.remembered("press")) == ([], None)
    with store.together("inspect"):
        number = store.add_tile(tile(1))
        store.add_innovation(InnovationRecord(3, NOW, 0.5, (0.1, 0.2, -0.3), True, ("L:ewma+",), number))
        store.remember("press", '{"a": 1}')
    assert len(store.tiles()) == 1
    assert store.innovations(run_id=3) == [InnovationRecord(3, NOW, 0.5, (0.1, 0.2, -0.3), True, ("L:ewma+",), number)]


def test_tiles_are_told_of_a_run_a_time_a_face_and_the_newest(store: InspectionStore) -> None:
    for number in (4, 1, 3, 2):
        store.add_tile(tile(number, run_id=3 if number < 4 else 9))
    assert [record.face for record in store.tiles()] == [1, 2, 3, 4]
    assert [record.face for record in store.tiles(run_id=3)] == [1, 2, 3]
    since, until = NOW + timedelta(seconds=2), NOW + timedelta(seconds=4)
    assert [record.face for record in store.tiles(since=since, until=until)] == [2, 3]
    assert [record.face for record in store.tiles(last=2)] == [3, 4]
    assert [record.face for record in store.tiles(face=2)] == [2]


def test_grades_defects_and_lots_count_each_tile_once(store: InspectionStore) -> None:
    bad = inspected(2, defects=(LINE_DEFECT, SPOT, SPOT), grade=Grade.SECOND)
    darker = replace(COLOUR, fired_lab=(60.5, 2.5, 9.0))
    store.add_tile(tile(1))
    store.add_tile(tile(2, bad))
    store.add_tile(tile(3, inspected(3, defects=(SPOT,), colour=darker), shade_lot="B"))
    store.add_tile(tile(4, inspected(3, defects=(SPOT,), grade=Grade.SCRAP), repeat=True))
    assert store.grades(run_id=3) == {Grade.FIRST: 2, Grade.SECOND: 1, Grade.SCRAP: 0}
    assert list(store.defect_counts().items()) == [(DefectKind.SPOT, 2), (DefectKind.NOZZLE_LINE, 1)]
    assert [(record.face, record.defect) for record in store.defects()] == [
        (2, LINE_DEFECT),
        (2, SPOT),
        (2, SPOT),
        (3, SPOT),
    ]
    first, second = store.shade_lots(run_id=3)
    assert (first.name, first.tiles, first.offset_lab) == ("A", 2, pytest.approx((-0.5, 0.0, 0.5)))
    assert (second.name, second.tiles, second.offset_lab) == ("B", 1, pytest.approx((-1.0, 0.5, 0.0)))
    assert first.first_at == NOW + timedelta(seconds=1)
    assert store.shade_lots(run_id=4) == []


def test_the_worst_are_those_whose_pictures_are_kept(store: InspectionStore) -> None:
    numbers = [
        store.add_tile(tile(number), Pictures(badness, f"{number}p.png", f"{number}f.png"))
        for number, badness in ((1, 3.0), (2, 9.0), (3, 6.0))
    ]
    store.add_tile(tile(4))
    assert [record.face for record in store.worst(3)] == [2, 3, 1]
    assert [record.face for record in store.worst(last=1)] == [2]
    store.drop_pictures(numbers[:1])
    assert [record.face for record in store.worst(3)] == [2, 3]
    assert store.tiles(face=1)[0].pictures is None


def test_images_and_arms_that_are_done_are_known(store: InspectionStore) -> None:
    store.add_tile(tile(1))
    store.skip([SkippedImage("b.png", NOW, "behind"), SkippedImage("0001.png", NOW, "behind")])
    store.skip([SkippedImage("b.png", NOW, "again"), SkippedImage("c.png", NOW, "can't be read")])
    names = [f"{number:04}.png" for number in range(2000)]
    assert store.done_images([*names, "b.png", "c.png", "d.png"]) == {"0001.png", "b.png", "c.png"}
    assert [(image.image, image.reason) for image in store.skipped()] == [
        ("b.png", "behind"),
        ("c.png", "can't be read"),
    ]
    assert store.seen_arms(range(5000)) == {101}


def test_what_is_remembered_is_the_last_of_its_name(store: InspectionStore) -> None:
    store.remember("press a", "old")
    store.remember("press b", "b")
    store.remember("press a", "new" * 50_000)
    assert store.remembered("press a") == "new" * 50_000
    assert (store.remembered("press b"), store.remembered("press c")) == ("b", None)


def test_proposals_are_kept_as_proposed_and_answered(store: InspectionStore) -> None:
    first = store.propose(3, "drifted by 1.2", '{"mean": []}')
    second = store.propose(3, "a step", "{}")
    store.answer(first, number=1)
    store.answer(second, number=None, answer="too soon")
    third = store.propose(4, "drifted", "{}")
    one, two = store.proposals(run_id=3)
    assert (one.number, one.answer, one.answered_at, one.drift) == (1, "", NOW, '{"mean": []}')
    assert (two.number, two.answer, two.reason) == (None, "too soon", "a step")
    assert [proposal.proposal_id for proposal in store.proposals(unanswered=True)] == [third]


def test_an_alarm_is_up_once_until_it_is_cleared(store: InspectionStore) -> None:
    number = store.raise_alarm("defect_run", "a nozzle", subject="nozzle 40", run_id=3)
    assert number is not None
    assert store.raise_alarm("defect_run", "a nozzle", subject="nozzle 40") is None
    assert store.raise_alarm("defect_run", "another", subject="nozzle 90") is not None
    store.alarm_told(number)
    assert [(alarm.subject, alarm.told) for alarm in store.alarms(up=True)] == [
        ("nozzle 40", True),
        ("nozzle 90", False),
    ]
    assert store.clear_alarm("defect_run", subject="nozzle 40")
    assert not store.clear_alarm("defect_run", subject="nozzle 40")
    assert [alarm.subject for alarm in store.alarms(up=True)] == ["nozzle 90"]
    assert store.raise_alarm("defect_run", "again", subject="nozzle 40") is not None
    assert [alarm.cleared_at for alarm in store.alarms()] == [NOW, None, None]
    assert [alarm.text for alarm in store.alarms(run_id=3)] == ["a nozzle"]


def test_lines_of_one_database_dont_see_each_other(url: str) -> None:
    with InspectionStore.open(url, line=LINE) as store:
        store.add_tile(tile(1))
        store.propose(3, "why", "{}")
    with InspectionStore.open(url, line="line 2") as store:
        store.add_tile(tile(1))
        store.add_tile(tile(2))
        assert (len(store.tiles()), store.proposals(), store.innovations()) == (2, [], [])
    with InspectionStore.look(url, line=LINE) as store:
        assert len(store.tiles()) == 1


def test_a_second_inspector_is_refused_and_lookers_on_arent(url: str) -> None:
    with InspectionStore.open(url, line=LINE) as store:
        store.add_tile(tile(1))
        with pytest.raises(JournalError, match="another inspector"):
            InspectionStore.open(url, line=LINE)
        with InspectionStore.look(url, line=LINE) as looker:
            assert len(looker.tiles()) == 1
            with pytest.raises(JournalError):
                looker.add_tile(tile(2))


def test_the_journal_may_be_in_the_same_server(url: str) -> None:
    if url.startswith("sqlite"):
        with InspectionStore.open(url, line=LINE), pytest.raises(JournalError):
            Journal.look(url, line=LINE)
        other = url.replace("inspection.db", "journal.db")
        Journal.open(other, line=LINE).close()
        with pytest.raises(JournalError, match="journal"):
            InspectionStore.open(other, line=LINE)
        return
    with InspectionStore.open(url, line=LINE) as store, Journal.open(url, line=LINE) as journal:
        store.add_tile(tile(1))
        assert journal.runs() == []
        assert len(store.tiles()) == 1
    with Journal.open(url, line=LINE), InspectionStore.open(url, line=LINE) as store:
        assert len(store.tiles()) == 1


def test_without_inspections_there_is_nothing_to_look_at(url: str) -> None:
    with pytest.raises(JournalError, match="nothing was inspected yet"):
        InspectionStore.look(url, line=LINE)
    assert not InspectionStore.exists(url, LINE)
    InspectionStore.open(url, line="another").close()
    with pytest.raises(JournalError, match="knows no line"):
        InspectionStore.look(url, line=LINE)
    assert not InspectionStore.exists(url, LINE)
    assert InspectionStore.exists(url, "another")


def test_old_tiles_keep_their_figures_only(store: InspectionStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_DETAILED", 3)
    monkeypatch.setattr(module, "_TIDY_EVERY", 5)
    numbers = [store.add_tile(tile(number)) for number in range(5)]
    assert [store.full(number) is not None for number in numbers] == [False, False, True, True, True]
    assert all(record.colour == COLOUR for record in store.tiles())


def test_only_its_own_thread_may_use_it(store: InspectionStore) -> None:
    caught: list[BaseException] = []

    def use() -> None:
        try:
            store.tiles()
        except JournalError as error:
            caught.append(error)

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert "another thread" in str(caught[0])


def test_a_store_of_a_newer_schema_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "inspection.db"
    InspectionStore.open(sqlite_url(path), line=LINE).close()
    plain = sqlite3.connect(path)
    plain.execute("UPDATE alembic_version SET version_num = '9999'")
    plain.commit()
    plain.close()
    for open_store in (InspectionStore.open, InspectionStore.look):
        with pytest.raises(JournalError, match="newer schema"):
            open_store(sqlite_url(path), line=LINE)


def test_migrations_lead_to_the_schema(url: str) -> None:
    with InspectionStore.open(url, line=LINE) as store:
        database = store._database
        config = Config(attributes={"connection": database.connection})
        config.set_main_option("script_location", str(_FOLDER))
        config.set_main_option("path_separator", "os")
        assert ScriptDirectory.from_config(config).get_heads() == [HEAD]
        with database.transaction("compare"):
            context = MigrationContext.configure(database.connection, opts={"compare_type": True})
            assert compare_metadata(context, metadata) == []


def test_tables_are_word_for_word_those_of_the_schema(tmp_path: Path) -> None:
    """Checks and partial indexes, too, which alembic doesn't compare."""
    migrated, made = tmp_path / "migrated.db", tmp_path / "made.db"
    InspectionStore.open(sqlite_url(migrated), line=LINE).close()
    engine = create_engine(sqlite_url(made))
    metadata.create_all(engine)
    engine.dispose()
    assert described(migrated) == described(made)


def described(path: Path) -> dict[str, set[str]]:
    plain = sqlite3.connect(path)
    rows = plain.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL AND name <> 'alembic_version'")
    found = {}
    for name, sql in rows.fetchall():
        inner = re.sub(r"\s+", " ", sql)
        found[name] = {part.strip(" ()") for part in inner.partition("(")[2].split(", ")}
        # A key of several columns is written in another order by the two.
        found[name] |= {str("AUTOINCREMENT" in sql)}
    plain.close()
    return found


def test_a_damaged_inspection_is_told_and_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "inspection.db"
    with InspectionStore.open(sqlite_url(path), line=LINE) as store:
        number = store.add_tile(tile(1))
        with store._database.transaction("damage") as connection:
            connection.exec_driver_sql("UPDATE inspections SET detail = '{\"colour\": 5}'")
        with pytest.raises(JournalError, match="damaged"):
            store.full(number)
        assert store.full(number + 1) is None


def test_a_name_of_a_line_has_its_bounds(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="100 printable characters"):
        InspectionDatabase(sqlite_url(tmp_path / "a.db"), line="x" * 90, read_only=False)


FINITE = st.floats(-1e6, 1e6, allow_subnormal=False)


@given(
    values=st.lists(FINITE, min_size=12, max_size=12),
    kinds=st.lists(st.sampled_from(list(DefectKind)), max_size=4),
    reasons=st.lists(st.text(), max_size=3),
    face=st.none() | st.integers(0, (1 << 40) - 1),
)
def test_json_of_an_inspection_is_the_inspection(
    values: list[float], kinds: list[DefectKind], reasons: list[str], face: int | None
) -> None:
    inspection = TileInspection(
        Recognition(
            face,
            1,
            ((values[0], values[1]),),
            values[2],
            values[3],
            values[4],
            values[5],
            None,
            (*reasons, "")[0],
        ),
        replace(COLOUR, hue=values[6], fired_lab=(values[7], values[8], values[9])) if face else None,
        SIZE if face is None else None,
        tuple(Defect(kind, *values[:7], Grade.SECOND) for kind in kinds),
        Grade.SCRAP,
        tuple(reasons),
        (values[10], values[11]),
        values[0],
    )
    assert inspection_from_json(inspection_text(inspection)) == inspection


@pytest.mark.parametrize("text", ["", "5", "[]", "{}", '{"recognition": null, "colour": null, "dimensions": null}'])
def test_other_json_is_no_inspection(text: str) -> None:
    with pytest.raises(ValueError):
        inspection_from_json(text)
