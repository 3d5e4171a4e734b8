"""The whole plant over real sockets and serial lines, without faults."""

from __future__ import annotations

import asyncio
import hashlib
import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from zlib import crc32

import pytest

from sim.plant.config import parse_plant
from sim.plant.inprocess import plant_in, running_plant, running_plant_here
from sim.plant.main import main
from tests.unit.sim.plant.hosts import (
    ControlHost,
    DataHost,
    ModbusHost,
    PrinterHost,
    RtuHost,
    SerialHost,
    address,
    serial_path,
    wait_until,
)

pytestmark = pytest.mark.xdist_group("line")

FACE = bytes(range(240)) * 100


def test_a_tile_is_seen_armed_streamed_printed_released_and_fired(tmp_path):
    quick = {"least_minutes": 1.0, "cycle_minutes": 1.0}
    with running_plant_here(plant_in(tmp_path, clock={"rate": 10.0}, kiln=quick)) as running:
        make_a_tile(running)


def make_a_tile(running):
    ends = running.endpoints
    with ModbusHost(ends["plc_tcp"]) as plc, PrinterHost(ends["printer_control"]) as printer:
        printer.open()
        with DataHost(ends["printer_data"]) as data:
            assert data.stat() == (0, 0, 512 << 20, 0)
            plc.poll()
            plc.command(1)

            def alive():
                plc.poll()
                printer.ask(2)
                return True

            (seen, *_) = wait_until(lambda: alive() and printer.detections(1))
            assert printer.arm(1, 1, seen[1] + 2600 * 20) == 0
            for row in range(0, 600, 200):
                data.strip(1, row, FACE[row * 40 : (row + 200) * 40])
                assert data.stat() == (1, row + 200, (512 << 20) - (row + 200) * 40, 0)
            wait_until(lambda: alive() and printer.outcome(1)[3] == 2, "printed")
            assert printer.outcome(1) == (1, 101, 1, 2, 600, 600, crc32(FACE))
            wait_until(lambda: alive() and plc.poll()[14] >= 1, "decided")
            wait_until(lambda: alive() and running.summary()["in_kiln"], "in the kiln")
    (tile,) = [tile for tile in running.truth()["tiles"] if tile["id"] == 1]
    assert tile["prints"][0] | {"at": 0, "margin_mm": 0, "armed_ahead_mm": 0} == {
        **{"arm": 1, "face": 101, "detect_seq": 1, "rows": 600, "rows_ordered": 600, "complete": True},
        **{"crc32": crc32(FACE), "sha256": None, "nozzle_out": False, "on_tile": True},
        **{"offset_mm": 0.0, "centre_mm": 0.0, "at": 0, "margin_mm": 0, "armed_ahead_mm": 0},
    }
    running.set_rate(1000)
    with SerialHost(ends["gauge"]) as gauge:

        def measured():
            gauge.send(b"?1 M\n")
            return b" E " not in gauge.read_until(lambda data: data.endswith(b"\n"))

        wait_until(measured, "a tile comes out")


def test_the_same_registers_over_tcp_and_serial(running):
    with ModbusHost(running.endpoints["plc_tcp"]) as tcp, RtuHost(running.endpoints["plc_rtu"]) as rtu:
        body = bytes.fromhex("0300020003")
        assert tcp.ask(body) == rtu.ask(body, 8)
        assert rtu.ask(bytes.fromhex("0600210001"), 5) == bytes.fromhex("0600210001")
        assert tcp.ask(bytes.fromhex("0300210001")) == bytes.fromhex("03020001")
        assert rtu.ask(bytes.fromhex("0600210004"), 2) == bytes.fromhex("8603")


def test_the_kiln_has_its_own_unit(running):
    with ModbusHost(running.endpoints["kiln"]) as kiln:
        assert kiln.poll(80)[8] == 8
        kiln.unit = 1
        assert kiln.ask(bytes.fromhex("0300000001")) == bytes.fromhex("830b")


