"""The daemon of a line: loops of its devices, the state machine between them, and what an operator may ask."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Coroutine, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from tilefab.config.line import LineFile
from tilefab.control import line_machine as machine
from tilefab.control.feeding import Feeding, watch_feed
from tilefab.control.line_machine import Line, LineState
from tilefab.errors import InterlockError, JournalError, TilefabError
from tilefab.pipeline.line.arming import Arming
from tilefab.pipeline.line.book import FaceBook
from tilefab.pipeline.line.conveyor_loop import ConveyorLoop
from tilefab.pipeline.line.correcting import Corrector
from tilefab.pipeline.line.correction_maps import CorrectionMaps, KeptMaps
from tilefab.pipeline.line.device_link import DeviceLink
from tilefab.pipeline.line.gauge_loop import GaugeLoop
from tilefab.pipeline.line.jobs import LineJob, open_job
from tilefab.pipeline.line.keeper import JournalKeeper
from tilefab.pipeline.line.kiln_loop import KilnLoop
from tilefab.pipeline.line.present_run import PresentRun
from tilefab.pipeline.line.printer_loop import PrinterLoop
from tilefab.pipeline.line.probe import Probe, nothing
from tilefab.pipeline.line.source import FaceSource
from tilefab.pipeline.line.streaming import Streamer
from tilefab.pipeline.line.timing import Throughput
from tilefab.pipeline.line.wires import Wires

_WATCH_PERIOD_S = 0.1
_LOADER_WAY_MM = 10_000
"""No loader is farther from its eye."""
_SLOW_JOURNAL_S = 1.0

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
    correction_maps
        Where the maps of corrections come from; by default the run's own folder.
    """

    def __init__(
        self,
        line_file: LineFile,
        jobs: Sequence[LineJob],
        *,
        log: Log = no_log,
        probe: Probe = nothing,
        open_source: Callable[[LineJob, int], FaceSource] = open_job,
        correction_maps: CorrectionMaps | None = None,
    ) -> None:
        settings = line_file.line
        self.line_file = line_file
        self.line = Line(missing=frozenset(line_devices(line_file)))
        self.since = datetime.now(UTC)
        self.keeper = JournalKeeper(line_file.journal_url, settings.line.name, probe)
        rows = settings.line.stream_strip_rows
        self.work = PresentRun(self, self.keeper, jobs, open_source, rows, probe)
        maps = correction_maps if correction_maps is not None else KeptMaps()
        self.corrector = Corrector(line_file, self.keeper, self.work, maps, self.tell, probe)
        self.printer = PrinterLoop(self, self.keeper, probe)
        self.conveyor = ConveyorLoop(self, self.keeper, probe)
        self.conveyor.edges = self.printer.edges
        self.throughput = Throughput(time.monotonic)
        self.tiles_passed = self.tiles_diverted = 0
        self.stopping = asyncio.Event()
        self._log = log
        self._closed = False
        self._cancelling: asyncio.Task[None] | None = None
        self._watched = 0
        self._feeding = Feeding()
        self._drained_at: int | None = None
        self._tasks: set[asyncio.Task[Any]] = set()
        self._answering: asyncio.Task[machine.Event] | None = None
        self.gauge = GaugeLoop(self.keeper)
        self.kiln: KilnLoop | None = None
        if settings.kiln is not None:
            self.kiln = KilnLoop(self, settings.kiln.limits, settings.kiln.tolerance_degc, self.put_down)
        data_endpoint = settings.printer.data
        self.arming = Arming(
            self,
            self.keeper,
            self.work,
            self.corrector,
            self.printer,
            self.conveyor,
            self.kiln,
            data_endpoint,
            self.tell,
            probe,
        )
        self.wires = Wires(
            line_file,
            self.printer,
            self.conveyor,
            self.kiln,
            self.gauge,
            session=lambda: self.arming.session,
            lost=self._lost,
            back=self._back,
            gauge_lost=self._gauge_lost,
        )

    @property
    def links(self) -> tuple[DeviceLink[Any], ...]:
        """Links to all devices."""
        return tuple(self.wires.all)

    @property
    def rounds(self) -> dict[str, int]:
        """How often each loop went round, by name."""
        return {link.name: link.rounds for link in self.links} | {"watch": self._watched}

    async def run(self) -> None:
        """Work until `stopping` is set; then stop the belt, hold the printer, and close everything."""
        if not self.keeper.is_open:
            await self.keeper.open()
        await self.arming.begin_session()
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
            await self.arming.close_streamer()
            await self.printer.written()
            await self.conveyor.written()
            self._closed = True
            await self.keeper.close()

    async def _leave(self) -> None:
        """Leave the line at rest: its devices would stop by themselves, but late and with an alarm."""
        if self.line.state in machine.ACTIVE:
            self.post(machine.OperatorHold())
        with suppress(TimeoutError):
            await self.wires.turn_present()
        await self.work.give_up_pool()

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
        return self.work.book

    @property
    def job(self) -> LineJob | None:
        """The present job."""
        return self.work.job

    @property
    def jobs(self) -> deque[LineJob]:
        """The present job, and those that wait."""
        return self.work.jobs

    @property
    def streamer(self) -> Streamer | None:
        """Where faces are sent from."""
        return self.arming.streamer

    def e_stop(self, device: str, pressed: bool) -> None:
        """An emergency stop was pressed or let go."""
        if pressed:
            self.tiles_moved("e_stop")
        self.post(machine.EStop(device=device, pressed=pressed))

    def tiles_moved(self, code: str) -> None:
        """Tiles may lie elsewhere than the counts say."""
        self.arming.tiles_moved(code)

    @property
    def spoilt(self) -> bool:
        """Whether ink or a nozzle failed since the line was brought up."""
        return self.arming.spoilt

    def print_spoilt(self, code: str) -> None:
        """Ink or a nozzle failed: what is under the head may lack ink."""
        self.arming.print_spoilt(code)

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
        self.work.want_faces(lambda book: self._start(self.work.fill(book)))

    def releases_wanted(self) -> None:
        """Tiles are to be released as soon as can be."""
        self.wires.plc.hurry()

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
                self.wires.plc.hurry()
            case machine.HoldPrinter():
                self.printer.hold()
                self.wires.printer.hurry()
            case machine.RunBelt(feed):
                self.conveyor.run_belt, self.conveyor.feed = True, feed
                self.wires.plc.hurry()
            case machine.ClearPrinter():
                self.printer.clear()
                self.wires.printer.hurry()
            case machine.AckPlc():
                self.conveyor.acknowledge()
                self.printer.acknowledge()
                self.wires.plc.hurry()
            case machine.CancelArms():
                self._cancelling = self._start(self.arming.cancel(self.wires))
            case machine.BeginChangeover():
                self._answer(self._take_job(), lambda why, code: machine.ChangeoverReady(False, why, code))
            case machine.CheckDevices():
                self._answer(self._check_devices(), lambda why, code: machine.DevicesReady(False, why, code))
            case machine.Reconcile():
                self._answer(
                    self.arming.settle(self.wires, self._all_written),
                    lambda why, code: machine.Reconciled(False, reason=why, code=code),
                )
            case machine.RaiseAlarm(code, text, number):
                self.tell("alarm", number=number, code=code, text=text)
            case machine.ClearAlarms():
                pass
            case machine.Note(text):
                self.tell("note", text=text)

    def tell(self, kind: str, **facts: object) -> None:
        """Write an event to the log and the journal."""
        self._log(kind, **facts)
        self.put_down(kind, **facts)

    def put_down(self, kind: str, **facts: object) -> None:
        """Write an event to the journal alone."""
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

    async def _take_job(self) -> machine.Event:
        """Open the job that comes first in the queue, unless it is open."""
        await self.work.use_journal()
        if self.work.book is not None and self.work.book.done:
            await self._end_job()
        if await self.work.take() and (job := self.work.job) is not None and (book := self.work.book) is not None:
            self.tell("job", run_id=book.run_id, name=job.plan.name, faces=job.plan.job.tile.count)
        return machine.ChangeoverReady()

    async def _end_job(self) -> None:
        """Put down that the job is done."""
        await self.arming.close_streamer()
        await self._all_written()
        await self.work.end()

    async def _check_devices(self) -> machine.Event:
        await self.work.use_journal()
        return await self.arming.check(self.wires)

    async def _all_written(self) -> None:
        """Wait until the journal has all that was begun."""
        await self.work.filled()
        if self._cancelling is not None:
            await asyncio.wait([self._cancelling])
        await self.printer.written()
        await self.conveyor.written()

    # Devices.

    def _lost(self, name: str, reason: str) -> None:
        self.post(machine.DeviceLost(name, reason))

    def _gauge_lost(self, name: str, reason: str) -> None:
        """Tell of the gauge's silence; tiles are printed without it."""
        self.warn("gauge_lost", f"no answer from {name}: {reason}")

    def _back(self, name: str) -> None:
        self.post(machine.DeviceBack(name))

    # Watching.

    async def _watch(self) -> None:
        """See to what no device tells by itself: the end of a job, and how many tiles to feed."""
        while True:
            await asyncio.sleep(_WATCH_PERIOD_S)
            self._watched += 1
            if self.moving and self.keeper.waiting_s > _SLOW_JOURNAL_S:
                self.doubt("journal_slow", "the journal has been waited for too long: tiles couldn't be released")
            book = self.work.book
            if book is None:
                continue
            if self.moving:
                # At rest arms may be under way that the book doesn't know of yet.
                self.corrector.let_go(self.streamer)
            if self.may_print:
                self.work.expect(book)
            if self.line.state is LineState.RUNNING:
                self._feed(book)
                self.faces_wanted()
                if book.faces_to_go == 0 and not book.armed:
                    self.post(machine.JobDone())
            if self.line.state is not LineState.DRAINING or book.active:
                self._drained_at = None
            elif self._ran_out():
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

    def _ran_out(self) -> bool:
        """Whether the belt has brought the last tiles to the kiln, where a change of its recipe waits for them."""
        status = self.conveyor.status
        if status is None:
            return False
        if self._drained_at is None:
            self._drained_at = status.position_counts
        way_counts = self.line_file.line.line.run_out_mm * self.conveyor.counts_per_mm
        return (status.position_counts - self._drained_at) % (1 << 32) >= way_counts

    async def _drained(self, book: FaceBook) -> None:
        done = book.done
        try:
            await (self._end_job() if done else self.work.give_up_pool())
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
