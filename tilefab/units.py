"""The one place where millimetres, pixels and dots per inch meet."""

from __future__ import annotations

import math

from tilefab.types import SizeMm, SizePx

MM_PER_INCH = 25.4


def px_from_mm(length_mm: float, dpi: float) -> int:
    """Length in whole pixels, rounded to the nearest (halves up), of ``length_mm`` millimetres at ``dpi``.

    >>> px_from_mm(600, 400)
    9449
    """
    return math.floor(length_mm * dpi / MM_PER_INCH + 0.5)


def mm_from_px(length_px: float, dpi: float) -> float:
    """Length in millimetres of ``length_px`` pixels at ``dpi``.

    >>> mm_from_px(400, 400)
    25.4
    """
    return length_px * MM_PER_INCH / dpi


def size_px_from_mm(size: SizeMm, dpi: float) -> SizePx:
    """Size in whole pixels of a physical size at ``dpi``.

    >>> size_px_from_mm(SizeMm(width=600, height=1200), 400)
    SizePx(rows=18898, cols=9449)
    """
    return SizePx(rows=px_from_mm(size.height, dpi), cols=px_from_mm(size.width, dpi))


def square_metres_from_px(pixels: float, dpi: float) -> float:
    """Area in square metres of a number of pixels at ``dpi``.

    >>> round(square_metres_from_px(400 * 400, 400), 8)
    0.00064516
    """
    return pixels * (MM_PER_INCH / dpi / 1000.0) ** 2
