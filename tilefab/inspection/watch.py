"""Watches the drift controller's innovations: single values, EWMA, CUSUM and the eight rules at once, tile by tile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tilefab.inspection.run_rules import LONGEST, newest_rules
from tilefab.inspection.spc import CusumChart, CusumState, EwmaChart, ShewhartChart


@dataclass(frozen=True)
class WatchCharts:
    """Settings of the three charts."""

    shewhart: ShewhartChart = field(default_factory=ShewhartChart)
    ewma: EwmaChart = field(default_factory=EwmaChart)
    cusum: CusumChart = field(default_factory=CusumChart)


@dataclass(frozen=True)
class WatchState:
    """All that must be kept between two tiles.

    Attributes
    ----------
    average
        Of the EWMA chart.
    high, low
        Sums of the CUSUM chart.
    recent
        The newest values, at most 15.
    seen
        How many values there were.
    """

    average: float = 0.0
    high: float = 0.0
    low: float = 0.0
    recent: tuple[float, ...] = ()
    seen: int = 0

    def plain(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "average": self.average,
            "high": self.high,
            "low": self.low,
            "recent": list(self.recent),
            "seen": self.seen,
        }

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> WatchState:
        """Undo `plain`."""
        return cls(
            float(plain["average"]),
            float(plain["high"]),
            float(plain["low"]),
            tuple(float(value) for value in plain["recent"]),
            int(plain["seen"]),
        )


@dataclass(frozen=True)
class WatchSignals:
    """What one value made the charts say.

    Attributes
    ----------
    shewhart, ewma, cusum
        -1 or 1: beyond the lower or upper limit; 0: in control.
    average, high, low
        The EWMA's and the CUSUM's values that this value made, before a signal sets them back.
    rules
        Numbers of the Nelson rules that this value fulfils.
    """

    shewhart: int
    ewma: int
    cusum: int
    average: float
    high: float
    low: float
    rules: tuple[int, ...]

    @property
    def alarming(self) -> bool:
        """Whether EWMA or CUSUM signal: what is worth waking somebody.

        The eight rules together cry wolf once in some 75 tiles (benchmarks/run_lengths.py); they are for the report.
        """
        return bool(self.ewma or self.cusum)


def watch(state: WatchState, value: float, charts: WatchCharts | None = None) -> tuple[WatchState, WatchSignals]:
    """Take in one standardised innovation.

    A chart that signals begins anew, so that each signal is news: `arl_ewma` and `arl_cusum` tell how far apart they
    are by chance.

    Raises
    ------
    ValueError
        If the value is not finite.
    """
    chosen = charts or WatchCharts()
    shewhart = chosen.shewhart.update(value)
    average, ewma = chosen.ewma.update(state.average, value)
    sums, cusum = chosen.cusum.update(CusumState(state.high, state.low), value)
    recent = (*state.recent, value)[-LONGEST:]
    signals = WatchSignals(shewhart, ewma, cusum, average, sums.high, sums.low, newest_rules(recent))
    kept = CusumState() if cusum else sums
    return WatchState(0.0 if ewma else average, kept.high, kept.low, recent, state.seen + 1), signals


def watch_all(values: Sequence[float], charts: WatchCharts | None = None) -> tuple[WatchSignals, ...]:
    """What `watch` says of each of many values in order, without the rules (see `nelson_rules` for all at once)."""
    chosen = charts or WatchCharts()
    average, sums, said = 0.0, CusumState(), []
    for value in values:
        average, ewma = chosen.ewma.update(average, value)
        sums, cusum = chosen.cusum.update(sums, value)
        said.append(WatchSignals(chosen.shewhart.update(value), ewma, cusum, average, sums.high, sums.low, ()))
        average = 0.0 if ewma else average
        sums = CusumState() if cusum else sums
    return tuple(said)
