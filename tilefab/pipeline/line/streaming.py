"""Sends the faces of accepted arms to the printer, strip by strip, from threads of their own.

One thread finds out what the coming faces show, another renders their strips and sends them. Both spend nearly all
their time outside the interpreter's lock, so that the loop which arms the printer isn't held up by them.
"""

from __future__ import annotations

import threading
import zlib
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from tilefab.devices import joined_crc32
from tilefab.errors import DeviceError, DeviceRefused, TilefabError
from tilefab.pipeline.faces import PlannedFace
from tilefab.pipeline.line.probe import Probe, nothing
from tilefab.pipeline.line.source import FaceSource

_PLANNED_AHEAD = 3
_CREDIT_TIMEOUT_S = 3600.0
"""Waiting for room in the printer's buffer is no fault: the belt may stand still for an hour."""
_RETRIES = 3
_KEPT_CHECKSUMS = 256


class StripLink(Protocol):
    """A connection that takes strips; see `tilefab.devices.PrinterDataLink`."""

    def open(self, timeout_s: float) -> None:
        """Connect."""

    def send_strip(self, arm_id: int, row: int, rows: int, data: memoryview, *, timeout_s: float) -> int:
        """Send a strip once there is room for it; its CRC-32."""

    def next_row(self, arm_id: int) -> int:
        """Row of an arm that the printer wants next."""

    def close(self) -> None:
        """Disconnect; a waiting send fails."""


@dataclass
class _Task:
    arm_id: int
    face: int
    correction: int = 0
    checksums: dict[int, int] = field(default_factory=lambda: {0: 0})
    """CRC-32 of all rows before a strip's first."""


