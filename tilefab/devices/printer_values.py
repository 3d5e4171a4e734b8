"""What the printer tells and is told, in the units of the line."""

from __future__ import annotations

from dataclasses import dataclass

from tilefab.devices.printer_messages import ArmStatus, OutcomeState


@dataclass(frozen=True)
class PrinterIdentity:
    """What a printer is.

    Attributes
    ----------
    version
        Of the protocol.
    boot_id
        Another at each start.
    inks, bits
        Channels, and most bits a dot.
    counts_per_mm
        Encoder counts to a millimetre of travel.
    eye_to_head_counts, min_lead_counts
        Along the belt; and how far before the head a tile must be armed at the latest.
    queue_len
        Most arms that wait.
    buffer_bytes
        Room for rows.
    """

    version: int
    boot_id: int
    inks: int
    bits: int
    counts_per_mm: float
    eye_to_head_counts: int
    min_lead_counts: int
    queue_len: int
    buffer_bytes: int


@dataclass(frozen=True)
class PrinterStatus:
    """What a printer shows at one moment.

    Attributes
    ----------
    boot_id
        Another at each start.
    ready, held, e_stop, ink_out, nozzle_out, deadman, printing, underrun
        Its flags.
    encoder_counts, detect_seq
        Travel, and tiles seen at the eye, since its start.
    last_accepted_arm, last_outcome_arm
        Highest arm accepted, and highest whose print has ended; both survive a loss of power.
    queued
        Arms that wait.
    buffer_free
        Bytes.
    ink_frac
        Of each ink, 0 .. 1.
    fault_counter
        Faults so far.
    """

    boot_id: int
    ready: bool
    held: bool
    e_stop: bool
    ink_out: bool
    nozzle_out: bool
    deadman: bool
    printing: bool
    underrun: bool
    encoder_counts: int
    detect_seq: int
    last_accepted_arm: int
    last_outcome_arm: int
    queued: int
    buffer_free: int
    ink_frac: tuple[float, ...]
    fault_counter: int


@dataclass(frozen=True)
class Detection:
    """A tile at the eye: its number, counts at its leading edge, and its length, 0 while it covers the eye."""

    detect_seq: int
    encoder_counts: int
    length_counts: int


@dataclass(frozen=True)
class ArmCommand:
    """A face for a tile.

    Attributes
    ----------
    arm_id
        Above every one before; 64 bits.
    face
        Its index.
    detect_seq
        The tile.
    start_encoder
        Counts when row 0 is under the head.
    rows, cols
        Of the face, rows along the travel.
    row_pitch_millicounts
        Thousandths of a count from row to row.
    channels, bits
        Inks, and bits a dot.
    """

    arm_id: int
    face: int
    detect_seq: int
    start_encoder: int
    rows: int
    cols: int
    row_pitch_millicounts: int
    channels: int
    bits: int


@dataclass(frozen=True)
class ArmReply:
    """What became of an arm command."""

    status: ArmStatus
    last_accepted_arm: int


@dataclass(frozen=True)
class Outcome:
    """What became of an accepted arm.

    Attributes
    ----------
    arm_id, face, detect_seq
        As it was armed.
    state
        How far it came.
    rows_printed, rows_received
        So far; received counts from row 0 without a gap.
    data_crc32
        CRC-32 of the bytes of the rows received.
    """

    arm_id: int
    face: int
    detect_seq: int
    state: OutcomeState
    rows_printed: int
    rows_received: int
    data_crc32: int
