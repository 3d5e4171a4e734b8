"""A made-up daemon, and its API on a socket of its own."""

from __future__ import annotations

import asyncio
import io
import socket
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from tests.unit.pipeline.line.test_status import FULL
from tilefab.config import LineFile, load_line
from tilefab.errors import InterlockError
from tilefab.pipeline.line.log import LineLog
from tilefab.pipeline.line.status import AlarmView, CorrectionView, FaceView, LineStatus
from tilefab.web.api import serve_api

LINE = """\
[line]
name = "line 1"
state_directory = "s"
[plc]
endpoint = "modbus-tcp://127.0.0.1:1502?unit=1"
[printer]
control = "serial:///tmp/p?baud=921600"
data = "tcp://127.0.0.1:9100"
[recipes.default]
belt_speed_mm_s = 500
tile_gap_mm = 100
"""


class Control:
    """Takes every order but those it is told to refuse."""

    def __init__(self) -> None:
        self.orders: list[tuple[str, Mapping[str, object]]] = []
        self.corrected: list[tuple[int, Mapping[str, object], str]] = []
        self.warned: list[tuple[str, str]] = []
        self.refuse = ""
        self.defect = ""
        self.asked_for = 0

    def status(self) -> LineStatus:
        if self.defect:
            raise ZeroDivisionError(self.defect)
        return FULL

    async def command(self, name: str, arguments: Mapping[str, object]) -> str:
        await asyncio.sleep(0)
        if self.refuse:
            raise InterlockError(self.refuse, device="line")
        self.orders.append((name, arguments))
        return f"{name} done"

    def metrics(self) -> bytes:
        return b"tilefab_line_alarms 1.0\n"

    async def faces(self, last: int) -> Sequence[FaceView]:
        self.asked_for = last
        return FULL.last_faces[:last]

    def alarms(self) -> Sequence[AlarmView]:
        return FULL.alarms

    async def correct(self, run_id: int, drift: Mapping[str, object], reason: str) -> int:
        await asyncio.sleep(0)
        if self.refuse:
            raise InterlockError(self.refuse, device="line")
        self.corrected.append((run_id, drift, reason))
        return len(self.corrected)

    async def corrections(self, run_id: int | None) -> tuple[int, Sequence[CorrectionView]]:
        if run_id == 99:
            raise InterlockError("it has no run 99", device="line")
        assert FULL.correction is not None
        return run_id or 7, (FULL.correction,)

    def warn(self, code: str, text: str) -> None:
        self.warned.append((code, text))


def line_file(folder: Path, text: str = LINE) -> LineFile:
    """A line's file in a folder."""
    path = folder / "line.toml"
    path.write_text(text, encoding="utf-8")
    return load_line(path)


@asynccontextmanager
async def at_work(folder: Path, control: Control, text: str = LINE) -> AsyncIterator[tuple[LineFile, io.StringIO]]:
    """The API of a line, up; and what it logs, whole once it is down."""
    file, stream = line_file(folder, text), io.StringIO()
    with LineLog(None, stream=stream) as log:
        async with serve_api(control, file, log):
            yield file, stream


async def ask(
    path: Path | tuple[str, int], request: str, body: bytes = b"", **headers: str
) -> tuple[int, dict[str, str], bytes]:
    """Ask in the wire's own words; code, headers and body of the answer."""
    if isinstance(path, tuple):
        reader, writer = await asyncio.open_connection(*path)
    else:
        reader, writer = await asyncio.open_unix_connection(path)
    try:
        lines = {"Host": "localhost", "Content-Length": str(len(body)), "Connection": "close"}
        lines |= {name.replace("_", "-"): value for name, value in headers.items()}
        head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        writer.write(f"{request} HTTP/1.1\r\n{head}\r\n".encode("latin-1") + body)
        async with asyncio.timeout(5):
            answer = await reader.read()
    finally:
        writer.close()
        await writer.wait_closed()
    first, _, rest = answer.partition(b"\r\n")
    head_bytes, _, content = rest.partition(b"\r\n\r\n")
    pairs = (line.partition(": ") for line in head_bytes.decode("latin-1").split("\r\n"))
    return int(first.split()[1]), {name.lower(): value for name, _, value in pairs}, content


def free_port() -> int:
    """A port that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
