"""The kiln's loop: watches its zones and brings them to a recipe within what the ware and the bricks stand."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from tilefab.control.ramp import RampLimits, next_set_points
from tilefab.devices import KilnCommand, KilnSession, KilnStatus
from tilefab.pipeline.line.host import LineHost

_STEP_S = 10.0
"""Set-points are moved this often while they are on their way."""
_SET_STEP_DEGC = 0.05
_CYCLE_STEP_MIN = 0.05
_OFF_FOR_S = 5.0
"""A zone may be off for so long before it is told of."""

FIRING = "kiln"
"""Kind of the journal's note of the kiln's zones."""
_NOTE_MOVED_DEGC = 0.5
_NOTE_SOONEST_S = 2.0
_NOTE_LATEST_S = 60.0


@dataclass(frozen=True)
class KilnRecipe:
    """What a recipe asks of the kiln.

    Attributes
    ----------
    set_points_degc
        Of each zone; ``None``: as they are.
    cycle_min
        Time in the kiln; ``None``: as it is.
    """

    set_points_degc: tuple[float, ...] | None
    cycle_min: float | None


class KilnLoop:
    """Talks to the kiln's controller.

    Parameters
    ----------
    host
        The line.
    limits
        Of set-points and of how fast they may move.
    tolerance_degc
        How near to its set-point a zone must be to print.
    note
        Puts down in the journal how its zones go.
    """

    def __init__(self, host: LineHost, limits: RampLimits, tolerance_degc: float, note: Callable[..., None]) -> None:
        self._host, self._limits, self._tolerance_degc, self._note = host, limits, tolerance_degc, note
        self._noted: tuple[float, KilnStatus] | None = None
        self.status: KilnStatus | None = None
        self._target: KilnRecipe | None = None
        self._last_step_s: float | None = None
        self._began = False
        self._off_since: dict[int, float] = {}
        self._told: set[int] = set()

    @property
    def at_recipe(self) -> bool:
        """Whether the kiln is where the recipe wants it, so that tiles may be sent to it."""
        status, target = self.status, self._target
        if status is None or target is None:
            return False
        if not self._is_set(status, target):
            return False
        if target.set_points_degc is None:
            return True
        return all(
            abs(now - wanted) <= self._tolerance_degc
            for now, wanted in zip(status.temperatures_degc, target.set_points_degc, strict=True)
        )

    def bring_to(self, recipe: KilnRecipe) -> None:
        """Move the kiln to a recipe from now on."""
        self._target, self._began = recipe, False
        self._last_step_s = None

    async def cycle(self, session: KilnSession) -> None:
        """One round: zones, faults, the next step towards the recipe."""
        status = await session.poll()
        self.status = status
        self._look_at(status)
        self._put_down(status, asyncio.get_running_loop().time())
        target = self._target
        if target is None or self._is_set(status, target):
            return
        if status.tiles_inside and not self._began:
            # What is in the kiln keeps the firing that it came in for.
            return
        now = asyncio.get_running_loop().time()
        elapsed_s = _STEP_S if self._last_step_s is None else now - self._last_step_s
        if elapsed_s < _STEP_S:
            return
        self._began, self._last_step_s = True, now
        wanted = target.set_points_degc or status.set_points_degc
        await session.command(
            KilnCommand(
                set_points_degc=next_set_points(status.set_points_degc, wanted, elapsed_s, self._limits),
                ramp_limit_degc_min=self._limits.ramp_degc_min,
                cycle_min=target.cycle_min if target.cycle_min is not None else status.cycle_time_min,
            )
        )

    def _is_set(self, status: KilnStatus, target: KilnRecipe) -> bool:
        """Whether the kiln's set-points and firing time are those of a recipe."""
        if target.cycle_min is not None and abs(status.cycle_time_min - target.cycle_min) > _CYCLE_STEP_MIN:
            return False
        if target.set_points_degc is None:
            return True
        pairs = zip(status.set_points_degc, target.set_points_degc, strict=True)
        return all(abs(now - wanted) <= _SET_STEP_DEGC for now, wanted in pairs)

    def _put_down(self, status: KilnStatus, now: float) -> None:
        """Note the zones when they moved, and now and then in any case, for whoever asks what fired a tile."""
        if self._noted is not None:
            then, last = self._noted
            moved = max(
                abs(degc - before)
                for degc, before in zip(status.temperatures_degc, last.temperatures_degc, strict=True)
            )
            changed = moved >= _NOTE_MOVED_DEGC or status.set_points_degc != last.set_points_degc
            if now - then < (_NOTE_SOONEST_S if changed else _NOTE_LATEST_S):
                return
        self._noted = now, status
        self._note(
            FIRING,
            temperatures_degc=[round(degc, 1) for degc in status.temperatures_degc],
            set_points_degc=[round(degc, 1) for degc in status.set_points_degc],
        )

    def _look_at(self, status: KilnStatus) -> None:
        if not self._host.moving:
            return
        if status.burner_fault:
            self._host.doubt("kiln_burner", "a burner of the kiln failed")
        elif status.over_temp:
            self._host.doubt("kiln_over_temp", "the kiln is too hot")
        elif status.blocked:
            self._host.doubt("kiln_blocked", "the kiln takes no tiles")
        target = self._target
        if target is None or target.set_points_degc is None:
            return
        now = asyncio.get_running_loop().time()
        for zone, (degc, wanted) in enumerate(zip(status.temperatures_degc, target.set_points_degc, strict=True), 1):
            if abs(degc - wanted) <= self._tolerance_degc:
                self._off_since.pop(zone, None)
                self._told.discard(zone)
            elif now - self._off_since.setdefault(zone, now) > _OFF_FOR_S and zone not in self._told:
                self._told.add(zone)
                self._host.warn("kiln_zone", f"zone {zone} of the kiln is at {degc:.0f} °C, {wanted:.0f} wanted")
