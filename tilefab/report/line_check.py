"""Refuses a line report's view that can't be drawn, naming the field at fault, before a line is drawn."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from tilefab.errors import ReportError
from tilefab.report.line_view import LineReportView, TileView
from tilefab.types import Array

# datetime's range, with a week to spare for time zones.
_EARLIEST_S, _LATEST_S = -62_135_000_000.0, 253_402_000_000.0


def check_line_view(view: LineReportView) -> None:
    """Check every time, number and picture of ``view``.

    Raises
    ------
    ReportError
        Naming the first field that can't be drawn, and what it should be.
    """
    _times((view.begun_s, view.ended_s), "begun_s and ended_s")
    if view.ended_s < view.begun_s:
        raise ReportError(f"ended_s {view.ended_s} is before begun_s {view.begun_s}; give the span in order of time")
    if abs(view.utc_offset_min) > 24 * 60:
        raise ReportError(f"utc_offset_min is {view.utc_offset_min}; it must be within a day")
    _numbers(view.tile_size_mm, "tile_size_mm", low=1e-9)
    for place, tile in enumerate(view.tiles):
        _check_tile(tile, f"tiles[{place}]")
    for place, worst in enumerate(view.worst):
        _check_tile(worst.tile, f"worst[{place}].tile")
        for name in ("predicted", "fired", "difference"):
            _image(getattr(worst, name), f"worst[{place}].{name}")
    _image(view.tile_picture, "tile_picture")
    _check_events(view)
    for place, ink in enumerate(view.inks):
        _numbers((ink.used,), f"inks[{place}].used", low=0.0)
        _numbers(() if ink.saved is None else (ink.saved,), f"inks[{place}].saved")
    if view.variation is not None:
        found = view.variation
        figures = (found.index, found.between_delta_e, found.within_delta_e, found.cmc_plain or 0.0)
        _numbers(figures, "variation", low=0.0)
    limits = view.limits
    for name in limits.__dataclass_fields__:
        value = getattr(limits, name)
        _numbers(() if value is None else (value,), f"limits.{name}", low=0.0)


def _check_events(view: LineReportView) -> None:
    for place, one in enumerate(view.corrections):
        _times((one.at_s,), f"corrections[{place}].at_s")
        cost = one.drift_delta_e
        _numbers(() if cost is None else (cost,), f"corrections[{place}].drift_delta_e", low=0.0)
    for place, zone in enumerate(view.kiln):
        if len(zone.at_s) != len(zone.temp_degc):
            raise ReportError(
                f"kiln[{place}] has {len(zone.at_s)} times and {len(zone.temp_degc)} temperatures; give one for each"
            )
        _times(zone.at_s, f"kiln[{place}].at_s")
        _numbers(zone.temp_degc, f"kiln[{place}].temp_degc")
        _numbers(() if zone.setpoint_degc is None else (zone.setpoint_degc,), f"kiln[{place}].setpoint_degc")
    for place, innovation in enumerate(view.innovations):
        _times((innovation.at_s,), f"innovations[{place}].at_s")
        _numbers((innovation.value,), f"innovations[{place}].value")
    for name in ("holds", "downtime", "alarms"):
        for place, span in enumerate(getattr(view, name)):
            _times((span.begun_s, *(() if span.ended_s is None else (span.ended_s,))), f"{name}[{place}]")
    for place, lot in enumerate(view.lots):
        _times((lot.first_s, lot.last_s), f"lots[{place}]")
        _numbers((*lot.difference_lab, lot.spread_delta_e), f"lots[{place}]")
        _numbers(lot.rgb or (), f"lots[{place}].rgb", low=0.0, high=255.0)
    for place, shift in enumerate(view.shifts):
        _times((shift.begun_s, shift.ended_s), f"shifts[{place}]")


def _check_tile(tile: TileView, name: str) -> None:
    _times((at_s for at_s in (tile.printed_s, tile.fired_s) if at_s is not None), f"{name} printed_s or fired_s")
    colour, dimensions = tile.colour, tile.dimensions
    if colour is not None:
        _numbers((colour.delta_e_mean, colour.delta_e_p95), f"{name}.colour", low=0.0)
        _numbers((*colour.fired_lab, *colour.predicted_lab), f"{name}.colour L*a*b*")
    if dimensions is not None:
        figures = (
            dimensions.width_mm,
            dimensions.height_mm,
            dimensions.size_deviation_percent,
            dimensions.straightness_percent,
            dimensions.rectangularity_percent,
        )
        _numbers(figures, f"{name}.dimensions")
    for place, defect in enumerate(tile.defects):
        _numbers((defect.x_mm, defect.y_mm, defect.width_mm, defect.height_mm), f"{name}.defects[{place}]")


def _times(values: Iterable[float], name: str) -> None:
    for value in values:
        if not (math.isfinite(value) and _EARLIEST_S <= value <= _LATEST_S):
            raise ReportError(f"{name} is {value}; times are seconds since 1970, between the years 1 and 9999")


def _numbers(values: Iterable[float], name: str, *, low: float = -1e300, high: float = 1e300) -> None:
    for value in values:
        if not (math.isfinite(value) and low <= value <= high):
            bounds = f" from {low:g} to {high:g}" if high < 1e300 else f" of at least {low:g}" if low > -1e300 else ""
            raise ReportError(f"{name} is {value}; it must be a finite number{bounds}")


def _image(image: Array | None, name: str) -> None:
    if image is None:
        return
    if not isinstance(image, np.ndarray) or image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        shape, kind = getattr(image, "shape", None), getattr(image, "dtype", type(image).__name__)
        raise ReportError(f"{name} has shape {shape} and type {kind}; a picture must be uint8 RGB (rows, cols, 3)")
    if image.size == 0:
        raise ReportError(f"{name} has shape {image.shape}; a picture must have at least one pixel")
