"""A line's daemon on a plant of its own: whole jobs, restarts, changeovers, and what it does when things go missing."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.line_campaigns import workplace
from tests.line_hand import Hand, at_work
from tests.line_workshop import (
    STOPPED,
    PlantProcess,
    Workplace,
    judge,
    kill_at,
    plant_process,
    wait_for,
    write_job,
    write_line,
    write_slab,
)
from tilefab.config import load_job
from tilefab.control import line_machine as machine
from tilefab.control.ledger import ArmState
from tilefab.control.line_machine import LineState
from tilefab.pipeline.line.jobs import line_job
from tilefab.pipeline.line.source import open_source
from tilefab.pipeline.plan import plan_job
from tilefab.pipeline.progress import Silent

pytestmark = pytest.mark.xdist_group("line")

Line = tuple[PlantProcess, Workplace]


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Line]:
    with workplace(tmp_path_factory.mktemp("daemon"), rate=40.0, count=1) as here:
        yield here


def test_a_whole_job_over_tcp_is_printed_as_the_job_gives_it(line: Line) -> None:
    plant, place = line[0], line[1].more(25)
    assert wait_for(place.fork(lambda _: None)) == STOPPED
    judged = judge(plant, place, check_pixels=40)
    assert not judged.wrong
    assert judged.faces == {"passed": place.job.plan.job.tile.count}


def test_a_whole_job_over_rtu_is_printed_as_the_job_gives_it(line: Line) -> None:
    plant, place = line[0], line[1].more(12)
    folder = place.line.path.parent
    serial = Workplace.open(folder / "job.toml", write_line(folder, plant.endpoints, rtu=True))
    plant.do("rate", rate=15)
    try:
        assert wait_for(serial.fork(lambda _: None)) == STOPPED
    finally:
        plant.do("rate", rate=40)
    judged = judge(plant, serial, check_pixels=10)
    assert not judged.wrong
    assert set(judged.faces) == {"passed"}


def test_a_daemon_ended_in_the_middle_is_gone_on_with_by_the_next(line: Line) -> None:
    plant, place = line[0], line[1].more(12)

    async def begin() -> None:
        async with at_work(plant, place) as hand:
            await hand.start()
            await hand.until_prints(4)
        now = plant.do("state")
        # It leaves the line at rest: nothing has to stop by itself.
        assert now["speed_mm_s"] == 0
        assert now["printer"]["held"]
        assert "DEAD_MAN" not in now["plc"]["trouble"]
        assert not now["printer"]["deadman"]

    asyncio.run(begin())
    assert wait_for(place.fork(lambda _: None)) == STOPPED
    judged = judge(plant, place)
    assert not judged.wrong
    assert set(judged.faces) == {"passed"}


def test_a_daemon_ended_while_it_brings_the_line_up_moves_nothing(line: Line) -> None:
    plant, place = line[0], line[1].more(3)

    async def begin() -> None:
        async with at_work(plant, place) as hand:
            await hand.until(lambda: not hand.daemon.line.missing)
            travel = plant.do("state")["travel_mm"]
            hand.order(machine.OperatorStart())
            await asyncio.sleep(0.1)
        assert "running" not in hand.states
        assert plant.do("state")["travel_mm"] == travel

    asyncio.run(begin())
    assert wait_for(place.fork(lambda _: None)) == STOPPED
    assert not judge(plant, place).wrong


def test_a_line_stopped_by_its_operator_brings_its_tiles_through_and_goes_on(line: Line) -> None:
    plant, place = line[0], line[1].more(15)

    async def work() -> None:
        async with at_work(plant, place) as hand:
            await hand.start()
            await hand.until_prints(3)
            hand.order(machine.OperatorStop())
            await hand.until_state(LineState.STOPPED)
            journal = place.journal()
            open_arms = journal.arms(states=[ArmState.INTENT, ArmState.ARMED, ArmState.PRINTED])
            journal.close()
            assert not open_arms
            assert hand.daemon.jobs
            await hand.start()
            await hand.until(lambda: not hand.daemon.jobs)
            await hand.until_state(LineState.STOPPED)
            assert "holding" not in hand.states

    asyncio.run(work())
    judged = judge(plant, place)
    assert not judged.wrong
    assert set(judged.faces) == {"passed"}


def test_orders_that_follow_each_other_at_once_lose_no_face(line: Line) -> None:
    plant, place = line[0], line[1].more(15)

    async def work() -> None:
        async with at_work(plant, place) as hand:
            await hand.start()
            for pause in (0.0, 0.03, 0.08, 0.15, 0.22, 0.3, 0.4):
                # Held while the line is brought up, at whatever it is doing there.
                hand.order(machine.OperatorHold())
                await hand.until(lambda: not machine.refusal(hand.daemon.line, machine.OperatorResume()))
                hand.order(machine.OperatorResume())
                await asyncio.sleep(pause)
            await hand.until_state(LineState.RUNNING)
            hand.order(machine.OperatorHold())
            hand.order(machine.OperatorStop())
            assert hand.state is LineState.STOPPED
            hand.order(machine.OperatorStart())
            await hand.until_state(LineState.RUNNING)
            hand.order(machine.OperatorStop())
            hand.order(machine.OperatorStart())
            await hand.finish()

    asyncio.run(work())
    judged = judge(plant, place)
    assert not judged.wrong
    assert set(judged.faces) == {"passed"}


def test_a_slow_disk_loses_no_face_and_trips_no_dead_man(line: Line) -> None:
    plant, place = line[0], line[1].more(8)

    async def work() -> None:
        async with at_work(plant, place) as hand:
            await hand.start()
            slow_down(hand, 0.2)
            await hand.until_prints(2)
            hand.order(machine.OperatorHold())
            await hand.resume()
            await hand.finish()
            slow_down(hand, 0.0)
            assert not {"deadman_plc", "deadman_printer", "defect", "journal"} & {*hand.alarms}

    plant.do("rate", rate=15)
    try:
        asyncio.run(work())
    finally:
        plant.do("rate", rate=40)
    judged = judge(plant, place)
    assert not judged.wrong


def slow_down(hand: Hand, seconds: float) -> None:
    """Let every commit of a daemon's journal take long."""
    keeper: Any = hand.daemon.keeper
    mark, intend = type(keeper._journal).mark, type(keeper._journal).intend

    def late(call: Any) -> Any:
        def work(*arguments: Any, **named: Any) -> Any:
            time.sleep(seconds)
            return call(keeper._journal, *arguments, **named)

        return work

    keeper._journal.mark, keeper._journal.intend = late(mark), late(intend)


