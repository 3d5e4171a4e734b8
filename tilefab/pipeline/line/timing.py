"""Latencies of the line, in constant memory."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Callable

_WINDOW_S = 60.0
_FIRST_S = 1e-4
_RATIO = 1.05
_BOUNDS = tuple(_FIRST_S * _RATIO**n for n in range(240))
"""From 0.1 ms to some 11 s, each 5 % above the one before."""


class Latencies:
    """A histogram of times, with bins 5 % wide."""

    def __init__(self) -> None:
        self._counts = [0] * (len(_BOUNDS) + 1)
        self.count = 0
        self.largest_s = 0.0

    def add(self, seconds: float) -> None:
        """Count a time."""
        self._counts[bisect.bisect_left(_BOUNDS, seconds)] += 1
        self.count += 1
        self.largest_s = max(self.largest_s, seconds)

    def quantile_s(self, share: float) -> float:
        """Time that a share of all doesn't exceed, rounded up to the end of its bin; 0 without any.

        >>> times = Latencies()
        >>> for ms in range(1, 101): times.add(ms / 1000)
        >>> 0.05 <= times.quantile_s(0.5) < 0.053
        True
        """
        wanted, seen = share * self.count, 0
        for n, count in enumerate(self._counts):
            seen += count
            if count and seen >= wanted:
                return min(_BOUNDS[n], self.largest_s) if n < len(_BOUNDS) else self.largest_s
        return self.largest_s


class Throughput:
    """Tiles of the last minute.

    Parameters
    ----------
    now_s
        A monotonic clock, seconds.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._times: deque[float] = deque()
        self._began_s = now_s()

    def count(self) -> None:
        """Count a tile."""
        self._times.append(self._now_s())
        self._forget()

    @property
    def per_minute(self) -> float:
        """Tiles a minute, over the last minute or since the beginning."""
        self._forget()
        spent_s = min(_WINDOW_S, max(1.0, self._now_s() - self._began_s))
        return len(self._times) * 60.0 / spent_s

    def _forget(self) -> None:
        while self._times and self._now_s() - self._times[0] > _WINDOW_S:
            self._times.popleft()
