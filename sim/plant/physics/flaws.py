"""What a print head can do wrong without noticing, and prints that are kept so that they can be looked at."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

FlawKind = Literal["nozzle", "banding", "double_print"]


@dataclass(frozen=True)
class Flaw:
    """Something wrong with a print.

    Attributes
    ----------
    kind
        `nozzle`: an ink's column stays white. `banding`: rows are stronger and weaker in turn. `double_print`: the
        same is laid down a second time, further down.
    ink
        Which ink a nozzle lacks.
    at_mm, width_mm
        How far to the right of the print's middle, seen with its first row above, the column lies that a nozzle
        leaves, and how wide it is, at least one column.
    from_row
        First row that a nozzle left out.
    strength
        How much stronger the strongest row is, or of the second print; share.
    period_mm
        From one strong row to the next.
    shift_mm
        How much further down the second print lies.
    """

    kind: FlawKind
    ink: int = 0
    at_mm: float = 0.0
    width_mm: float = 0.0
    from_row: int = 0
    strength: float = 0.0
    period_mm: float = 0.0
    shift_mm: float = 0.0

    def view(self) -> dict[str, Any]:
        """Its facts, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class KeptPrint:
    """The rows that were put down, as they were received: row after row, column after column, ink after ink.

    Attributes
    ----------
    data
        The rows.
    cols, channels, bits
        Their layout; 16 bits are little-endian.
    pitch_mm
        From row to row, and from column to column.
    """

    data: bytes = field(repr=False)
    cols: int
    channels: int
    bits: int
    pitch_mm: float


class Shelf:
    """Where prints are kept until their tile has left the plant; it has room for so many bytes.

    Parameters
    ----------
    room
        Bytes; 0 if nothing is kept.
    """

    def __init__(self, room: int) -> None:
        self.room = room
        self.used = 0

    def put(self, kept: KeptPrint) -> KeptPrint | None:
        """Keep a print; None if there is no room for it."""
        if self.used + len(kept.data) > self.room:
            return None
        self.used += len(kept.data)
        return kept

    def take(self, kept: KeptPrint | None) -> None:
        """A print isn't kept any longer."""
        if kept is not None:
            self.used -= len(kept.data)
