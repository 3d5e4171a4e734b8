"""Answers that are wrong on purpose are wrong in just the way that was asked for; and the gauge's lines."""

from __future__ import annotations

import random
import re
from zlib import crc32

import pytest

from sim.plant.checks import crc16
from sim.plant.network.faults import FORGED_KINDS, MESSAGE_KINDS, Fault, Link, Plan, answer_through
from sim.plant.physics.gauge import Gauge
from sim.plant.wire import gauge_lines, tfp
from sim.plant.wire.forge import garbled, with_wrong
from sim.plant.wire.modbus import rtu_frame, tcp_frame

BODY = bytes.fromhex("17 08 0001 0002 0003 0004")
CHANCE = random.Random(1)
TCP = tcp_frame(0x1234, 1, BODY)
RTU = rtu_frame(1, BODY)
TFP = tfp.frame(5, 6, 0x82, b"\1\2\3")


@pytest.mark.parametrize(
    ("kind", "frame"),
    [
        ("old_tid", "1233 0000 000b 01 17 08 0001 0002 0003 0004"),
        ("wrong_unit", "1234 0000 000b 02 17 08 0001 0002 0003 0004"),
        ("wrong_function", "1234 0000 000b 01 03 08 0001 0002 0003 0004"),
        ("wrong_count", "1234 0000 0009 01 17 06 0001 0002 0003"),
    ],
)
def test_wrong_tcp_answers(kind, frame):
    assert with_wrong("tcp", TCP, kind, CHANCE) == bytes.fromhex(frame)


@pytest.mark.parametrize("kind", ["wrong_unit", "wrong_function", "wrong_count"])
def test_wrong_rtu_answers_have_the_right_checksum(kind):
    wrong = with_wrong("rtu", RTU, kind, CHANCE)
    assert wrong != RTU
    assert crc16(wrong[:-2]).to_bytes(2, "little") == wrong[-2:]


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("old_tid", tfp.Message(5, 5, 0x82, b"\1\2\3")),
        ("wrong_unit", tfp.Message(4, 6, 0x82, b"\1\2\3")),
        ("wrong_function", tfp.Message(5, 6, 0x83, b"\1\2\3")),
        ("wrong_count", tfp.Message(5, 6, 0x82, b"\1\2")),
    ],
)
def test_wrong_printer_answers_have_the_right_checksum(kind, message):
    wrong = with_wrong("tfp", TFP, kind, CHANCE)
    assert wrong[-1] == 0
    assert tfp.parse(wrong[:-1]) == message


def test_a_wrong_count_of_an_empty_answer_is_too_long():
    wrong = with_wrong("tfp", tfp.frame(1, 1, 0x87, b""), "wrong_count", CHANCE)
    assert tfp.parse(wrong[:-1]) == tfp.Message(1, 1, 0x87, b"\0")


def gauge_line(text):
    return f"!{text}*{crc32(text.encode()):08x}\n".encode()


@pytest.mark.parametrize(
    ("kind", "text"), [("old_tid", "8 1 62.00 1"), ("wrong_count", "9 1 62.00"), ("wrong_function", "9 Z 62.00 1")]
)
def test_wrong_lines_have_the_right_checksum(kind, text):
    assert with_wrong("ascii", gauge_line("9 1 62.00 1"), kind, CHANCE) == gauge_line(text)


@pytest.mark.parametrize(("form", "frame"), [("tcp", TCP), ("rtu", RTU), ("tfp", TFP), ("tfd", b"STAT" + bytes(17))])
def test_garbled_answers_differ_in_one_to_three_bits(form, frame):
    chance = random.Random(3)
    for _ in range(200):
        wrong = garbled(form, frame, chance)
        assert 1 <= sum((a ^ b).bit_count() for a, b in zip(frame, wrong, strict=True)) <= 3
        if form == "tcp":
            assert wrong[9:] == frame[9:]
        if form == "tfd":
            assert wrong[4:] == frame[4:]


def test_anywhere_is_anywhere():
    chance = random.Random(3)
    assert any(garbled("tcp", TCP, chance, anywhere=True)[9:] != TCP[9:] for _ in range(20))


def answered(form, frame, kinds, seed=1):
    """What is sent under faults that strike together."""
    sent = []
    link = Link(sent.append, lambda: None, lambda _delay, call: call(), form)
    answer_through(Plan(tuple(Fault("plc", kind, random.Random(seed)) for kind in kinds)), link, lambda: frame)
    return sent


FRAMES = {"tcp": TCP, "rtu": RTU, "tfp": TFP, "ascii": gauge_line("9 E 1"), "tfd": b"STAT" + bytes(17)}


@pytest.mark.parametrize("form", FRAMES)
def test_any_faults_may_strike_the_same_message(form):
    chance = random.Random(form)
    kinds = sorted(MESSAGE_KINDS)
    for seed in range(500):
        answered(form, FRAMES[form], chance.choices(kinds, k=chance.randint(2, 5)), seed)


@pytest.mark.parametrize("kind", sorted(FORGED_KINDS))
def test_a_wrong_content_is_made_before_any_damage_and_once(kind):
    (alone,) = answered("tcp", TCP, [kind])
    assert answered("tcp", TCP, [kind, kind]) == [alone]
    (cut,) = answered("tcp", TCP, ["truncate", kind])
    assert alone.startswith(cut)
    assert len(cut) < len(alone)


def test_the_gauge_answers_in_lines():
    gauge = Gauge(1)
    assert gauge_lines.answer(gauge, b"?12 M") == gauge_line("12 E 2")
    gauge.see(1, [1180] * 8)
    line = gauge_lines.answer(gauge, b"?13 M\r")
    assert line is not None
    match = re.fullmatch(rb"!(13 1 \d+\.\d\d \d+\.\d\d \d+\.\d\d 1)\*([0-9a-f]{8})\n", line)
    assert match is not None
    assert int(match[2], 16) == crc32(match[1])
    assert len(line) <= gauge_lines.MOST_LINE
    assert gauge_lines.answer(gauge, b"?14 X") == gauge_line("14 E 1")
    assert gauge_lines.answer(gauge, b"hello") is None
    assert gauge_lines.answer(gauge, b"\xff?1 M") is None
