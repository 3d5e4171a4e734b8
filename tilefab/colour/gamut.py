"""The gamut of a press, and the perceptual way of fitting colours into it.

Everything here is in Lab relative to the unprinted tile.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.colour.separation import Separator
from tilefab.colour.spaces import absolute_lab, relative_lab

Float64Array = NDArray[np.float64]

_LIGHTNESS_STEPS = 25
_HUE_STEPS = 48
_BEYOND_CHROMA = 130.0
_CHROMA_PULL = 0.05
_TOE_SHARE = 0.35
_KNEE_SHARE = 0.8


def compress_lightness(lightness: Float64Array, dark_l: float) -> Float64Array:
    """Lift the darkest lightness to what the press can print, smoothly, leaving light tones alone.

    Parameters
    ----------
    lightness
        (...) L*, 0 to 100.
    dark_l
        Darkest printable L*; 0 becomes this.

    Returns
    -------
    numpy.ndarray
        (...) L*, rising throughout; equal to the input above the toe.
    """
    pivot = dark_l + _TOE_SHARE * (100.0 - dark_l)
    bend = dark_l / (pivot * (pivot - dark_l))
    below = np.maximum(pivot - lightness, 0.0)
    return np.where(lightness < pivot, pivot - below / (1.0 + bend * below), lightness)


def compress_chroma(chroma: Float64Array, most: Float64Array) -> Float64Array:
    """Compress chroma smoothly below ``most``: unchanged up to 80 % of it, then ever slower towards it."""
    knee = _KNEE_SHARE * most
    room = np.maximum(most - knee, 1e-6)
    over = np.maximum(chroma - knee, 0.0) / room
    return np.where(chroma > knee, knee + room * over / (1.0 + over), chroma)


def chroma_limits(separator: Separator, white_lab: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Largest chroma that the press prints, by lightness and hue.

    Parameters
    ----------
    separator
        The press model turned round, with its limits.
    white_lab
        (3,) absolute Lab of the unprinted tile.

    Returns
    -------
    lightness
        (25,) relative L* from the darkest to 100.
    most
        (25, 48) relative chroma at those, for hues 0, 7.5, 15 … degrees.
    """
    dark_l = float(relative_lab(separator.dark_lab, white_lab)[0])
    lightness = np.linspace(dark_l, 100.0, _LIGHTNESS_STEPS)
    hue = np.arange(_HUE_STEPS) * 2.0 * np.pi / _HUE_STEPS
    grid_l, grid_h = (part.reshape(-1) for part in np.meshgrid(lightness, hue, indexing="ij"))
    direction = np.stack([np.cos(grid_h), np.sin(grid_h)], axis=1)
    beyond = np.column_stack([grid_l, _BEYOND_CHROMA * direction])
    metric = np.zeros((len(beyond), 3, 3))
    metric[:, 0, 0] = 1.0
    metric[:, 1, 1:] = _CHROMA_PULL * direction
    metric[:, 2, 1] = -direction[:, 1]
    metric[:, 2, 2] = direction[:, 0]
    # Begin from the solution for half that chroma, which already leans the right way.
    gentle = np.column_stack([grid_l, 0.3 * _BEYOND_CHROMA * direction])
    start = separator.separate(absolute_lab(gentle, white_lab))
    inks = separator.solve(
        absolute_lab(beyond, white_lab),
        start=start,
        anchor=start,
        pull=np.full_like(start, 1e-4),
        metric=metric,
        iterations=60,
    )
    reached = relative_lab(separator.model.lab(inks), white_lab)
    most = np.maximum((reached[:, 1:] * direction).sum(axis=1), 0.0).reshape(len(lightness), len(hue))
    smooth = ndimage.gaussian_filter(most, sigma=(0.7, 0.7), mode=("nearest", "wrap"))
    return lightness, np.minimum(most, smooth)


def perceptual_map(separator: Separator, white_lab: Float64Array) -> Callable[[Float64Array], Float64Array]:
    """A function that fits relative Lab (M, 3) into the gamut: lightness first, then chroma, hue kept."""
    lightness, most = chroma_limits(separator, white_lab)
    step_l = float(lightness[1] - lightness[0])

    def fit(lab: Float64Array) -> Float64Array:
        fitted_l = compress_lightness(np.clip(lab[:, 0], 0.0, 100.0), float(lightness[0]))
        chroma = np.hypot(lab[:, 1], lab[:, 2])
        hue = np.arctan2(lab[:, 2], lab[:, 1]) % (2.0 * np.pi)
        place_l = (fitted_l - lightness[0]) / step_l
        place_h = hue * _HUE_STEPS / (2.0 * np.pi)
        wrapped = np.hstack([most, most[:, :1]])
        limit = ndimage.map_coordinates(wrapped, [place_l, place_h], order=1, mode="nearest")
        scale = compress_chroma(chroma, limit) / np.maximum(chroma, 1e-9)
        return np.column_stack([fitted_l, lab[:, 1] * scale, lab[:, 2] * scale])

    return fit
