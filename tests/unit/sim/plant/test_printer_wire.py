"""The printer's two protocols, byte by byte."""

from __future__ import annotations

import struct
from zlib import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.plant.wire import tfd, tfp
from tests.unit.sim.plant.physics_bench import COUNTS, EYE_TO_HEAD, Bench


@given(st.binary(max_size=1200))
def test_cobs_has_no_zeros_and_can_be_undone(data):
    assert 0 not in tfp.cobs(data)
    assert tfp.from_cobs(tfp.cobs(data)) == data


@pytest.mark.parametrize(
    ("data", "coded"),
    [
        ("", "01"),
        ("00", "0101"),
        ("0000", "010101"),
        ("11220033", "0311220233"),
        ("11000000", "0211010101"),
        ("01" * 253, "fe" + "01" * 253),
    ],
)
def test_cobs_of_published_examples(data, coded):
    assert tfp.cobs(bytes.fromhex(data)).hex() == coded


@pytest.mark.parametrize("data", [b"\x05\x11", b"\x00", b"\x03\x11\x22\x00\x01"])
def test_what_is_not_cobs_is_told(data):
    assert tfp.from_cobs(data) is None


class Line:
    """The controller, with requests and answers as payloads."""

    def __init__(self, **tables):
        self.bench = Bench(**tables)
        config = self.bench.plant.config
        self.controller = tfp.Controller(self.bench.head, config.printer, round(EYE_TO_HEAD * COUNTS), COUNTS)
        self.seq = 0

    def frame(self, kind, payload=b"", *, session=1, seq=None):
        if seq is None:
            self.seq += 1
        return tfp.frame(session, self.seq if seq is None else seq, kind, payload)

    def ask(self, kind, payload=b"", *, session=1, seq=None):
        request = tfp.parse(self.frame(kind, payload, session=session, seq=seq)[:-1])
        assert request is not None
        reply = tfp.parse(self.controller.answer(request)[:-1])
        assert reply is not None
        assert (reply.session, reply.seq) == (request.session, request.seq)
        return reply.kind, reply.payload

    def hello(self, session=1):
        return self.ask(1, b"\x01", session=session)


def test_a_frame_byte_by_byte():
    body = bytes.fromhex("07000000 0300 02".replace(" ", ""))
    check = crc32(body).to_bytes(4, "little")
    assert tfp.frame(7, 3, 2, b"") == tfp.cobs(body + check) + b"\0"
    assert tfp.cobs(body).hex() == "0207" + "01" * 2 + "0203" + "0202"


def test_damaged_frames_are_dropped():
    good = tfp.frame(1, 1, 2, b"")[:-1]
    assert tfp.parse(good) == tfp.Message(1, 1, 2, b"")
    for at in range(len(good)):
        assert tfp.parse(good[:at] + bytes([good[at] ^ 0x10]) + good[at + 1 :]) is None
    assert tfp.parse(b"") is None
    long = bytes(240)
    assert tfp.parse(tfp.frame(1, 1, 2, long)[:-1]) is None


def test_hello_tells_what_the_printer_is():
    line = Line(printer={"inks": 6, "bits": 16, "buffer_bytes": 123456, "queue_len": 5, "min_lead_mm": 40.0})
    kind, payload = line.hello()
    assert kind == 0x81
    assert struct.unpack("<BIBBIIIBI", payload) == (*(1, line.bench.head.boot_id, 6, 16, 20000, 52000, 800, 5, 123456),)


def test_another_version_opens_no_session():
    line = Line()
    assert line.ask(1, b"\x02")[0] == 0x81
    assert line.ask(2) == (0xFF, b"\x04")


def test_status_tells_how_the_printer_is():
    line = Line(printer={"ink_faces": 4})
    line.hello()
    bench = line.bench
    kind, payload = line.ask(2)
    assert kind == 0x82
    assert len(payload) == 57
    assert struct.unpack("<IH", payload[:6])[1] == 0b10
    bench.start(release_base=1, release_bits=15)
    bench.wait_for_tile()
    bench.arm(9)
    bench.send(9, 0, 600)
    bench.until_travel(800 + EYE_TO_HEAD + 300)
    values = struct.unpack("<IHQIQQBI8HH", line.ask(2)[1])
    assert values[0] == bench.head.boot_id
    assert values[1] == 0b1000001
    assert values[2] == bench.head.encoder
    assert values[3:8] == (bench.head.detect_seq, 9, 0, 0, (512 << 20) - 300 * 40)
    bench.until_travel(800 + EYE_TO_HEAD + 600)
    values = struct.unpack("<IHQIQQBI8HH", line.ask(2)[1])
    assert values[5] == 9
    assert values[8:16] == (750, 750, 750, 750, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("trouble", "bit"),
    [
        (lambda bench: bench.plant.e_stop(True), 2),
        (lambda bench: bench.head.set_ink(1, 0), 3),
        (lambda bench: bench.head.set_nozzles(True), 4),
    ],
)
def test_troubles_have_their_bits_and_count(trouble, bit):
    line = Line()
    line.hello()
    assert line.ask(8, b"\0\0") == (0x88, b"\0")
    assert struct.unpack("<IH", line.ask(2)[1][:6])[1] == 1
    trouble(line.bench)
    payload = line.ask(2)[1]
    assert struct.unpack("<IH", payload[:6])[1] == 1 << bit | 2
    assert payload[-2:] == b"\x01\0"
    assert line.ask(8, b"\0\0") == (0x88, b"\x01")
    assert line.ask(8, b"\x01\0") == (0x88, b"\x02")


