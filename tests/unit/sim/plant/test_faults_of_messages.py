"""Every fault of messages, on every wire that can have it; what hosts make of it is not the plant's affair."""

from __future__ import annotations

import struct

import pytest

from sim.plant.inprocess import plant_in, running_plant_here
from sim.plant.wire import tfp
from tests.unit.sim.plant.hosts import DataHost, ModbusHost, PrinterHost, RtuHost, SerialHost, wait_until

pytestmark = pytest.mark.xdist_group("line")

PROBE = bytes.fromhex("0300030002")
PROBE_REPLY = bytes.fromhex("030401020304")
SPEED = bytes.fromhex("0600220064")


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """One plant for all of this page; every test takes its faults away again."""
    with running_plant_here(plant_in(tmp_path_factory.mktemp("plant"))) as plant:
        yield plant


@pytest.fixture
def running(shared):
    yield shared
    shared.clear()


@pytest.fixture
def plc(running):
    with ModbusHost(running.endpoints["plc_tcp"]) as host:
        yield host


@pytest.fixture
def rtu(running):
    with RtuHost(running.endpoints["plc_rtu"]) as host:
        yield host


@pytest.fixture
def printer(running):
    with PrinterHost(running.endpoints["printer_control"], session=1000) as host:
        host.ask(1, b"\x01")
        yield host


def speed(running):
    with running.physics():
        return running.service.plc.read(34, 1)[0]


def set_speed(value):
    return struct.pack(">BHH", 6, 34, value)


@pytest.mark.parametrize(("acts", "value"), [("now", 111), ("never", 0)])
def test_mute(running, plc, acts, value):
    plc.ask(set_speed(0))
    running.fault("plc", "mute", acts=acts)
    plc.send(set_speed(111))
    assert plc.silent()
    assert speed(running) == value
    assert plc.ask(PROBE) == PROBE_REPLY


def test_mute_for_a_while_strikes_every_message(running, plc):
    running.fault("plc", "mute", seconds=0.3)
    plc.send(PROBE)
    plc.send(PROBE)
    assert plc.silent()

    def answered():
        plc.send(PROBE)
        return not plc.silent()

    wait_until(answered)
    assert plc.frame()[0] > 2


@pytest.mark.parametrize(("acts", "at_once"), [("now", 5), ("late", 0)])
def test_late(running, plc, acts, at_once):
    plc.ask(set_speed(0))
    running.fault("plc_tcp", "late", seconds=0.3, acts=acts)
    plc.send(set_speed(5))
    assert plc.silent()
    assert speed(running) == at_once
    assert plc.ask(PROBE) == PROBE_REPLY
    assert plc.frame()[0] == 2
    assert speed(running) == 5


def test_twice(running, plc):
    running.fault("plc", "twice")
    plc.send(PROBE)
    assert plc.frame() == plc.frame() == (1, 1, PROBE_REPLY)


def garbled_answers(running, plc, **options):
    """Right and garbled answers to the same request."""
    for seed in range(20):
        running.fault("plc", "garble", seed=seed, **options)
        plc.send(PROBE)
        right = plc.tid.to_bytes(2, "big") + bytes.fromhex("0000000701") + PROBE_REPLY
        wrong = plc.read(13)
        assert wrong != right
        yield right, wrong


def test_garble_strikes_anywhere_where_check_words_show_it(running, plc):
    assert any(wrong[9:] != right[9:] for right, wrong in garbled_answers(running, plc))


def test_garble_strikes_the_header_only_where_that_is_asked_for(running, plc):
    assert all(wrong[9:] == right[9:] for right, wrong in garbled_answers(running, plc, anywhere=False))


@pytest.mark.parametrize("device", ["plc", "kiln"])
def test_garble_strikes_the_header_only_of_a_controller_without_check_words(tmp_path, device):
    config = plant_in(tmp_path, **{device: {"check_words": False}})
    with running_plant_here(config) as plant:
        for name in ("plc", "kiln"):
            plant.fault(name, "garble")
        anywhere = {fault.device: fault.anywhere for fault in plant.service.faults._faults}
    assert anywhere == {"plc": device != "plc", "kiln": device != "kiln"}


def test_truncate(running, plc):
    running.fault("plc", "truncate", seed=1)
    plc.send(PROBE)
    assert 1 <= len(plc.socket.recv(100)) < 13
    assert plc.silent()


def test_noise(running, plc):
    running.fault("plc", "noise", seed=1)
    plc.send(PROBE)
    data = b""
    while not data.endswith(PROBE_REPLY):
        data += plc.socket.recv(100)
    assert len(data) > 13


