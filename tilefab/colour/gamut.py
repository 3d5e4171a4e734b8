"""The gamut of a press and of an image, and the perceptual way of fitting one into the other.

Boundaries are largest chromas by lightness and hue, in the hue-linear space of `tilefab.colour.hue_linear`, of colours
relative to the unprinted tile.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.colour.hue_linear import lab_from_oklab, oklab_from_lab
from tilefab.colour.separation import Separator
from tilefab.colour.spaces import relative_lab

Float64Array = NDArray[np.float64]

_LIGHTNESS_STEPS = 33
_HUE_STEPS = 48
_TOE_SHARE = 0.35
_KNEE_SHARE = 0.8
_LEAST_CHROMA = 1e-4
_DENSER = 4
_FACE_LEVELS = np.array([0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0])
_BLACK_LEVELS = np.array([0.0, 0.1, 0.25, 0.45, 0.7, 1.0])
_MOST_SHARE = 0.995
_VIVID = 1.2


@dataclass(frozen=True)
class GamutBoundary:
    """How far colours reach.

    Attributes
    ----------
    dark, light
        Lowest and highest lightness, Oklab, 0 to 1.
    chroma
        (33, 48) largest chroma, Oklab, at even steps of lightness from ``dark`` to ``light``, for hues 0, 7.5, 15 ...
        degrees.
    """

    dark: float
    light: float
    chroma: Float64Array = field(repr=False)

    def chroma_at(self, lightness: Float64Array, hue_rad: Float64Array) -> Float64Array:
        """Largest chroma (M,) at lightness and hue (M,), linear between the steps."""
        place_l = (lightness - self.dark) / max(self.light - self.dark, 1e-9) * (_LIGHTNESS_STEPS - 1)
        place_h = (hue_rad % (2.0 * np.pi)) * _HUE_STEPS / (2.0 * np.pi)
        wrapped = np.hstack([self.chroma, self.chroma[:, :1]])
        found = ndimage.map_coordinates(wrapped, [np.clip(place_l, 0, _LIGHTNESS_STEPS - 1), place_h], order=1)
        return np.asarray(found, dtype=np.float64)


def boundary_of(lab_relative: Float64Array, *, largest_share: float = 1.0) -> GamutBoundary:
    """Boundary of a set of colours.

    Parameters
    ----------
    lab_relative
        (M, 3), at least one.
    largest_share
        1 takes the largest chroma in each cell of lightness and hue; below, that quantile, which leaves out stray ones.
    """
    oklab = oklab_from_lab(lab_relative)
    stray = 1.0 - largest_share
    dark, light = np.quantile(oklab[:, 0], [stray, 1.0]).tolist()
    chroma = np.hypot(oklab[:, 1], oklab[:, 2])
    row = np.rint((oklab[:, 0] - dark) / max(light - dark, 1e-9) * (_LIGHTNESS_STEPS - 1)).astype(int)
    hue = np.arctan2(oklab[:, 2], oklab[:, 1]) % (2.0 * np.pi)
    col = np.rint(hue * _HUE_STEPS / (2.0 * np.pi)).astype(int) % _HUE_STEPS
    cell = np.clip(row, 0, _LIGHTNESS_STEPS - 1) * _HUE_STEPS + col
    order = np.lexsort((chroma, cell))
    counts = np.bincount(cell, minlength=_LIGHTNESS_STEPS * _HUE_STEPS)
    ends = np.cumsum(counts)
    most = np.full(len(counts), np.nan)
    filled = counts > 0
    skipped = np.floor(counts * stray).astype(int)
    most[filled] = chroma[order][(ends - 1 - skipped)[filled]]
    return GamutBoundary(dark, light, _filled(most.reshape(_LIGHTNESS_STEPS, _HUE_STEPS)))


def _filled(most: Float64Array) -> Float64Array:
    """Cells that no colour fell into, from those around them: along lightness, then along hue."""
    steps = np.arange(len(most))
    out = most.copy()
    for col in range(most.shape[1]):
        known = ~np.isnan(most[:, col])
        if known.any():
            out[:, col] = np.interp(steps, steps[known], most[known, col])
    known = np.asarray(~np.isnan(out).all(axis=0))
    turns = np.arange(3 * _HUE_STEPS)
    for row in range(len(out)):
        line, there = np.tile(out[row], 3), np.tile(known, 3)
        out[row] = np.interp(turns[_HUE_STEPS : 2 * _HUE_STEPS], turns[there], line[there])
    return out


def press_boundary(separator: Separator, white_lab: Float64Array | None = None) -> GamutBoundary:
    """Boundary of what a press prints within its limits.

    Colours are relative to ``white_lab`` (3,), absolute Lab; None: to the press's own unprinted tile. The most
    colourful prints use one or two coloured inks, and black to darken them; they are tried at even steps.
    """
    model, settings = separator.model, separator.settings
    white = separator.white_lab if white_lab is None else white_lab
    black = settings.black_channel
    coloured = [ink for ink in range(model.inks) if ink != black]
    pairs: list[tuple[int, ...]] = [*itertools.combinations(coloured, 2)]
    pairs = pairs or [(ink,) for ink in coloured] or [(0,)]
    blacks = _BLACK_LEVELS if black is not None and coloured else np.zeros(1)
    levels = np.concatenate([[0.0], _FACE_LEVELS])
    found = []
    for chosen in pairs:
        amounts = np.stack(np.meshgrid(*[levels] * len(chosen), blacks, indexing="ij"), axis=-1)
        recipe = np.zeros((*amounts.shape[:-1], model.inks))
        recipe[..., list(chosen)] = amounts[..., :-1]
        if black is not None:
            recipe[..., black] = np.maximum(recipe[..., black], amounts[..., -1])
        flat = separator.feasible(recipe.reshape(-1, model.inks) * separator.upper)
        colours = relative_lab(model.lab(flat), white)
        # Between the recipes tried, colours are nearly straight: many more points for the boundary at no cost.
        grid = colours.reshape(*recipe.shape[:-1], 3)
        places = np.meshgrid(
            *[np.linspace(0.0, n - 1.0, _DENSER * (n - 1) + 1) for n in grid.shape[:-1]], indexing="ij"
        )
        dense = [ndimage.map_coordinates(grid[..., k], places, order=1) for k in range(3)]
        found.append(np.stack(dense, axis=-1).reshape(-1, 3))
    dark = relative_lab(separator.dark_lab, white)
    return boundary_of(np.concatenate([*found, dark[np.newaxis]]))


def compress_lightness(lightness: Float64Array, source_dark: float, dark: float) -> Float64Array:
    """Lift dark tones to what the press can print, smoothly, leaving light tones alone.

    Parameters
    ----------
    lightness
        (...) 0 to 1.
    source_dark, dark
        Darkest lightness that comes in, and the one it becomes. Where the press reaches as deep, nothing changes.

    Returns
    -------
    numpy.ndarray
        (...) rising throughout; equal to the input above the toe.
    """
    if source_dark >= dark:
        return np.asarray(lightness, dtype=np.float64)
    pivot = dark + _TOE_SHARE * (1.0 - dark)
    reach = pivot - source_dark
    bend = (reach / (pivot - dark) - 1.0) / reach
    below = np.maximum(pivot - lightness, 0.0)
    return np.where(lightness < pivot, pivot - below / (1.0 + bend * below), lightness)


def compress_chroma(chroma: Float64Array, most: Float64Array, source: Float64Array | None) -> Float64Array:
    """Compress chroma smoothly below ``most``: unchanged up to 80 % of it, then ever slower.

    Parameters
    ----------
    chroma, most
        (M,) chroma, and the largest that the press has there.
    source
        (M,) largest chroma that comes in there, which becomes ``most``; where it is smaller than ``most``, nothing
        changes. None: without bound.
    """
    knee = _KNEE_SHARE * most
    room = np.maximum(most - knee, 1e-9)
    over = np.maximum(chroma - knee, 0.0) / room
    pull: Float64Array | float = 1.0
    if source is not None:
        farthest = np.maximum(source - knee, 0.0) / room
        pull = np.maximum(1.0 - 1.0 / np.maximum(farthest, 1e-9), 0.0)
    return np.where(chroma > knee, knee + room * over / (1.0 + pull * over), chroma)


def perceptual_map(
    press: GamutBoundary, image: GamutBoundary | None = None, *, vivid: bool = False
) -> Callable[[Float64Array], Float64Array]:
    """A function that fits relative Lab (M, 3) into a press's gamut: lightness first, then chroma, hue kept.

    Parameters
    ----------
    press
        What the press reaches.
    image
        What the image needs, if it is known: only as much is compressed as it takes. None makes room for any colour.
    vivid
        For the saturation intent: chroma is raised by a fifth before it is fitted in.
    """
    source_dark = image.dark if image is not None else 0.0

    def fit(lab_relative: Float64Array) -> Float64Array:
        oklab = oklab_from_lab(lab_relative)
        lightness = np.clip(oklab[:, 0], 0.0, 1.0)
        fitted = compress_lightness(lightness, source_dark, press.dark)
        chroma = np.hypot(oklab[:, 1], oklab[:, 2])
        hue = np.arctan2(oklab[:, 2], oklab[:, 1])
        wanted = chroma * (_VIVID if vivid else 1.0)
        most = np.maximum(press.chroma_at(fitted, hue), _LEAST_CHROMA)
        source = None if image is None else image.chroma_at(lightness, hue) * (_VIVID if vivid else 1.0)
        scale = compress_chroma(wanted, most, source) / np.maximum(chroma, 1e-9)
        return lab_from_oklab(np.column_stack([fitted, oklab[:, 1] * scale, oklab[:, 2] * scale]))

    return fit


def image_boundary(lab_relative: Float64Array) -> GamutBoundary:
    """Boundary of an image's colours (M, 3), stray ones (a half of a percent in each cell) left out."""
    return boundary_of(lab_relative, largest_share=_MOST_SHARE)