def test_requests_may_come_in_pieces_and_together(running):
    with ModbusHost(running.endpoints["plc_tcp"]) as plc:
        one = bytes.fromhex("0001 0000 0006 01 03 0003 0002".replace(" ", ""))
        two = bytes.fromhex("0002 0000 0006 01 03 0003 0002".replace(" ", ""))
        plc.socket.sendall(one[:5])
        assert plc.silent()
        plc.socket.sendall(one[5:] + two)
        assert [plc.frame()[0] for _ in range(2)] == [1, 2]


@pytest.mark.parametrize("nonsense", [b"GET / HTTP/1.1\r\n\r\n", bytes.fromhex("0001 0000 ffff 01 03"), bytes(20)])
def test_what_is_no_modbus_ends_the_connection(running, nonsense):
    with ModbusHost(running.endpoints["plc_tcp"]) as plc:
        plc.socket.sendall(nonsense)
        assert plc.ended()


def test_a_serial_slave_finds_its_feet_after_nonsense(running):
    with RtuHost(running.endpoints["plc_rtu"]) as rtu:
        rtu.send(b"\x01\x99\x00\x17\xff")
        assert rtu.silent()
        assert rtu.ask(bytes.fromhex("0300030002"), 6) == bytes.fromhex("030401020304")


def test_a_serial_line_is_no_faster_than_its_baud_rate(tmp_path):
    with (
        running_plant_here(plant_in(tmp_path, plc={"baud": 4800})) as plant,
        RtuHost(plant.endpoints["plc_rtu"]) as rtu,
    ):
        started = time.monotonic()
        rtu.ask(bytes.fromhex("0300000040"), 130)
        assert time.monotonic() - started >= (8 + 133) * 11 / 4800


def test_data_before_a_session_or_of_another_is_refused(running):
    ends = running.endpoints
    with DataHost(ends["printer_data"]) as data:
        assert data.ended()
    with PrinterHost(ends["printer_control"], session=5) as printer:
        printer.open()
        for session in (4, 6):
            with DataHost(ends["printer_data"], session) as data:
                assert data.ended()
        with DataHost(ends["printer_data"], 5) as old:
            old.stat()
            with DataHost(ends["printer_data"], 5) as new:
                new.stat()
                assert old.ended()
                with PrinterHost(ends["printer_control"], session=6) as next_one:
                    next_one.open()
                    assert new.ended()


def armed(running, printer, plc, **options):
    """Open, run, and arm the first tile."""
    printer.open()
    plc.poll()
    plc.command(1)
    (seen, *_) = wait_until(lambda: plc.poll() and printer.ask(2) and printer.detections(1))
    assert printer.arm(1, 1, seen[1] + 2600 * 20, **options) == 0


def test_strips_that_do_not_fit_are_not_taken(running):
    ends = running.endpoints
    running.set_rate(1)
    with ModbusHost(ends["plc_tcp"]) as plc, PrinterHost(ends["printer_control"]) as printer:
        armed(running, printer, plc)
        with DataHost(ends["printer_data"]) as data:
            credit = data.stat()[2]
            data.strip(2, 0, FACE[:400])
            assert data.stat() == (2, 0, credit, 2)
            data.strip(1, 10, FACE[:400])
            assert data.stat() == (1, 0, credit, 3)
            data.strip(1, 0, FACE[:400], check=5)
            assert data.stat() == (1, 0, credit, 1)
            data.strip(1, 0, FACE[:400])
            assert data.stat() == (1, 10, credit - 400, 0)
        with DataHost(ends["printer_data"]) as data:
            data.stat()
            assert printer.outcome(1)[5] == 10
            data.strip(1, 10, FACE[400:800])
            assert data.stat()[:2] == (1, 20)
            data.socket.sendall(b"nonsense" * 5)
            assert data.ended()


def test_long_strips_arrive_in_many_pieces(running):
    ends = running.endpoints
    with ModbusHost(ends["plc_tcp"]) as plc, PrinterHost(ends["printer_control"]) as printer:
        armed(running, printer, plc, cols=500)
        with DataHost(ends["printer_data"]) as data:
            data.stat()
            long = FACE * 40
            data.strip(1, 0, long, row_bytes=2000)
            assert data.stat()[1::2] == (480, 0)
            data.strip(1, 480, long[:240000], row_bytes=2000)
            assert data.stat()[1::2] == (600, 0)
            assert printer.outcome(1)[6] == crc32(long + long[:240000])


