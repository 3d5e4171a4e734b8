"""The same report for machines: every record of the view without its pictures, and the figures that the pages show."""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, fields
from enum import Enum
from typing import Any

import numpy as np

from tilefab.report.line_check import check_line_view
from tilefab.report.line_figures import (
    Groups,
    LineFigures,
    LoopStatistics,
    colour_series,
    defect_counts,
    grouped,
    line_figures,
    loop_statistics,
    shift_figures,
)
from tilefab.report.line_verdicts import line_verdicts
from tilefab.report.line_view import LineReportView

SCHEMA_VERSION = 1

_PICTURES = ("worst", "tile_picture")


def line_report_json(view: LineReportView) -> dict[str, Any]:
    """Turn a view into plain values for ``json.dumps``.

    Parameters
    ----------
    view
        As for `build_line_report`.

    Returns
    -------
    dict
        ``schema_version`` 1; the view's fields by their names, pictures left out, times in seconds since 1970 UTC;
        ``figures``, ``verdicts``, ``shift_figures``, ``defect_counts``, ``loop`` and ``control_limits`` as the pages
        show them. What isn't known, or isn't finite, is null.

    Raises
    ------
    ReportError
        As in `build_line_report`.
    """
    check_line_view(view)
    figures, loop = line_figures(view), loop_statistics(view.innovations)
    series = colour_series(view.tiles)
    plain: dict[str, Any] = {"schema_version": SCHEMA_VERSION}
    names = [field.name for field in fields(view) if field.name not in _PICTURES]
    plain |= {name: _plain(getattr(view, name)) for name in names}
    plain["worst"] = [_plain(worst.tile) for worst in view.worst]
    plain["figures"] = _figures(figures)
    plain["verdicts"] = [asdict(verdict) for verdict in line_verdicts(view, figures, loop)]
    plain["shift_figures"] = [
        {"name": name, "corrections": made, **_figures(found)} for name, found, made in shift_figures(view)
    ]
    plain["defect_counts"] = [
        {"kind": kind.value, "defects": defects, "tiles": tiles, "tiles_not_first": cost}
        for kind, defects, tiles, cost in defect_counts(view.tiles)
    ]
    plain["control_limits"] = {
        name: _limits(grouped(series.at_s, series.difference_lab[:, channel]))
        for channel, name in enumerate(("lightness", "a", "b"))
    }
    plain["loop"] = None if loop is None else _loop(loop)
    return plain


def _figures(figures: LineFigures) -> dict[str, Any]:
    found: dict[str, Any] = _plain(figures)
    return found | {"availability": _plain(figures.availability), "share_first": _plain(figures.counts.share_first)}


def _limits(found: Groups | None) -> Any:
    return None if found is None else _plain(found.limits)


def _loop(loop: LoopStatistics) -> dict[str, Any]:
    names = ("shewhart", "ewma", "cusum")
    return {
        "innovations": len(loop.values),
        "rejected": loop.rejected,
        "signals": dict(zip(names, loop.counts, strict=True)),
        "signals_by_chance": dict(zip(names, map(_plain, loop.chance), strict=True)),
        "signals_at_s": {
            name: [float(at_s) for at_s, said in zip(loop.at_s, loop.signals, strict=True) if getattr(said, name) != 0]
            for name in names
        },
        "rules": _plain(loop.rules),
        "mean_range_limits": _limits(loop.groups),
    }


def _plain(value: Any) -> Any:
    """Plain JSON values of records, without pictures and other arrays."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    kind: Any = type(value)
    return {name: _plain(getattr(value, name)) for name in _names(kind)}


@functools.cache
def _names(record: Any) -> tuple[str, ...]:
    return tuple(field.name for field in fields(record))
