"""Register maps: they say what the contract with the controllers says, and values survive the way through words."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.devices.maps import KILN_MAP, PLC_MAP
from tilefab.devices.registers import ContentError, Kind, Register, RegisterMap

PLC_PLACES = {
    "seq": (0, 1),
    "scan_counter": (1, 1),
    "boot_id": (2, 1),
    "word_order_probe": (3, 2),
    "flags": (5, 1),
    "belt_speed": (6, 1),
    "position": (7, 2),
    "tile_seq": (9, 2),
    "tile_position": (11, 2),
    "decided_seq": (13, 2),
    "passed_bits": (15, 4),
    "cmd_ack": (19, 1),
    "fault_counter": (20, 1),
    "tiles_fed": (21, 2),
    "cmd_seq": (32, 1),
    "run": (33, 1),
    "speed_set": (34, 1),
    "tile_length_set": (35, 1),
    "tile_pitch_set": (36, 1),
    "release_base": (37, 2),
    "release_bits": (39, 2),
    "ack_fault": (41, 1),
    "check": (62, 2),
}
KILN_PLACES = {
    "seq": (0, 1),
    "scan_counter": (1, 1),
    "boot_id": (2, 1),
    "word_order_probe": (3, 2),
    "flags": (5, 1),
    "tiles_inside": (6, 1),
    "cycle_time": (7, 1),
    "zone_count": (8, 1),
    "temperature": (10, 16),
    "cmd_ack": (26, 1),
    "cmd_seq": (32, 1),
    "set_point": (34, 16),
    "ramp_limit": (50, 2),
    "cycle_set": (52, 1),
    "check": (78, 2),
}


@pytest.mark.parametrize(("registers", "places"), [(PLC_MAP, PLC_PLACES), (KILN_MAP, KILN_PLACES)])
def test_registers_stand_where_the_controllers_have_them(registers, places):
    assert {one.name: (one.address, one.words) for one in registers.registers} == places


@pytest.mark.parametrize("registers", [PLC_MAP, KILN_MAP])
def test_registers_are_in_order_and_dont_overlap(registers):
    taken = [address for one in registers.registers for address in range(one.address, one.address + one.words)]
    assert taken == sorted(set(taken))
    assert taken[-1] < registers.window <= 125


def words_of(registers: RegisterMap) -> list[int]:
    """A window that shows constants and nothing else."""
    words = [0] * registers.window
    for one in registers.registers:
        if one.constant is not None:
            data = struct.pack(">" + one.kind.value, one.constant)
            words[one.address : one.address + one.words] = struct.unpack(f">{one.words}H", data)
    return words


def test_a_window_becomes_values():
    words = words_of(PLC_MAP)
    words[5] = 0b100000110
    words[6] = 2503
    words[7:9] = 1, 2
    words[15:19] = 1, 2, 3, 4
    values = PLC_MAP.decode(words)
    assert (values["e_stop"], values["jam"], values["kiln_full"], values["belt_running"]) == (1, 1, 1, 0)
    assert values["belt_speed"] == 250.3
    assert values["position"] == 65538
    assert values["passed_bits"] == 0x0001_0002_0003_0004


def test_floats_of_the_kiln():
    words = words_of(KILN_MAP)
    words[10:26] = struct.unpack(">16H", struct.pack(">8f", *(800.5 + i for i in range(8))))
    assert KILN_MAP.decode(words)["temperature"] == tuple(800.5 + i for i in range(8))


def test_the_low_word_may_come_first():
    low = replace(PLC_MAP, word_order="low")
    words = words_of(PLC_MAP)
    words[3:5] = words[4], words[3]
    words[7:9] = 2, 1
    words[15:19] = 4, 3, 2, 1
    values = low.decode(words)
    assert (values["position"], values["passed_bits"]) == (65538, 0x0001_0002_0003_0004)


@pytest.mark.parametrize("registers", [PLC_MAP, KILN_MAP])
def test_swapped_words_are_told_as_such(registers):
    words = words_of(registers)
    words[3], words[4] = words[4], words[3]
    with pytest.raises(ContentError, match=r"other order.* high word first"):
        registers.decode(words)


@pytest.mark.parametrize(
    ("place", "word", "reason"),
    [
        (3, 0x0103, "doesn't read 16909060"),
        (5, 0x0200, "bits that mean nothing"),
        (23, 1, "register 23, which is not in use, reads 1"),
        (61, 7, "register 61"),
    ],
)
def test_what_no_conveyor_shows_is_refused(place, word, reason):
    words = words_of(PLC_MAP)
    words[place] = word
    with pytest.raises(ContentError, match=reason):
        PLC_MAP.decode(words)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_temperature_that_is_no_number_is_refused(value):
    words = words_of(KILN_MAP)
    words[12:14] = struct.unpack(">2H", struct.pack(">f", value))
    with pytest.raises(ContentError, match="temperature"):
        KILN_MAP.decode(words)


def test_the_sum_covers_every_register_before_it():
    words = words_of(PLC_MAP)
    for place in range(62):
        changed = list(words)
        changed[place] ^= 1
        assert PLC_MAP.check_words(changed)[1] != PLC_MAP.check_words(words)[1]
    assert PLC_MAP.check_words(words)[1] == zlib.crc32(b"".join(word.to_bytes(2, "big") for word in words[:62]))


BELT = {
    "cmd_seq": 9,
    "run": 3,
    "speed_set": 250.3,
    "tile_length_set": 600,
    "tile_pitch_set": 4000,
    "release_base": 70000,
    "release_bits": 0x80000001,
    "ack_fault": 65535,
}


def test_a_command_of_the_conveyor_is_one_write():
    (write,) = PLC_MAP.encode_command(BELT)
    assert write.address == 32
    assert write.words == (9, 3, 2503, 6000, 40000, 1, 4464, 0x8000, 1, 65535)


def test_a_command_of_the_kiln_leaves_the_gap_out_and_gives_its_number_last():
    values = {"cmd_seq": 9, "set_point": [1000.5] * 8, "ramp_limit": 0.1, "cycle_set": 61.2}
    settings, number = KILN_MAP.encode_command(values)
    assert (number.address, number.words) == (32, (9,))
    assert settings.address == 34
    assert settings.words[-1] == 612
    assert struct.pack(">19H", *settings.words)[:4] == struct.pack(">f", 1000.5)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("run", 4),
        ("speed_set", -0.1),
        ("speed_set", 3000.1),
        ("tile_length_set", 49.9),
        ("tile_pitch_set", 4000.1),
        ("release_base", 1 << 32),
        ("release_bits", -1),
        ("ack_fault", 65536),
        ("speed_set", math.nan),
        ("speed_set", math.inf),
    ],
)
def test_values_outside_their_limits_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        PLC_MAP.encode_command({**BELT, name: value})


@pytest.mark.parametrize("zones", [[1000.0] * 7, [1000.0] * 7 + [1250.1], [19.9] + [1000.0] * 7])
def test_set_points_are_eight_and_within_limits(zones):
    with pytest.raises(ValueError, match="set_point"):
        KILN_MAP.encode_command({"cmd_seq": 1, "set_point": zones, "ramp_limit": 5, "cycle_set": 50})


@given(st.data())
def test_what_is_written_reads_back(data):
    kind = data.draw(st.sampled_from([Kind.U16, Kind.U32, Kind.U64]))
    order = data.draw(st.sampled_from(["high", "low"]))
    value = data.draw(st.integers(0, 256 ** (2 * kind.words) - 1))
    registers = RegisterMap(
        "any", 1, 8, (Register(2, "value", kind, "", writable=True),), ("value", "value"), 6, word_order=order
    )
    (write,) = registers.encode_command({"value": value})
    words = [0, 0, *write.words, *[0] * (6 - len(write.words))]
    assert registers.decode(words)["value"] == value


@given(st.integers(0, 30000))
def test_every_tenth_survives(tenths):
    (write,) = PLC_MAP.encode_command({**BELT, "speed_set": tenths / 10})
    assert write.words[2] == tenths
