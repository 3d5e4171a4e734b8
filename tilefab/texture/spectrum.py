"""How near two textures are in their radial power spectra: how much contrast there is at each scale."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tilefab.types import Array

Plane: TypeAlias = NDArray[np.float64]

MIN_SIDE_PX = 16
"""The smallest side that has a spectrum worth the name."""
_BINS_PER_OCTAVE = 4
_LOWEST_CYCLES = 2
"""Fewer cycles per window are brightness falling off across it, and the window's own main lobe."""
_FLOOR = 0.01
"""Spectral density that rounding to 8 bits makes, (100 / 255)^2 / 12 in CIELAB units: what lies below isn't texture."""


def radial_psd_distance(exemplar: Array, image: Array) -> float:
    """Root mean square difference between the radial log power spectral densities of two images of one channel.

    Parameters
    ----------
    exemplar
        (rows, cols), the texture as it should be, at least 16 pixels a side, in CIELAB units; finite.
    image
        (rows, cols) of the same channel and resolution, at least 16 pixels a side.

    Returns
    -------
    float
        >= 0, in natural logarithms of power: 0.2 means that the contrast at the typical scale is off by some 10 %.
        0 for the same image.

    Raises
    ------
    ValueError
        If an image isn't two-dimensional, is too small or isn't finite.

    Notes
    -----
    Both spectra are means over half-overlapping Hann windows (Welch 1967) no larger than the smaller image, so that
    frequencies in cycles per pixel and leakage across borders are the same for both, whatever their sizes. Bins are a
    quarter of an octave wide, from two cycles per window to the Nyquist frequency. Phase noise with the right
    spectrum scores 0 here; the Portilla-Simoncelli statistics catch it.
    """
    check_planes(exemplar, image, MIN_SIDE_PX, "a radial spectrum")
    rows, cols = min(exemplar.shape[0], image.shape[0]), min(exemplar.shape[1], image.shape[1])
    _, wanted = radial_psd(exemplar, rows, cols)
    _, found = radial_psd(image, rows, cols)
    return float(np.sqrt(np.mean((np.log(found + _FLOOR) - np.log(wanted + _FLOOR)) ** 2)))


def radial_psd(plane: Array, window_rows: int, window_cols: int) -> tuple[Plane, Plane]:
    """Radial power spectral density by windows, from low frequencies to high.

    Parameters
    ----------
    plane
        (rows, cols) of one channel.
    window_rows, window_cols
        Size of the windows in pixels, no larger than the plane.

    Returns
    -------
    frequency
        (n,) cycles per pixel, the mean of each quarter of an octave that any frequency falls into.
    density
        (n,) mean power spectral density there, squared units of the channel x pixels.
    """
    taper = np.outer(_hann(window_rows), _hann(window_cols))
    total = np.zeros((window_rows, window_cols // 2 + 1))
    tops, lefts = _starts(plane.shape[0], window_rows), _starts(plane.shape[1], window_cols)
    mean = float(plane.mean())
    for top in tops:
        for left in lefts:
            window = (plane[top : top + window_rows, left : left + window_cols] - mean) * taper
            total += np.abs(fft.rfft2(window)) ** 2
    density = total / (len(tops) * len(lefts) * float((taper**2).sum()))
    frequency = np.hypot(fft.fftfreq(window_rows)[:, None], fft.rfftfreq(window_cols)[None, :])
    lowest = _LOWEST_CYCLES / min(window_rows, window_cols)
    used = (frequency >= lowest) & (frequency <= 0.5)
    bins = np.floor(np.log2(frequency[used] / lowest) * _BINS_PER_OCTAVE).astype(np.int64)
    # The last bin is cut off by the Nyquist frequency: what falls there joins the one before.
    bins = np.minimum(bins, max(0, int(math.log2(0.5 / lowest) * _BINS_PER_OCTAVE) - 1))
    counts = np.bincount(bins)
    filled = counts > 0
    frequencies = np.bincount(bins, weights=frequency[used])[filled] / counts[filled]
    return frequencies, np.bincount(bins, weights=density[used])[filled] / counts[filled]


def check_planes(exemplar: Array, image: Array, min_side_px: int, purpose: str) -> None:
    """Raise ValueError unless both are finite (rows, cols) of at least ``min_side_px`` a side."""
    for name, plane in (("exemplar", exemplar), ("image", image)):
        if plane.ndim != 2:
            raise ValueError(f"{name} must be (rows, cols), not {plane.shape}")
        if min(plane.shape) < min_side_px:
            rows, cols = plane.shape
            raise ValueError(f"{purpose} needs {min_side_px} x {min_side_px} pixels; {name} is {rows} x {cols}")
        if not np.isfinite(plane).all():
            raise ValueError(f"{name} has values that aren't finite")


def _hann(length: int) -> Plane:
    return np.asarray(np.sin(math.pi * (np.arange(length) + 0.5) / length) ** 2)


def _starts(length: int, window: int) -> list[int]:
    """Where windows begin so that they cover the length evenly, half overlapping or a little more."""
    steps = -(-2 * (length - window) // window)
    return [round(i * (length - window) / steps) for i in range(steps + 1)] if steps else [0]
