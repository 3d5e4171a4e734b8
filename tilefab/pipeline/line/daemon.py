"""The daemon of a line: loops of its devices, the state machine between them, and what an operator may ask."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from tilefab.config.line import LineFile
from tilefab.control import line_machine as machine
from tilefab.control.feeding import Feeding, watch_feed
from tilefab.control.ledger import ArmState, FaceQueue
from tilefab.control.line_machine import Line, LineState
from tilefab.devices import (
    GaugeSession,
    KilnSession,
    PlcSession,
    PlcStatus,
    PrinterDataLink,
    PrinterSession,
    PrinterStatus,
)
from tilefab.errors import DeviceError, InterlockError, JournalError, TilefabError
from tilefab.io.journal import ArmChange
from tilefab.pipeline.line.book import INTENTS_AHEAD, FaceBook
from tilefab.pipeline.line.bring_up import PRINT_SPOILT, TILES_MOVED, BringUp
from tilefab.pipeline.line.conveyor_loop import ConveyorLoop
from tilefab.pipeline.line.device_link import DeviceLink
from tilefab.pipeline.line.gauge_loop import GaugeLoop
from tilefab.pipeline.line.jobs import LineJob, check_printer, open_job, print_job
from tilefab.pipeline.line.keeper import JournalKeeper
from tilefab.pipeline.line.kiln_loop import KilnLoop
from tilefab.pipeline.line.printer_loop import PrinterLoop
from tilefab.pipeline.line.probe import Probe, nothing
from tilefab.pipeline.line.source import FaceSource
from tilefab.pipeline.line.streaming import Streamer
from tilefab.pipeline.line.timing import Throughput

_PRINTER_PERIOD_S = 0.015
_PLC_PERIOD_S = 0.04
_KILN_PERIOD_S = 0.5
_GAUGE_PERIOD_S = 0.5
_WATCH_PERIOD_S = 0.1
_TURN_S = 0.005
_SESSIONS_SINCE_S = 1_767_225_600
"""2026-01-01, from which sessions are counted in seconds, if the journal that counted them was lost."""

_RUNS_LOOKED_AT = 1000
_NAMED = 12
_LOADER_WAY_MM = 10_000
"""No loader is farther from its eye."""
_SLOW_JOURNAL_S = 1.0
_ANSWER_S = 5.0
"""Longest wait for a device that was there a moment ago."""

MOVED = frozenset(
    {
        "jam",
        "double_feed",
        "tiles_disagree",
        "tiles_missed",
        "tile_lost",
        "printer_rebooted",
        "plc_rebooted",
        "printer_confused",
        "arm_refused",
        "e_stop",
        "diverter_fault",
    }
)
"""Reasons after which tiles may lie elsewhere than the counts say: hands reached onto the belt, or counts were lost."""

Errand = Callable[[PrinterSession], Awaitable[None]]
Log = Callable[..., None]


def line_devices(line_file: LineFile) -> tuple[str, ...]:
    """Names of a line's devices that it can't run without."""
    return ("plc", "printer") if line_file.line.kiln is None else ("plc", "printer", "kiln")


def no_log(kind: str, **facts: object) -> None:
    """Write nothing."""


class LineDaemon:
    """A line at work.

    Parameters
    ----------
    line_file
        The line.
    jobs
        What to print, in this order.
    log
        Takes a kind of event and its facts.
    probe
        See `tilefab.pipeline.line.probe`.
    open_source
        Opens the faces of a job; blocking, run in a thread.
    """

    def __init__(
        self,
        line_file: LineFile,
        jobs: Sequence[LineJob],
        *,
        log: Log = no_log,
        probe: Probe = nothing,
        open_source: Callable[[LineJob, int], FaceSource] = open_job,
    ) -> None:
        settings = line_file.line
        self.line_file = line_file
        self.line = Line(missing=frozenset(line_devices(line_file)))
        self.since = datetime.now(UTC)
        self.jobs: deque[LineJob] = deque(jobs)
        self.job: LineJob | None = None
        self.source: FaceSource | None = None
        self.keeper = JournalKeeper(line_file.journal_url, settings.line.name, probe)
        self.printer = PrinterLoop(self, self.keeper, probe)
        self.conveyor = ConveyorLoop(self, self.keeper, probe)
        self.conveyor.edges = self.printer.edges
        self.throughput = Throughput(time.monotonic)
        self.tiles_passed = self.tiles_diverted = 0
        self.stopping = asyncio.Event()
        self._log = log
        self._book: FaceBook | None = None
        self._streamer: Streamer | None = None
        self._probe, self._open_source = probe, open_source
        self._session = 0
        self._moved = self._spoilt = self._closed = False
        self._filling: asyncio.Task[None] | None = None
        self._cancelling: asyncio.Task[None] | None = None
        self._watched = 0
        self._behind_told: int | None = None
        self._feeding = Feeding()
        self._tasks: set[asyncio.Task[Any]] = set()
        self._answering: asyncio.Task[machine.Event] | None = None
        self._errands: deque[tuple[Errand, asyncio.Future[None]]] = deque()
        self.plc_link = DeviceLink(
            "plc",
            lambda: PlcSession(settings.plc.endpoint),
            cycle=self.conveyor.cycle,
            period_s=_PLC_PERIOD_S,
            lost=self._lost,
            back=self._back,
        )
        self.printer_link = DeviceLink(
            "printer",
            lambda: PrinterSession(settings.printer.control, self._session),
            begin=self.printer.greet,
            cycle=self._printer_cycle,
            period_s=_PRINTER_PERIOD_S,
            lost=self._lost,
            back=self._back,
        )
        self.gauge = GaugeLoop(self.keeper)
        self.gauge_link: DeviceLink[GaugeSession] | None = None
        if settings.gauge is not None:
            gauge_endpoint = settings.gauge.endpoint
            self.gauge_link = DeviceLink(
                "gauge",
                lambda: GaugeSession(gauge_endpoint),
                cycle=self.gauge.cycle,
                period_s=_GAUGE_PERIOD_S,
                lost=self._gauge_lost,
                back=lambda _name: None,
            )
        self.kiln: KilnLoop | None = None
        self.kiln_link: DeviceLink[KilnSession] | None = None
        if settings.kiln is not None:
            kiln_endpoint = settings.kiln.endpoint
            self.kiln = KilnLoop(self, settings.kiln.limits, settings.kiln.tolerance_degc)
            self.kiln_link = DeviceLink(
                "kiln",
                lambda: KilnSession(kiln_endpoint),
                cycle=self.kiln.cycle,
                period_s=_KILN_PERIOD_S,
                lost=self._lost,
                back=self._back,
            )

    @property
    def links(self) -> tuple[DeviceLink[Any], ...]:
        """Links to all devices."""
        others = (self.kiln_link, self.gauge_link)
        return (self.plc_link, self.printer_link, *(link for link in others if link is not None))

    @property
    def rounds(self) -> dict[str, int]:
        """How often each loop went round, by name."""
        return {link.name: link.rounds for link in self.links} | {"watch": self._watched}

    async def run(self) -> None:
        """Work until `stopping` is set; then stop the belt, hold the printer, and close everything."""
        if not self.keeper.is_open:
            await self.keeper.open()
        self._session = await self._new_session()
        loops = [self._watch(), *(link.run() for link in self.links)]
        running = [asyncio.create_task(loop) for loop in loops]
        try:
            ended = asyncio.create_task(self.stopping.wait())
            done, _ = await asyncio.wait([*running, ended], return_when=asyncio.FIRST_COMPLETED)
            if ended in done:
                await self._leave()
            for task in done - {ended}:
                task.result()
        finally:
            for task in (*running, *self._tasks):
                task.cancel()
            await asyncio.gather(*running, *self._tasks, return_exceptions=True)
            await self._close_streamer()
            await self.printer.written()
            await self.conveyor.written()
            self._closed = True
            await self.keeper.close()

    async def _leave(self) -> None:
        """Leave the line at rest: its devices would stop by themselves, but late and with an alarm."""
        if self.line.state in machine.ACTIVE:
            self.post(machine.OperatorHold())
        with suppress(TimeoutError):
            async with asyncio.timeout(_ANSWER_S):
                if self.plc_link.present:
                    await self._turn(self.plc_link)
                if self.printer_link.present:
                    await self._turn(self.printer_link)
        if self._book is not None:
            await self._give_up_pool(self._book)

    # What the loops of the devices may ask and tell: `LineHost`.

    @property
    def may_print(self) -> bool:
        """Whether tiles get faces."""
        return self.line.state is LineState.RUNNING

    @property
    def moving(self) -> bool:
        """Whether the belt is meant to move."""
        return self.line.state in (LineState.RUNNING, LineState.DRAINING)

    @property
    def book(self) -> FaceBook | None:
        """Faces of the present run."""
        return self._book

    @property
    def streamer(self) -> Streamer | None:
        """Where faces are sent from."""
        return self._streamer

    def e_stop(self, device: str, pressed: bool) -> None:
        """An emergency stop was pressed or let go."""
        if pressed:
            self.tiles_moved("e_stop")
        self.post(machine.EStop(device=device, pressed=pressed))

    def tiles_moved(self, code: str) -> None:
        """Tiles may lie elsewhere than the counts say."""
        if not self._moved:
            self._moved = True
            self.tell(TILES_MOVED, code=code)

    @property
    def spoilt(self) -> bool:
        """Whether ink or a nozzle failed since the line was brought up."""
        return self._spoilt

    def print_spoilt(self, code: str) -> None:
        """Ink or a nozzle failed: what is under the head may lack ink."""
        if not self._spoilt:
            self._spoilt = True
            self.tell(PRINT_SPOILT, code=code)

    def doubt(self, code: str, reason: str) -> None:
        """Something isn't as it must be."""
        if code in MOVED:
            self.tiles_moved(code)
        self.post(machine.Doubt(code, reason))

    def fault(self, code: str, reason: str) -> None:
        """The line can't go on."""
        if code in MOVED:
            self.tiles_moved(code)
        self.post(machine.Fault(code, reason))

    def warn(self, code: str, reason: str) -> None:
        """An operator should see something."""
        self.post(machine.Warn(code, reason))

    def faces_wanted(self) -> None:
        """More faces are to be put down."""
        if self._filling is None and self._book is not None and len(self._book.pool) < INTENTS_AHEAD // 2:
            self._filling = self._start(self._fill(self._book))

    def releases_wanted(self) -> None:
        """Tiles are to be released as soon as can be."""
        self.plc_link.hurry()

    def tile_done(self, passed: bool) -> None:
        """A tile with a face was decided."""
        self.tiles_passed += passed
        self.tiles_diverted += not passed
        self.throughput.count()

    # The machine.

    def post(self, event: machine.Event) -> None:
        """Let the machine take a step, and do what it says."""
        before = self.line
        self.line, actions = machine.step(before, event)
        if self.line.state is not before.state:
            self.since = datetime.now(UTC)
            if self.line.state is not LineState.ARMING and self._answering is not None:
                self._answering.cancel()
            self.tell("state", state=self.line.state.value, before=before.state.value, reason=self.line.reason)
        for action in actions:
            self._do(action)

    def _do(self, action: machine.Action) -> None:
        match action:
            case machine.StopBelt():
                self.conveyor.run_belt = self.conveyor.feed = False
                self.plc_link.hurry()
            case machine.HoldPrinter():
                self.printer.hold()
                self.printer_link.hurry()
            case machine.RunBelt(feed):
                self.conveyor.run_belt, self.conveyor.feed = True, feed
                self.plc_link.hurry()
            case machine.ClearPrinter():
                self.printer.clear()
                self.printer_link.hurry()
            case machine.AckPlc():
                self.conveyor.acknowledge()
                self.printer.acknowledge()
                self.plc_link.hurry()
            case machine.CancelArms():
                self._cancelling = self._start(self._cancel_arms())
            case machine.BeginChangeover():
                self._answer(self._take_job(), lambda why, code: machine.ChangeoverReady(False, why, code))
            case machine.CheckDevices():
                self._answer(self._check_devices(), lambda why, code: machine.DevicesReady(False, why, code))
            case machine.Reconcile():
                self._answer(self._settle(), lambda why, code: machine.Reconciled(False, reason=why, code=code))
            case machine.RaiseAlarm(code, text, number):
                self.tell("alarm", number=number, code=code, text=text)
            case machine.ClearAlarms():
                pass
            case machine.Note(text):
                self.tell("note", text=text)

    def tell(self, kind: str, **facts: object) -> None:
        """Write an event to the log and the journal."""
        self._log(kind, **facts)
        if not self._closed:
            self._start(self._note(kind, facts))

    async def _note(self, kind: str, facts: Mapping[str, object]) -> None:
        try:
            await self.keeper.note(kind, **facts)
        except JournalError as error:
            if self.moving:
                raise
            # At rest nothing hangs on it, and whoever starts opens the journal anew, or says why it can't.
            self._log("journal", error=error.message)

    # What the machine asks.

    def _answer(self, work: Coroutine[None, None, machine.Event], failed: Callable[[str, str], machine.Event]) -> None:
        """Have a question of the machine answered, once, however the work ends."""
        task = self._answering = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)

        def answer(done: asyncio.Task[machine.Event]) -> None:
            self._tasks.discard(done)
            if self._answering is done:
                self._answering = None
            if done.cancelled():
                self.post(failed("given up", "given_up"))
                return
            error = done.exception()
            if error is None:
                self.post(done.result())
            elif isinstance(error, InterlockError):
                self.post(failed(error.message, error.code))
            elif isinstance(error, TilefabError):
                if isinstance(error, JournalError):
                    self.fault("journal", error.message)
                self.post(failed(error.message, "not_ready"))
            elif isinstance(error, TimeoutError):
                self.post(failed("a device stopped answering while the line was brought up", "not_ready"))
            else:
                self.fault("defect", f"{type(error).__name__}: {error}")
                self.post(failed("a defect of tilefab", "not_ready"))

        task.add_done_callback(answer)

    async def _use_journal(self) -> None:
        """Open a journal that was lost anew; what comes next is read from it, as after a restart."""
        if await self.keeper.reopen_if_lost() and (book := self._book) is not None:
            states = await self.keeper.call(lambda journal: journal.face_states(book.run_id))
            self._book = FaceBook(book.run_id, FaceQueue(states))

    async def _take_job(self) -> machine.Event:
        """Open the job that comes first in the queue, unless it is open."""
        await self._use_journal()
        if self._book is not None and self._book.done:
            await self._end_job()
        await self._drop_finished()
        if self._book is None:
            if not self.jobs:
                raise InterlockError("no job waits: queue one", device="line", code="changeover_failed")
            job = self.jobs[0]
            try:
                source = await asyncio.to_thread(self._open_source, job, self.line_file.line.line.stream_strip_rows)
                run_id = await self.keeper.start_run(job.run_facts(source))
            except TilefabError as error:
                # It can't be begun or gone on with as it is; those behind it must not wait for it.
                self.jobs.popleft()
                why = f"{error.message}; {job.plan.name} was taken out of the queue"
                raise InterlockError(why, device="line", code="changeover_failed") from error
            states = await self.keeper.call(lambda journal: journal.face_states(run_id))
            self.job, self.source, self._book = job, source, FaceBook(run_id, FaceQueue(states))
            self.tell("job", run_id=run_id, name=job.plan.name, faces=job.plan.job.tile.count)
        return machine.ChangeoverReady()

    async def _drop_finished(self) -> None:
        """Take jobs out of the queue that were printed before, as those that a restarted daemon is given again."""
        runs = await self.keeper.call(lambda journal: journal.runs(last=_RUNS_LOOKED_AT))
        finished = {run.facts.job_hash: run.facts.faces for run in runs if run.finished_at is not None}
        while self._book is None and self.jobs:
            job = self.jobs[0]
            if job.plan.job.tile.count > finished.get(job.plan.job_hash, 0):
                return
            self.jobs.popleft()
            self.warn(
                "job_refused",
                f"all faces of {job.plan.name} were printed: for more of them raise its count, for others change its "
                "seed, for single ones order reprints",
            )

    async def _end_job(self) -> None:
        """Put down that the job is done."""
        book = self._book
        if book is None:
            return
        await self._close_streamer()
        await self._all_written()
        await self.keeper.call(lambda journal: journal.finish_run(book.run_id))
        self._probe("run.finished")
        self._book = self.source = self.job = None
        self.jobs.popleft()

    async def _check_devices(self) -> machine.Event:
        """See that the kiln is at the recipe, however long that takes, and that nothing stands in the way."""
        await self._use_journal()
        if self.kiln is not None and self.job is not None:
            self.kiln.bring_to(self.job.kiln)
            if not self.kiln.at_recipe:
                self.tell("note", text="waiting for the kiln to be at the job's recipe")
            while not self.kiln.at_recipe:
                await asyncio.sleep(_WATCH_PERIOD_S)
        plc, printer = (await self._read())[::-1]
        standing = {
            "emergency stop": plc.e_stop or printer.e_stop,
            "jam": plc.jam,
            "double feed": plc.double_feed,
            "diverter fault": plc.diverter_fault,
            "no ink": printer.ink_out,
            "failed nozzle": printer.nozzle_out,
            "releases of an earlier life of the conveyor's controller: restart it": plc.boot_id
            == self.conveyor.spoilt_boot,
        }
        found = [what for what, stands in standing.items() if stands]
        if found:
            raise InterlockError(f"still reported: {', '.join(found)}; put it right and acknowledge", device="line")
        return machine.DevicesReady()

    async def _settle(self) -> machine.Event:
        """Find out what became of every face, and where every tile is."""
        book, source, job = self._book, self.source, self.job
        if book is None or source is None or job is None:
            raise InterlockError("no job is open", device="line")
        # From here on only this task settles faces: the loops know of no tile.
        self.printer.calibration = self.conveyor.calibration = None
        await self._close_streamer()
        await self._read()
        await self._all_written()
        self._session = await self._new_session()
        self.printer_link.renew()
        await self._read()
        identity = self.printer.identity
        if identity is None:
            raise InterlockError("the printer didn't introduce itself", device="printer")
        check_printer(source, identity)
        await self._skip_arms()
        self.conveyor.counts_per_mm = identity.counts_per_mm
        bring_up = BringUp(self.keeper, self._read, self._ask_printer, source.checksum, self._probe)
        moved, self._moved = self._moved, False
        spoilt, self._spoilt = self._spoilt, False
        try:
            found = await bring_up.settle(book, moved=moved, spoilt=spoilt, counts_per_mm=identity.counts_per_mm)
        except BaseException:
            self._moved |= moved
            self._spoilt |= spoilt
            raise
        book.coming = 0
        self._streamer = self._new_streamer(source)
        for arm_id, face in found.streaming:
            self._streamer.submit(arm_id, face)
        self.conveyor.settings = job.belt
        self.printer.begin_at(found.calibration, print_job(job, source, identity))
        self.conveyor.begin_at(found.calibration)
        await self._fill(book)
        if not found.in_doubt:
            return machine.Reconciled()
        named = ", ".join(map(str, found.in_doubt[:_NAMED])) + (", ..." if len(found.in_doubt) > _NAMED else "")
        return machine.Reconciled(
            doubt=len(found.in_doubt), reason=f"nobody can tell what became of {len(found.in_doubt)} faces: {named}"
        )

    async def _cancel_arms(self) -> None:
        """Take back what the printer hasn't begun; the next start finds out what became of it."""
        book = self._book
        if book is None:
            return
        arms = [arm.intent.arm_id for arm in book.armed]

        async def disarm(session: PrinterSession) -> None:
            for arm_id in arms:
                await session.disarm(arm_id)

        if arms and self.printer_link.present:
            with suppress(TilefabError, TimeoutError):
                await self._ask_printer(disarm)
        await self._give_up_pool(book)

    async def _all_written(self) -> None:
        """Wait until the journal has all that was begun."""
        begun = [task for task in (self._filling, self._cancelling) if task is not None]
        if begun:
            await asyncio.wait(begun)
        await self.printer.written()
        await self.conveyor.written()

    async def _new_session(self) -> int:
        """A session above every earlier one, even if the journal that counted them was lost."""
        floor = max(0, int(time.time()) - _SESSIONS_SINCE_S)
        return await self.keeper.begin_session(above=floor)

    async def _skip_arms(self) -> None:
        """Let arms begin above those that the printer remembers, if they come from a journal that was lost."""
        status = self.printer.status
        last = await self.keeper.call(lambda journal: journal.last_arm())
        if status is not None and status.last_accepted_arm > last:
            accepted = status.last_accepted_arm
            if self._behind_told == accepted:
                # Somebody has acknowledged it since, and said resume.
                await self.keeper.call(lambda journal: journal.skip_arms(accepted))
                return
            self._behind_told = accepted
            raise InterlockError(
                f"the printer remembers arm {accepted}, the journal none above {last}: faces that were printed "
                "meanwhile come again once you resume",
                device="printer",
                code="journal_behind",
            )

    # Devices.

    async def _turn(self, link: DeviceLink[Any]) -> None:
        """Wait until a link has been through a whole cycle that began after now."""
        wanted = link.turns + 2
        link.hurry()
        while link.turns < wanted:
            await asyncio.sleep(_TURN_S)
            link.hurry()

    async def _read(self) -> tuple[PrinterStatus, PlcStatus]:
        async with asyncio.timeout(_ANSWER_S):
            await self._turn(self.printer_link)
            await self._turn(self.plc_link)
        if self.printer.status is None or self.conveyor.status is None:
            raise InterlockError("conveyor or printer haven't answered yet", device="line")
        return self.printer.status, self.conveyor.status

    async def _ask_printer(self, errand: Errand) -> None:
        """Do something with the printer's session in between its cycles."""
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._errands.append((errand, done))
        self.printer_link.hurry()
        async with asyncio.timeout(_ANSWER_S):
            await done

    async def _printer_cycle(self, session: PrinterSession) -> None:
        while self._errands:
            errand, done = self._errands.popleft()
            if done.done():
                continue
            try:
                await errand(session)
            except TilefabError as error:
                if not done.done():
                    done.set_exception(error)
                if isinstance(error, DeviceError) and not isinstance(error, InterlockError):
                    raise
            else:
                if not done.done():
                    done.set_result(None)
        await self.printer.cycle(session)

    def _lost(self, name: str, reason: str) -> None:
        self.post(machine.DeviceLost(name, reason))

    def _gauge_lost(self, name: str, reason: str) -> None:
        """Tell of the gauge's silence; tiles are printed without it."""
        self.warn("gauge_lost", f"no answer from {name}: {reason}")

    def _back(self, name: str) -> None:
        self.post(machine.DeviceBack(name))

    def _new_streamer(self, source: FaceSource) -> Streamer:
        loop, session = asyncio.get_running_loop(), self._session

        def trouble(error: TilefabError) -> None:
            with suppress(RuntimeError):  # the loop may have ended meanwhile
                loop.call_soon_threadsafe(self.doubt, "streaming", error.message)

        def link() -> PrinterDataLink:
            return PrinterDataLink(self.line_file.line.printer.data, session)

        return Streamer(source, link, trouble, probe=self._probe)

    async def _close_streamer(self) -> None:
        streamer, self._streamer = self._streamer, None
        if streamer is not None:
            await asyncio.to_thread(streamer.close)

    # Faces.

    async def _fill(self, book: FaceBook) -> None:
        """Put down the next faces, so that tiles never wait for a disk."""
        try:
            while len(book.pool) < INTENTS_AHEAD and (faces := book.queue.take(INTENTS_AHEAD - len(book.pool))):
                book.coming = len(faces)
                book.pool.extend(await self.keeper.intend(book.run_id, faces))
                book.coming = 0
        except JournalError as error:
            # Faces that were taken come back when the line is brought up.
            self.fault("journal", error.message)
        finally:
            self._filling = None
        if self._streamer is not None:
            self._streamer.expect([intent.face for intent in book.pool])

    async def _give_up_pool(self, book: FaceBook) -> None:
        """Say of faces that no tile came for that they weren't printed."""
        intents = list(book.pool)
        book.pool.clear()
        changes = [ArmChange(intent.arm_id, ArmState.UNPRINTED, reason="no tile came for it") for intent in intents]
        with suppress(JournalError):
            await self.keeper.mark(changes, "reconcile")
            for intent in intents:
                book.queue.give_back(intent.face, intent.attempt, ArmState.UNPRINTED)

    # Watching.

    async def _watch(self) -> None:
        """See to what no device tells by itself: the end of a job, and how many tiles to feed."""
        while True:
            await asyncio.sleep(_WATCH_PERIOD_S)
            self._watched += 1
            if self.moving and self.keeper.waiting_s > _SLOW_JOURNAL_S:
                self.doubt("journal_slow", "the journal has been waited for too long: tiles couldn't be released")
            book = self._book
            if book is None:
                continue
            if self._streamer is not None and self.may_print:
                self._streamer.expect([intent.face for intent in book.pool])
            if self.line.state is LineState.RUNNING:
                self._feed(book)
                self.faces_wanted()
                if book.faces_to_go == 0 and not book.armed:
                    self.post(machine.JobDone())
            elif self.line.state is LineState.DRAINING and not book.active:
                await self._drained(book)

    def _feed(self, book: FaceBook) -> None:
        """Feed only as many tiles as there are faces for them."""
        status = self.conveyor.status
        if status is None:
            return
        before = self._feeding
        self._feeding = now = watch_feed(
            before,
            plc_boot=status.boot_id,
            tiles_fed=status.tiles_fed,
            tile_seq=status.tile_seq,
            position_counts=status.position_counts,
            way_counts=round(_LOADER_WAY_MM * self.conveyor.counts_per_mm),
        )
        if now.overdue and not before.overdue and self.conveyor.feed:
            self.warn("no_tiles", "the belt runs, but no tile comes to the eye")
        self.conveyor.feed = book.faces_to_go > now.coming

    async def _drained(self, book: FaceBook) -> None:
        done = book.done
        try:
            await (self._end_job() if done else self._give_up_pool(book))
        except JournalError as error:
            self.fault("journal", error.message)
        else:
            self.post(machine.Drained(job_done=done, more=bool(self.jobs) and done))

    def _start(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if task.cancelled() or (error := task.exception()) is None:
            return
        if isinstance(error, JournalError):
            self.fault("journal", error.message)
        else:
            self.fault("defect", f"{type(error).__name__}: {error}")
