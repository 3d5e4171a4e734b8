"""Colours corrected in the middle of a run: by the real maker, by hand through the API, and with daemons killed."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.line_campaigns import ANY, KILLED, kill_often, workplace
from tests.line_hand import at_work
from tests.line_workshop import (
    PlantProcess,
    Workplace,
    judge,
    kill_at,
    made_up_drift,
    wait_for,
)
from tilefab.control import line_machine as machine
from tilefab.control.ledger import ArmState
from tilefab.control.line_machine import LineState
from tilefab.pipeline.line.book import FaceBook
from tilefab.pipeline.line.correction_maps import KeptMaps
from tilefab.pipeline.line.desk import Desk
from tilefab.pipeline.line.probe import CORRECTION_STEPS

pytestmark = pytest.mark.xdist_group("line")

Line = tuple[PlantProcess, Workplace]


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Line]:
    with workplace(tmp_path_factory.mktemp("corrections"), rate=30.0, corrected=True, count=40) as here:
        yield here


def corrections_of(place: Workplace) -> list[int]:
    """Of every arm of the run that was printed, in order."""
    with contextlib.closing(place.journal()) as journal:
        return [arm.correction for arm in journal.arms() if arm.state is not ArmState.UNPRINTED]


def faces_under_way(book: FaceBook) -> set[int]:
    """Faces whose tiles aren't decided, as far as the journal has it."""
    return {arm.intent.face for arm in book.active.values()}


def test_a_daemon_killed_at_any_step_of_a_correction_prints_every_face_as_the_journal_has_it(line: Line) -> None:
    plant, place = line
    # Tiles of several corrections are under way when a daemon dies, and the next one has their maps to open.
    tiles = (("strip.sent", 30), ("printed.committed", 3), ("release.before", 4), ("armed.committed", 5))
    for step, count in (*((step, 3) for step in CORRECTION_STEPS), *tiles, *((step, 1) for step in CORRECTION_STEPS)):
        code = wait_for(place.fork(kill_at(step, count)))
        assert code == KILLED, f"{step}: {code}"
    found = kill_often(plant, place, ANY, 4, seed=2, check_pixels=60)
    assert not found.wrong
    assert found.faces[ArmState.PASSED.value] + found.faces[ArmState.IN_DOUBT.value] > 30
    assert len(set(corrections_of(place))) > 3


def test_faces_that_are_put_down_keep_the_correction_they_were_put_down_with(tmp_path: Path) -> None:
    with workplace(tmp_path, rate=20.0, corrected=True, count=60) as (plant, place):

        async def work() -> None:
            async with at_work(plant, place) as hand:
                await hand.start()
                await hand.until_prints(2)
                work = hand.daemon.work
                assert work.book is not None
                ahead = {intent.face for intent in work.book.pool}
                assert ahead
                desk = Desk(lambda *_, **__: None)
                desk.attend(hand.daemon)
                assert desk.status().correction is None
                assert await desk.correct(work.book.run_id, made_up_drift(place.job.plan, 1), "too dark") == 1
                shown = desk.status().correction
                assert shown is not None
                assert (shown.number, shown.reason) == (1, "too dark")
                assert await desk.corrections(None) == (work.book.run_id, [shown])
                assert b'tilefab_line_correction{line="workshop"} 1.0' in desk.metrics()
                told = [facts for kind, facts in hand.told if kind == "correction"]
                assert [(facts["number"], facts["reason"]) for facts in told] == [(1, "too dark")]
                assert {intent.correction for intent in work.book.pool if intent.face in ahead} <= {0}
                # Asked for what is in use: nothing changes.
                again = hand.daemon.corrector.correct(work.book.run_id, made_up_drift(place.job.plan, 1), "again")
                assert await again == 1
                await hand.until(lambda: place.source.corrections == {1})
                # What the inspector has to say doesn't stop the line.
                desk.warn("colour_signal", "darker by 2.1")
                assert [(alarm.code, alarm.message) for alarm in desk.alarms()] == [("colour_signal", "darker by 2.1")]
                assert hand.state is LineState.RUNNING
                await desk.close()
                # Held, stopped, resumed: what was put down is still printed as it was.
                hand.order(machine.OperatorHold())
                await hand.resume()
                await hand.finish()
                assert hand.state is LineState.STOPPED

        asyncio.run(work())
        judged = judge(plant, place, check_pixels=60)
        assert not judged.wrong
        found = corrections_of(place)
        assert set(found) == {0, 1}
        assert found == sorted(found)
        assert judged.faces == {"passed": 60}


