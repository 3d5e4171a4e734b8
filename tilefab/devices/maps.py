"""The register maps of the conveyor's controller and of the kiln's."""

from __future__ import annotations

from typing import Final

from tilefab.devices.registers import Kind, Register, RegisterMap

_SEQ = Register(
    0,
    "seq",
    Kind.U16,
    "written with each poll, so that the answer shows which poll it answers; a "
    "changing value is also the host's heartbeat",
    writable=True,
)
_SCAN = Register(1, "scan_counter", Kind.U16, "+ 1 at each scan of the controller (10 ms), wraps")
_BOOT = Register(2, "boot_id", Kind.U16, "another at each start of the controller, never 0")
_CMD_SEQ = Register(
    32,
    "cmd_seq",
    Kind.U16,
    "the block is acted on when this is newer than the last acted on: "
    "(new - last) mod 65536 from 1 to 32767, or any value after a start",
    writable=True,
)
_CMD_ACK_MEANING = "cmd_seq of the last command block acted on"


def _check(address: int) -> Register:
    return Register(
        address,
        "check",
        Kind.U32,
        f"CRC-32 (as of zlib; 0xFFFFFFFF in place of 0) of registers 0 to {address - 1} as they stand in this answer, "
        "high byte first; 0 from a controller that makes none. Without it nothing but TCP's own sums protects a poll "
        "over TCP",
    )


PLC_MAP: Final = RegisterMap(
    device="conveyor",
    unit=1,
    window=64,
    registers=(
        _SEQ,
        _SCAN,
        _BOOT,
        Register(3, "word_order_probe", Kind.U32, "shows the order of words", constant=0x01020304),
        Register(
            5,
            "flags",
            Kind.U16,
            "e_stop, jam, deadman_tripped, double_feed, diverter_fault stay until acknowledged and their cause is gone",
            bits=(
                "belt_running",
                "e_stop",
                "jam",
                "deadman_tripped",
                "double_feed",
                "feed_enabled",
                "ready",
                "diverter_fault",
                "kiln_full",
            ),
        ),
        Register(6, "belt_speed", Kind.U16, "of the belt now", unit="mm/s", per_unit=10),
        Register(7, "position", Kind.U32, "of the belt since the start, wraps", unit="counts"),
        Register(9, "tile_seq", Kind.U32, "last tile seen at the eye; the first is 1, 0 before it"),
        Register(11, "tile_position", Kind.U32, "position at the leading edge of that tile", unit="counts"),
        Register(13, "decided_seq", Kind.U32, "last tile decided at the diverter"),
        Register(15, "passed_bits", Kind.U64, "bit i: tile decided_seq - i passed (1) or was diverted (0)"),
        Register(19, "cmd_ack", Kind.U16, _CMD_ACK_MEANING),
        Register(20, "fault_counter", Kind.U16, "+ 1 for each newly latched fault"),
        Register(21, "tiles_fed", Kind.U32, "by the loader since the start"),
        _CMD_SEQ,
        Register(33, "run", Kind.U16, "what shall run", writable=True, low=0, high=3, bits=("run_belt", "run_feed")),
        Register(34, "speed_set", Kind.U16, "of the belt", True, "mm/s", 10, 0, 30000),
        Register(35, "tile_length_set", Kind.U16, "along the travel", True, "mm", 10, 500, 30000),
        Register(36, "tile_pitch_set", Kind.U16, "from one leading edge to the next", True, "mm", 10, 600, 40000),
        Register(37, "release_base", Kind.U32, "first tile of release_bits", writable=True),
        Register(39, "release_bits", Kind.U32, "bit i: tile release_base + i may pass; releases add up", writable=True),
        Register(41, "ack_fault", Kind.U16, "the fault_counter that the operator acknowledges", writable=True),
        _check(62),
    ),
    command=("cmd_seq", "ack_fault"),
    check_address=62,
)

KILN_MAP: Final = RegisterMap(
    device="kiln",
    unit=2,
    window=80,
    registers=(
        _SEQ,
        _SCAN,
        _BOOT,
        Register(3, "word_order_probe", Kind.F32, "shows the order of words", constant=1234.5),
        Register(
            5,
            "flags",
            Kind.U16,
            "state of the kiln",
            bits=("heating", "burner_fault", "over_temp", "at_set_point", "blocked"),
        ),
        Register(6, "tiles_inside", Kind.U16, "tiles in the kiln"),
        Register(7, "cycle_time", Kind.U16, "expected time from entry to exit", unit="min", per_unit=10),
        Register(8, "zone_count", Kind.U16, "zones of the kiln", constant=8),
        Register(10, "temperature", Kind.F32, "of each zone", unit="°C", count=8),
        Register(26, "cmd_ack", Kind.U16, _CMD_ACK_MEANING),
        _CMD_SEQ,
        Register(34, "set_point", Kind.F32, "of each zone", True, "°C", low=20, high=1250, count=8),
        Register(50, "ramp_limit", Kind.F32, "fastest change of a zone", True, "°C/min", low=0.1, high=15),
        Register(52, "cycle_set", Kind.U16, "wanted time from entry to exit", True, "min", 10, 350, 750),
        _check(78),
    ),
    command=("cmd_seq", "cycle_set"),
    check_address=78,
)
