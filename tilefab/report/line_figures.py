"""What a line report says of its tiles in numbers: counted and computed from the view, for pages and JSON alike."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tilefab.inspection.records import DefectKind, Grade
from tilefab.inspection.run_lengths import average_run_length
from tilefab.inspection.run_rules import RuleFindings, count_findings
from tilefab.inspection.spc import (
    Capability,
    CusumChart,
    EwmaChart,
    MeanRangeLimits,
    ShewhartChart,
    cpk,
    mean_range_limits,
)
from tilefab.inspection.watch import WatchSignals, watch_all
from tilefab.report.line_view import InnovationView, LineReportView, SpanView, TileView

Float64Array = NDArray[np.float64]

GROUP = 5
"""Neighbouring tiles in a group of a mean and range chart."""

_FEWEST_GROUPS = 2


@dataclass(frozen=True)
class TileCounts:
    """How many tiles came how far.

    Attributes
    ----------
    printed, fired, inspected
        Printed; photographed behind the kiln; graded.
    first, second, scrap
        Of the graded ones.
    waiting
        Printed and not yet photographed.
    """

    printed: int
    fired: int
    inspected: int
    first: int
    second: int
    scrap: int
    waiting: int

    @property
    def share_first(self) -> float | None:
        """First choice over inspected tiles; None without any."""
        return self.first / self.inspected if self.inspected else None


def count_tiles(tiles: Sequence[TileView]) -> TileCounts:
    """Count tiles."""
    grades = Counter(tile.grade for tile in tiles)
    printed = sum(tile.printed_s is not None for tile in tiles)
    fired = sum(tile.fired_s is not None for tile in tiles)
    waiting = sum(tile.printed_s is not None and tile.fired_s is None for tile in tiles)
    return TileCounts(
        printed=printed,
        fired=fired,
        inspected=len(tiles) - grades[None],
        first=grades[Grade.FIRST],
        second=grades[Grade.SECOND],
        scrap=grades[Grade.SCRAP],
        waiting=waiting,
    )


@dataclass(frozen=True, eq=False)
class ColourSeries:
    """Measured tiles in order of firing: (T,) times, mean and 95 % difference, and (T, 3) mean fired less predicted."""

    at_s: Float64Array
    delta_e: Float64Array
    delta_e_p95: Float64Array
    difference_lab: Float64Array
    lots: tuple[str, ...]


def colour_series(tiles: Sequence[TileView]) -> ColourSeries:
    """Series of the tiles that were measured and whose time is known."""
    found = sorted(
        (
            (tile.fired_s, tile.arm, tile.colour, tile.lot)
            for tile in tiles
            if tile.colour is not None and tile.fired_s is not None
        ),
        key=lambda row: row[:2],
    )
    return ColourSeries(
        np.array([at_s for at_s, _, _, _ in found], dtype=np.float64),
        np.array([colour.delta_e_mean for _, _, colour, _ in found], dtype=np.float64),
        np.array([colour.delta_e_p95 for _, _, colour, _ in found], dtype=np.float64),
        np.array([np.subtract(colour.fired_lab, colour.predicted_lab) for _, _, colour, _ in found]).reshape(-1, 3),
        tuple(lot for _, _, _, lot in found),
    )


@dataclass(frozen=True, eq=False)
class Groups:
    """Values in groups of neighbours: (G,) middle times, means and ranges, with their limits."""

    at_s: Float64Array
    mean: Float64Array
    range: Float64Array
    limits: MeanRangeLimits


def grouped(at_s: Float64Array, values: Float64Array) -> Groups | None:
    """Mean and range chart of values in order of time; None for too few groups."""
    count = len(values) // GROUP
    if count < _FEWEST_GROUPS:
        return None
    table = values[: count * GROUP].reshape(count, GROUP)
    times = at_s[: count * GROUP].reshape(count, GROUP).mean(axis=1)
    return Groups(times, table.mean(axis=1), np.ptp(table, axis=1), mean_range_limits(table))


@dataclass(frozen=True, eq=False)
class LoopStatistics:
    """Charts of the accepted innovations.

    Attributes
    ----------
    at_s, values
        (N,) times and values.
    signals
        What EWMA, CUSUM and single limits said of each.
    rules
        Findings of the eight Nelson rules.
    groups
        Mean and range chart; None for too few.
    chance
        How many signals of single values, EWMA and CUSUM chance alone would make.
    rejected
        Innovations that the controller did not believe.
    """

    at_s: Float64Array
    values: Float64Array
    signals: tuple[WatchSignals, ...]
    rules: tuple[RuleFindings, ...]
    groups: Groups | None
    chance: tuple[float, float, float]
    rejected: int

    @property
    def counts(self) -> tuple[int, int, int]:
        """Signals of single values, EWMA and CUSUM."""
        return (
            sum(said.shewhart != 0 for said in self.signals),
            sum(said.ewma != 0 for said in self.signals),
            sum(said.cusum != 0 for said in self.signals),
        )


def loop_statistics(innovations: Sequence[InnovationView]) -> LoopStatistics | None:
    """Chart the innovations that were accepted; None without any innovation at all."""
    if not innovations:
        return None
    accepted = [one for one in innovations if one.accepted]
    at_s = np.array([one.at_s for one in accepted], dtype=np.float64)
    values = np.array([one.value for one in accepted], dtype=np.float64)
    lengths = [average_run_length(chart) for chart in (ShewhartChart(), EwmaChart(), CusumChart())]
    single, ewma, cusum = (len(values) / length for length in lengths)
    return LoopStatistics(
        at_s=at_s,
        values=values,
        signals=watch_all([one.value for one in accepted]),
        rules=count_findings(values),
        groups=grouped(at_s, values),
        chance=(single, ewma, cusum),
        rejected=len(innovations) - len(accepted),
    )


def defect_counts(tiles: Sequence[TileView]) -> tuple[tuple[DefectKind, int, int, int], ...]:
    """For each kind found: how many defects, on how many tiles, and how many of those tiles it cost the first choice.

    The most frequent first.
    """
    defects: Counter[DefectKind] = Counter()
    on_tiles: Counter[DefectKind] = Counter()
    cost: Counter[DefectKind] = Counter()
    for tile in tiles:
        defects.update(defect.kind for defect in tile.defects)
        on_tiles.update({defect.kind for defect in tile.defects})
        cost.update({defect.kind for defect in tile.defects if defect.grade is not Grade.FIRST})
    order = sorted(defects, key=lambda kind: (-on_tiles[kind], -defects[kind], kind.value))
    return tuple((kind, defects[kind], on_tiles[kind], cost[kind]) for kind in order)


def union_s(spans: Sequence[SpanView], begun_s: float, ended_s: float) -> float:
    """Seconds of a span that are covered by at least one of some others."""
    total, reached = 0.0, begun_s
    for span in sorted(spans, key=lambda one: one.begun_s):
        end = min(ended_s if span.ended_s is None else span.ended_s, ended_s)
        start = max(span.begun_s, reached)
        if end > start:
            total += end - start
            reached = end
    return total


@dataclass(frozen=True)
class LineFigures:
    """The figures of the first page.

    Attributes
    ----------
    counts
        Of all tiles.
    delta_e_mean, delta_e_p95
        Mean over tiles of a tile's mean, and the 95th percentile over tiles of it; None without measured tiles.
    share_within
        Share of measured tiles whose mean and 95 % differences are both tolerated; None without tolerance or tiles.
    capability
        Of the tiles' mean differences against the tolerance; None if it can't be told.
    drift_delta_e
        Largest drift that corrections had to take out; None if not known.
    span_s, downtime_s
        Length of the span, and how much of it the line stood.
    ink_used, ink_saved
        Over all inks, in the view's unit; None if not known.
    """

    counts: TileCounts
    delta_e_mean: float | None
    delta_e_p95: float | None
    share_within: float | None
    capability: Capability | None
    drift_delta_e: float | None
    span_s: float
    downtime_s: float
    ink_used: float | None
    ink_saved: float | None

    @property
    def availability(self) -> float:
        """Share of the span that the line did not stand."""
        return 1.0 - self.downtime_s / self.span_s if self.span_s > 0 else 1.0


def line_figures(view: LineReportView) -> LineFigures:
    """Compute them."""
    series = colour_series(view.tiles)
    measured = len(series.at_s)
    limit_mean, limit_p95 = view.limits.delta_e_mean, view.limits.delta_e_p95
    within = None
    if measured and (limit_mean is not None or limit_p95 is not None):
        good = series.delta_e <= (math.inf if limit_mean is None else limit_mean)
        good &= series.delta_e_p95 <= (math.inf if limit_p95 is None else limit_p95)
        within = float(good.mean())
    drifts = [one.drift_delta_e for one in view.corrections if one.drift_delta_e is not None]
    saved = [ink.saved for ink in view.inks if ink.saved is not None]
    return LineFigures(
        counts=count_tiles(view.tiles),
        delta_e_mean=float(series.delta_e.mean()) if measured else None,
        delta_e_p95=float(np.percentile(series.delta_e, 95)) if measured else None,
        share_within=within,
        capability=cpk(series.delta_e, None, limit_mean) if measured > 1 and limit_mean is not None else None,
        drift_delta_e=max(drifts, default=None),
        span_s=view.ended_s - view.begun_s,
        downtime_s=union_s(view.downtime, view.begun_s, view.ended_s),
        ink_used=sum(ink.used for ink in view.inks) if view.inks else None,
        ink_saved=sum(saved) if saved else None,
    )


def shift_figures(view: LineReportView) -> tuple[tuple[str, LineFigures, int], ...]:
    """For each shift: its name, its figures and how many corrections it had.

    A tile belongs to the shift in which it was photographed, or printed while it is not photographed.
    """
    rows = []
    for shift in view.shifts:
        begun, ended = shift.begun_s, shift.ended_s

        def inside(at_s: float | None, begun: float = begun, ended: float = ended) -> bool:
            return at_s is not None and begun <= at_s < ended

        tiles = tuple(tile for tile in view.tiles if inside(tile.printed_s if tile.fired_s is None else tile.fired_s))
        corrections = tuple(one for one in view.corrections if inside(one.at_s))
        part = replace(view, tiles=tiles, corrections=corrections, begun_s=begun, ended_s=ended, inks=())
        rows.append((shift.name, line_figures(part), len(corrections)))
    return tuple(rows)
