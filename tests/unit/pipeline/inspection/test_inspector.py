"""The inspector deals with every image once, whatever comes, and learns from each tile what can be learnt."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.inspection_world import LINE, TRANSIT, Shown, World
from tilefab.control.drift_control_state import ControlSettings
from tilefab.errors import JournalError
from tilefab.inspection.records import Defect, DefectKind, Grade, ImageProblem
from tilefab.io.inspection_store import InspectionStore
from tilefab.io.journal import Journal
from tilefab.pipeline.inspection import inspector as module
from tilefab.pipeline.inspection.correcting import control_number
from tilefab.pipeline.inspection.inspector import Inspector
from tilefab.pipeline.inspection.loop import LoopSettings
from tilefab.pipeline.inspection.remembering import press_name, press_state, run_name, run_state

MINUTE = timedelta(minutes=1)
NOZZLE = Defect(DefectKind.NOZZLE_LINE, 40.0, 75.0, 0.2, 150.0, 30.0, 3.0, 2.5, Grade.SECOND)


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    made = World(tmp_path)
    with made.stack:
        yield made


def work(inspector: Inspector, rounds: int = 3) -> int:
    return sum(inspector.round() for _ in range(rounds))


def fire(world: World, run_id: int, *faces: int, every_s: float = 20.0, correction: int = 0) -> None:
    """Print faces, let them go through the kiln, and photograph them."""
    for face in faces:
        world.print_(run_id, face, correction=correction)
        world.clock.pass_(every_s)
    world.clock.pass_(TRANSIT.total_seconds())
    for face in faces:
        world.photograph(Shown(face))
        world.clock.pass_(every_s)


def test_a_tile_is_known_put_down_and_done_with(world: World) -> None:
    run_id = world.run()
    (arm,) = world.print_(run_id, 7)
    printed_at = world.clock.at
    world.clock.pass_(TRANSIT.total_seconds())
    name = world.photograph(Shown(7, offset=(0.5, 0.0, 0.0)))
    inspector = world.inspector()
    assert work(inspector) == 1
    (tile,) = world.look().tiles()
    assert (tile.image, tile.run_id, tile.face, tile.arm_id) == (name, run_id, 7, arm)
    assert (tile.printed_at, tile.taken_at, tile.correction) == (printed_at, world.clock.at, 0)
    assert (tile.shade_lot, tile.grade, tile.repeat) == ("A", Grade.FIRST, False)
    assert world.bench.asked == [(name, (7,))]
    assert work(inspector) == 0


def test_only_expected_faces_are_looked_among_first_then_all_that_were_printed(world: World) -> None:
    run_id = world.run()
    fire(world, run_id, 1, 2)
    world.print_(run_id, 9)
    inspector = world.inspector()
    work(inspector)
    world.clock.pass_(4 * 3600)
    world.print_(run_id, 5)
    world.clock.pass_(60)
    name = world.photograph(Shown(9))
    work(inspector)
    assert [faces for image, faces in world.bench.asked if image == name] == [(5,), (1, 2, 5, 9)]
    assert world.look().tile_of_image(name).face == 9  # type: ignore[union-attr]


def test_images_are_dealt_with_in_the_order_they_were_taken(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, *range(20))
    world.clock.pass_(3000)
    begin = world.clock.at
    order = list(range(20))
    random.Random(1).shuffle(order)
    for place in order:
        world.photograph(Shown(place), begin + timedelta(seconds=place))
    world.clock.pass_(30)
    inspector = world.inspector()
    work(inspector, 5)
    assert [fact["face"] for fact in world.told("tile")] == list(range(20))


def test_a_second_image_of_a_tile_is_a_repeat_and_teaches_nothing(world: World) -> None:
    run_id = world.run()
    fire(world, run_id, 1)
    inspector = world.inspector()
    work(inspector)
    world.photograph(Shown(1))
    work(inspector)
    store = world.look()
    assert [tile.repeat for tile in store.tiles()] == [False, True]
    assert len(store.innovations()) == 1
    assert sum(store.grades().values()) == 1


def test_a_face_printed_again_is_paired_with_the_print_that_its_tile_came_from(world: World) -> None:
    run_id = world.run()
    fire(world, run_id, *range(4))
    with ExitStack() as stack:
        work(world.inspector(stack))
    world.journal.correct(run_id, press_key="k", drift=json.dumps({"mean": [1.0, 0.0, 0.0]}), reason="drift")
    (first,) = world.print_(run_id, 10)
    world.clock.pass_(1500)
    (second,) = world.print_(run_id, 10, correction=1)
    world.clock.pass_(TRANSIT.total_seconds())
    # The first of the two broke in the kiln.
    world.photograph(Shown(10))
    work(world.inspector())
    tile = world.look().tiles()[-1]
    assert first != second
    assert (tile.arm_id, tile.correction) == (second, 1)
    assert world.bench.corrections[-1] == 1


@pytest.mark.parametrize("problem", list(ImageProblem))
def test_an_image_without_a_tile_is_put_down_as_such(world: World, problem: ImageProblem) -> None:
    run_id = world.run()
    world.print_(run_id, 1)
    world.clock.pass_(60)
    world.photograph(Shown(None, problem))
    work(world.inspector())
    (tile,) = world.look().tiles()
    assert (tile.problem, tile.run_id, tile.face) == (problem, None, None)
    assert len({image for image, _ in world.bench.asked}) == 1
    state = press_state(world.look().remembered(press_name("press a")) or "", ControlSettings())
    assert state.control.unread_share > 0.0


def test_a_strange_tile_is_none_of_these_and_many_are_an_alarm(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1)
    inspector = world.inspector()
    for _ in range(5):
        world.clock.pass_(20)
        world.photograph(Shown(None))
        work(inspector)
    store = world.look()
    assert [tile.face for tile in store.tiles()] == [None] * 5
    assert [alarm.code for alarm in store.alarms(up=True)] == ["inspection_strangers"]
    world.photograph(Shown(1))
    work(inspector)
    assert store.alarms(up=True) == []


def test_an_image_that_cant_be_read_is_tried_again_and_then_left_out(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1, 2)
    world.clock.pass_(60)
    bad = world.photograph(Shown(1))
    world.unreadable.add(bad)
    world.clock.pass_(1)
    good = world.photograph(Shown(2))
    inspector = world.inspector()
    work(inspector, 3)
    assert world.look().tile_of_image(good) is not None
    assert world.look().skipped() == []
    work(inspector, 40)
    assert [(image.image, "can't be read" in image.reason) for image in world.look().skipped()] == [(bad, True)]


def test_an_image_that_becomes_readable_is_inspected(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1)
    world.clock.pass_(60)
    name = world.photograph(Shown(1))
    world.unreadable.add(name)
    inspector = world.inspector()
    work(inspector, 3)
    world.unreadable.clear()
    work(inspector, 10)
    assert world.look().tile_of_image(name) is not None


def test_a_tile_that_cant_be_computed_doesnt_stop_the_others(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1, 2)
    world.clock.pass_(60)
    world.photograph(Shown(1, fails=np.linalg.LinAlgError("singular")))
    world.clock.pass_(1)
    good = world.photograph(Shown(2))
    inspector = world.inspector()
    work(inspector)
    store = world.look()
    assert "singular" in store.skipped()[0].reason
    assert [tile.image for tile in store.tiles()] == [good]
    assert [(alarm.code, alarm.cleared_at is None) for alarm in store.alarms()] == [("inspection_run", False)]


def test_images_wait_until_their_job_can_be_opened(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1)
    world.clock.pass_(60)
    world.photograph(Shown(1))
    world.closed_jobs.add(run_id)
    inspector = world.inspector()
    assert work(inspector) == 0
    store = world.look()
    (alarm,) = store.alarms(up=True)
    assert (alarm.code, alarm.run_id) == ("inspection_run", run_id)
    assert "no such file" in alarm.text
    world.closed_jobs.clear()
    assert work(inspector) == 0
    world.clock.pass_(61)
    assert work(inspector) == 1
    assert store.alarms(up=True) == []


def test_a_line_that_printed_nothing_has_no_tiles(world: World) -> None:
    world.run()
    world.photograph(Shown(None))
    work(world.inspector())
    assert "printed nothing" in world.look().skipped()[0].reason


def test_without_a_journal_images_wait(world: World) -> None:
    inspector = world.inspector()
    assert work(inspector, 19) == 0
    assert world.look().alarms() == []
    work(inspector, 1)
    assert [alarm.code for alarm in world.look().alarms(up=True)] == ["inspection_run"]
    run_id = world.run()
    fire(world, run_id, 1)
    assert work(inspector) == 1
    assert world.look().alarms(up=True) == []


def test_tiles_of_two_runs_are_told_apart(world: World) -> None:
    first, second = world.run(name="one"), world.run(name="two")
    world.print_(first, 1, 2)
    world.clock.pass_(20)
    world.print_(second, 3)
    world.clock.pass_(TRANSIT.total_seconds())
    for face in (1, 3, 2):
        world.photograph(Shown(face))
        world.clock.pass_(20)
    work(world.inspector())
    assert [(tile.run_id, tile.face) for tile in world.look().tiles()] == [(first, 1), (second, 3), (first, 2)]


# The loop


def drift(world: World, run_id: int, inspector: Inspector, *, tiles: int, offset: float, first: int = 0) -> None:
    """Let tiles of a press that has drifted by ``offset`` come, one each 30 s, printed with the corrections in use."""
    for face in range(first, first + tiles):
        made = world.journal.corrections(run_id)
        applied = json.loads(made[-1].drift)["mean"] if made else [0.0, 0.0, 0.0]
        world.print_(run_id, face, correction=made[-1].number if made else 0)
        world.clock.pass_(30)
        world.photograph(Shown(face, offset=(offset - applied[0], -applied[1], -applied[2])))
        work(inspector, 2)


def put_into_use(world: World, run_id: int) -> None:
    """What the daemon does with the last correction that it took."""
    _, state, reason = world.daemon.corrections[-1]
    world.journal.correct(run_id, press_key="k", drift=json.dumps(state), reason=reason)


def test_a_drift_is_corrected_and_what_was_corrected_is_learnt_from(world: World) -> None:
    run_id, inspector = world.run(), world.inspector()
    drift(world, run_id, inspector, tiles=15, offset=1.0)
    of_run, state, reason = world.daemon.corrections[0]
    assert (of_run, state["mean"]) == (run_id, pytest.approx([1.0, 0.0, 0.0], abs=0.2))
    assert reason
    put_into_use(world, run_id)
    drift(world, run_id, inspector, tiles=30, offset=1.0, first=20)
    store = world.look()
    proposals = store.proposals(run_id=run_id)
    assert [proposal.number for proposal in proposals] == list(range(1, len(proposals) + 1))
    assert {tile.correction for tile in store.tiles()} >= {0, 1}
    last = store.tiles()[-1].colour
    assert last is not None
    assert abs(last.lightness) < 0.3
    assert len(store.innovations(run_id=run_id)) == 45
    press = press_state(store.remembered(press_name("press a")) or "", ControlSettings())
    assert control_number(run_id, 1) in dict(press.control.corrections)


def test_nothing_is_corrected_where_the_lines_file_says_so(world: World) -> None:
    world.settings = LoopSettings(ControlSettings(least_interval_s=300.0, fewest_tiles=3), correct=False)
    run_id, inspector = world.run(), world.inspector()
    drift(world, run_id, inspector, tiles=30, offset=1.0)
    assert world.daemon.corrections == []
    proposals = world.look().proposals()
    assert proposals
    assert all("only told" in proposal.answer and proposal.number is None for proposal in proposals)


def test_refused_corrections_are_proposed_again_and_become_an_alarm(world: World) -> None:
    world.daemon.refuses = "too soon after the last one"
    run_id, inspector = world.run(), world.inspector()
    drift(world, run_id, inspector, tiles=50, offset=1.0)
    store = world.look()
    assert len(store.proposals()) >= 3
    (alarm,) = store.alarms(up=True)
    assert alarm.code == "correction_refused"
    assert "too soon" in alarm.text
    world.daemon.refuses = ""
    drift(world, run_id, inspector, tiles=15, offset=1.0, first=60)
    assert store.alarms(up=True) == []
    assert world.daemon.corrections


def test_a_proposal_without_an_answer_is_sent_again_after_a_restart(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1)
    with ExitStack() as stack:
        world.inspector(stack)
        store = stack.enter_context(ExitStack())
        del store
    with InspectionStore.open(world.store_url, line=LINE) as opened:
        opened.propose(run_id, "older", '{"mean": [1, 0, 0]}')
        opened.propose(run_id, "newer", '{"mean": [2, 0, 0]}')
    work(world.inspector(), 2)
    assert [(drift["mean"], reason) for _, drift, reason in world.daemon.corrections] == [([2, 0, 0], "newer")]
    older, newer = world.look().proposals()
    assert (older.number, "overtaken" in older.answer) == (None, True)
    assert newer.number == 1


def test_a_new_run_begins_with_what_is_known_of_its_press(world: World) -> None:
    first, inspector = world.run(name="one"), world.inspector()
    drift(world, first, inspector, tiles=20, offset=1.0)
    put_into_use(world, first)
    work(inspector)
    second = world.run(name="two")
    world.print_(second, 0)
    world.clock.pass_(600)
    work(inspector)
    world.clock.pass_(31)
    work(inspector)
    of_run, state, _ = world.daemon.corrections[-1]
    assert (of_run, state["mean"]) == (second, pytest.approx([1.0, 0.0, 0.0], abs=0.2))


def test_images_that_show_nothing_hold_the_corrections(world: World) -> None:
    run_id, inspector = world.run(), world.inspector()
    drift(world, run_id, inspector, tiles=5, offset=0.0)
    for _ in range(40):
        world.clock.pass_(20)
        world.photograph(Shown(None, ImageProblem.BLACK))
        work(inspector, 2)
    store = world.look()
    assert {alarm.code for alarm in store.alarms(up=True)} == {"inspection_images", "colour_held"}
    assert {code for code, _ in world.daemon.warnings} == {"inspection_images", "colour_held"}
    drift(world, run_id, inspector, tiles=60, offset=0.0, first=100)
    assert store.alarms(up=True) == []


# Alarms


def test_the_daemon_is_told_once_it_is_there(world: World) -> None:
    world.daemon.away = True
    inspector = world.inspector()
    (world.camera).rename(world.folder / "gone")
    run_id = world.run()
    world.print_(run_id, 1)
    work(inspector, 5)
    assert [(alarm.code, alarm.told) for alarm in world.look().alarms(up=True)] == [("camera_folder", False)]
    world.daemon.away = False
    work(inspector, 1)
    assert world.daemon.warnings == []
    world.clock.pass_(31)
    work(inspector, 3)
    ((code, text),) = world.daemon.warnings
    assert code == "camera_folder"
    assert "No such file" in text
    (world.folder / "gone").rename(world.camera)
    work(inspector, 1)
    assert world.look().alarms(up=True) == []


def test_what_is_over_before_the_daemon_is_there_is_not_told(world: World) -> None:
    world.daemon.away = True
    inspector = world.inspector()
    run_id = world.run()
    world.print_(run_id, 1)
    world.camera.rename(world.folder / "gone")
    work(inspector, 5)
    (world.folder / "gone").rename(world.camera)
    world.daemon.away = False
    for _ in range(3):
        world.clock.pass_(31)
        work(inspector, 1)
    assert len(world.look().alarms()) == 1
    assert world.daemon.warnings == []


def test_a_folder_away_for_a_moment_is_no_alarm(world: World) -> None:
    inspector = world.inspector()
    run_id = world.run()
    world.print_(run_id, 1)
    work(inspector, 1)
    world.camera.rename(world.folder / "gone")
    work(inspector, 2)
    (world.folder / "gone").rename(world.camera)
    work(inspector, 2)
    assert world.look().alarms() == []


def test_a_silent_camera_is_noticed_when_tiles_should_come(world: World) -> None:
    run_id, inspector = world.run(), world.inspector()
    fire(world, run_id, *range(3))
    work(inspector)
    world.print_(run_id, *range(10, 15))
    for _ in range(45):
        world.clock.pass_(60)
        work(inspector, 1)
    assert world.look().alarms() == []
    for _ in range(8):
        world.clock.pass_(60)
        work(inspector, 1)
    (alarm,) = world.look().alarms(up=True)
    assert alarm.code == "camera_silent"
    assert "5 tiles" in alarm.text
    world.photograph(Shown(10))
    work(inspector)
    assert world.look().alarms(up=True) == []


def test_a_camera_is_not_silent_while_no_tiles_come(world: World) -> None:
    run_id, inspector = world.run(), world.inspector()
    fire(world, run_id, 1)
    work(inspector)
    for _ in range(20):
        world.clock.pass_(600)
        work(inspector, 1)
    assert world.look().alarms() == []


def test_a_failed_nozzle_is_told_with_its_place(world: World) -> None:
    run_id, inspector = world.run(), world.inspector()
    world.print_(run_id, *range(20))
    world.clock.pass_(TRANSIT.total_seconds())
    for face in range(3):
        world.photograph(Shown(face, defects=(NOZZLE,), grade=Grade.SECOND))
        world.clock.pass_(20)
        work(inspector)
    (alarm,) = world.look().alarms(up=True)
    assert (alarm.code, alarm.run_id) == ("defect_run", run_id)
    assert "40.0 mm" in alarm.text
    for face in range(3, 13):
        world.photograph(Shown(face))
        world.clock.pass_(20)
        work(inspector)
    assert world.look().alarms(up=True) == []


def test_far_behind_images_are_left_out_evenly_and_told(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_WAITING", 30)
    run_id = world.run()
    world.print_(run_id, *range(100))
    world.clock.pass_(TRANSIT.total_seconds())
    for face in range(100):
        world.photograph(Shown(face))
        world.clock.pass_(1)
    inspector = world.inspector()
    work(inspector, 20)
    store = world.look()
    faces = [tile.face for tile in store.tiles()]
    assert faces == list(range(3, 100, 4))
    assert len(store.skipped()) == 75
    (alarm,) = store.alarms()
    assert alarm.code == "inspection_behind"
    assert "75 images" in alarm.text
    assert alarm.cleared_at is not None


def test_pictures_of_the_ten_worst_are_kept(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, *range(30))
    world.clock.pass_(TRANSIT.total_seconds())
    offsets = list(range(30))
    random.Random(3).shuffle(offsets)
    for face, offset in enumerate(offsets):
        world.photograph(Shown(face, offset=(0.1 * offset, 0.0, 0.0)))
        world.clock.pass_(1)
    work(world.inspector(), 8)
    worst = world.look().worst(run_id)
    assert [offsets[tile.face or 0] for tile in worst] == list(range(29, 19, -1))
    names = {name for tile in worst if tile.pictures for name in (tile.pictures.predicted, tile.pictures.fired)}
    kept = {path.relative_to(world.pictures).as_posix() for path in world.pictures.rglob("*.png")}
    assert kept == names
    assert len(names) == 20


def test_pictures_that_nobody_knows_are_cleared_away(world: World) -> None:
    stray = world.pictures / "run_1" / "stray.png"
    stray.parent.mkdir(parents=True)
    stray.write_bytes(b"x")
    world.inspector()
    assert not stray.exists()


# What may happen to it


@pytest.mark.parametrize("leap_s", [-86_400.0, 86_400.0, 3e8])
def test_a_clock_that_leaps_does_no_harm(world: World, leap_s: float) -> None:
    run_id, inspector = world.run(), world.inspector()
    drift(world, run_id, inspector, tiles=5, offset=0.5)
    world.clock.at += timedelta(seconds=leap_s)
    drift(world, run_id, inspector, tiles=5, offset=0.5, first=10)
    world.clock.at -= timedelta(seconds=leap_s)
    drift(world, run_id, inspector, tiles=5, offset=0.5, first=20)
    tiles = world.look().tiles()
    assert sorted(tile.face or 0 for tile in tiles) == [*range(5), *range(10, 15), *range(20, 25)]
    assert all(tile.arm_id is not None for tile in tiles)


def test_an_image_named_for_the_future_is_still_known(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1)
    world.clock.pass_(60)
    world.photograph(Shown(1), world.clock.at + timedelta(days=400))
    work(world.inspector())
    assert [tile.face for tile in world.look().tiles()] == [1]


def test_a_tile_that_the_journal_knows_nothing_of_is_known_but_teaches_nothing(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1, 3)
    world.clock.pass_(60)
    world.photograph(Shown(2))
    work(world.inspector())
    store = world.look()
    (tile,) = store.tiles()
    assert (tile.run_id, tile.face, tile.arm_id, tile.correction) == (run_id, 2, None, None)
    assert store.innovations() == []


def test_a_whole_job_is_looked_through_only_if_it_is_small(world: World) -> None:
    run_id = world.run(faces=100_000)
    world.print_(run_id, 1, 3)
    world.clock.pass_(60)
    world.photograph(Shown(2))
    work(world.inspector())
    (tile,) = world.look().tiles()
    assert (tile.run_id, tile.face) == (None, None)


def test_alarms_outlive_a_restart_and_are_told_once(world: World) -> None:
    run_id = world.run()
    world.print_(run_id, 1)
    world.closed_jobs.add(run_id)
    world.photograph(Shown(1))
    with ExitStack() as stack:
        work(world.inspector(stack))
    work(world.inspector())
    assert len(world.look().alarms()) == 1
    assert len(world.daemon.warnings) == 1


def test_a_store_that_cant_be_written_ends_the_inspector(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    run_id = world.run()
    fire(world, run_id, 1)
    inspector = world.inspector()

    def full(*_: object, **__: object) -> int:
        raise JournalError("no space left")

    monkeypatch.setattr(InspectionStore, "add_tile", full)
    with pytest.raises(JournalError, match="no space"):
        work(inspector)


class Killed(BaseException):
    """As by kill -9: nothing after it is done."""


_WRITES = ("add_tile", "remember", "add_innovation", "drop_pictures", "raise_alarm", "propose", "answer", "skip")


def killed_at(monkeypatch: pytest.MonkeyPatch, moment: int, *, after: bool) -> None:
    """Let the inspector die at the ``moment``-th call that changes the store, before or after it."""
    calls = 0

    def deadly(original: Any) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == moment and not after:
                raise Killed
            result = original(*arguments, **named)
            if calls == moment:
                raise Killed
            return result

        return call

    for name in _WRITES:
        monkeypatch.setattr(InspectionStore, name, deadly(getattr(InspectionStore, name)))


def all_of(world: World) -> list[object]:
    """All that doesn't depend on when it was done."""
    store = InspectionStore.look(world.store_url, line=LINE)
    try:
        tiles = [
            (tile.image, tile.face, tile.arm_id, tile.correction, tile.shade_lot, tile.repeat) for tile in store.tiles()
        ]
        innovations = [(one.at, one.surprise, one.values, one.accepted) for one in store.innovations()]
        press, run = store.remembered(press_name("press a")), store.remembered(run_name(1))
        kept = sorted(path.name for path in world.pictures.rglob("*.png"))
        return [tiles, innovations, press, run and run_state(run), kept]
    finally:
        store.close()


