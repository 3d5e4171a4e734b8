"""Power cuts, reboots and the plant's own faults, set at the control port and seen on the wires."""

from __future__ import annotations

import struct

import pytest

from tests.unit.sim.plant.hosts import ControlHost, DataHost, ModbusHost, PrinterHost, wait_until

pytestmark = pytest.mark.xdist_group("line")


def up(running, *devices):
    wait_until(lambda: all(running.state()["up"][device] for device in devices), "up again")


def test_a_rebooted_plc_drops_its_connections_and_forgets(running):
    with ModbusHost(running.endpoints["plc_tcp"]) as plc:
        plc.poll()
        plc.command(7, run=0)
        old = wait_until(lambda: (words := plc.poll())[19] == 7 and words)
        running.fault("plc", "reboot", seconds=0.2)
        assert plc.ended()
        with ModbusHost(running.endpoints["plc_tcp"]) as off:
            assert off.ended()
    up(running, "plc")
    with ModbusHost(running.endpoints["plc_tcp"]) as plc:
        words = plc.poll()
        assert words[2] not in (0, old[2])
        assert words[19] == 0
        assert words[32:42] == [0] * 10


def test_a_rebooted_printer_keeps_its_memory_unless_that_is_lost(running):
    ends = running.endpoints
    with PrinterHost(ends["printer_control"], session=3) as printer, ModbusHost(ends["plc_tcp"]) as plc:
        printer.open()
        plc.poll()
        plc.command(1)
        seen = wait_until(lambda: plc.poll() and printer.ask(2) and printer.detections(1))[0]
        assert printer.arm(5, 1, seen[1] + 2600 * 20) == 0
        boot = printer.ask(2)[:4]
        with DataHost(ends["printer_data"], 3) as data:
            data.stat()
            running.fault("printer", "reboot", seconds=0.05)
            assert data.ended()
        up(running, "printer")
        printer.request(2)
        (reply,) = printer.messages()
        assert reply is not None
        assert (reply.kind, reply.payload) == (0xFF, b"\x04")
        printer.ask(1, b"\x01")
        assert printer.outcome(5)[3] == 3
        status = struct.unpack_from("<IHQIQ", printer.ask(2))
        assert status[0] != boot
        assert status[4] == 5
        assert status[1] & 2
        running.fault("printer", "reboot_lost", seconds=0.05)
        up(running, "printer")
        printer.ask(1, b"\x01")
        assert printer.ask(6, bytes(8)) == b"\0"
        assert struct.unpack_from("<IHQIQ", printer.ask(2))[4] == 0


def test_while_it_boots_a_printer_is_silent(running):
    with PrinterHost(running.endpoints["printer_control"]) as printer:
        printer.open()
        running.fault("printer", "reboot", seconds=60)
        printer.request(2)
        assert printer.silent()
        running.fault("printer", "reboot", seconds=0)
        up(running, "printer")


def test_a_power_cut_takes_everything_at_once(running):
    ends = running.endpoints
    with (
        ControlHost(ends["control"]) as control,
        ModbusHost(ends["plc_tcp"]) as plc,
        ModbusHost(ends["kiln"]) as kiln,
        PrinterHost(ends["printer_control"]) as printer,
    ):
        plc.poll()
        plc.command(1)
        kiln.poll()
        printer.open()
        wait_until(lambda: plc.poll()[5] & 1, "runs")
        boots = (plc.poll()[2], kiln.poll()[2], printer.ask(2)[:4])
        assert control.do("power_cut", seconds=0.2) == {"ok": True}
        assert plc.ended()
        assert kiln.ended()
        assert not any(control.do("state")["up"].values())
        up(running, "plc", "kiln", "printer", "gauge")
        wait_until(lambda: running.state()["speed_mm_s"] == 0, "the belt stops")
        printer.ask(1, b"\x01")
    with ModbusHost(ends["plc_tcp"]) as plc, ModbusHost(ends["kiln"]) as kiln:
        assert plc.poll()[2] != boots[0]
        assert kiln.poll()[2] != boots[1]
        assert not plc.poll()[5] & 1


