"""The belt's motion: from one speed to the next at a constant acceleration, solved instead of stepped."""

from __future__ import annotations

import math


class Motion:
    """Where the belt is at any time, and when it will be somewhere.

    Travel is in mm since the start of the plant, time in plant seconds. The belt never runs backwards.
    """

    def __init__(self) -> None:
        self._t0 = self._x0 = self._v0 = 0.0
        self._a = self._v1 = 0.0
        self._t1 = self._x1 = 0.0

    def aim(self, t: float, x: float, speed: float, accel: float) -> None:
        """From time `t`, at travel `x`, change over to `speed` (mm/s, not below 0) at `accel` (mm/s², above 0)."""
        v = self.speed_at(t)
        self._t0, self._x0, self._v0, self._v1 = t, x, v, speed
        self._a = math.copysign(accel, speed - v)
        took = abs(speed - v) / accel
        self._t1 = t + took
        self._x1 = x + (v + speed) / 2 * took

    @property
    def target(self) -> float:
        """Speed that the belt is changing over to or has, mm/s."""
        return self._v1

    def speed_at(self, t: float) -> float:
        """Speed in mm/s at a time not before the last change of aim."""
        if t >= self._t1:
            return self._v1
        return max(0.0, self._v0 + self._a * (t - self._t0))

    def travel_at(self, t: float) -> float:
        """Travel in mm at a time not before the last change of aim."""
        if t >= self._t1:
            return self._x1 + self._v1 * (t - self._t1)
        passed = t - self._t0
        return self._x0 + (self._v0 + self._a / 2 * passed) * passed

    def time_at(self, x: float) -> float:
        """When travel reaches `x` mm; infinity if it never does as things stand."""
        if x <= self._x0:
            return self._t0
        if x > self._x1:
            return self._t1 + (x - self._x1) / self._v1 if self._v1 > 0 else math.inf
        # The stable form of the quadratic's root: it also holds while the belt starts from rest or comes to it.
        way = x - self._x0
        root = math.sqrt(max(0.0, self._v0 * self._v0 + 2 * self._a * way))
        return min(self._t1, self._t0 + 2 * way / (self._v0 + root)) if self._v0 + root > 0 else self._t1
