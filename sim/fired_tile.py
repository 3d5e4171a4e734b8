"""A fired tile, made of what was really printed on it: prints in their places, with their flaws, on the bare glaze."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.kiln import Firing
from sim.plant.physics.flaws import Flaw
from sim.scanner import fired_rgb
from sim.spectral_press import SpectralPress

Pixels = NDArray[np.unsignedinteger]

_MOST_PX = 8192


@dataclass(frozen=True, eq=False)
class LaidPrint:
    """Print data (rows, cols, N), uint8 or uint16, 0 = no ink, and where it lies on a tile.

    Attributes
    ----------
    pitch_mm
        From row to row, and from column to column.
    offset_mm
        From the tile's leading edge to the first row; below 0 if that is printed beside the tile.
    flaws
        What the head did wrong.
    """

    pixels: Pixels = field(repr=False)
    pitch_mm: float
    offset_mm: float
    flaws: tuple[Flaw, ...] = ()


def flawed(print_: LaidPrint) -> Pixels:
    """Print data (rows, cols, N) with its flaws in it, except for those that need further rows."""
    pixels, most = print_.pixels, np.iinfo(print_.pixels.dtype).max
    for flaw in print_.flaws:
        if flaw.kind == "nozzle" and 0 <= flaw.ink < pixels.shape[2]:
            first = math.floor(pixels.shape[1] / 2.0 + (flaw.at_mm - flaw.width_mm / 2.0) / print_.pitch_mm + 0.5)
            wide = max(1, round(flaw.width_mm / print_.pitch_mm))
            pixels = pixels.copy()
            pixels[flaw.from_row :, max(0, first) : max(0, first + wide), flaw.ink] = 0
        elif flaw.kind == "banding":
            rows = np.arange(len(pixels)) * print_.pitch_mm / (flaw.period_mm or 1.0)
            share = 1.0 + flaw.strength * np.sin(2.0 * np.pi * rows).astype(np.float32)
            pixels = np.rint(np.clip(pixels * share[:, np.newaxis, np.newaxis], 0, most)).astype(pixels.dtype)
    return pixels


def inks_on_tile(prints: Sequence[LaidPrint], size_mm: tuple[float, float], inks: int) -> tuple[Pixels, float, float]:
    """What lies on a tile, on the grid of its first print.

    Prints lie in the middle across the travel. Where two lie on each other, their inks add up to at most full covers.

    Parameters
    ----------
    prints
        At least one.
    size_mm
        The tile's width across the travel, and its length along it.
    inks
        How many inks the press has; those that prints haven't are laid nowhere.

    Returns
    -------
    pixels
        (rows, cols, inks) in the first print's data type, over the whole tile and up to a pixel beyond.
    row0_mm, col0_mm
        Places of its first row's and first column's outer edges on the tile; not above 0.

    Raises
    ------
    ValueError
        If the tile has more than 8,192 pixels a side.
    """
    first = prints[0]
    pitch, dtype = first.pitch_mm, first.pixels.dtype
    width, length = size_mm
    left = (width - first.pixels.shape[1] * pitch) / 2.0
    row0, col0 = math.floor(-first.offset_mm / pitch + 1e-9), math.floor(-left / pitch + 1e-9)
    row0_mm, col0_mm = first.offset_mm + row0 * pitch, left + col0 * pitch
    shape = (math.ceil((length - row0_mm) / pitch - 1e-9), math.ceil((width - col0_mm) / pitch - 1e-9))
    if max(shape) > _MOST_PX:
        raise ValueError(f"a tile of {shape[0]} x {shape[1]} pixels is larger than {_MOST_PX} a side")
    laid = np.zeros((*shape, inks), dtype=np.uint32)
    for print_ in prints:
        pixels = flawed(print_)
        col = round(((width - pixels.shape[1] * pitch) / 2.0 - col0_mm) / pitch)
        row = round((print_.offset_mm - row0_mm) / pitch)
        _add(laid, pixels, row, col)
        for flaw in print_.flaws:
            if flaw.kind == "double_print":
                again = np.rint(pixels * np.float32(flaw.strength)).astype(np.uint32)
                _add(laid, again, row + round(flaw.shift_mm / pitch), col)
    return np.minimum(laid, np.iinfo(dtype).max).astype(dtype), row0_mm, col0_mm


def _add(laid: NDArray[np.uint32], pixels: Pixels, row: int, col: int) -> None:
    """Add print data to a canvas, its first row and column at these."""
    rows, cols, inks = laid.shape
    top, left = max(0, row), max(0, col)
    part = pixels[top - row : max(0, rows - row), left - col : max(0, cols - col), :inks]
    laid[top : top + part.shape[0], left : left + part.shape[1], : part.shape[2]] += part


def fired_tile(
    prints: Sequence[LaidPrint],
    size_mm: tuple[float, float],
    press: SpectralPress,
    firing: Firing | None = None,
    *,
    px_per_mm: float,
) -> NDArray[np.float32]:
    """A fired tile in linear sRGB (rows, cols, 3), its leading edge above, every print pixel an even patch.

    Parameters
    ----------
    prints
        What was printed on it, in its order; without any the tile is bare.
    size_mm
        The tile's width across the travel, and its length along it.
    press
        The press that printed it.
    firing
        The firing; None is the normal one.
    px_per_mm
        Pixels a millimetre; prints and edges lie as exactly as half a pixel.
    """
    shape = (max(1, round(size_mm[1] * px_per_mm)), max(1, round(size_mm[0] * px_per_mm)))
    inks = len(press.ink_names)
    if not prints:
        bare = fired_rgb(np.zeros((1, 1, inks), dtype=np.uint8), press, firing)
        return np.ascontiguousarray(np.broadcast_to(bare, (*shape, 3)))
    laid, row0_mm, col0_mm = inks_on_tile(prints, size_mm, inks)
    fired = fired_rgb(laid, press, firing)
    pitch = prints[0].pitch_mm
    row, col = (
        np.minimum(((np.arange(count) + 0.5) / px_per_mm - start) / pitch, limit - 1).astype(np.int64)
        for count, start, limit in zip(shape, (row0_mm, col0_mm), fired.shape[:2], strict=True)
    )
    return np.asarray(fired[row[:, np.newaxis], col], dtype=np.float32)
