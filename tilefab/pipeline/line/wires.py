"""The links to a line's devices, and what needs several of them, or the printer between two of its cycles."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any

from tilefab.config.line import LineFile
from tilefab.devices import GaugeSession, KilnSession, PlcSession, PlcStatus, PrinterSession, PrinterStatus
from tilefab.errors import DeviceError, InterlockError, TilefabError
from tilefab.pipeline.line.conveyor_loop import ConveyorLoop
from tilefab.pipeline.line.device_link import DeviceLink
from tilefab.pipeline.line.gauge_loop import GaugeLoop
from tilefab.pipeline.line.kiln_loop import KilnLoop
from tilefab.pipeline.line.printer_loop import PrinterLoop

_PRINTER_PERIOD_S = 0.015
_PLC_PERIOD_S = 0.04
_KILN_PERIOD_S = 0.5
_GAUGE_PERIOD_S = 0.5
_TURN_S = 0.005
ANSWER_S = 5.0
"""Longest wait for a device that was there a moment ago."""

Errand = Callable[[PrinterSession], Awaitable[None]]


class Wires:
    """Links to all devices of a line.

    Parameters
    ----------
    line_file
        The line.
    printer, conveyor, kiln, gauge
        Loops of the devices; those of kiln and gauge are asked only where the line has them.
    session
        Number of the present session with the printer.
    lost, back
        Called when a device that the line can't run without is lost, and when it is back.
    gauge_lost
        Called when the gauge is.
    """

    def __init__(
        self,
        line_file: LineFile,
        printer: PrinterLoop,
        conveyor: ConveyorLoop,
        kiln: KilnLoop | None,
        gauge: GaugeLoop,
        *,
        session: Callable[[], int],
        lost: Callable[[str, str], None],
        back: Callable[[str], None],
        gauge_lost: Callable[[str, str], None],
    ) -> None:
        settings = line_file.line
        self._printer_loop, self._conveyor_loop = printer, conveyor
        self._errands: deque[tuple[Errand, asyncio.Future[None]]] = deque()
        self.plc = DeviceLink(
            "plc",
            lambda: PlcSession(settings.plc.endpoint),
            cycle=conveyor.cycle,
            period_s=_PLC_PERIOD_S,
            lost=lost,
            back=back,
        )
        self.printer = DeviceLink(
            "printer",
            lambda: PrinterSession(settings.printer.control, session()),
            begin=printer.greet,
            cycle=self._printer_cycle,
            period_s=_PRINTER_PERIOD_S,
            lost=lost,
            back=back,
        )
        self.all: list[DeviceLink[Any]] = [self.plc, self.printer]
        if settings.kiln is not None and kiln is not None:
            kiln_endpoint = settings.kiln.endpoint
            self.all.append(
                DeviceLink(
                    "kiln",
                    lambda: KilnSession(kiln_endpoint),
                    cycle=kiln.cycle,
                    period_s=_KILN_PERIOD_S,
                    lost=lost,
                    back=back,
                )
            )
        if settings.gauge is not None:
            gauge_endpoint = settings.gauge.endpoint
            self.all.append(
                DeviceLink(
                    "gauge",
                    lambda: GaugeSession(gauge_endpoint),
                    cycle=gauge.cycle,
                    period_s=_GAUGE_PERIOD_S,
                    lost=gauge_lost,
                    back=lambda _name: None,
                )
            )

    async def turn(self, link: DeviceLink[Any]) -> None:
        """Wait until a link has been through a whole cycle that began after now."""
        wanted = link.turns + 2
        link.hurry()
        while link.turns < wanted:
            await asyncio.sleep(_TURN_S)
            link.hurry()

    async def turn_present(self) -> None:
        """Wait for a whole cycle of conveyor and printer, whichever is there."""
        async with asyncio.timeout(ANSWER_S):
            for link in self.all[:2]:
                if link.present:
                    await self.turn(link)

    async def read(self) -> tuple[PrinterStatus, PlcStatus]:
        """State of printer and conveyor, both asked for after now.

        Raises
        ------
        InterlockError
            If one has never answered.
        TimeoutError
            If one doesn't answer any more.
        """
        async with asyncio.timeout(ANSWER_S):
            await self.turn(self.printer)
            await self.turn(self.plc)
        printer, plc = self._printer_loop.status, self._conveyor_loop.status
        if printer is None or plc is None:
            raise InterlockError("conveyor or printer haven't answered yet", device="line")
        return printer, plc

    async def ask_printer(self, errand: Errand) -> None:
        """Do something with the printer's session in between its cycles."""
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._errands.append((errand, done))
        self.printer.hurry()
        async with asyncio.timeout(ANSWER_S):
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
        await self._printer_loop.cycle(session)