@pytest.mark.parametrize("verify", ["sha256", "none"])
def test_other_ways_to_verify(tmp_path, verify):
    config = plant_in(tmp_path, clock={"rate": 10.0}, printer={"verify": verify})
    with running_plant_here(config) as running:
        ends = running.endpoints
        with ModbusHost(ends["plc_tcp"]) as plc, PrinterHost(ends["printer_control"]) as printer:
            armed(running, printer, plc)
            with DataHost(ends["printer_data"]) as data:
                data.stat()
                if verify == "sha256":
                    data.strip(1, 0, FACE[:400], check=5)
                    assert data.stat()[3] == 1
                data.strip(1, 0, FACE[:12000])
                data.strip(1, 300, FACE[12000:])
                wait_until(lambda: plc.poll() and printer.ask(2) and running.summary()["prints"])
        (print_,) = next(tile for tile in running.truth()["tiles"] if tile["id"] == 1)["prints"]
        assert print_["crc32"] == crc32(FACE)
        assert print_["sha256"] == (hashlib.sha256(FACE).hexdigest() if verify == "sha256" else None)


def test_new_credit_is_told_while_rows_are_printed(tmp_path):
    config = plant_in(tmp_path, clock={"rate": 10.0}, printer={"buffer_bytes": 8000})
    with running_plant_here(config) as running:
        ends = running.endpoints
        with ModbusHost(ends["plc_tcp"]) as plc, PrinterHost(ends["printer_control"]) as printer:
            armed(running, printer, plc)
            with DataHost(ends["printer_data"]) as data:
                assert data.stat()[2] == 8000
                data.strip(1, 0, FACE[:8000])
                assert data.stat() == (1, 200, 0, 0)
                data.strip(1, 200, FACE[8000:8400])
                assert data.stat() == (1, 200, 0, 4)
                row, credit = 200, 0
                while row < 600:
                    while credit < 400:
                        plc.poll()
                        printer.ask(2)
                        if not data.silent():
                            arm, row, credit, code = data.stat()
                            assert (arm, code) == (1, 0)
                    data.strip(1, row, FACE[row * 40 : row * 40 + 400])
                    arm, row, credit, code = data.stat()
                    if code == 2:
                        break
                # Whoever is that slow may be too late: then the truth says so.
                wait_until(lambda: plc.poll() and printer.ask(2) and printer.outcome(1)[3] in (2, 4))


def test_the_control_port_answers_every_line(running):
    with ControlHost(running.endpoints["control"]) as control:
        assert control.do("rate", rate=60)["ok"]
        state = control.do("state")
        assert state["rate"] == 60
        assert state["up"] == {"plc": True, "kiln": True, "printer": True, "gauge": True}
        assert control.do("truth")["tiles"] == []
        assert control.do("truth", summary=True).keys() == {"ok", "summary"}
        assert control.do("forget_faces") == {"ok": True}


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"nonsense", "Expecting value"),
        (b"[]", "a command is a JSON object"),
        (b'{"do": "dance"}', "no command 'dance'"),
        (b'{"do": "_do_rate"}', "no command"),
        (b'{"do": "rate"}', "KeyError"),
        (b'{"do": "rate", "rate": 0}', "not 1 to 1000"),
        (b'{"do": "fault", "kind": "dance"}', "no fault 'dance'"),
        (b'{"do": "fault", "kind": "mute", "device": "oven"}', "no device 'oven'"),
        (b'{"do": "fault", "kind": "reboot", "device": "plc_tcp"}', "no device 'plc_tcp'"),
        (b'{"do": "fault", "kind": "stale", "device": "printer"}', "has no registers"),
        (b'{"do": "fault", "kind": "late", "acts": "never"}', "that is mute"),
        (b'{"do": "fault", "kind": "mute", "acts": "maybe"}', "now, late or never"),
        (b'{"do": "fault", "kind": "ink_out", "ink": 9}', "IndexError"),
    ],
)
def test_the_control_port_tells_what_is_wrong(running, line, says):
    with ControlHost(running.endpoints["control"]) as control:
        reply = control.say(line)
        assert reply["ok"] is False
        assert says in reply["error"]
        assert control.do("state")["ok"]


