"""Tiles, and what the plant knows of them: the truth that a test holds the product against."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections import Counter, OrderedDict, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from sim.plant.physics.firing import Fired, Laid
from sim.plant.physics.flaws import Flaw, KeptPrint

Fate = Literal["on_belt", "passed", "diverted", "in_kiln", "fired", "broken", "removed"]
FINAL: frozenset[Fate] = frozenset({"diverted", "fired", "broken", "removed"})
_MOST_NAMED = 1000


@dataclass
class Print:
    """Rows that the head has put down one after another, wherever they landed.

    Attributes
    ----------
    offset_mm
        From the tile's leading edge to the first row, along the travel; None beside tiles.
    centre_mm
        From the tile's centre to the centre of the rows as they were ordered: the registration error of a centred face.
    crc32, sha256
        Of the rows received, in order; the SHA-256 only of whole faces, and where the printer keeps one.
    armed_ahead_mm
        How far the belt still had to go to the first row when the face was armed.
    margin_mm
        How far it still had to go, at the least, to the first row of a strip that arrived.
    flaws
        What the head did wrong.
    kept
        The rows themselves, where they are kept.
    """

    arm: int
    face: int
    detect_seq: int
    rows: int
    rows_ordered: int
    complete: bool
    crc32: int
    sha256: str | None
    nozzle_out: bool
    armed_ahead_mm: float
    margin_mm: float
    start_x: float
    length_mm: float
    printed_mm: float
    at: float
    on_tile: bool = False
    offset_mm: float | None = None
    centre_mm: float | None = None
    flaws: tuple[Flaw, ...] = ()
    kept: KeptPrint | None = None

    def view(self) -> dict[str, Any]:
        """Its facts, ready for JSON."""
        facts = {
            "arm": self.arm,
            "face": self.face,
            "detect_seq": self.detect_seq,
            "rows": self.rows,
            "rows_ordered": self.rows_ordered,
            "complete": self.complete,
            "crc32": self.crc32,
            "sha256": self.sha256,
            "nozzle_out": self.nozzle_out,
            "armed_ahead_mm": self.armed_ahead_mm,
            "margin_mm": self.margin_mm,
            "on_tile": self.on_tile,
            "offset_mm": self.offset_mm,
            "centre_mm": self.centre_mm,
            "at": self.at,
        }
        return facts | {"flaws": [flaw.view() for flaw in self.flaws]} if self.flaws else facts


@dataclass
class Tile:
    """One tile.

    Attributes
    ----------
    lead_x
        The belt's travel at which its leading edge passes the eye (mm).
    laid, fired
        What it brought to the kiln, and how it was fired, in a plant whose colours are looked at.
    photo
        What the camera made of it; None if there is no camera or it didn't look.
    """

    id: int
    lead_x: float
    length_mm: float
    fate: Fate = "on_belt"
    plc_boot: int = 0
    tile_seq: int = 0
    printer_boot: int = 0
    detect_seq: int = 0
    prints: list[Print] = field(default_factory=list)
    decided_at: float | None = None
    ended_at: float | None = None
    change: int = 0
    laid: Laid | None = None
    fired: Fired | None = None
    photo: dict[str, Any] | None = None

    def view(self) -> dict[str, Any]:
        """Its facts, ready for JSON."""
        facts: dict[str, Any] = {
            "id": self.id,
            "length_mm": self.length_mm,
            "fate": self.fate,
            "plc_boot": self.plc_boot,
            "tile_seq": self.tile_seq,
            "printer_boot": self.printer_boot,
            "detect_seq": self.detect_seq,
            "prints": [print_.view() for print_ in self.prints],
            "decided_at": self.decided_at,
            "ended_at": self.ended_at,
            "change": self.change,
        }
        if self.fired is not None:
            facts["fired"] = self.fired.view()
        if self.photo is not None:
            facts["photo"] = self.photo
        return facts


class NumberSet:
    """A set of whole numbers kept as runs, so that numbers that come nearly in order take next to no memory."""

    def __init__(self) -> None:
        self._firsts: list[int] = []
        self._lasts: list[int] = []

    def add(self, number: int) -> bool:
        """Add a number; False if it was there."""
        at = bisect_right(self._firsts, number)
        if at and number <= self._lasts[at - 1]:
            return False
        joins_before = at > 0 and self._lasts[at - 1] == number - 1
        joins_after = at < len(self._firsts) and self._firsts[at] == number + 1
        if joins_before and joins_after:
            self._lasts[at - 1] = self._lasts.pop(at)
            del self._firsts[at]
        elif joins_before:
            self._lasts[at - 1] = number
        elif joins_after:
            self._firsts[at] = number
        else:
            self._firsts.insert(at, number)
            self._lasts.insert(at, number)
        return True

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return zip(self._firsts, self._lasts, strict=True)


class Truth:
    """All tiles on their way, the last finished ones, and counts of everything that ever happened.

    Parameters
    ----------
    keep
        How many finished tiles stay in memory.
    path
        File that finished tiles are added to, one JSON object a line; None for none.
    """

    def __init__(self, keep: int, path: Path | None) -> None:
        self._keep = keep
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", encoding="utf-8") if path else None
        self._tiles: OrderedDict[int, Tile] = OrderedDict()
        self._finished: deque[Tile] = deque()
        self._faces = NumberSet()
        self._change = 0
        self.beside: deque[dict[str, Any]] = deque(maxlen=_MOST_NAMED)
        self.twice: deque[int] = deque(maxlen=_MOST_NAMED)
        self.counts: Counter[str] = Counter()

    def touch(self, tile: Tile) -> None:
        """Note that something about a tile has changed."""
        self._change += 1
        tile.change = self._change
        self._tiles[tile.id] = tile
        self._tiles.move_to_end(tile.id)

    def add(self, tile: Tile) -> None:
        """A new tile lies on the belt."""
        self.counts["tiles"] += 1
        self.touch(tile)

    def settle(self, tile: Tile, fate: Fate, at: float) -> None:
        """A tile's fate changes at plant time `at`."""
        tile.fate = fate
        self.counts[fate] += 1
        if fate in ("passed", "diverted"):
            tile.decided_at = at
            if fate == "passed":
                self._count_passed(tile)
        self.touch(tile)
        if fate not in FINAL:
            return
        tile.ended_at = at
        if self._file:
            self._file.write(json.dumps(tile.view()) + "\n")
        self._finished.append(tile)
        if len(self._finished) > self._keep:
            self._tiles.pop(self._finished.popleft().id, None)

    def _count_passed(self, tile: Tile) -> None:
        whole = sum(print_.complete for print_ in tile.prints)
        if len(tile.prints) == 1 and whole == 1:
            self.counts["passed_good"] += 1
        elif not tile.prints:
            self.counts["passed_blank"] += 1
        else:
            self.counts["passed_spoilt"] += 1

    def printed(self, print_: Print, tile: Tile | None) -> None:
        """The head has put down rows: on a tile, or beside all of them."""
        self.counts["prints"] += 1
        self.counts["prints_complete" if print_.complete else "prints_partial"] += 1
        if not self._faces.add(print_.face):
            self.counts["faces_twice"] += 1
            self.twice.append(print_.face)
        if tile is None:
            self.counts["prints_beside"] += 1
            self._change += 1
            view = print_.view() | {"change": self._change}
            self.beside.append(view)
            if self._file:
                self._file.write(json.dumps({"beside": view}) + "\n")
            return
        if tile.prints:
            self.counts["tiles_twice"] += 1
        tile.prints.append(print_)
        self.touch(tile)

    def forget_faces(self) -> None:
        """Count doubled faces anew, as for another job whose faces start at 0 again."""
        self._faces = NumberSet()
        self.twice.clear()
        self.counts["faces_twice"] = 0

    def summary(self) -> dict[str, Any]:
        """Counts since the plant's start, the doubled faces among the last, and the ranges of faces ever begun."""
        names = (
            *("tiles", "passed", "diverted", "in_kiln", "fired", "broken", "removed", "prints", "prints_complete"),
            *("prints_partial", "prints_beside", "missed", "faces_twice", "tiles_twice"),
            *("passed_good", "passed_blank", "passed_spoilt", "underruns"),
        )
        return {name: self.counts[name] for name in names} | {
            "twice": list(self.twice),
            "faces": [list(run) for run in list(self._faces)[:_MOST_NAMED]],
        }

    def view(self, since: int = 0, limit: int | None = None) -> dict[str, Any]:
        """Tiles and prints beside tiles that changed after change `since`, oldest first, and where to go on.

        Parameters
        ----------
        since
            `next` of an earlier view; 0 for everything still in memory.
        limit
            Most tiles to name; None for all.
        """
        changed: list[Tile] = []
        for tile in reversed(self._tiles.values()):
            if tile.change <= since:
                break
            changed.append(tile)
        changed.reverse()
        if limit is not None and len(changed) > limit:
            changed = changed[:limit]
            until = changed[-1].change
        else:
            until = self._change
        return {
            "tiles": [tile.view() for tile in changed],
            "beside": [view for view in self.beside if since < view["change"] <= until],
            "next": until,
            "summary": self.summary(),
        }

    def flush(self) -> None:
        """Hand the truth file's lines to the system."""
        if self._file:
            self._file.flush()

    def close(self) -> None:
        """Close the truth file."""
        if self._file:
            self._file.close()
            self._file = None
