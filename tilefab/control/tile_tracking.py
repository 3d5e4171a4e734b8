"""Which tile is which: two devices count the same eye and the same encoder, each from its own zero.

The printer latches a leading edge as (detect_seq, encoder), the conveyor as (tile_seq, position). Both zeros are lost
at every boot, so the two are matched anew whenever the belt stands still, and from then on each holds the other to
account: an edge that only one of them saw, or saw elsewhere, means that nobody knows which tile is which.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

_WORD = 1 << 32


@dataclass(frozen=True)
class Calibration:
    """How the counts of printer and conveyor belong together, found while the belt stood still.

    Attributes
    ----------
    printer_boot, plc_boot
        The boots for which it holds.
    seq_offset
        ``tile_seq - detect_seq`` modulo 2**32.
    position_offset_counts
        Conveyor's position less printer's encoder, modulo 2**32.
    detect_seq
        Last edge the printer had seen by then: tiles up to it were on the belt already.
    """

    printer_boot: int
    plc_boot: int
    seq_offset: int
    position_offset_counts: int
    detect_seq: int

    def tile_seq(self, detect_seq: int) -> int:
        """Number that the conveyor gave to the tile of an edge."""
        return (detect_seq + self.seq_offset) % _WORD

    def detect_seq_of(self, tile_seq: int) -> int:
        """Edge that the printer saw of a tile of the conveyor."""
        return (tile_seq - self.seq_offset) % _WORD


@dataclass(frozen=True)
class Standstill:
    """Counts of both devices, read while the belt stood still."""

    printer_boot: int
    encoder_counts: int
    detect_seq: int
    plc_boot: int
    position_counts: int
    tile_seq: int


def calibrate(still: Standstill) -> Calibration:
    """Match the counts of both devices.

    >>> calibrate(Standstill(1, 5000, 7, 2, 4400, 5)).tile_seq(8)
    6
    """
    return Calibration(
        printer_boot=still.printer_boot,
        plc_boot=still.plc_boot,
        seq_offset=(still.tile_seq - still.detect_seq) % _WORD,
        position_offset_counts=(still.position_counts - still.encoder_counts) % _WORD,
        detect_seq=still.detect_seq,
    )


@dataclass(frozen=True)
class TileShape:
    """What a tile on this belt looks like to the eye, in encoder counts."""

    length_counts: int
    pitch_counts: int

    def edge_problem(self, distance_counts: int) -> str:
        """What is wrong with the distance from the leading edge before, or nothing.

        Tiles may come late, never early: closer than a tile and half its gap, two are one on top of the other.
        """
        least = self.length_counts + (self.pitch_counts - self.length_counts) // 2
        if distance_counts < least:
            return f"two leading edges {distance_counts} counts apart, not {least}: tiles overlap, or dirt on the eye"
        return ""

    def length_problem(self, length_counts: int) -> str:
        """What is wrong with the length of a tile, or nothing: within 4 %, as a chipped corner or a slanted tile is."""
        slack = max(2, self.length_counts // 25)
        told = f"a tile {length_counts} counts long, {self.length_counts} wanted"
        if length_counts > self.length_counts + slack:
            return f"{told}: double feed, or the wrong size loaded"
        if length_counts < self.length_counts - slack:
            return f"{told}: broken, or the wrong size loaded"
        return ""


def cross_check(
    calibration: Calibration,
    edges: Mapping[int, int],
    tile_seq: int,
    tile_position_counts: int,
    tolerance_counts: int,
) -> str | None:
    """Compare the conveyor's latest edge with the printer's of the same tile.

    Parameters
    ----------
    calibration
        From the last standstill.
    edges
        Encoder counts of the edges that the printer saw, by detect_seq.
    tile_seq, tile_position_counts
        The conveyor's latest.
    tolerance_counts
        How far the two may be apart: their inputs are sampled, not latched at one instant.

    Returns
    -------
    str or None
        Empty if they agree, what is wrong if not, ``None`` if the printer hasn't told of that edge yet.
    """
    detect_seq = calibration.detect_seq_of(tile_seq)
    if detect_seq == calibration.detect_seq:
        return ""
    encoder = edges.get(detect_seq)
    if encoder is None:
        return None
    apart = (tile_position_counts - encoder - calibration.position_offset_counts + _WORD // 2) % _WORD - _WORD // 2
    if abs(apart) > tolerance_counts:
        return (
            f"printer and conveyor saw tile {tile_seq} {apart} counts apart (at most {tolerance_counts}): one of them "
            "missed a tile, or the encoder slips"
        )
    return ""


def print_start_counts(edge_counts: int, eye_to_head_counts: int, bleed_counts: int) -> int:
    """Encoder count at which the first row of a face is due: its bleed begins before the tile does."""
    return edge_counts + eye_to_head_counts - bleed_counts
