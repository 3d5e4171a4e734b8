"""The simulated conveyor read and written by programs that nobody here wrote: mbpoll (libmodbus) and modbus-serial.

A test is skipped where its program isn't installed. modbus-serial is looked for in the folder that TILEFAB_NODE_MODULES
names, or in node_modules beside the repository's own files.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
import subprocess
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from sim.plant.inprocess import RunningPlant, plant_in, running_plant_here

pytestmark = pytest.mark.xdist_group("line")

ROOT = Path(__file__).parents[2]
NODE_MODULES = Path(os.environ.get("TILEFAB_NODE_MODULES", ROOT / "node_modules"))
PATIENCE_S = 20.0


def run(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, **options)


@pytest.fixture
def plant(tmp_path: Path) -> Iterator[RunningPlant]:
    with running_plant_here(plant_in(tmp_path)) as running:
        yield running


@contextmanager
def socat(first: Path, second: str) -> Iterator[None]:
    """A pair of pseudo terminals, as a cable from one name to another line."""
    if shutil.which("socat") is None:
        pytest.skip("socat is not installed")
    with subprocess.Popen(["socat", f"PTY,raw,echo=0,link={first}", f"OPEN:{second},raw,echo=0"]) as process:
        try:
            deadline = time.monotonic() + PATIENCE_S
            while not first.exists():
                assert process.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.01)
            yield
        finally:
            process.terminate()
            process.wait(10)


def serial_path(plant: RunningPlant) -> str:
    return plant.endpoints["plc_rtu"].partition("://")[2].partition("?")[0]


def tcp_port(plant: RunningPlant, name: str = "plc_tcp") -> str:
    return plant.endpoints[name].rpartition(":")[2].partition("?")[0]


@pytest.fixture(params=["tcp", "rtu", "rtu over socat"])
def mbpoll(request: pytest.FixtureRequest, plant: RunningPlant, tmp_path: Path) -> Iterator[list[str]]:
    """The beginning and the end of mbpoll's command for each way to the conveyor."""
    rtu = ["-m", "rtu", "-b", "19200", "-d", "8", "-s", "1", "-P", "even"]
    if request.param == "tcp":
        yield ["-m", "tcp", "-p", tcp_port(plant), "127.0.0.1"]
    elif request.param == "rtu":
        yield [*rtu, serial_path(plant)]
    else:
        with socat(tmp_path / "cable", serial_path(plant)):
            yield [*rtu, str(tmp_path / "cable")]


def poll(way: list[str], first: int, count: int, *kind: str, unit: int = 1) -> list[float]:
    """Read registers with mbpoll."""
    *options, place = way
    command = ["mbpoll", *options, "-a", str(unit), "-0", "-1", "-q", "-r", str(first), "-c", str(count), *kind, place]
    done = run(command)
    assert done.returncode == 0, done.stdout + done.stderr
    return [float(value) for value in re.findall(r"^\[\d+\]:\s+(\S+)", done.stdout, re.MULTILINE)]


def write(way: list[str], first: int, *values: int) -> subprocess.CompletedProcess[str]:
    """Write registers with mbpoll: one with function 6, several with function 16."""
    *options, place = way
    command = ["mbpoll", *options, "-a", "1", "-0", "-1", "-q", "-r", str(first), place, *map(str, values)]
    return run(command)


def test_mbpoll_reads_the_whole_window(plant: RunningPlant, mbpoll: list[str]) -> None:
    words = poll(mbpoll, 0, 64)
    assert len(words) == 64
    assert words[3:6] == [0x0102, 0x0304, 1 << 6]
    assert words[2] == plant.state()["plc"]["boot_id"]
    check = zlib.crc32(struct.pack(">62H", *map(int, words[:62])))
    assert words[62:] == [check >> 16, check & 0xFFFF]


def test_mbpoll_reads_wide_values_high_word_first(mbpoll: list[str]) -> None:
    assert poll(mbpoll, 3, 1, "-t", "4:int", "-B") == [0x01020304]


def test_mbpoll_runs_the_belt_and_is_refused_what_is_wrong(plant: RunningPlant, mbpoll: list[str]) -> None:
    done = write(mbpoll, 32, 1, 3, 2000, 6000, 7000, 0, 1, 0, 5, 0)
    assert done.returncode == 0, done.stdout + done.stderr
    deadline = time.monotonic() + PATIENCE_S
    while plant.state()["plc"]["cmd_ack"] != 1:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert poll(mbpoll, 32, 10) == [1, 3, 2000, 6000, 7000, 0, 1, 0, 5, 0]
    # Nobody keeps the heartbeat up: by the next look the dead-man switch may have stopped the belt again.
    assert poll(mbpoll, 19, 1) == [1]
    assert write(mbpoll, 34, 777).returncode == 0
    assert poll(mbpoll, 34, 1) == [777]
    for address, value, reason in ((3, 1, "Illegal data address"), (34, 30001, "Illegal data value")):
        done = write(mbpoll, address, value)
        assert reason in done.stdout + done.stderr
    assert poll(mbpoll, 34, 1) == [777]


def test_mbpoll_reads_the_kiln(plant: RunningPlant) -> None:
    way = ["-m", "tcp", "-p", tcp_port(plant, "kiln"), "127.0.0.1"]
    assert poll(way, 3, 1, "-t", "4:float", "-B", unit=2) == [1234.5]
    assert poll(way, 10, 8, "-t", "4:float", "-B", unit=2) == [20.0] * 8


SCRIPT = """
const Modbus = require("modbus-serial");
const [way, place] = process.argv.slice(2);
const host = new Modbus();
async function main() {
  if (way === "tcp") await host.connectTCP("127.0.0.1", { port: Number(place) });
  else await host.connectRTUBuffered(place, { baudRate: 19200, parity: "even" });
  host.setID(1);
  host.setTimeout(3000);
  const found = {};
  found.window = (await host.readHoldingRegisters(0, 64)).data;
  await host.writeRegister(0, 4711);
  found.seq = (await host.readHoldingRegisters(0, 1)).data;
  await host.writeRegisters(32, [9, 0, 1000, 6000, 7000, 0, 1, 0, 5, 0]);
  found.block = (await host.readHoldingRegisters(32, 10)).data;
  found.refused = [];
  for (const [address, value] of [[3, 1], [36, 599]])
    await host.writeRegister(address, value).catch((error) => found.refused.push(error.modbusCode));
  await host.readHoldingRegisters(60, 5).catch((error) => found.refused.push(error.modbusCode));
  console.log(JSON.stringify(found));
  host.close(() => process.exit(0));
}
main().catch((error) => { console.error(error); process.exit(1); });
"""


@pytest.mark.parametrize("way", ["tcp", "rtu"])
def test_modbus_serial_reads_and_writes(plant: RunningPlant, tmp_path: Path, way: str) -> None:
    if not (NODE_MODULES / "modbus-serial").is_dir():
        pytest.skip("modbus-serial is not installed: npm install modbus-serial, or name its folder")
    script = tmp_path / "host.js"
    script.write_text(SCRIPT)
    place = tcp_port(plant) if way == "tcp" else serial_path(plant)
    done = run(["node", str(script), way, place], env={**os.environ, "NODE_PATH": str(NODE_MODULES)})
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["window"][3:6] == [0x0102, 0x0304, 1 << 6]
    assert found["seq"] == [4711]
    assert found["block"] == [9, 0, 1000, 6000, 7000, 0, 1, 0, 5, 0]
    assert found["refused"] == [2, 3, 2]
