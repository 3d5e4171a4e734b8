"""What is worth an alarm among many tiles, while each of them alone is none."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass

from tilefab.inspection.records import DefectKind, Grade, TileInspection

_IMAGES = 20
_BAD_RAISE, _BAD_CLEAR = 10, 2
_BAD_IN_A_ROW = 5
_STRANGERS_IN_A_ROW = 5
_TILES = 10
_NOZZLE_TILES, _NOZZLE_TIMES, _SAME_PLACE_MM = 5, 3, 1.5
_KIND_TIMES = 5
_PLACED = frozenset({DefectKind.NOZZLE_LINE})

DefectsOfTile = tuple[tuple[str, float], ...]


class ImageHealth:
    """Whether the camera's images are of use."""

    def __init__(self) -> None:
        self._problems: deque[str] = deque(maxlen=_IMAGES)
        self._strangers = 0

    def saw(self, problem: str, *, recognised: bool) -> None:
        """Take in an image: why it can't be used (empty if it can), and whether it shows one of the line's faces."""
        self._problems.append(problem)
        if recognised:
            self._strangers = 0
        elif not problem:
            self._strangers += 1

    @property
    def unusable(self) -> str:
        """What to say of images that can't be used; empty if there is nothing to say."""
        bad = [problem for problem in self._problems if problem]
        last = list(self._problems)[-_BAD_IN_A_ROW:]
        if len(bad) < _BAD_RAISE and not (len(last) == _BAD_IN_A_ROW and all(last)):
            return ""
        kinds = ", ".join(f"{many} {kind.replace('_', ' ')}" for kind, many in Counter(bad).most_common())
        return f"{len(bad)} of the last {len(self._problems)} images can't be used: {kinds}"

    @property
    def usable(self) -> bool:
        """Whether images are in order again."""
        return sum(map(bool, self._problems)) <= _BAD_CLEAR and not any(list(self._problems)[-_BAD_IN_A_ROW:])

    @property
    def strange(self) -> str:
        """What to say of tiles that aren't the line's; empty if there is nothing to say."""
        if self._strangers < _STRANGERS_IN_A_ROW:
            return ""
        return f"{self._strangers} tiles in a row show none of the faces that this line printed"


@dataclass(frozen=True)
class DefectRun:
    """The same defect on several tiles.

    Attributes
    ----------
    subject
        Tells it from others: the defect's kind, with its place where that is known.
    text
        For people.
    """

    subject: str
    text: str


def repeating_defects(inspection: TileInspection) -> DefectsOfTile:
    """Of a tile's defects those that count as the same when they come again."""
    found = [
        (defect.kind.value, defect.x_mm if defect.kind in _PLACED else 0.0)
        for defect in inspection.defects
        if defect.kind in _PLACED or defect.grade is not Grade.FIRST
    ]
    return tuple(dict.fromkeys(found))


def kept_defects(before: Sequence[DefectsOfTile], newest: DefectsOfTile) -> tuple[DefectsOfTile, ...]:
    """Defects of the latest tiles, with those of one more."""
    return (*before, newest)[-_TILES:]


def defect_runs(tiles: Sequence[DefectsOfTile]) -> list[DefectRun]:
    """Defects of the newest tile that it shares with tiles before it."""
    if not tiles:
        return []
    runs: list[DefectRun] = []
    lately = tiles[-_NOZZLE_TILES:]
    for kind, place in tiles[-1]:
        if kind in _PLACED:
            same = [at for tile in lately for at in _nearest(tile, kind, place)]
            middle = sum(same) / len(same)
            if len(same) >= _NOZZLE_TIMES:
                where = f"{middle:.1f} mm from the face's left edge"
                text = f"a nozzle line {where} is on {len(same)} of the last {len(lately)} tiles"
                runs.append(DefectRun(f"{kind} {round(middle)}", f"{text}: see to the nozzle there"))
            continue
        times = sum(any(other == kind for other, _ in tile) for tile in tiles)
        if times >= _KIND_TIMES:
            words = kind.replace("_", " ")
            runs.append(DefectRun(kind, f"{times} of the last {len(tiles)} tiles have this defect: {words}"))
    return runs


def is_over(subject: str, tiles: Sequence[DefectsOfTile]) -> bool:
    """Whether none of the latest tiles shows what a run of defects was about."""
    kind, _, place = subject.partition(" ")
    if len(tiles) < _TILES:
        return False
    if place:
        return not any(_nearest(tile, kind, float(place)) for tile in tiles)
    return not any(other == kind for tile in tiles for other, _ in tile)


def _nearest(tile: DefectsOfTile, kind: str, place: float) -> list[float]:
    """Place of the nearest defect of a kind on a tile, if it is near."""
    places = [at for other, at in tile if other == kind and abs(at - place) <= _SAME_PLACE_MM]
    return [min(places, key=lambda at: abs(at - place))] if places else []
