"""The verdicts of a line report: each a grade and one sentence with the figures that it rests on.

Grades are "good", "fair" and "poor", or "none" where nothing can be said.
"""

from __future__ import annotations

import math

from tilefab.report.line_charts import span_text
from tilefab.report.line_figures import LineFigures, LoopStatistics, defect_counts
from tilefab.report.line_view import LineReportView
from tilefab.report.profile_view import VerdictView
from tilefab.report.style import number, percent

_WITHIN = (0.99, 0.95)
_FIRST = (0.97, 0.90)
_SEEN = (0.98, 0.90)
_AVAILABLE = (0.95, 0.85)
_MAIN_LOT = (0.9, 0.5)


def line_verdicts(view: LineReportView, figures: LineFigures, loop: LoopStatistics | None) -> tuple[VerdictView, ...]:
    """Judge colour, quality, control, shade, recognition and the line's stops."""
    return (
        _colour(figures),
        _quality(view, figures),
        _control(view, loop),
        _shade(view),
        _recognition(view, figures),
        _stops(view, figures),
    )


def _grade(share: float, steps: tuple[float, float]) -> str:
    return "good" if share >= steps[0] else "fair" if share >= steps[1] else "poor"


def _colour(figures: LineFigures) -> VerdictView:
    if figures.delta_e_mean is None:
        return VerdictView("Colour", "none", "No tile's colour was measured.")
    drift = figures.drift_delta_e
    took = f" Uncorrected, drift would have put them off by up to ΔE {number(drift)}." if drift else ""
    text = f"Mean ΔE {number(figures.delta_e_mean, 2)} of each tile against its own predicted face"
    if figures.share_within is None:
        return VerdictView("Colour", "none", f"{text}; no tolerance is set.{took}")
    return VerdictView(
        "Colour",
        _grade(figures.share_within, _WITHIN),
        f"{text}; {percent(100 * figures.share_within)} of tiles are within the tolerance.{took}",
    )


def _quality(view: LineReportView, figures: LineFigures) -> VerdictView:
    counts = figures.counts
    share = counts.share_first
    if share is None:
        return VerdictView("Quality", "none", "No tile was graded.")
    text = f"{percent(100 * share)} of {number(counts.inspected, 0)} graded tiles are first choice"
    costly = [(cost, kind) for kind, _, _, cost in defect_counts(view.tiles) if cost]
    if costly:
        cost, kind = max(costly, key=lambda row: row[0])
        what = kind.value.replace("_", " ")
        text += f"; the most frequent defect that cost it is {what}, on {number(cost, 0)} tile{'s' if cost > 1 else ''}"
    return VerdictView("Quality", _grade(share, _FIRST), f"{text}.")


def _control(view: LineReportView, loop: LoopStatistics | None) -> VerdictView:
    held = [hold for hold in view.holds if hold.ended_s is None]
    made = len(view.corrections)
    text = f"{made} correction{'' if made == 1 else 's'} made" if made else "No correction was made"
    if loop is None:
        return VerdictView("Control", "poor" if held else "none", f"{text}; nothing is known of the controller.")
    _, ewma, cusum = loop.counts
    _, by_ewma, by_cusum = loop.chance
    # Counts of rare events: three standard deviations above what chance makes is no chance any more.
    odd = any(found > most + 3.0 * math.sqrt(most) + 1.0 for found, most in ((ewma, by_ewma), (cusum, by_cusum)))
    if held:
        return VerdictView("Control", "poor", f"{text}; the controller holds: {held[-1].text}")
    if view.holds:
        text += f"; the controller held {'once' if len(view.holds) == 1 else f'{len(view.holds)} times'}"
    chance = by_ewma + by_cusum
    by_chance = number(chance, 0 if chance >= 10 else 1)
    signals = "1 signal" if ewma + cusum == 1 else f"{number(ewma + cusum, 0)} signals"
    expected = f"{signals} of the charts of lightness, {by_chance} to be expected by chance"
    return VerdictView("Control", "fair" if odd or view.holds else "good", f"{text}; {expected}.")


def _shade(view: LineReportView) -> VerdictView:
    total = sum(lot.tiles for lot in view.lots)
    if not total:
        return VerdictView("Shade", "none", "No shade lots were made.")
    main = max(view.lots, key=lambda lot: lot.tiles)
    share = main.tiles / total
    lots = f"{len(view.lots)} shade lots" if len(view.lots) > 1 else "One shade lot"
    rest = f"; lot {main.name} holds {percent(100 * share)} of the tiles" if len(view.lots) > 1 else ""
    return VerdictView("Shade", _grade(share, _MAIN_LOT), f"{lots}{rest}. Pack each lot by itself.")


def _recognition(view: LineReportView, figures: LineFigures) -> VerdictView:
    unread = sum(count for _, count in view.unreadable)
    seen = figures.counts.fired
    total = seen + unread + view.strangers
    if not total:
        return VerdictView("Recognition", "none", "No photographs of fired tiles.")
    text = f"{number(seen, 0)} of {number(total, 0)} photographs were recognised as a face of this job"
    odd = [f"{number(unread, 0)} could not be read"] if unread else []
    odd += [f"{number(view.strangers, 0)} showed tiles that are not of it"] if view.strangers else []
    return VerdictView("Recognition", _grade(seen / total, _SEEN), "; ".join([text, *odd]) + ".")


def _stops(view: LineReportView, figures: LineFigures) -> VerdictView:
    if figures.span_s <= 0:
        return VerdictView("Line", "none", "The span has no length.")
    if not view.downtime:
        return VerdictView("Line", "good", "The line ran without a stop.")
    longest = max(view.downtime, key=lambda stop: (stop.ended_s or view.ended_s) - stop.begun_s)
    long_s = (longest.ended_s or view.ended_s) - longest.begun_s
    stops = f"{len(view.downtime)} stop{'' if len(view.downtime) == 1 else 's'}"
    text = f"Running {percent(100 * figures.availability)} of the time; {stops}, {span_text(figures.downtime_s)} in all"
    return VerdictView(
        "Line", _grade(figures.availability, _AVAILABLE), f"{text}; the longest, {span_text(long_s)}: {longest.text}"
    )
