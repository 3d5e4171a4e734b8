"""The camera over the kiln's exit: which tiles it sees, how they lie before it, what its images are called."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any

from sim.plant.config import CameraConfig
from sim.plant.physics.firing import Fired
from sim.plant.physics.flaws import Flaw, KeptPrint
from sim.plant.physics.tiles import Tile
from sim.plant.physics.timeline import Timeline

FAULTS = ("camera_dead", "camera_dirty", "camera_black", "camera_blown", "camera_torn", "camera_two_tiles")
"""Faults of the camera, the ones that hide others first."""

_LASTING = ("camera_dead", "camera_dirty")
_MOST_OCCLUDED, _LEAST_BROKEN, _MOST_BROKEN = 0.3, 0.05, 0.4
_LEAST_SIDE = 0.3


@dataclass(frozen=True, eq=False)
class Layer:
    """A print on a tile: its rows, where the first one lies behind the leading edge, and what is wrong with it."""

    kept: KeptPrint = field(repr=False)
    offset_mm: float
    flaws: tuple[Flaw, ...]


@dataclass(frozen=True, eq=False)
class Subject:
    """A fired tile before the camera: its size, its prints in their order, how it was fired."""

    width_mm: float
    length_mm: float
    layers: tuple[Layer, ...]
    fired: Fired


@dataclass(frozen=True)
class View:
    """How a tile lies before the camera and is lit; each value as in `sim.tile_photo.PhotoConditions`."""

    quarter_turns: int
    rotation_deg: float
    shift_mm: tuple[float, float]
    scale: float
    light: float
    gain_rgb: tuple[float, float, float]
    blur_px: float
    noise: float
    perspective: float
    occluded: tuple[float, float, float, float] | None
    broken: float


@dataclass(frozen=True, eq=False)
class PhotoOrder:
    """An image to be made now.

    Attributes
    ----------
    name
        Its file's name.
    number
        Its number; also the key of everything that is random in it.
    subject, view
        The tile, and how it lies.
    faults
        Faults of the camera that strike it.
    other
        A second tile that lies beside it.
    """

    name: str
    number: int
    subject: Subject
    view: View
    faults: tuple[str, ...]
    other: Subject | None = None


class Camera:
    """The camera; what makes its images is told by orders.

    Parameters
    ----------
    timeline
        The plant's clock.
    config
        What it is like.
    epoch_s
        Seconds since 1970 at the start; images are named by the clock on the wall.
    width_mm
        Width of tiles; 0 for as wide as they are long.
    """

    def __init__(self, timeline: Timeline, config: CameraConfig, epoch_s: float, width_mm: float) -> None:
        self._timeline = timeline
        self._config = config
        self._epoch_s = epoch_s
        self._wall0 = timeline.wall
        self._width_mm = width_mm
        self._faults: dict[str, int] = {}
        self._last: Subject | None = None
        self.on_photo: Callable[[PhotoOrder], None] = lambda _: None
        self.clock_off_s = 0.0
        self.seen = self.taken = self.missed = 0

    def strike(self, kind: str, count: int | None) -> None:
        """From now on a fault strikes so many images; None for all, or one if it is of single images."""
        endless = kind in _LASTING
        self._faults[kind] = count if count is not None else -1 if endless else 1

    def mend(self) -> None:
        """The camera is well, clean and on time again."""
        self._faults.clear()
        self.clock_off_s = 0.0

    def see(self, tile: Tile, whole: bool) -> None:
        """A tile comes out of the kiln; its `photo` says what becomes of that."""
        self.seen += 1
        config = self._config
        if self.seen % config.every or tile.fired is None:
            return
        chance = random.Random(f"camera:{config.seed}:{tile.id}")
        missed = chance.random() < config.miss_rate
        view = self._view(chance, whole)
        late = config.late_s
        if chance.random() < config.late_rate:
            late += chance.uniform(0.0, config.late_most_s)
        layers = tuple(
            Layer(print_.kept, print_.offset_mm or 0.0, print_.flaws) for print_ in tile.prints if print_.kept
        )
        if len(layers) < len(tile.prints):
            tile.photo = self._not_taken("not_kept")
            return
        if missed or self._struck("camera_dead"):
            tile.photo = self._not_taken("missed" if missed else "camera_dead")
            return
        faults = tuple(kind for kind in FAULTS[1:] if self._struck(kind))
        subject = Subject(self._width_mm or tile.length_mm, tile.length_mm, layers, tile.fired)
        other = (self._last or subject) if "camera_two_tiles" in faults else None
        self._last = subject
        self.taken += 1
        order = PhotoOrder(self._name(), self.taken, subject, view, faults, other)
        tile.photo = {
            "name": order.name,
            "at": self._timeline.t,
            "arrives_at": self._timeline.t + late,
            "faults": list(faults),
            "width_mm": subject.width_mm,
            "view": asdict(view),
        }
        self._timeline.at_time(self._timeline.t + late, lambda: self.on_photo(order))

    def _not_taken(self, why: str) -> dict[str, Any]:
        self.missed += 1
        return {"name": None, "at": self._timeline.t, "faults": [why]}

    def _struck(self, kind: str) -> bool:
        left = self._faults.get(kind, 0)
        if left > 0:
            self._faults[kind] = left - 1
        return left != 0

    def _view(self, chance: random.Random, whole: bool) -> View:
        config = self._config

        def within(most: float) -> float:
            return round(chance.uniform(-most, most), 5)

        occluded = None
        covered = chance.random() < config.occluded_rate
        area, side = chance.uniform(0.0, _MOST_OCCLUDED), chance.uniform(_LEAST_SIDE, 1.0)
        at = (chance.random(), chance.random())
        broken = chance.uniform(_LEAST_BROKEN, _MOST_BROKEN)
        if covered:
            wide, high = side, min(1.0, area / side)
            occluded = (at[0] * (1.0 - wide), at[1] * (1.0 - high), wide, high)
        return View(
            quarter_turns=chance.randrange(4) if config.quarter_turns else 0,
            rotation_deg=within(config.rotation_deg),
            shift_mm=(within(config.shift_mm), within(config.shift_mm)),
            scale=1.0 + within(config.scale),
            light=round(chance.uniform(0.0, config.light), 5),
            gain_rgb=(1.0 + within(config.gain), 1.0 + within(config.gain), 1.0 + within(config.gain)),
            blur_px=config.blur_px,
            noise=config.noise,
            perspective=round(chance.uniform(0.0, config.perspective), 5),
            occluded=occluded,
            broken=0.0 if whole else round(broken, 5),
        )

    def _name(self) -> str:
        """Such as 20261124T083015.250Z_000123.png."""
        now = self._epoch_s + self._timeline.wall - self._wall0 + self.clock_off_s
        # Whole milliseconds, so that no rounding makes 1,000 of them.
        seconds, millis = divmod(round(now * 1000), 1000)
        stamp = datetime.fromtimestamp(seconds, UTC).strftime("%Y%m%dT%H%M%S")
        ending = "tif" if self._config.format == "tiff" else "png"
        return f"{stamp}.{millis:03d}Z_{self.taken:06d}.{ending}"

    def state(self) -> Mapping[str, Any]:
        """How it is."""
        faults = {kind: left for kind, left in self._faults.items() if left}
        return {"seen": self.seen, "taken": self.taken, "missed": self.missed, "faults": faults}
