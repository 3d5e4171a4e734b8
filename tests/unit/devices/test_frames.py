"""Frames of the printer's control protocol."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.devices import peers
from tilefab.devices.frames import MOST_BODY, Frame, FrameReader, cobs_decode, cobs_encode, decode_frame, encode_frame

PAYLOADS = st.binary(max_size=MOST_BODY - 11)


@pytest.mark.parametrize(
    ("data", "wanted"),
    [
        (b"", "01"),
        (b"\0", "0101"),
        (b"\0\0", "010101"),
        (b"\x11\x22\0\x33", "0311220233"),
        (b"\x11\0\0\0", "0211010101"),
        (bytes(range(1, 255)), "ff" + bytes(range(1, 255)).hex() + "01"),
        (bytes(256), "01" * 257),
    ],
)
def test_known_codes(data, wanted):
    assert cobs_encode(data).hex() == wanted
    assert cobs_decode(bytes.fromhex(wanted)) == data


@given(st.binary(max_size=600) | st.lists(st.sampled_from([b"\0", b"\1", b"\1" * 253, b"\1" * 254])).map(b"".join))
def test_codes_have_no_zero_and_read_back(data):
    code = cobs_encode(data)
    assert 0 not in code
    assert cobs_decode(code) == data
    assert cobs_decode(peers.stuffed(data)) == data


@pytest.mark.parametrize("code", [b"\0", b"\3\1", b"\2\0", b"\5\1\1\1"])
def test_what_nothing_has_as_its_code_is_refused(code):
    with pytest.raises(ValueError, match="code"):
        cobs_decode(code)


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**16 - 1), st.integers(0, 255), PAYLOADS)
def test_frames_are_as_the_printer_makes_them(session, seq, kind, payload):
    frame = Frame(session, seq, kind, payload)
    wire = encode_frame(frame)
    assert wire == peers.tfp_frame(session, seq, kind, payload)
    assert decode_frame(wire[:-1]) == frame


def test_a_body_has_at_most_250_bytes():
    assert len(encode_frame(Frame(1, 2, 3, bytes(239)))) == 252
    with pytest.raises(ValueError, match="250"):
        encode_frame(Frame(1, 2, 3, bytes(240)))


@given(PAYLOADS, st.data())
def test_a_changed_byte_makes_it_no_frame(payload, data):
    wire = bytearray(encode_frame(Frame(1, 2, 3, payload)))[:-1]
    place = data.draw(st.integers(0, len(wire) - 1))
    wire[place] ^= data.draw(st.integers(1, 255))
    assert decode_frame(bytes(wire)) is None


@given(st.lists(PAYLOADS, max_size=4), st.data())
def test_frames_are_found_however_the_wire_cuts_them(payloads, data):
    frames = [Frame(1, number, 3, payload) for number, payload in enumerate(payloads)]
    noise = data.draw(st.lists(st.binary(min_size=1, max_size=300).map(lambda b: b + b"\0"), max_size=2))
    wire = b"".join([*noise, *(encode_frame(frame) for frame in frames)])
    reader, found, place = FrameReader(), [], 0
    while place < len(wire):
        size = data.draw(st.integers(1, len(wire)))
        found += reader.feed(wire[place : place + size])
        place += size
    assert found == frames


def test_a_babbling_line_takes_no_memory_and_its_end_is_no_frame():
    reader = FrameReader()
    for _ in range(1000):
        assert reader.feed(b"\x55" * 1000) == []
    assert len(reader._rest) < 300
    wire = encode_frame(Frame(1, 2, 3, b"x"))
    assert reader.feed(wire) == [], "it is the end of the babble"
    assert reader.feed(wire) == [Frame(1, 2, 3, b"x")]