def test_reorder(running, plc):
    running.fault("plc", "reorder", seconds=5)
    plc.send(PROBE)
    assert plc.silent()
    plc.send(PROBE)
    assert [plc.frame()[0] for _ in range(2)] == [2, 1]


def test_reorder_ends_by_itself(running, plc):
    running.fault("plc", "reorder", seconds=0.2)
    plc.send(PROBE)
    assert plc.silent()
    assert plc.frame()[0] == 1


def test_replay(running, plc):
    first = plc.poll()
    running.fault("plc", "replay")
    plc.send(plc.poll_body())
    tid, _, reply = plc.frame()
    assert tid == plc.tid - 1
    assert list(struct.unpack(">64H", reply[2:])) == first


def test_drop(running, plc):
    running.fault("plc", "drop")
    plc.send(PROBE)
    assert plc.ended()
    with ModbusHost(running.endpoints["plc_tcp"]) as again:
        assert again.ask(PROBE) == PROBE_REPLY


def test_half_open(running, plc):
    running.fault("plc", "half_open")
    for _ in range(2):
        plc.send(PROBE)
        assert plc.silent()
    with ModbusHost(running.endpoints["plc_tcp"]) as again:
        assert again.ask(PROBE) == PROBE_REPLY
    plc.send(PROBE)
    assert plc.silent()


@pytest.mark.parametrize(
    ("kind", "reply"),
    [
        ("wrong_unit", (1, 2, PROBE_REPLY)),
        ("wrong_function", (1, 1, b"\x04" + PROBE_REPLY[1:])),
        ("wrong_count", (1, 1, bytes.fromhex("03020102"))),
        ("old_tid", (0, 1, PROBE_REPLY)),
    ],
)
def test_answers_that_are_whole_and_wrong(running, plc, kind, reply):
    running.fault("plc", kind)
    plc.send(PROBE)
    assert plc.frame() == reply


def test_word_order_and_stale_until_cleared(running, plc):
    running.fault("plc", "word_order")
    assert plc.poll()[3:5] == [0x0304, 0x0102]
    running.clear()
    assert plc.poll()[3:5] == [0x0102, 0x0304]
    running.fault("plc", "stale")
    first = plc.poll()[1:32]
    assert plc.silent()
    assert plc.poll()[1:32] == first
    running.clear()
    assert plc.poll()[1] != first[0]


@pytest.mark.parametrize("device", ["plc", "kiln"])
@pytest.mark.parametrize("kind", ["stale", "word_order"])
def test_wrong_views_end_by_themselves(running, device, kind):
    with ModbusHost(running.endpoints["kiln" if device == "kiln" else "plc_tcp"]) as host:
        right = host.poll()[3:5]
        running.fault(device, kind, seconds=0.1)
        if kind == "word_order":
            assert host.poll()[3:5] == right[::-1]
        else:
            assert host.poll()[1] == host.poll()[1]
        first = host.poll()[1]
        wait_until(lambda: (words := host.poll())[3:5] == right and words[1] != first)


def test_only_the_messages_that_match_are_struck_after_those_that_are_skipped(running, plc):
    running.fault("plc", "mute", match=6, skip=1)
    assert plc.ask(PROBE) == PROBE_REPLY
    assert plc.ask(SPEED) == SPEED
    assert plc.ask(PROBE) == PROBE_REPLY
    plc.send(SPEED)
    assert plc.silent()
    assert plc.ask(SPEED) == SPEED


def test_a_probability_strikes_the_same_messages_with_the_same_seed(running, plc):
    def struck():
        running.fault("plc", "old_tid", probability=0.4, seed=7)
        found = []
        for _ in range(60):
            plc.send(PROBE)
            found.append(plc.frame()[0] != plc.tid)
        running.clear()
        return found

    first = struck()
    assert first == struck()
    assert 10 < sum(first) < 40
    assert running.state()["faults_struck"]["plc.old_tid"] >= 2 * sum(first)


def test_a_fault_of_one_wire_leaves_the_other_alone(running, plc, rtu):
    running.fault("plc_tcp", "mute", count=9)
    assert rtu.ask(PROBE, 6) == PROBE_REPLY
    plc.send(PROBE)
    assert plc.silent()


def test_late_on_the_serial_line_comes_after_another_answer(running, rtu):
    running.fault("plc_rtu", "late", seconds=0.3)
    rtu.send_body(PROBE)
    assert rtu.silent()
    assert rtu.ask(SPEED, 5) == SPEED
    assert rtu.frame(6) == PROBE_REPLY


