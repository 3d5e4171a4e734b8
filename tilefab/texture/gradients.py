"""How near two textures are in the strength of their edges."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tilefab.types import Array

Plane: TypeAlias = NDArray[np.float64]

MIN_SIDE_PX = 8
LEAST_GRADIENT_DE76 = 0.1
"""Colour difference per pixel that nobody sees: no difference is divided by less."""
_QUANTILES = 2048


def gradient_distance(exemplar_lab: Array, image_lab: Array) -> float:
    """Earth mover's distance between the distributions of gradient magnitude, relative to the exemplar's mean.

    Parameters
    ----------
    exemplar_lab
        (rows, cols, 3) CIELAB, at least 8 a side; finite.
    image_lab
        (rows, cols, 3) CIELAB of the same resolution.

    Returns
    -------
    float
        >= 0: 0.1 means that edges would have to change by a tenth of the exemplar's mean gradient on average. In one
        dimension the distance is the mean difference between the distributions' quantiles.

    Raises
    ------
    ValueError
        If an image has the wrong shape, is too small or isn't finite.
    """
    check_labs(exemplar_lab, image_lab, MIN_SIDE_PX, "a distribution of gradients")
    wanted, found = gradient_magnitude_de76(exemplar_lab), gradient_magnitude_de76(image_lab)
    levels = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    moved = float(np.abs(np.quantile(found, levels) - np.quantile(wanted, levels)).mean())
    return moved / max(float(wanted.mean()), LEAST_GRADIENT_DE76)


def check_labs(exemplar_lab: Array, image_lab: Array, min_side_px: int, purpose: str) -> None:
    """Raise ValueError unless both are finite (rows, cols, 3) of at least ``min_side_px`` a side."""
    for name, lab in (("exemplar", exemplar_lab), ("image", image_lab)):
        if lab.ndim != 3 or lab.shape[2] != 3:
            raise ValueError(f"{name} must be (rows, cols, 3) CIELAB, not {lab.shape}")
        if min(lab.shape[:2]) < min_side_px:
            rows, cols = lab.shape[:2]
            raise ValueError(f"{purpose} needs {min_side_px} x {min_side_px} pixels; {name} is {rows} x {cols}")
        if not np.isfinite(lab).all():
            raise ValueError(f"{name} has values that aren't finite")


def gradient_magnitude_de76(lab: Array) -> Plane:
    """Colour difference per pixel along the steepest way, (rows - 1, cols - 1), of (rows, cols, 3) CIELAB.

    Differences to the next pixel rather than across two, which would not see the finest detail; all three channels
    added up in squares.
    """
    down = np.diff(lab.astype(np.float64), axis=0)[:, :-1]
    right = np.diff(lab.astype(np.float64), axis=1)[:-1]
    return np.asarray(np.sqrt((down**2 + right**2).sum(axis=2)))
