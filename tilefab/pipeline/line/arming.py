"""What must be in order before the belt moves: devices, faces, tiles, and a new session with the printer."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress

from tilefab.control import line_machine as machine
from tilefab.devices import PrinterDataLink, PrinterSession
from tilefab.errors import InterlockError, TilefabError
from tilefab.pipeline.line.bring_up import PRINT_SPOILT, TILES_MOVED, BringUp
from tilefab.pipeline.line.conveyor_loop import ConveyorLoop
from tilefab.pipeline.line.correcting import Corrector
from tilefab.pipeline.line.host import LineHost
from tilefab.pipeline.line.jobs import check_printer, print_job
from tilefab.pipeline.line.keeper import JournalKeeper
from tilefab.pipeline.line.kiln_loop import KilnLoop
from tilefab.pipeline.line.present_run import PresentRun
from tilefab.pipeline.line.printer_loop import PrinterLoop
from tilefab.pipeline.line.probe import Probe, nothing
from tilefab.pipeline.line.source import FaceSource
from tilefab.pipeline.line.streaming import Streamer
from tilefab.pipeline.line.wires import Wires

_KILN_LOOK_S = 0.1
_NAMED = 12
_SESSIONS_SINCE_S = 1_767_225_600
"""2026-01-01, from which sessions are counted in seconds, if the journal that counted them was lost."""


class Arming:
    """Answers what the machine asks of the devices and of the last faces.

    Parameters
    ----------
    host
        The line.
    keeper
        The journal.
    work
        The present run.
    corrector
        Its corrections.
    printer, conveyor, kiln
        Loops of the devices.
    data_endpoint
        Where the printer takes faces.
    tell
        Writes an event to the log and the journal.
    probe
        See `tilefab.pipeline.line.probe`.
    """

    def __init__(
        self,
        host: LineHost,
        keeper: JournalKeeper,
        work: PresentRun,
        corrector: Corrector,
        printer: PrinterLoop,
        conveyor: ConveyorLoop,
        kiln: KilnLoop | None,
        data_endpoint: str,
        tell: Callable[..., None],
        probe: Probe = nothing,
    ) -> None:
        self._host, self._keeper, self._work, self._corrector = host, keeper, work, corrector
        self._printer, self._conveyor, self._kiln = printer, conveyor, kiln
        self._data_endpoint, self._tell, self._probe = data_endpoint, tell, probe
        self.session = 0
        """Number of the present session with the printer."""
        self.streamer: Streamer | None = None
        self.spoilt = False
        """Whether ink or a nozzle failed since the last settling."""
        self._moved = False
        self._behind_told: int | None = None

    def tiles_moved(self, code: str) -> None:
        """Tiles may lie elsewhere than the counts say."""
        if not self._moved:
            self._moved = True
            self._tell(TILES_MOVED, code=code)

    def print_spoilt(self, code: str) -> None:
        """Ink or a nozzle failed: what is under the head may lack ink."""
        if not self.spoilt:
            self.spoilt = True
            self._tell(PRINT_SPOILT, code=code)

    async def begin_session(self) -> None:
        """Count a session above every earlier one, even if the journal that counted them was lost."""
        floor = max(0, int(time.time()) - _SESSIONS_SINCE_S)
        self.session = await self._keeper.begin_session(above=floor)

    async def check(self, wires: Wires) -> machine.Event:
        """See that the kiln is at the recipe, however long that takes, and that nothing stands in the way."""
        job = self._work.job
        if self._kiln is not None and job is not None:
            self._kiln.bring_to(job.kiln)
            if not self._kiln.at_recipe:
                self._tell("note", text="waiting for the kiln to be at the job's recipe")
            while not self._kiln.at_recipe:
                await asyncio.sleep(_KILN_LOOK_S)
        printer, plc = await wires.read()
        standing = {
            "emergency stop": plc.e_stop or printer.e_stop,
            "jam": plc.jam,
            "double feed": plc.double_feed,
            "diverter fault": plc.diverter_fault,
            "no ink": printer.ink_out,
            "failed nozzle": printer.nozzle_out,
            "releases of an earlier life of the conveyor's controller: restart it": plc.boot_id
            == self._conveyor.spoilt_boot,
        }
        found = [what for what, stands in standing.items() if stands]
        if found:
            raise InterlockError(f"still reported: {', '.join(found)}; put it right and acknowledge", device="line")
        return machine.DevicesReady()

    async def settle(self, wires: Wires, written: Callable[[], Awaitable[None]]) -> machine.Event:
        """Find out what became of every face, and where every tile is.

        Parameters
        ----------
        wires
            Links to the devices.
        written
            Waits until the journal has all that was begun.
        """
        book, source, job = self._work.book, self._work.source, self._work.job
        if book is None or source is None or job is None:
            raise InterlockError("no job is open", device="line")
        # From here on only this task settles faces: the loops know of no tile.
        self._printer.calibration = self._conveyor.calibration = None
        await self.close_streamer()
        await wires.read()
        await written()
        await self._corrector.keep_up()
        await self.begin_session()
        wires.printer.renew()
        await wires.read()
        identity = self._printer.identity
        if identity is None:
            raise InterlockError("the printer didn't introduce itself", device="printer")
        check_printer(source, identity)
        await self._skip_arms()
        self._conveyor.counts_per_mm = identity.counts_per_mm
        bring_up = BringUp(self._keeper, wires.read, wires.ask_printer, source.checksum, self._probe)
        moved, self._moved = self._moved, False
        spoilt, self.spoilt = self.spoilt, False
        try:
            found = await bring_up.settle(book, moved=moved, spoilt=spoilt, counts_per_mm=identity.counts_per_mm)
        except BaseException:
            self._moved |= moved
            self.spoilt |= spoilt
            raise
        book.coming = 0
        self.streamer = self._new_streamer(source)
        for arm_id, face, correction in found.streaming:
            self.streamer.submit(arm_id, face, correction)
        self._conveyor.settings = job.belt
        self._printer.begin_at(found.calibration, print_job(job, source, identity))
        self._conveyor.begin_at(found.calibration)
        await self._work.fill(book)
        if not found.in_doubt:
            return machine.Reconciled()
        named = ", ".join(map(str, found.in_doubt[:_NAMED])) + (", ..." if len(found.in_doubt) > _NAMED else "")
        return machine.Reconciled(
            doubt=len(found.in_doubt), reason=f"nobody can tell what became of {len(found.in_doubt)} faces: {named}"
        )

    async def cancel(self, wires: Wires) -> None:
        """Take back what the printer hasn't begun; the next start finds out what became of it."""
        book = self._work.book
        if book is None:
            return
        arms = [arm.intent.arm_id for arm in book.armed]

        async def disarm(session: PrinterSession) -> None:
            for arm_id in arms:
                await session.disarm(arm_id)

        if arms and wires.printer.present:
            with suppress(TilefabError, TimeoutError):
                await wires.ask_printer(disarm)
        await self._work.give_up_pool()

    async def close_streamer(self) -> None:
        """Send no more."""
        streamer, self.streamer = self.streamer, None
        if streamer is not None:
            await asyncio.to_thread(streamer.close)

    async def _skip_arms(self) -> None:
        """Let arms begin above those that the printer remembers, if they come from a journal that was lost."""
        status = self._printer.status
        last = await self._keeper.call(lambda journal: journal.last_arm())
        if status is None or status.last_accepted_arm <= last:
            return
        accepted = status.last_accepted_arm
        if self._behind_told == accepted:
            # Somebody has acknowledged it since, and said resume.
            await self._keeper.call(lambda journal: journal.skip_arms(accepted))
            return
        self._behind_told = accepted
        raise InterlockError(
            f"the printer remembers arm {accepted}, the journal none above {last}: faces that were printed meanwhile "
            "come again once you resume",
            device="printer",
            code="journal_behind",
        )

    def _new_streamer(self, source: FaceSource) -> Streamer:
        loop, session = asyncio.get_running_loop(), self.session

        def trouble(error: TilefabError) -> None:
            with suppress(RuntimeError):  # the loop may have ended meanwhile
                loop.call_soon_threadsafe(self._host.doubt, "streaming", error.message)

        return Streamer(source, lambda: PrinterDataLink(self._data_endpoint, session), trouble, probe=self._probe)