class Streamer:
    """Streams one job's faces over one session's data link.

    Parameters
    ----------
    source
        The faces.
    make_link
        Makes a new link of the session, not yet open.
    on_trouble
        Called, from a thread of this, when the link is lost for good, or rendering failed.
    connect_timeout_s
        For each attempt.
    probe
        See `tilefab.pipeline.line.probe`.
    """

    def __init__(
        self,
        source: FaceSource,
        make_link: Callable[[], StripLink],
        on_trouble: Callable[[TilefabError], None],
        *,
        connect_timeout_s: float = 0.2,
        probe: Probe = nothing,
    ) -> None:
        self._source, self._make_link, self._on_trouble, self._probe = source, make_link, on_trouble, probe
        self._connect_timeout_s = connect_timeout_s
        self._wake = threading.Condition()
        self._tasks: deque[_Task] = deque()
        self._expected: tuple[int, ...] = ()
        self._planned: OrderedDict[int, PlannedFace] = OrderedDict()
        self._cancelled: set[int] = set()
        self._finished: OrderedDict[int, int] = OrderedDict()
        self._current: _Task | None = None
        self._link: StripLink | None = None
        self._stopping = False
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,), name=name, daemon=True)
            for name, work in (("tilefab-plan", self._plan_ahead), ("tilefab-stream", self._stream))
        ]
        for thread in self._threads:
            thread.start()

    def expect(self, faces: Sequence[int]) -> None:
        """Tell which faces come next, so that they are planned by the time they are armed."""
        with self._wake:
            self._expected = tuple(faces[:_PLANNED_AHEAD])
            self._wake.notify_all()

    def submit(self, arm_id: int, face: int, correction: int = 0) -> None:
        """Stream a face, as corrected, for an arm that the printer accepted; faces go out in this order."""
        with self._wake:
            self._tasks.append(_Task(arm_id, face, correction))
            self._wake.notify_all()

    def cancel(self, arm_id: int) -> None:
        """Send no more of an arm's face."""
        with self._wake:
            if any(task.arm_id == arm_id for task in self._unsent()):
                self._cancelled.add(arm_id)

    def checksum(self, arm_id: int) -> int | None:
        """CRC-32 of the whole face sent for an arm; ``None`` if it wasn't sent whole."""
        with self._wake:
            return self._finished.get(arm_id)

    @property
    def waiting(self) -> int:
        """Arms whose faces aren't sent whole yet."""
        with self._wake:
            return len(self._unsent())

    @property
    def corrections(self) -> frozenset[int]:
        """Corrections of the arms whose faces aren't sent whole yet."""
        with self._wake:
            return frozenset(task.correction for task in self._unsent())

    def close(self) -> None:
        """Stop at once; joins the threads."""
        with self._wake:
            self._stopping = True
            link = self._link
            self._wake.notify_all()
        if link is not None:
            link.close()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join()

    def _unsent(self) -> list[_Task]:
        return [*self._tasks, *([self._current] if self._current is not None else ())]

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except TilefabError as error:
            self._report(error)
        except Exception as error:  # a defect must stop the line, not a thread of it in silence
            what = f"{type(error).__name__}: {error}"
            self._report(TilefabError(f"streaming failed: {what}; report it to tilefab's makers"))

    def _report(self, error: TilefabError) -> None:
        with self._wake:
            if self._stopping:
                return
        self._on_trouble(error)

    def _plan_ahead(self) -> None:
        while True:
            with self._wake:
                face = next((face for face in self._expected if face not in self._planned), None)
                while face is None and not self._stopping:
                    self._wake.wait()
                    face = next((face for face in self._expected if face not in self._planned), None)
                if self._stopping or face is None:
                    return
            planned = self._source.prepare(face)
            with self._wake:
                self._planned[face] = planned
                while len(self._planned) > 2 * _PLANNED_AHEAD:
                    self._planned.popitem(last=False)
                self._wake.notify_all()

    def _stream(self) -> None:
        while True:
            with self._wake:
                self._current = None
                while not self._tasks and not self._stopping:
                    self._wake.wait()
                if self._stopping:
                    return
                task = self._tasks.popleft()
                self._current = task
                planned = self._planned.get(task.face)
            self._send_face(task, planned if planned is not None else self._source.prepare(task.face))
            with self._wake:
                self._cancelled.discard(task.arm_id)

    def _send_face(self, task: _Task, planned: PlannedFace) -> None:
        for attempt in range(_RETRIES + 1):
            try:
                self._send_rest(task, planned)
            except DeviceRefused:
                # The printer has done with this arm: its outcome tells how. It may have had the whole face before it
                # was asked, so that the checksum is still wanted.
                self._sum_up(task, planned)
                return
            except DeviceError:
                self._drop_link()
                if attempt == _RETRIES or self._is_stopping(task):
                    raise
            else:
                return

    def _send_rest(self, task: _Task, planned: PlannedFace) -> None:
        link = self._connected()
        first = link.next_row(task.arm_id)
        # Rows that the printer has already, from this session or an earlier one, are rendered for the checksum alone.
        begin = max(row for row in task.checksums if row <= first)
        crc = task.checksums[begin]
        for strip in self._source.strips(planned, begin, task.correction):
            if self._is_stopping(task):
                return
            rows = strip.pixels.shape[0]
            had = min(rows, max(0, first - strip.first))
            if had:
                crc = zlib.crc32(strip.pixels[:had].data.cast("B"), crc)
            if had < rows:
                self._probe("strip.before")
                data, row = strip.pixels[had:].data.cast("B"), strip.first + had
                # The link sums up each strip for the wire: a whole face isn't read a second time for its own sum.
                sent = link.send_strip(task.arm_id, row, rows - had, data, timeout_s=_CREDIT_TIMEOUT_S)
                crc = joined_crc32(crc, sent, data.nbytes)
                self._probe("strip.sent")
            task.checksums[strip.first + rows] = crc
        self._finish(task, crc)
        self._probe("face.sent")

    def _sum_up(self, task: _Task, planned: PlannedFace) -> None:
        """Find the checksum of a face of which nothing more is to be sent."""
        begin = max(task.checksums)
        crc = task.checksums[begin]
        for strip in self._source.strips(planned, begin, task.correction):
            if self._is_stopping(task):
                return
            crc = zlib.crc32(strip.pixels.data.cast("B"), crc)
        self._finish(task, crc)

    def _finish(self, task: _Task, crc: int) -> None:
        with self._wake:
            self._finished[task.arm_id] = crc
            while len(self._finished) > _KEPT_CHECKSUMS:
                self._finished.popitem(last=False)

    def _is_stopping(self, task: _Task) -> bool:
        with self._wake:
            return self._stopping or task.arm_id in self._cancelled

    def _connected(self) -> StripLink:
        if self._link is None:
            link = self._make_link()
            link.open(self._connect_timeout_s)
            with self._wake:
                self._link = link
                if self._stopping:
                    link.close()
        return self._link

    def _drop_link(self) -> None:
        with self._wake:
            link, self._link = self._link, None
        if link is not None:
            link.close()
