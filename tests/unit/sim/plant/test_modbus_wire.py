"""Requests and answers of Modbus, byte by byte, over TCP and RTU."""

from __future__ import annotations

import pytest

from sim.plant.checks import crc16
from sim.plant.wire.modbus import answer, rtu_frame, rtu_length, rtu_request, tcp_answer
from sim.plant.wire.window import PlcWindow
from tests.unit.sim.plant.physics_bench import Bench


@pytest.fixture
def window():
    return PlcWindow(Bench().conveyor)


def raw(text):
    return bytes.fromhex(text)


def framed(text):
    data = raw(text)
    return data + crc16(data).to_bytes(2, "little")


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        ("03 0003 0002", "03 04 01020304"),
        ("06 0022 1388", "06 0022 1388"),
        ("10 0021 0002 04 0001 03e8", "10 0021 0002"),
        ("17 0000 0001 0000 0001 02 abcd", "17 02 abcd"),
        ("17 0003 0002 0000 0001 02 0001", "17 04 01020304"),
        ("03 0040 0001", "83 02"),
        ("03 0000 0000", "83 03"),
        ("03 0000", "83 03"),
        ("03 0000 0001 00", "83 03"),
        ("06 0001 0001", "86 02"),
        ("06 0021 0004", "86 03"),
        ("10 0021 0002 04 0001", "90 03"),
        ("10 0021 0002 02 0001", "90 03"),
        ("10 0021 0000 00", "90 03"),
        ("10 0021", "90 03"),
        ("17 0000 0041 0000 0001 02 0005", "97 02"),
        ("17 0000 0001 0001 0001 02 0005", "97 02"),
        ("17 0000 0001 0000 0001", "97 03"),
        ("04 0000 0001", "84 01"),
        ("2b 0e 01 00", "ab 01"),
    ],
)
def test_requests_and_answers(window, request_, reply):
    assert answer(window, raw(request_)) == raw(reply)


def test_a_refused_read_and_write_has_written_nothing(window):
    answer(window, raw("17 0000 0041 0000 0001 02 0005"))
    assert window.read(0, 1) == [0]


def test_tcp_frames_carry_number_and_unit(window):
    assert tcp_answer(window, raw("1234 0000 0006 01 03 0003 0002")) == raw("1234 0000 0007 01 03 04 01020304")
    assert tcp_answer(window, raw("0001 0000 0006 07 03 0003 0002")) == raw("0001 0000 0003 07 83 0b")


def test_rtu_frames_carry_unit_and_checksum():
    assert rtu_request(1, framed("01 03 0003 0002")) == raw("03 0003 0002")
    assert rtu_frame(1, raw("03 04 01020304")) == framed("01 03 04 01020304")


@pytest.mark.parametrize(
    "frame", [framed("02 03 0003 0002"), framed("00 06 0022 0001"), raw("01030003000200"), b"\x01", b""]
)
def test_a_slave_is_silent_about_what_is_not_for_it_or_damaged(frame):
    assert rtu_request(1, frame) is None


@pytest.mark.parametrize(
    ("data", "length"),
    [
        ("01", None),
        ("01 03 00", 8),
        ("01 06", 8),
        ("01 10 0021 0002", None),
        ("01 10 0021 0002 04", 13),
        ("01 17 0000 0001 0000 0001 02", 15),
        ("01 17 0000 0001", None),
        ("01 2b", 0),
    ],
)
def test_lengths_of_requests_are_known_from_their_beginnings(data, length):
    assert rtu_length(raw(data)) == length
