"""Refuses a view model that can't be drawn, naming the field at fault, before a line is drawn."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from tilefab.errors import ReportError
from tilefab.report.view_model import ColourView, HistogramView, RunReportView, TextureMapView
from tilefab.types import Array

_MOST_PICTURES = 4
_CHARTS = 2


def check_view(view: RunReportView) -> None:
    """Check every picture, number and array of ``view``.

    Raises
    ------
    ReportError
        Naming the first field that can't be drawn, and what it should be.
    """
    _check_image(view.wall_preview, "wall_preview")
    if view.max_contact_faces < 1:
        raise ReportError(f"max_contact_faces is {view.max_contact_faces}; it must be at least 1")
    for place, face in enumerate(view.faces):
        if face.thumbnail is not None:
            _check_image(face.thumbnail, f"faces[{place}].thumbnail")
        if not face.code:
            raise ReportError(f"faces[{place}].code is empty; a face's QR code needs the string that re-creates it")
    _check_colour(view.colour)
    _check_texture_map(view.texture_map)


def _check_colour(colour: ColourView) -> None:
    limit = () if colour.ink_limit_percent is None else (("ink_limit_percent", colour.ink_limit_percent),)
    named = (
        *limit,
        ("max_total_ink_percent", colour.max_total_ink_percent),
        ("mean_total_ink_percent", colour.mean_total_ink_percent),
        ("delta_e_mean", colour.delta_e_mean),
        ("delta_e_p95", colour.delta_e_p95),
        ("out_of_gamut_mean", colour.out_of_gamut_mean),
        ("out_of_gamut_p95", colour.out_of_gamut_p95),
    )
    for name, value in named:
        _check_numbers((value,), f"colour.{name}", low=0.0)
    for name, value in (
        ("share_limited", colour.share_limited),
        ("out_of_gamut_share", colour.out_of_gamut_share),
    ):
        _check_numbers((value,), f"colour.{name}", low=0.0, high=1.0)
    for place, ink in enumerate(colour.inks):
        figures = (ink.mean_percent, ink.max_percent, ink.full_coverage_m2_per_m2)
        _check_numbers(figures, f"colour.inks[{place}]", low=0.0)
    for place, swatch in enumerate(colour.swatches):
        where = f"colour.swatches[{place}]"
        _check_numbers((*swatch.lab_slab, *swatch.lab_printed), f"{where} L*a*b*")
        _check_numbers((swatch.delta_e_2000,), f"{where}.delta_e_2000", low=0.0)
        _check_numbers((swatch.share,), f"{where}.share", low=0.0, high=1.0)
        _check_numbers((*swatch.rgb_slab, *swatch.rgb_printed), f"{where} rgb", low=0.0, high=255.0)
    _check_table(colour.slab_lab_sample, "colour.slab_lab_sample", 3)
    _check_table(colour.gamut_ab, "colour.gamut_ab", 2)
    _check_table(colour.gamut_lc, "colour.gamut_lc", 2)


def _check_texture_map(texture_map: TextureMapView) -> None:
    if not 1 <= len(texture_map.pictures) <= _MOST_PICTURES:
        raise ReportError(f"texture_map.pictures are {len(texture_map.pictures)}; show one to {_MOST_PICTURES}")
    if len(texture_map.charts) != _CHARTS:
        raise ReportError(f"texture_map.charts are {len(texture_map.charts)}; show {_CHARTS}")
    for place, picture in enumerate(texture_map.pictures):
        _check_image(picture.image, f"texture_map.pictures[{place}].image")
    for place, chart in enumerate(texture_map.charts):
        _check_histogram(chart.histogram, f"texture_map.charts[{place}].histogram")


def _check_image(image: Array, name: str) -> None:
    shape = getattr(image, "shape", None)
    if not isinstance(image, np.ndarray) or image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        kind = getattr(image, "dtype", type(image).__name__)
        raise ReportError(f"{name} has shape {shape} and type {kind}; a picture must be uint8 RGB (rows, cols, 3)")
    if image.size == 0:
        raise ReportError(f"{name} has shape {shape}; a picture must have at least one pixel")


def _check_numbers(values: Iterable[float], name: str, *, low: float = -1e300, high: float = 1e300) -> None:
    for value in values:
        if not (math.isfinite(value) and low <= value <= high):
            bounds = f" from {low:g} to {high:g}" if high < 1e300 else " of 0 or more" if low == 0 else ""
            raise ReportError(f"{name} is {value}; it must be a finite number{bounds}")


def _check_table(table: Array, name: str, columns: int) -> None:
    if table.ndim != 2 or table.shape[1] != columns or table.dtype.kind not in "iuf":
        raise ReportError(f"{name} has shape {table.shape} of {table.dtype}; it must hold numbers (K, {columns})")
    if not bool(np.isfinite(table).all()) or bool((np.abs(table.astype(np.float64)) > 1e12).any()):
        raise ReportError(f"{name} holds a value that is not finite; leave such colours out")


def _check_histogram(histogram: HistogramView, name: str) -> None:
    edges, counts = histogram.edges, histogram.counts
    if edges.ndim != 1 or counts.ndim != 1 or edges.dtype.kind not in "iuf" or counts.dtype.kind not in "iuf":
        raise ReportError(f"{name} must be a row of edges and a row of counts, both numbers")
    if counts.size == 0:
        return
    if edges.size != counts.size + 1:
        raise ReportError(f"{name} has {edges.size} edges and {counts.size} counts; there must be one edge more")
    if not bool(np.isfinite(edges).all()) or not bool(np.isfinite(counts).all()) or bool((counts < 0).any()):
        raise ReportError(f"{name} holds a value that is not finite, or a count below 0")
    if not bool((np.diff(edges.astype(np.float64)) > 0).all()):
        raise ReportError(f"{name} has edges that don't rise")