@pytest.mark.parametrize("kind", ["garble", "truncate"])
def test_damage_on_the_serial_line_shows_in_the_checksum(running, rtu, kind):
    running.fault("plc_rtu", kind, seed=3)
    rtu.send_body(PROBE)
    data = rtu.read_until(lambda data: len(data) >= (9 if kind == "garble" else 1))
    assert data != b"\x01" + PROBE_REPLY + bytes.fromhex("5B3C")
    assert rtu.silent()
    assert rtu.ask(PROBE, 6) == PROBE_REPLY


def test_replay_on_the_serial_line_has_a_good_checksum(running, rtu):
    rtu.ask(PROBE, 6)
    running.fault("plc_rtu", "replay")
    assert rtu.ask(SPEED, 6) == PROBE_REPLY


def test_drop_breaks_the_serial_line_and_another_takes_its_place(running, rtu):
    running.fault("plc_rtu", "drop")
    rtu.send_body(PROBE)
    wait_until(rtu.broken)
    with RtuHost(running.endpoints["plc_rtu"]) as again:
        assert again.ask(PROBE, 6) == PROBE_REPLY


def test_half_open_on_a_serial_line_lasts_for_a_while(running, rtu):
    running.fault("plc_rtu", "half_open", seconds=0.3)
    rtu.send_body(PROBE)
    assert rtu.silent()

    def answered():
        rtu.send_body(PROBE)
        return not rtu.silent()

    wait_until(answered)


def test_mute_and_late_of_the_printer(running, printer):
    running.fault("printer", "mute", match=tfp.HOLD)
    printer.request(tfp.HOLD)
    assert printer.silent()
    printer.ask(tfp.STATUS)
    running.fault("printer", "late", seconds=0.2, match=tfp.STATUS)
    printer.request(tfp.STATUS)
    printer.request(tfp.HOLD)
    replies = printer.messages(2)
    assert [reply.kind for reply in replies if reply] == [tfp.HOLD | 0x80, tfp.STATUS | 0x80]


def test_a_lost_answer_of_the_printer_can_be_asked_for_again(running, printer):
    running.fault("printer", "mute", match=tfp.HELLO)
    printer.request(tfp.HELLO, b"\x01")
    assert printer.silent()
    printer.seq -= 1
    assert len(printer.ask(tfp.HELLO, b"\x01")) == 24


def test_twice_garble_and_noise_of_the_printer(running, printer):
    running.fault("printer_control", "twice")
    printer.request(tfp.STATUS)
    first, second = printer.messages(2)
    assert first == second
    running.fault("printer", "garble", seed=2)
    printer.request(tfp.HOLD)
    assert None in printer.messages(1)
    running.fault("printer", "noise", seed=2)
    printer.request(tfp.HOLD)
    assert printer.messages(1)[0] is None


@pytest.mark.parametrize("kind", ["wrong_unit", "wrong_function", "wrong_count", "old_tid"])
def test_whole_and_wrong_answers_of_the_printer(running, printer, kind):
    running.fault("printer", kind)
    printer.request(tfp.HOLD)
    (reply,) = printer.messages()
    assert reply is not None
    assert reply != tfp.Message(printer.session, printer.seq, tfp.HOLD | 0x80, b"\0")


def test_faults_of_the_gauge(running):
    with SerialHost(running.endpoints["gauge"]) as gauge:
        for kind in ("old_tid", "garble", "twice"):
            running.fault("gauge", kind, seed=1)
            gauge.send(b"?7 M\n")
            line = gauge.read_some(1) + (b"" if gauge.silent() else b"more")
            assert line != b"!7 E 2*" + line[7:], (kind, line)


def test_faults_of_the_data_link(running, printer):
    end = running.endpoints["printer_data"]
    with DataHost(end, printer.session) as data:
        data.stat()
        running.fault("printer_data", "mute")
        data.strip(99, 0, bytes(40))
        assert data.silent()
        running.fault("printer_data", "twice")
        data.strip(99, 0, bytes(40))
        assert data.stat() == data.stat()
        running.fault("printer_data", "late", seconds=0.3)
        data.strip(99, 0, bytes(40))
        assert data.silent()
        assert data.stat()[3] == 2
        running.fault("printer_data", "garble", seed=1)
        data.strip(99, 0, bytes(40))
        assert data.read(21)[:4] != b"STAT"
        running.fault("printer_data", "drop")
        data.strip(99, 0, bytes(40))
        assert data.ended()
    with DataHost(end, printer.session) as data:
        data.stat()
        running.fault("printer_data", "half_open")
        data.strip(99, 0, bytes(40))
        assert data.silent()
        data.strip(99, 0, bytes(40))
        assert data.silent()
        with DataHost(end, printer.session) as again:
            again.stat()
