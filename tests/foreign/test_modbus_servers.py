"""Our sessions against Modbus servers that nobody here wrote: libmodbus, through ctypes, and modbus-serial, in node
(in ``$TILEFAB_NODE_MODULES``, or node_modules in the current folder).

Both are plain memory; a thread or a timer beside it plays the controller: it advances scan_counter and copies cmd_seq
to cmd_ack. Run as a program, this file is the libmodbus server. A test is skipped where its server isn't installed.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import ctypes.util
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tilefab.devices import KilnCommand, KilnSession, PlcCommand, PlcSession

ROOT = Path(__file__).parents[2]
NODE_MODULES = Path(os.environ.get("TILEFAB_NODE_MODULES", "node_modules")).absolute()
PLC_WORDS = {2: 7, 3: 0x0102, 4: 0x0304, 5: 0b1000001, 6: 2503, 7: 1, 8: 2, 10: 12, 14: 11, 16: 3, 18: 5, 22: 40}
KILN_WORDS = {2: 9, 3: 0x449A, 4: 0x5000, 5: 0b1001, 6: 321, 7: 505, 8: 8} | {
    10 + 2 * i + j: word for i in range(8) for j, word in enumerate(struct.unpack(">HH", struct.pack(">f", 900.5 + i)))
}
COMMAND = PlcCommand(True, False, 250.3, 600.0, 650.0, 70000, 0x80000005, 3)
COMMAND_WORDS = [1, 2503, 6000, 6500, 1, 4464, 0x8000, 5, 3]
NODE_SERVER = """
const Modbus = require("modbus-serial");
const [words, ack, unit] = JSON.parse(process.argv[1]);
const memory = new Uint16Array(128);
for (const [place, word] of Object.entries(words)) memory[place] = word;
setInterval(() => { memory[1]++; memory[ack] = memory[32]; }, 10);
const server = new Modbus.ServerTCP({
  getHoldingRegister: (place) => memory[place],
  setRegister: (place, word) => { memory[place] = word; },
}, { host: "127.0.0.1", port: 0, unitID: unit });
server.on("initialized", () => console.log(server._server.address().port));
process.stdin.on("data", () => console.log(JSON.stringify(Array.from(memory))));
process.stdin.on("end", () => process.exit(0));
"""


class _Mapping(ctypes.Structure):
    """``modbus_mapping_t`` of libmodbus 3.1."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("nb_bits", "start_bits", "nb_input_bits", "start_input_bits")),
        *((name, ctypes.c_int) for name in ("nb_input_registers", "start_input_registers")),
        *((name, ctypes.c_int) for name in ("nb_registers", "start_registers")),
        ("tab_bits", ctypes.POINTER(ctypes.c_uint8)),
        ("tab_input_bits", ctypes.POINTER(ctypes.c_uint8)),
        ("tab_input_registers", ctypes.POINTER(ctypes.c_uint16)),
        ("tab_registers", ctypes.POINTER(ctypes.c_uint16)),
    )


def serve(words: dict[str, int], ack: int, unit: int, path: str) -> None:
    """Be a libmodbus server, on a TCP port of its choice or on a serial port, until the input ends."""
    library: Any = ctypes.CDLL(ctypes.util.find_library("modbus"))
    library.modbus_new_tcp.restype = library.modbus_new_rtu.restype = ctypes.c_void_p
    library.modbus_mapping_new.restype = ctypes.POINTER(_Mapping)
    mapping = library.modbus_mapping_new(0, 0, 128, 0)
    memory = mapping.contents.tab_registers
    for place, word in words.items():
        memory[int(place)] = word

    def control() -> None:
        while True:
            memory[1] += 1
            memory[ack] = memory[32]
            time.sleep(0.01)

    def obey() -> None:
        for _ in sys.stdin:
            say([memory[i] for i in range(128)])
        os._exit(0)

    for work in (control, obey):
        threading.Thread(target=work, daemon=True).start()
    query = (ctypes.c_uint8 * 260)()
    if path:
        context = ctypes.c_void_p(library.modbus_new_rtu(path.encode(), 19200, ctypes.c_char(b"N"), 8, 1))
        library.modbus_set_slave(context, unit)
        assert library.modbus_connect(context) == 0
        say(0)
        while True:
            length = library.modbus_receive(context, query)
            if length > 0:
                library.modbus_reply(context, query, length, mapping)
    context = ctypes.c_void_p(library.modbus_new_tcp(b"127.0.0.1", 0))
    listening = library.modbus_tcp_listen(context, 1)
    assert listening >= 0
    with socket.socket(fileno=os.dup(listening)) as copy:
        say(copy.getsockname()[1])
    number = ctypes.c_int(listening)
    while library.modbus_tcp_accept(context, ctypes.byref(number)) >= 0:
        while (length := library.modbus_receive(context, query)) >= 0:
            library.modbus_reply(context, query, length, mapping)
        library.modbus_close(context)


def say(value: object) -> None:
    """Tell the test."""
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


class Server:
    """A server in a process of its own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.port = self._told()

    def _told(self) -> Any:
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def registers(self) -> list[int]:
        """Memory of the server now."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return list(self._told())


