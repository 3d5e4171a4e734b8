"""One clock for the whole plant, and everything that happens in its order."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from itertools import count

from sim.plant.physics.motion import Motion

Happening = Callable[[], None]


class Timeline:
    """Plant time, the belt's travel, and what is to happen at a time, at a travel or at a wall time.

    Travel, kilns and faults of the plant live in plant time, which runs at `rate` times the wall's; scans and
    dead-man switches of controllers live in wall time. Nothing happens on its own: `advance` brings the plant up to a
    wall time, and everything due until then happens first, in order and each at its exact time and travel.

    Parameters
    ----------
    rate
        Plant seconds a wall second, 1 to 1000.
    wall
        Wall time of the start, in seconds of any monotonic clock.
    """

    def __init__(self, rate: float, wall: float) -> None:
        self.rate = rate
        self.wall = wall
        self.t = 0.0
        self.x = 0.0
        self._wall0, self._t0 = wall, 0.0
        self._motion = Motion()
        self._order = count()
        self._at_time: list[tuple[float, int, Happening]] = []
        self._at_wall: list[tuple[float, int, Happening]] = []
        self._at_travel: list[tuple[float, int, int, Happening]] = []

    @property
    def speed(self) -> float:
        """The belt's speed now, mm/s."""
        return self._motion.speed_at(self.t)

    @property
    def target_speed(self) -> float:
        """Speed that the belt has or changes over to, mm/s."""
        return self._motion.target

    def at_time(self, t: float, happening: Happening) -> None:
        """Let something happen at a plant time (s)."""
        heapq.heappush(self._at_time, (max(t, self.t), next(self._order), happening))

    def at_wall(self, wall: float, happening: Happening) -> None:
        """Let something happen at a wall time (s)."""
        heapq.heappush(self._at_wall, (max(wall, self.wall), next(self._order), happening))

    def at_travel(self, x: float, happening: Happening, *, rank: int = 0) -> None:
        """Let something happen when the belt's travel reaches `x` mm; at the same travel lower ranks go first."""
        heapq.heappush(self._at_travel, (max(x, self.x), rank, next(self._order), happening))

    def set_speed(self, speed: float, accel: float) -> None:
        """From now on the belt changes over to `speed` (mm/s) at `accel` (mm/s²)."""
        self._motion.aim(self.t, self.x, speed, accel)

    def set_rate(self, rate: float) -> None:
        """From now on the plant's clock runs at `rate` times the wall's."""
        self._wall0, self._t0, self.rate = self.wall, self.t, rate

    def wall_at_travel(self, x: float) -> float:
        """Wall time at which travel reaches `x` as things stand; infinity if never."""
        return self._wall_of(self._motion.time_at(x))

    def advance(self, wall: float) -> None:
        """Bring the plant up to a wall time; one that is past changes nothing."""
        if wall < self.wall:
            return
        until = self._plant_of(wall)
        while True:
            timed = self._at_time[0][0] if self._at_time else math.inf
            walled = self._plant_of(self._at_wall[0][0]) if self._at_wall else math.inf
            travelled = self._motion.time_at(self._at_travel[0][0]) if self._at_travel else math.inf
            due = min(timed, walled, travelled)
            if due > until:
                break
            self.t = max(self.t, due)
            self.wall = max(self.wall, self._wall_of(self.t))
            if travelled == due:
                self.x = max(self.x, self._at_travel[0][0])
                happening = heapq.heappop(self._at_travel)[3]
            else:
                self.x = max(self.x, self._motion.travel_at(self.t))
                happening = heapq.heappop(self._at_time if timed == due else self._at_wall)[2]
            happening()
        self.wall = wall
        self.t = max(self.t, until)
        self.x = max(self.x, self._motion.travel_at(self.t))

    def _plant_of(self, wall: float) -> float:
        return self._t0 + (wall - self._wall0) * self.rate

    def _wall_of(self, t: float) -> float:
        return self._wall0 + (t - self._t0) / self.rate
