"""The emergency stop in every state of a whole line: nothing prints or moves then, and nothing starts by itself."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest

from tests.line_campaigns import workplace
from tests.line_hand import Hand, at_work
from tests.line_workshop import PlantProcess, Workplace, judge
from tilefab.control import line_machine as machine
from tilefab.control.line_machine import LineState

pytestmark = pytest.mark.xdist_group("line")

LONG_S = 0.15
"""For anything that would go on by itself: each loop has gone round several times."""

Here = tuple[PlantProcess, Workplace]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Here]:
    with workplace(tmp_path_factory.mktemp("estop"), rate=40.0, count=400) as here:
        yield here


class Pressed:
    """A button that was pressed just now, and what the plant must be like from then on."""

    def __init__(self, plant: PlantProcess) -> None:
        self._plant = plant
        plant.fault("plc", "e_stop")
        state = plant.do("state")
        self._at, self._travel = state["time"], state["travel_mm"]
        self._begun = self._arms()

    def check(self) -> None:
        """See that nothing was printed since, and that the belt only came to rest."""
        for tile in self._plant.do("truth")["tiles"]:
            for made in tile["prints"]:
                assert made["at"] <= self._at, f"arm {made['arm']} was printed after the button was pressed"
        assert self._arms() == self._begun
        state = self._plant.do("state")
        assert state["speed_mm_s"] == 0
        # From 200 mm/s at 6000 mm/s², with room for the controller's scan.
        assert state["travel_mm"] - self._travel < 20.0

    def _arms(self) -> dict[str, Any]:
        """Arms that the printer has accepted."""
        state = self._plant.do("state")
        return {"accepted": state["printer"]["last_accepted_arm"]}


async def bring_to(hand: Hand, state: LineState) -> None:
    """Bring a line that was just made to some state."""
    await hand.until(lambda: not hand.daemon.line.missing)
    match state:
        case LineState.IDLE:
            return
        case LineState.ARMING:
            hand.order(machine.OperatorStart())
        case _:
            await hand.start()
            await hand.until_prints(2)
    match state:
        case LineState.HOLDING:
            hand.order(machine.OperatorHold())
        case LineState.DRAINING | LineState.STOPPED:
            hand.order(machine.OperatorStop())
        case LineState.FAULTED:
            hand.daemon.fault("defect", "made up")
        case _:
            pass
    await hand.until_state(state)


STATES = [state for state in LineState if state is not LineState.E_STOPPED]


@pytest.mark.parametrize("state", STATES)
def test_nothing_is_printed_or_moves_after_the_button_was_pressed(here: Here, state: LineState) -> None:
    plant, place = here

    async def work() -> None:
        async with at_work(plant, place) as hand:
            await bring_to(hand, state)
            button = Pressed(plant)
            await hand.until_state(LineState.E_STOPPED)
            await hand.until_plant(lambda now: now["speed_mm_s"] == 0)
            refused = (machine.OperatorStart(), machine.OperatorResume(), machine.OperatorStop())
            for order in refused:
                hand.order(order)
            assert hand.state is LineState.E_STOPPED

            plant.fault("plc", "e_stop_release")
            await asyncio.sleep(LONG_S)
            assert hand.state is LineState.E_STOPPED
            for order in refused:
                hand.order(order)
            assert hand.state is LineState.E_STOPPED
            button.check()

            hand.ack()
            await hand.until_state(LineState.STOPPED)
            await asyncio.sleep(LONG_S)
            assert hand.state is LineState.STOPPED
            button.check()

            await hand.start()

    asyncio.run(work())
    assert not judge(plant, place, finished=False).wrong


def test_a_button_acknowledged_while_it_is_in_has_to_be_acknowledged_again(here: Here) -> None:
    plant, place = here

    async def work() -> None:
        async with at_work(plant, place) as hand:
            await bring_to(hand, LineState.RUNNING)
            button = Pressed(plant)
            await hand.until_state(LineState.E_STOPPED)
            hand.ack()
            await hand.until_plant(lambda now: now["speed_mm_s"] == 0)
            plant.fault("plc", "e_stop_release")
            await asyncio.sleep(LONG_S)
            assert hand.state is LineState.E_STOPPED
            button.check()
            hand.ack()
            await hand.until_state(LineState.STOPPED)
            await hand.start()

    asyncio.run(work())
    assert not judge(plant, place, finished=False).wrong


def test_a_button_that_was_in_for_a_moment_only_stops_the_line_as_well(here: Here) -> None:
    plant, place = here

    async def work() -> None:
        async with at_work(plant, place) as hand:
            await bring_to(hand, LineState.RUNNING)
            button = Pressed(plant)
            plant.fault("plc", "e_stop_release")
            await hand.until_state(LineState.E_STOPPED)
            await hand.until_plant(lambda now: now["speed_mm_s"] == 0)
            await asyncio.sleep(LONG_S)
            assert hand.state is LineState.E_STOPPED
            button.check()
            hand.ack()
            await hand.until_state(LineState.STOPPED)

    asyncio.run(work())
    assert not judge(plant, place, finished=False).wrong


def test_a_daemon_started_with_the_button_in_waits_for_it(here: Here) -> None:
    plant, place = here

    async def work() -> None:
        async with at_work(plant, place) as hand:
            await bring_to(hand, LineState.RUNNING)
        button = Pressed(plant)
        async with at_work(plant, place) as hand:
            await hand.until_state(LineState.E_STOPPED)
            hand.order(machine.OperatorStart())
            hand.ack()
            assert hand.state is LineState.E_STOPPED
            plant.fault("plc", "e_stop_release")
            await asyncio.sleep(LONG_S)
            assert hand.state is LineState.E_STOPPED
            button.check()
            hand.ack()
            await hand.until_state(LineState.STOPPED)
            button.check()
            await hand.start()

    asyncio.run(work())
    assert not judge(plant, place, finished=False).wrong