def test_a_plant_beside_an_event_loop(tmp_path):
    async def use():
        async with running_plant(plant_in(tmp_path)) as plant:
            reader, writer = await asyncio.open_connection(*address(plant.endpoints["control"]))
            writer.write(b'{"do": "state"}\n')
            assert json.loads(await reader.readline())["ok"]
            writer.close()
            await writer.wait_closed()
            with plant.physics() as physics:
                assert physics.timeline.t > 0
        return Path(serial_path(plant.endpoints["gauge"]))

    assert not asyncio.run(use()).exists()
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("sim-")]


def test_an_address_that_is_taken_is_told_and_nothing_stays_open(tmp_path):
    with running_plant_here(plant_in(tmp_path)) as first:
        taken = "{}:{}".format(*address(first.endpoints["kiln"]))
        config = plant_in(tmp_path / "..", control={"tcp": taken})
        with pytest.raises(OSError, match="in use"), running_plant_here(config):
            pass


def test_only_what_is_configured_is_offered():
    config = parse_plant({"plc": {"tcp": ""}, "kiln": {"tcp": ""}, "printer": {"data": ""}})
    with running_plant_here(config) as plant:
        assert plant.endpoints.keys() == {"control"}


def test_no_descriptor_is_left_behind(tmp_path):
    def descriptors():
        return len(list(Path("/proc/self/fd").iterdir()))

    def once():
        with running_plant_here(plant_in(tmp_path)) as plant, PrinterHost(plant.endpoints["printer_control"]) as host:
            host.open()
            with DataHost(plant.endpoints["printer_data"]) as data, ModbusHost(plant.endpoints["plc_tcp"]) as plc:
                data.stat()
                plc.poll()
                plant.power_cut(0.01)
                wait_until(lambda: plant.state()["up"]["plc"])
                plant.fault("gauge", "drop")

    once()
    before = descriptors()
    for _ in range(3):
        once()
    assert descriptors() == before


PLANT_FILE = """\
endpoints_file = "endpoints.json"
truth_file = "truth.jsonl"
[plc]
rtu = "pty:plc"
[printer]
control = "pty:printer"
"""


@pytest.mark.parametrize("end", ["stop", "term"])
def test_the_command_runs_until_it_is_told_to_stop(tmp_path, end):
    (tmp_path / "plant.toml").write_text(PLANT_FILE)
    command = [sys.executable, "-c", "from sim.plant.main import main; main()", str(tmp_path / "plant.toml")]
    with subprocess.Popen([*command, "--rate", "20"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        endpoints = json.loads(process.stdout.readline())
        assert json.loads((tmp_path / "endpoints.json").read_text()) == endpoints
        assert endpoints.keys() == {"plc_tcp", "plc_rtu", "kiln", "printer_control", "printer_data", "control"}
        with ControlHost(endpoints["control"]) as control:
            assert control.do("state")["rate"] == 20
            if end == "stop":
                assert control.do("stop") == {"ok": True}
            else:
                process.send_signal(signal.SIGTERM)
            assert process.wait(10) == 0
    assert not (tmp_path / "printer").is_symlink()


@pytest.mark.parametrize(("content", "code"), [("[clock]\nrate = 0", 2), ("nonsense", 2), (None, 2)])
def test_the_command_refuses_a_wrong_plant_file(tmp_path, capsys, content, code):
    path = tmp_path / "plant.toml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(SystemExit) as ended:
        main([str(path)])
    assert ended.value.code == code
    assert capsys.readouterr().err.startswith(f"error: {path}: ")


def test_the_command_tells_of_addresses_that_can_not_be_had(tmp_path, capsys):
    (tmp_path / "plant.toml").write_text('[control]\ntcp = "192.0.2.1:1"\n')
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "plant.toml")])
    assert ended.value.code == 1
    assert capsys.readouterr().err.startswith("error: ")
