"""A daemon in the test's own process, with an operator's hand beside it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any

from tests.line_workshop import PlantProcess, Workplace
from tilefab.control import line_machine as machine
from tilefab.control.line_machine import LineState
from tilefab.pipeline.line.daemon import LineDaemon
from tilefab.pipeline.line.jobs import LineJob
from tilefab.pipeline.line.source import FaceSource

_TURN_S = 0.004
_PATIENCE_S = 20.0


class Hand:
    """Orders and looks.

    Attributes
    ----------
    daemon
        The daemon.
    told
        Everything that it told: kind and facts.
    """

    def __init__(self, plant: PlantProcess, place: Workplace, jobs: Sequence[tuple[LineJob, FaceSource]]) -> None:
        self.plant = plant
        self.told: list[tuple[str, dict[str, object]]] = []
        sources = {job.plan.job_hash: source for job, source in jobs}
        self.daemon = LineDaemon(
            place.line,
            [job for job, _ in jobs],
            log=lambda kind, **facts: self.told.append((kind, facts)),
            open_source=lambda job, _rows: sources[job.plan.job_hash],
            correction_maps=place.maps,
        )

    @property
    def state(self) -> LineState:
        """What the line is doing."""
        return self.daemon.line.state

    @property
    def states(self) -> list[str]:
        """All that it has been doing, in order."""
        return [str(facts["state"]) for kind, facts in self.told if kind == "state"]

    @property
    def alarms(self) -> list[str]:
        """Codes of all alarms that were raised, in order."""
        return [str(facts["code"]) for kind, facts in self.told if kind == "alarm"]

    async def until(self, seen: Callable[[], object], seconds: float = _PATIENCE_S) -> None:
        """Wait until something is seen."""
        try:
            async with asyncio.timeout(seconds):
                while not seen():
                    await asyncio.sleep(_TURN_S)
        except TimeoutError:
            raise AssertionError(f"not seen within {seconds} s; {self.daemon.line}; {self.told[-8:]}") from None

    async def until_state(self, *states: LineState, seconds: float = _PATIENCE_S) -> None:
        """Wait until the line is in one of some states."""
        await self.until(lambda: self.state in states, seconds)

    async def until_plant(self, seen: Callable[[dict[str, Any]], object], seconds: float = _PATIENCE_S) -> None:
        """Wait until something is seen in the plant."""
        await self.until(lambda: seen(self.plant.do("state")), seconds)

    async def until_prints(self, many: int) -> None:
        """Wait until so many faces more were printed."""
        wanted = self.prints + many
        await self.until(lambda: self.prints >= wanted)

    @property
    def prints(self) -> int:
        """Faces printed since the plant was started."""
        return int(self.plant.do("truth", summary=True)["summary"]["prints"])

    def order(self, event: machine.Event) -> None:
        """Give an order."""
        self.daemon.post(event)

    def ack(self) -> None:
        """Acknowledge everything."""
        self.order(machine.OperatorAck(self.daemon.line.raised))

    async def start(self) -> None:
        """Start, once that isn't refused, and see the line run; faces in doubt are acknowledged."""
        await self.until(lambda: not machine.refusal(self.daemon.line, machine.OperatorStart()))
        self.order(machine.OperatorStart())
        await self.until_state(LineState.RUNNING, LineState.HOLDING)
        if [alarm.code for alarm in self.daemon.line.unacked] == ["faces_in_doubt"]:
            await self.resume()
        await self.until_state(LineState.RUNNING)

    async def resume(self) -> None:
        """Acknowledge and resume, once that isn't refused, and see the line run."""
        self.ack()
        await self.until(lambda: not machine.refusal(self.daemon.line, machine.OperatorResume()))
        self.order(machine.OperatorResume())
        await self.until_state(LineState.RUNNING)

    async def finish(self) -> None:
        """Bring the queue of jobs to its end, acknowledging and resuming as often as it takes."""

        def done() -> bool:
            state = self.state
            if state in (LineState.HOLDING, LineState.E_STOPPED, LineState.FAULTED):
                self.ack()
            for order in (machine.OperatorStart(), machine.OperatorResume()):
                if self.daemon.jobs and not machine.refusal(self.daemon.line, order):
                    self.order(order)
            return not self.daemon.jobs and state in (LineState.STOPPED, LineState.HOLDING)

        await self.until(done, 60.0)


@asynccontextmanager
async def at_work(
    plant: PlantProcess, place: Workplace, jobs: Sequence[tuple[LineJob, FaceSource]] = ()
) -> AsyncIterator[Hand]:
    """Run a daemon for as long as the block lasts; it must not end before."""
    hand = Hand(plant, place, jobs or [(place.job, place.source)])
    running = asyncio.create_task(hand.daemon.run())
    try:
        yield hand
        assert not running.done(), running.exception()
    finally:
        hand.daemon.stopping.set()
        await running