@contextlib.contextmanager
def running(command: list[str], folder: Path | None = None) -> Iterator[Server]:
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=folder) as process:
        try:
            yield Server(process)
        finally:
            process.kill()


@contextlib.contextmanager
def libmodbus(words: dict[int, int], ack: int, unit: int, path: str = "") -> Iterator[Server]:
    if ctypes.util.find_library("modbus") is None:
        pytest.skip("libmodbus is not installed")
    arguments = json.dumps([words, ack, unit, path])
    with running([sys.executable, "-m", "tests.foreign.test_modbus_servers", arguments], ROOT) as server:
        yield server


@contextlib.contextmanager
def modbus_serial(words: dict[int, int], ack: int, unit: int) -> Iterator[Server]:
    if shutil.which("node") is None or not (NODE_MODULES / "modbus-serial").is_dir():
        pytest.skip("modbus-serial is not installed")
    with running(["node", "-e", NODE_SERVER, json.dumps([words, ack, unit])], NODE_MODULES.parent) as server:
        yield server


@contextlib.contextmanager
def joined_ptys() -> Iterator[tuple[str, str]]:
    """Two serial ports with a cable between them."""
    ends = [os.openpty() for _ in range(2)]
    masters = [master for master, _ in ends]

    def carry(source: int, target: int) -> None:
        with contextlib.suppress(OSError):
            while data := os.read(source, 4096):
                os.write(target, data)

    for master, slave in ends:
        tty.setraw(master)
        tty.setraw(slave)
    pumps = [threading.Thread(target=carry, args=pair) for pair in (masters, masters[::-1])]
    for pump in pumps:
        pump.start()
    try:
        yield os.ttyname(ends[0][1]), os.ttyname(ends[1][1])
    finally:
        # The last end of a slave that is closed ends the reading of its master.
        for _, slave in ends:
            os.close(slave)
        for pump in pumps:
            pump.join()
        for master in masters:
            os.close(master)


async def poll_and_command_plc(endpoint: str, server: Server) -> None:
    session = PlcSession(endpoint)
    await session.connect()
    first = await session.poll()
    assert (first.boot_id, first.belt_running, first.ready, first.e_stop) == (7, True, True, False)
    assert (first.belt_speed_mm_s, first.position_counts, first.tile_seq) == (250.3, 65538, 12)
    assert (first.decided_seq, first.passed_bits, first.tiles_fed) == (11, 3 << 32 | 5, 40)
    for number in range(1, 4):
        assert (await session.command(COMMAND)).cmd_ack == first.cmd_ack + number
    assert server.registers()[32:42] == [3, *COMMAND_WORDS]
    last = await session.poll()
    assert last.scan_counter != first.scan_counter
    await session.close()


async def poll_and_command_kiln(endpoint: str, server: Server) -> None:
    session = KilnSession(endpoint)
    await session.connect()
    status = await session.poll()
    assert (status.boot_id, status.heating, status.at_set_point, status.blocked) == (9, True, True, False)
    assert (status.tiles_inside, status.cycle_time_min) == (321, 50.5)
    assert status.temperatures_degc == tuple(900.5 + i for i in range(8))
    wanted = KilnCommand(tuple(1000.25 + i for i in range(8)), 7.5, 61.2)
    assert (await session.command(wanted)).set_points_degc == wanted.set_points_degc
    words = server.registers()
    assert struct.unpack(">9f", struct.pack(">18H", *words[34:52])) == (*wanted.set_points_degc, 7.5)
    assert words[52] == 612
    await session.close()


@pytest.mark.parametrize("fc23", ["", "&fc23=no"])
def test_conveyor_on_libmodbus_over_tcp(fc23):
    with libmodbus(PLC_WORDS, 19, 1) as server:
        asyncio.run(poll_and_command_plc(f"modbus-tcp://127.0.0.1:{server.port}?unit=1{fc23}", server))


def test_conveyor_on_libmodbus_over_rtu():
    with joined_ptys() as (ours, theirs), libmodbus(PLC_WORDS, 19, 1, theirs) as server:
        asyncio.run(poll_and_command_plc(f"modbus-rtu://{ours}?baud=19200&unit=1", server))


def test_kiln_on_libmodbus():
    with libmodbus(KILN_WORDS, 26, 2) as server:
        asyncio.run(poll_and_command_kiln(f"modbus-tcp://127.0.0.1:{server.port}?unit=2", server))


def test_conveyor_on_modbus_serial():
    with modbus_serial(PLC_WORDS, 19, 1) as server:
        asyncio.run(poll_and_command_plc(f"modbus-tcp://127.0.0.1:{server.port}?unit=1&fc23=no", server))


def test_kiln_on_modbus_serial():
    with modbus_serial(KILN_WORDS, 26, 2) as server:
        asyncio.run(poll_and_command_kiln(f"modbus-tcp://127.0.0.1:{server.port}?unit=2&fc23=no", server))


if __name__ == "__main__":
    serve(*json.loads(sys.argv[1]))