def scene(folder: Path) -> World:
    """Ten tiles, bad images among them, all there before the inspector starts."""
    folder.mkdir()
    world = World(folder)
    run_id = world.run()
    world.print_(run_id, *range(10))
    world.clock.pass_(TRANSIT.total_seconds())
    for face in range(10):
        shown = Shown(None, ImageProblem.TORN) if face % 7 == 3 else Shown(face, offset=(0.9, 0.0, 0.01 * face))
        world.photograph(shown)
        world.clock.pass_(80)
    return world


def test_killed_anywhere_every_image_is_dealt_with_once(tmp_path: Path) -> None:
    whole = scene(tmp_path / "whole")
    with whole.stack:
        work(whole.inspector(), 4)
    wanted = all_of(whole)
    died = 0
    for place, moment in enumerate(range(1, 44, 3)):
        world = scene(tmp_path / f"killed {moment}")
        with world.stack:
            with pytest.MonkeyPatch.context() as monkeypatch, ExitStack() as stack:
                killed_at(monkeypatch, moment, after=place % 2 == 1)
                try:
                    work(world.inspector(stack), 4)
                except Killed:
                    died += 1
            work(world.inspector(), 4)
        assert all_of(world) == wanted, f"killed at call {moment}"
    assert died >= 12


def test_the_journal_is_only_ever_looked_at(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    run_id = world.run()
    fire(world, run_id, 1, 2)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("opened to write")

    monkeypatch.setattr(Journal, "open", refuse)
    assert work(world.inspector()) == 2