def test_the_later_of_two_boots_counts(running):
    running.fault("plc", "reboot", seconds=0.05)
    running.fault("plc", "reboot", seconds=60)
    running.fault("kiln", "reboot", seconds=0.1)
    up(running, "kiln")
    assert not running.state()["up"]["plc"]


def test_an_e_stop_is_seen_by_belt_and_printer_and_outlives_a_boot(running):
    with ModbusHost(running.endpoints["plc_tcp"]) as plc, PrinterHost(running.endpoints["printer_control"]) as printer:
        printer.open()
        running.fault("plc", "e_stop")
        assert plc.poll()[5] & 2
        assert struct.unpack_from("<IH", printer.ask(2))[1] & 6 == 6
        running.fault("printer", "reboot", seconds=0)
        up(running, "printer")
        printer.ask(1, b"\x01")
        assert struct.unpack_from("<IH", printer.ask(2))[1] & 6 == 6
        running.fault("plc", "e_stop_release")
        assert plc.poll()[5] & 2
        assert printer.ask(8, printer.ask(2)[-2:]) == b"\0"


@pytest.mark.parametrize(
    ("set_", "end", "bit"),
    [("jam", "jam_clear", 4), ("diverter_fault", "diverter_ok", 128), ("e_stop", "e_stop_release", 2)],
)
def test_faults_of_the_belt_need_their_end_and_an_acknowledgement(running, set_, end, bit):
    with ModbusHost(running.endpoints["plc_tcp"]) as plc:
        running.fault("plc", set_)
        assert plc.poll()[5] & bit
        plc.command(1, run=0, ack=1)
        wait_until(lambda: plc.poll()[19] == 1)
        assert plc.poll()[5] & bit
        running.fault("plc", end)
        plc.command(2, run=0, ack=1)
        wait_until(lambda: not plc.poll()[5] & bit)


def test_faults_of_the_printer(running):
    with PrinterHost(running.endpoints["printer_control"]) as printer:
        printer.open()
        for set_, end, bit in (("ink_out", "ink_refill", 8), ("nozzle_out", "nozzle_ok", 16)):
            running.fault("printer", set_, ink=2)
            status = printer.ask(2)
            assert struct.unpack_from("<IH", status)[1] == bit | 2
            assert printer.ask(8, status[-2:]) == b"\x02"
            running.fault("printer", end)
            assert printer.ask(8, status[-2:]) == b"\0"


def test_faults_of_the_kiln(running):
    with ModbusHost(running.endpoints["kiln"]) as kiln:
        running.fault("kiln", "zone_drift", zone=3, degc=40, minutes=0.1)
        drifted = 10 + 2 * 3

        def degc():
            words = kiln.poll(80)
            return struct.unpack(">f", struct.pack(">2H", *words[drifted : drifted + 2]))[0]

        wait_until(lambda: degc() == pytest.approx(60))
        running.fault("kiln", "burner_fault")
        running.fault("kiln", "kiln_block")
        assert kiln.poll()[5] & 0b10010 == 0b10010
        running.fault("kiln", "burner_ok")
        running.fault("kiln", "kiln_unblock")
        assert kiln.poll()[5] & 0b10010 == 0


def test_faults_of_the_loader(running):
    running.fault("plc", "missing_tile", count=2)
    running.fault("plc", "double_feed")
    with ModbusHost(running.endpoints["plc_tcp"]) as plc:
        plc.poll()
        plc.command(1)
        wait_until(lambda: plc.poll()[5] & 16, "two in one")
        words = plc.poll()
        assert words[10] == 1
        assert words[22] >= 3
    tiles = running.truth()["tiles"]
    assert [tile["tile_seq"] for tile in tiles if tile["id"] <= 2] == [1, 1]
