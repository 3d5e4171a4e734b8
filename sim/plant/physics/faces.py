"""Faces on their way through the printer: orders, what became of them, and what outlives a loss of power."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from sim.plant.physics.flaws import Flaw


class State(IntEnum):
    """How far an armed face has come."""

    QUEUED = 0
    PRINTING = 1
    PRINTED = 2
    MISSED = 3
    PARTIAL = 4
    CANCELLED = 5


class ArmAnswer(IntEnum):
    """What the printer says to an order to arm."""

    ACCEPTED = 0
    DUPLICATE = 1
    TOO_LATE = 2
    NOT_ABOVE = 3
    QUEUE_FULL = 4
    NOT_READY = 5
    BAD_GEOMETRY = 6
    UNKNOWN_DETECTION = 7


class StripAnswer(IntEnum):
    """What the printer says to a strip."""

    TAKEN = 0
    BAD_CRC = 1
    UNKNOWN_ARM = 2
    OUT_OF_ORDER = 3
    NO_CREDIT = 4


@dataclass(frozen=True)
class Order:
    """An order to arm a face."""

    arm_id: int
    face: int
    detect_seq: int
    start_encoder: int
    rows: int
    cols: int
    row_pitch_millicounts: int
    channels: int
    bits: int


@dataclass
class Armed:
    """A face that was accepted, and what became of it."""

    order: Order
    start_x: float
    pitch_mm: float
    ahead_mm: float
    margin_mm: float = math.inf
    state: State = State.QUEUED
    rows_printed: int = 0
    rows_received: int = 0
    crc32: int = 0
    nozzle_out: bool = False
    flaws: tuple[Flaw, ...] = ()
    data: bytearray | None = field(default=None, repr=False)
    digest: Any = field(default=None, repr=False)

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self.order.cols * self.order.channels * self.order.bits // 8

    @property
    def live(self) -> bool:
        """Whether rows can still come."""
        return self.state in (State.QUEUED, State.PRINTING)


@dataclass
class Seen:
    """A tile that the printer's eye saw."""

    detect_seq: int
    encoder: int
    length_counts: int = 0


@dataclass
class Memory:
    """What the printer remembers without power."""

    last_accepted: int = 0
    last_outcome: int = 0
    session: int = 0
    arms: OrderedDict[int, Armed] = field(default_factory=OrderedDict)