def test_a_daemon_that_is_frozen_stops_the_line_and_holds_when_it_comes_to(line: Line) -> None:
    plant, place = line[0], line[1].more(15)
    log = place.line.path.parent / "frozen.log"
    before = plant.do("truth", summary=True)["summary"]["prints"]
    pid = place.fork(lambda _: None, log=log)
    try:
        while plant.do("truth", summary=True)["summary"]["prints"] < before + 3:
            time.sleep(0.01)
        os.kill(pid, signal.SIGSTOP)
        deadline = time.monotonic() + 2.0
        while (now := plant.do("state"))["speed_mm_s"] > 0 or not now["printer"]["deadman"]:
            assert time.monotonic() < deadline, "devices didn't stop by themselves"
            time.sleep(0.01)
        assert "DEAD_MAN" in now["plc"]["trouble"]
    finally:
        os.kill(pid, signal.SIGCONT)
    assert wait_for(pid) == STOPPED
    assert "'state': 'holding', 'before': 'running'" in log.read_text()
    assert not judge(plant, place).wrong


def test_a_printer_whose_journal_was_lost_prints_nothing_before_an_operator_knows(tmp_path: Path) -> None:
    with workplace(tmp_path, rate=40.0, count=12) as (plant, place):
        assert wait_for(place.fork(kill_at("printed.committed", 6))) == -signal.SIGKILL
        for path in place.line.state_directory.glob("journal*"):
            path.unlink()

        async def work() -> None:
            async with at_work(plant, place) as hand:
                await hand.until(lambda: not hand.daemon.line.missing)
                prints = hand.prints
                hand.order(machine.OperatorStart())
                await hand.until_state(LineState.HOLDING)
                assert [alarm.code for alarm in hand.daemon.line.unacked] == ["journal_behind"]
                assert hand.prints == prints
                await hand.resume()
                await hand.until_prints(2)

        asyncio.run(work())


