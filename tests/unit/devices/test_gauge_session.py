"""The gauge's lines."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.devices import peers
from tilefab.devices import GaugeReading, GaugeSession
from tilefab.devices.gauge import parse_reply
from tilefab.errors import DeviceProtocolError, DeviceRefused, DeviceTimeout


def measured(gauge: peers.Gauge, times: int = 1, deadline_s: float = 0.2) -> list[GaugeReading]:
    async def run() -> list[GaugeReading]:
        async with peers.serial_port(gauge) as pair:
            session = GaugeSession(f"serial://{pair.path}?baud=9600", deadline_s=deadline_s)
            await session.connect()
            try:
                return [await session.measure() for _ in range(times)]
            finally:
                await session.close()

    return asyncio.run(run())


def test_a_reading():
    gauge = peers.Gauge("5 61.25 -0.5 12 40")
    assert measured(gauge, 2) == [GaugeReading(5, (61.25, -0.5, 12.0), 40)] * 2
    numbers = [int(line[1:].split()[0]) for line in gauge.requests]
    assert gauge.requests[0] == f"?{numbers[0]} M".encode()
    assert numbers[1] == numbers[0] % 65535 + 1


def test_an_error_is_a_refusal_with_its_code():
    with pytest.raises(DeviceRefused, match="error 7") as caught:
        measured(peers.Gauge("E 7"))
    assert caught.value.code == 7


@pytest.mark.parametrize(
    "text",
    [
        "E",
        "E x",
        "E 1 2",
        "5 61.25 -0.5 12",
        "5 61.25 -0.5 12 40 1",
        "-5 61.25 -0.5 12 40",
        "5 nan 0 0 40",
        "5 6e1 0 0 40",
        "5 101 0 0 40",
        "5 -1 0 0 40",
        "5 50 199 199 40",
        "5  50 0 0 40",
    ],
)
def test_a_line_with_a_right_sum_that_makes_no_sense_is_not_used(text):
    with pytest.raises(DeviceProtocolError):
        measured(peers.Gauge(text))


def test_other_lines_are_dropped():
    def script(line: bytes, send: peers.Send) -> None:
        number = int(line[1:].split()[0])
        send(b"\xff\n" + peers.gauge_line(str(number - 1), "1 1 1 1 1") + peers.gauge_line(f"0{number}", "2 2 2 2 2"))
        send(line[:-3] + b"0\n" + b"!" * 500 + b"noise" + line[:8])
        asyncio.get_running_loop().call_later(0.002, send, line[8:])

    gauge = peers.Gauge("5 61.25 -0.5 12 40", script=script)
    assert measured(gauge)[0].readings == 5


def test_silence_is_a_timeout():
    with pytest.raises(DeviceTimeout, match="didn't answer in time"):
        measured(peers.Gauge(script=peers.mute), deadline_s=0.02)


def test_two_at_once_take_turns_within_their_deadline():
    async def run() -> None:
        async with peers.serial_port(peers.Gauge(script=peers.mute)) as pair:
            session = GaugeSession(f"serial://{pair.path}?baud=9600", deadline_s=0.03)
            await session.connect()
            ends = await asyncio.gather(session.measure(), session.measure(), return_exceptions=True)
            assert [type(end) for end in ends] == [DeviceTimeout] * 2
            assert "busy" in str(ends[1])
            await session.close()

    asyncio.run(run())


@given(st.integers(1, 65535), st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="*")))
def test_sound_lines_are_read(number, word):
    line = peers.gauge_line(str(number), f"5 {word}")[:-1]
    assert parse_reply(line, number) == (("5", word) if len(line) < 120 else None)
    assert parse_reply(line, number + 1) is None


@given(st.binary(max_size=150))
def test_what_isnt_a_line_is_none(data):
    assert parse_reply(data, 5) is None


@given(st.data())
def test_a_changed_byte_makes_it_no_line(data):
    line = bytearray(peers.gauge_line("5", "5 61.25 -0.5 12 40")[:-1])
    place = data.draw(st.integers(0, len(line) - 1))
    line[place] ^= data.draw(st.integers(1, 255))
    found = parse_reply(bytes(line), 5)
    # A digit of the sum may be written in capitals.
    assert found is None or bytes(line).lower() == peers.gauge_line("5", "5 61.25 -0.5 12 40")[:-1].lower()
