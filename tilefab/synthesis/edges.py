"""How strongly each pixel looks like the border of something: the first step of the guidance channel.

The paper (Kaspar et al. 2015, section 3.1) takes the structured forests of Dollár and Zitnick (2013), whose trained
weights nobody ships. Here stands the gradient over several scales, which needs none: of fine scales the place, of
coarse ones the judgement of what is grain and what a border.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.types import Mask

SIGMAS_PX = (1.0, 2.0, 4.0)
"""Scales of the gradient."""

_RESPONSE_STEPS = 64


def edge_response(exemplar: NDArray[np.float32], valid: Mask) -> NDArray[np.float32]:
    """Strength of edges, without training: the gradient at σ = 1, 2 and 4 pixels.

    Parameters
    ----------
    exemplar
        (rows, cols, channels) CIELAB, or other channels scaled alike (0 to 100); finite where ``valid``.
    valid
        (rows, cols), True where the exemplar may be used; holes take the colour of the nearest valid pixel.

    Returns
    -------
    numpy.ndarray
        (rows, cols) float32 >= 0, colour difference (CIE76) across an edge of the scale, mean over the scales: a clean
        step of 30 gives some 12. In steps of 1/64, so that the last bits of a platform's arithmetic don't matter.

    Raises
    ------
    ValueError
        If the shapes don't fit, nothing is valid or a valid pixel isn't finite.
    """
    filled = fill_holes(exemplar, valid)
    total = np.zeros(valid.shape)
    for sigma in usable_sigmas(valid.shape):
        squared = np.zeros(valid.shape)
        for channel in range(filled.shape[2]):
            plane = filled[..., channel]
            for axis in (0, 1):
                order = [1 if axis == 0 else 0, 1 if axis == 1 else 0]
                squared += ndimage.gaussian_filter(plane, sigma, order=order, mode="nearest") ** 2
        # Times the scale: a step has the same strength at each, grain finer than the scale less and less.
        total += sigma * np.sqrt(squared)
    response = total / len(usable_sigmas(valid.shape))
    return (np.rint(response * _RESPONSE_STEPS) / _RESPONSE_STEPS).astype(np.float32)


def usable_sigmas(shape: tuple[int, ...]) -> tuple[float, ...]:
    """Those of `SIGMAS_PX` that an exemplar of this shape is large enough for: a sixteenth of the shorter side."""
    return tuple(sigma for sigma in SIGMAS_PX if sigma <= max(1.0, min(shape[:2]) / 16))


def fill_holes(exemplar: NDArray[np.float32], valid: Mask) -> NDArray[np.float64]:
    """Give holes the value of the nearest valid pixel.

    Parameters
    ----------
    exemplar
        (rows, cols, channels), finite where ``valid``.
    valid
        (rows, cols).

    Returns
    -------
    numpy.ndarray
        (rows, cols, channels) float64.

    Raises
    ------
    ValueError
        If the shapes don't fit, nothing is valid or a valid pixel isn't finite.
    """
    if exemplar.ndim != 3 or exemplar.shape[2] < 1 or exemplar.shape[:2] != valid.shape:
        raise ValueError(f"exemplar {exemplar.shape} must be (rows, cols, channels) of its mask's shape {valid.shape}")
    if not valid.any():
        raise ValueError("the exemplar has no valid pixel")
    if not np.isfinite(exemplar[valid]).all():
        raise ValueError("the exemplar has valid pixels that aren't finite")
    if valid.all():
        return exemplar.astype(np.float64)
    rows, cols = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return np.asarray(exemplar[rows, cols], dtype=np.float64)