def test_a_reprint_comes_with_the_correction_in_use(tmp_path: Path) -> None:
    with workplace(tmp_path, rate=20.0, corrected=True, count=40) as (plant, place):

        async def work() -> None:
            async with at_work(plant, place) as hand:
                await hand.start()
                book = hand.daemon.book
                assert book is not None
                # Passed, and put down so.
                await hand.until(lambda: hand.daemon.tiles_passed > 0 and 0 not in faces_under_way(book))
                await hand.daemon.corrector.correct(book.run_id, made_up_drift(place.job.plan, 1), "too dark")
                desk = Desk(lambda *_, **__: None)
                desk.attend(hand.daemon)
                await desk.command("reprint", {"face": 0})
                await desk.close()
                await hand.finish()

        asyncio.run(work())
        with contextlib.closing(place.journal()) as journal:
            arms = [arm for arm in journal.arms() if arm.face == 0]
        assert [(arm.attempt, arm.correction, arm.state) for arm in arms] == [
            (1, 0, ArmState.PASSED),
            (2, 1, ArmState.PASSED),
        ]


def test_a_restarted_daemon_goes_on_with_the_latest_correction(tmp_path: Path) -> None:
    with workplace(tmp_path, rate=30.0, corrected=True, count=30) as (plant, place):
        assert wait_for(place.fork(kill_at("printed.committed", 8))) == -signal.SIGKILL
        before = max(corrections_of(place))
        assert before > 0
        place.source.keep_only(())

        async def work() -> None:
            async with at_work(plant, place) as hand:
                await hand.start()
                latest = hand.daemon.work.correction
                assert latest is not None
                assert latest.number >= before
                assert latest.number in place.source.corrections
                await hand.finish()

        asyncio.run(work())
        judged = judge(plant, place, check_pixels=30)
        assert not judged.wrong


def test_the_real_maker_corrects_while_the_line_runs(tmp_path: Path) -> None:
    """A map is made by a process of its own: the line prints on meanwhile, and the next daemon finds the map kept."""
    with workplace(tmp_path, rate=2.0, corrected=True, count=20_000) as (plant, place):
        place.maps = KeptMaps()

        async def work() -> None:
            async with at_work(plant, place) as hand:
                await hand.start()
                book = hand.daemon.book
                assert book is not None
                before = hand.prints
                drift = made_up_drift(place.job.plan, 80)
                assert await hand.daemon.corrector.correct(book.run_id, drift, "faded") == 1
                assert hand.prints > before + 3, "nothing was printed meanwhile"
                assert place.source.corrections == {1}
                assert not {"underrun", "deadman_plc", "deadman_printer", "journal_slow"} & {*hand.alarms}
                plant.do("rate", rate=20)
                await hand.until(lambda: any(arm.intent.correction == 1 for arm in book.active.values()))

        asyncio.run(work())
        place.source.keep_only(())
        kept = sorted(place.job.plan.output.glob("maps/*.press.tfmap"))
        assert len(kept) == 2

        async def again() -> None:
            async with at_work(plant, place) as hand:
                await hand.start()
                assert place.source.corrections == {1}
                await hand.until_prints(20)
                hand.order(machine.OperatorStop())
                await hand.until_state(LineState.STOPPED)

        asyncio.run(again())
        assert sorted(place.job.plan.output.glob("maps/*.press.tfmap")) == kept
        judged = judge(plant, place, finished=False, check_pixels=40)
        assert not judged.wrong
        assert set(corrections_of(place)) == {0, 1}