def test_a_face_cut_off_within_by_a_kill_is_gone_on_with_right(tmp_path: Path) -> None:
    with workplace(tmp_path, rate=12.0, count=5, length=300, speed=300.0) as (plant, place):
        for count in (3, 14):
            assert wait_for(place.fork(kill_at("strip.sent", count))) == -signal.SIGKILL
        assert wait_for(place.fork(lambda _: None)) == STOPPED
        judged = judge(plant, place, check_pixels=8)
        assert not judged.wrong
        assert judged.faces["passed"] >= 3


KILN = """\
[kiln]
endpoint = "{kiln}"
ramp_degc_min = 15.0
tolerance_degc = 10.0
[recipes.large]
belt_speed_mm_s = 250.0
tile_gap_mm = 60.0
kiln_set_points_degc = [22, 22, 22, 22, 22, 22, 22, 22]
cycle_min = 40
"""


def test_a_changeover_brings_belt_and_kiln_to_the_next_recipe(tmp_path: Path) -> None:
    write_slab(tmp_path)
    small = write_job(tmp_path, name="small", count=8)
    large = write_job(tmp_path, name="large", count=6, seed=9, width=70, length=90, recipe="large")
    with plant_process(tmp_path, rate=40.0) as plant:
        more = KILN.format(kiln=plant.endpoints["kiln"])
        line_path = write_line(tmp_path, plant.endpoints, run_out_mm=3200.0, more=more)
        place = Workplace.open(small, line_path)
        job = line_job(plan_job(load_job(large)), place.line)
        source = open_source(job.plan, Silent(), 16)

        async def work() -> None:
            async with at_work(plant, place, [(place.job, place.source), (job, source)]) as hand:
                await hand.start()
                await hand.until(lambda: len(hand.daemon.jobs) == 1)
                await hand.until_state(LineState.ARMING)
                # None waits before the kiln, to come under the next recipe. "passed" is the fate of one on its way.
                fates = [tile["fate"] for tile in plant.do("truth")["tiles"] if tile["prints"]]
                assert len(fates) == 8
                assert "passed" not in fates
                # The last tiles keep the firing that they came in for: an hour of the plant's.
                kiln = hand.daemon.kiln
                assert kiln is not None
                plant.do("rate", rate=1000)
                await hand.until(lambda: kiln.status is not None and kiln.status.tiles_inside == 0)
                plant.do("rate", rate=40)
                await hand.until_state(LineState.RUNNING)
                status = kiln.status
                assert status is not None
                assert (*status.set_points_degc,) == (22.0,) * 8
                assert status.cycle_time_min == 40
                await hand.until(lambda: not hand.daemon.jobs)
                await hand.until_state(LineState.STOPPED)
                assert "holding" not in hand.states
                command = hand.daemon.conveyor.settings
                assert (command.speed_mm_s, command.tile_length_mm, command.tile_pitch_mm) == (250.0, 90.0, 150.0)

        asyncio.run(work())
        judged = judge(plant, place, check_pixels=6, others=[(job, source)])
        assert not judged.wrong
        assert judged.faces == {"passed": 14}


def test_a_job_that_was_printed_makes_way_for_the_next_in_a_restarted_daemon(tmp_path: Path) -> None:
    write_slab(tmp_path)
    first = write_job(tmp_path, name="first", count=4)
    second = write_job(tmp_path, name="second", count=4, seed=9)
    with plant_process(tmp_path, rate=40.0) as plant:
        place = Workplace.open(first, write_line(tmp_path, plant.endpoints))
        assert wait_for(place.fork(lambda _: None)) == STOPPED
        job = line_job(plan_job(load_job(second)), place.line)
        source = open_source(job.plan, Silent(), 16)

        async def work() -> None:
            async with at_work(plant, place, [(place.job, place.source), (job, source)]) as hand:
                await hand.start()
                assert "job_refused" in hand.alarms
                await hand.finish()

        asyncio.run(work())
        judged = judge(plant, place, others=[(job, source)])
        assert not judged.wrong
        assert judged.faces == {"passed": 8}
