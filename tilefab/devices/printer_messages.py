"""The printer's messages: control (TFP 1, serial) and data (TCP), as tables that code and documents share."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from tilefab.devices.layouts import Field, Layout, Message

VERSION: Final = 1
REPLY_BIT: Final = 0x80
ERROR_TYPE: Final = 0xFF
INKS: Final = 8
FLAGS: Final = ("ready", "held", "e_stop", "ink_out", "nozzle_out", "deadman", "printing", "underrun")
ERRORS: Final = {1: "unknown type", 2: "bad length", 3: "stale session", 4: "not ready"}


class ArmStatus(IntEnum):
    """What became of an ARM."""

    ACCEPTED = 0
    DUPLICATE = 1
    TOO_LATE = 2
    NOT_ABOVE_LAST = 3
    QUEUE_FULL = 4
    HELD = 5
    BAD_GEOMETRY = 6
    UNKNOWN_TILE = 7


class DisarmStatus(IntEnum):
    """What became of a DISARM."""

    CANCELLED = 0
    TOO_LATE = 1
    UNKNOWN = 2


class OutcomeState(IntEnum):
    """How far the print of an arm came."""

    QUEUED = 0
    PRINTING = 1
    PRINTED = 2
    MISSED = 3
    PARTIAL = 4
    CANCELLED = 5


class ClearStatus(IntEnum):
    """What became of a CLEAR."""

    CLEARED = 0
    STALE_COUNTER = 1
    CAUSE_PERSISTS = 2


class StripCode(IntEnum):
    """What the printer thinks of the last strip."""

    OK = 0
    BAD_CRC = 1
    UNKNOWN_ARM = 2
    OUT_OF_ORDER = 3
    NO_CREDIT = 4


MEANINGS: Final[dict[type[IntEnum], tuple[str, ...]]] = {
    ArmStatus: (
        "accepted",
        "the same arm_id and content were accepted before; nothing was done",
        "the head is, or is nearly, there",
        "arm_id is not above the last accepted one, and no identical duplicate",
        "no room in the queue",
        "held or not ready",
        "rows, columns, channels or bits can't be printed",
        "no such detect_seq",
    ),
    DisarmStatus: (
        "its outcome is cancelled; no row was printed",
        "printing, or finished",
        "no such arm",
    ),
    OutcomeState: (
        "waits for its tile",
        "its first row may be on the tile",
        "all rows are on the tile",
        "no row was printed: no tile, no data, or held when it was due",
        "some rows were printed",
        "no row was printed",
    ),
    ClearStatus: (
        "no longer held; deadman and underrun are off, ink_out and nozzle_out if they are over",
        "there was a newer fault",
        "the cause persists",
    ),
    StripCode: (
        "taken",
        "its sum is wrong",
        "no such arm, or it has ended",
        "it doesn't begin at next_row",
        "there was no room for it",
    ),
}
"""What the codes of each kind mean, in their order."""

HELLO: Final = Message(
    0x01,
    "HELLO",
    "Opens a session. The printer remembers the highest session; requests of a lower one get error 3.",
    Layout((Field("version", "u8", "1"),)),
    Layout(
        (
            Field("version", "u8", "1"),
            Field("boot_id", "u32", "another at each start"),
            Field("inks", "u8", "channels"),
            Field("bits", "u8", "most bits a dot"),
            Field("counts_per_mm_x1000", "u32", "encoder counts to 1000 mm"),
            Field("eye_to_head_counts", "u32", "along the belt"),
            Field("min_lead_counts", "u32", "least distance from the head at which a tile can be armed"),
            Field("queue_len", "u8", "most arms that wait"),
            Field("buffer_bytes", "u32", "room for rows"),
        )
    ),
)
STATUS: Final = Message(
    0x02,
    "STATUS",
    "The state. Also the host's heartbeat: 500 ms without one, and the printer sets deadman and holds.",
    reply=Layout(
        (
            Field("boot_id", "u32", "another at each start"),
            Field("flags", "u16", "bits: " + ", ".join(f"{bit} {name}" for bit, name in enumerate(FLAGS))),
            Field("encoder", "u64", "counts since the start"),
            Field("detect_seq", "u32", "leading edges seen at the eye since the start"),
            Field("last_accepted_arm", "u64", "survives a loss of power"),
            Field("last_outcome_arm", "u64", "highest arm whose print has ended"),
            Field("queued", "u8", "arms that wait"),
            Field("buffer_free", "u32", "bytes"),
            Field("ink_permille", "u16", "of each ink, 0 to 1000", INKS),
            Field("fault_counter", "u16", "+ 1 for each fault"),
        )
    ),
)
DETECTIONS: Final = Message(
    0x03,
    "DETECTIONS",
    "Tiles seen at the eye, oldest first from from_seq on; the printer keeps the last 64.",
    Layout((Field("from_seq", "u32"),)),
    Layout((Field("count", "u8", "entries that follow, at most 8"),)),
    Layout(
        (
            Field("detect_seq", "u32", "1 is the first since the start"),
            Field("encoder", "u64", "at its leading edge"),
            Field("length_counts", "u32", "0 while it still covers the eye"),
        )
    ),
    8,
)
ARM: Final = Message(
    0x04,
    "ARM",
    "Print a face on a tile. Accepted at most once: see status.",
    Layout(
        (
            Field("arm_id", "u64", "above every one before"),
            Field("face", "u64", "its index, for people"),
            Field("detect_seq", "u32", "the tile"),
            Field("start_encoder", "u64", "when row 0 is under the head"),
            Field("rows", "u32", "along the travel"),
            Field("cols", "u32", "across"),
            Field("row_pitch_millicounts", "u32", "thousandths of a count from row to row"),
            Field("channels", "u8", "inks"),
            Field("bits", "u8", "a dot"),
        )
    ),
    Layout((Field("status", "u8", "see below"), Field("last_accepted_arm", "u64", "after this"))),
)
DISARM: Final = Message(
    0x05,
    "DISARM",
    "Cancel an arm that hasn't begun.",
    Layout((Field("arm_id", "u64"),)),
    Layout((Field("status", "u8", "see below"),)),
)
OUTCOMES: Final = Message(
    0x06,
    "OUTCOMES",
    "What became of arms, ascending from from_arm on; the printer keeps the last 64 accepted, without power too.",
    Layout((Field("from_arm", "u64"),)),
    Layout((Field("count", "u8", "entries that follow, at most 6"),)),
    Layout(
        (
            Field("arm_id", "u64"),
            Field("face", "u64"),
            Field("detect_seq", "u32"),
            Field("state", "u8", "see below"),
            Field("rows_printed", "u32"),
            Field("rows_received", "u32", "without a gap from row 0"),
            Field("data_crc32", "u32", "CRC-32 of the bytes of the rows received, in order"),
        )
    ),
    6,
)
HOLD: Final = Message(
    0x07,
    "HOLD",
    "Begin no further print; one that has begun is finished.",
    reply=Layout((Field("status", "u8", "0"),)),
)
CLEAR: Final = Message(
    0x08,
    "CLEAR",
    "End holding, if fault_counter is that of the last STATUS.",
    Layout((Field("fault_counter", "u16"),)),
    Layout((Field("status", "u8", "see below"),)),
)
MESSAGES: Final = (HELLO, STATUS, DETECTIONS, ARM, DISARM, OUTCOMES, HOLD, CLEAR)
ERROR: Final = Layout((Field("code", "u8", ", ".join(f"{code} {text}" for code, text in ERRORS.items())),))

DATA_HELLO_MAGIC: Final = b"TFD1"
STRIP_MAGIC: Final = b"STRP"
STAT_MAGIC: Final = b"STAT"
DATA_HELLO: Final = Layout((Field("session", "u32", "that of the control session"),))
STRIP: Final = Layout(
    (
        Field("arm_id", "u64"),
        Field("row", "u32", "first row of the strip"),
        Field("rows", "u32", "rows in the strip"),
        Field("nbytes", "u32", "bytes that follow"),
        Field("crc32", "u32", "CRC-32 of these bytes"),
    )
)
STAT: Final = Layout(
    (
        Field("arm_id", "u64"),
        Field("next_row", "u32", "row of this arm that the printer wants next"),
        Field("credit", "u32", "bytes that it can take now"),
        Field("code", "u8", "see below"),
    )
)