def test_dead_man_and_underrun_have_their_bits():
    line = Line()
    line.hello()
    line.ask(8, b"\0\0")
    line.bench.alive = False
    line.bench.after(0.6)
    assert struct.unpack("<IH", line.ask(2)[1][:6])[1] == 1 << 5 | 2
    line.bench.alive = True
    line.bench.start()
    line.bench.wait_for_tile()
    line.bench.arm(1)
    line.bench.until_travel(800 + EYE_TO_HEAD + 1)
    assert struct.unpack("<IH", line.ask(2)[1][:6])[1] == 1 << 7 | 2


def test_detections_come_oldest_first_eight_at_a_time():
    line = Line()
    line.bench.start(tile_length_mm=60.0, tile_pitch_mm=100.0)
    line.bench.wait_for_tile(12)
    kind, payload = line.ask(3, (3).to_bytes(4, "little"))
    assert (kind, payload[0], len(payload)) == (0x83, 8, 1 + 8 * 16)
    seen = [struct.unpack_from("<IQI", payload, 1 + 16 * at) for at in range(8)]
    assert [entry[0] for entry in seen] == list(range(3, 11))
    assert seen[0] == (3, round(line.bench.tiles()[2].lead_x * COUNTS), 1200)
    assert line.ask(3, (99).to_bytes(4, "little")) == (0x83, b"\0")


def arm_payload(order):
    return struct.pack(
        "<QQIQIIIBB",
        *(order.arm_id, order.face, order.detect_seq, order.start_encoder, order.rows, order.cols),
        *(order.row_pitch_millicounts, order.channels, order.bits),
    )


def test_arming_disarming_and_outcomes():
    line = Line()
    line.bench.start()
    line.bench.wait_for_tile(2)
    payload = arm_payload(line.bench.order(5))
    assert line.ask(4, payload) == (0x84, b"\0" + (5).to_bytes(8, "little"))
    assert line.ask(4, payload) == (0x84, b"\x01" + (5).to_bytes(8, "little"))
    assert line.ask(4, arm_payload(line.bench.order(4, 2))) == (0x84, b"\x03" + (5).to_bytes(8, "little"))
    assert line.ask(4, arm_payload(line.bench.order(6, 2)))[1][0] == 0
    line.bench.send(5, 0, 100)
    assert line.ask(5, (6).to_bytes(8, "little")) == (0x85, b"\0")
    assert line.ask(5, (8).to_bytes(8, "little")) == (0x85, b"\x02")
    kind, reply = line.ask(6, bytes(8))
    assert (kind, reply[0], len(reply)) == (0x86, 2, 1 + 2 * 33)
    first, second = (struct.unpack_from("<QQIBIII", reply, 1 + 33 * at) for at in range(2))
    assert first == (5, 105, 1, 0, 0, 100, line.bench.outcome(5).crc32)
    assert second == (6, 106, 2, 5, 0, 0, 0)
    assert line.ask(6, (7).to_bytes(8, "little")) == (0x86, b"\0")
    assert line.ask(7) == (0x87, b"\0")
    assert line.bench.head.held


def test_a_request_asked_again_is_answered_again_and_done_once():
    line = Line()
    line.bench.start()
    line.bench.wait_for_tile()
    payload = arm_payload(line.bench.order(5))
    first = line.ask(4, payload, seq=77)
    assert line.ask(4, payload, seq=77) == first
    assert first[1][0] == 0
    assert line.ask(4, payload, seq=78)[1][0] == 1
    line.ask(7, seq=79)
    line.bench.head.clear(0)
    line.ask(7, seq=79)
    assert not line.bench.head.held


def test_a_lower_session_changes_nothing():
    line = Line()
    assert line.hello(5)[0] == 0x81
    assert line.ask(8, b"\0\0", session=5)[1] == b"\0"
    assert line.ask(7, session=4) == (0xFF, b"\x03")
    assert line.hello(4) == (0xFF, b"\x03")
    assert not line.bench.head.held
    assert line.ask(2, session=5)[0] == 0x82
    assert line.hello(6)[0] == 0x81
    assert line.ask(2, session=5) == (0xFF, b"\x03")


def test_errors():
    line = Line()
    assert line.ask(2) == (0xFF, b"\x04")
    line.hello()
    assert line.ask(9) == (0xFF, b"\x01")
    assert line.ask(2, b"\0") == (0xFF, b"\x02")
    assert line.ask(4, bytes(41)) == (0xFF, b"\x02")


def test_after_a_boot_a_session_must_be_opened_again():
    line = Line()
    line.hello()
    line.ask(2, seq=9)
    line.bench.head.power_down()
    line.bench.head.power_up()
    line.controller.reset()
    assert line.ask(2, seq=9) == (0xFF, b"\x04")
    assert line.hello()[0] == 0x81


def test_messages_of_the_data_link():
    assert tfd.parse_hello(b"TFD1\x05\0\0\0") == 5
    assert tfd.parse_hello(b"TFD2\x05\0\0\0") is None
    strip = struct.pack("<4sQIIII", b"STRP", 1 << 40, 3, 4, 5, 6)
    assert tfd.parse_strip(strip) == tfd.StripHead(1 << 40, 3, 4, 5, 6)
    assert tfd.parse_strip(b"X" + strip[1:]) is None
    assert tfd.stat(7, 8, 1 << 40, 3).hex() == "53544154" + "0700000000000000" + "08000000" + "ffffffff" + "03"
