"""Exemplars that may be shown: photographs that scikit-image carries (CC0), tinted, and stones drawn here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

Rgb = NDArray[np.uint8]

PHOTOGRAPHS = {"gravel": (1.0, 0.93, 0.84), "grass": (0.95, 0.97, 0.8), "brick": (1.0, 0.85, 0.75)}
"""Of scikit-image, 512 pixels a side, gray; and the tints that they are shown in."""
DRAWN = ("marble", "mosaic")
SIDE_PX = 256
_SEED = 7
_CELLS = 12


def stone(name: str) -> Rgb:
    """(256, 256, 3) sRGB of a stone by its name."""
    if name in PHOTOGRAPHS:
        from skimage import data

        gray = np.asarray(getattr(data, name)(), dtype=np.float64)
        small = gray.reshape(SIDE_PX, gray.shape[0] // SIDE_PX, SIDE_PX, gray.shape[1] // SIDE_PX).mean(axis=(1, 3))
        return _rounded(small[..., None] * np.array(PHOTOGRAPHS[name]))
    return {"marble": _marble, "mosaic": _mosaic}[name]()


def study_exemplar(folder: Path) -> Rgb:
    """The exemplar of a texture of the study."""
    with Image.open(folder / "exemplar.png") as image:
        return np.asarray(image.convert("RGB"))


def _marble() -> Rgb:
    """Veins that wander and fork, where warped noise crosses zero, over pale clouds."""
    random = np.random.default_rng(_SEED)
    clouds, wide, narrow, down, right, fine = (_noise(random, sigma) for sigma in (20, 22, 11, 7, 7, 0.8))
    row, col = np.mgrid[:SIDE_PX, :SIDE_PX]
    places = [row + 5 * down, col + 5 * right]
    veins = np.zeros((SIDE_PX, SIDE_PX))
    for noise, width, strength in ((wide, 0.16, 1.0), (narrow, 0.1, 0.55)):
        warped = ndimage.map_coordinates(noise, places, order=1, mode="wrap")
        veins = np.maximum(veins, strength * np.exp(-np.abs(warped) / width))
    veins *= 0.65 + 0.35 * np.tanh(clouds)
    light = 205 + 16 * clouds + 4 * fine
    return _rounded(light[..., None] * np.array([1.0, 0.98, 0.93]) - veins[..., None] * np.array([150.0, 135.0, 105.0]))


def _mosaic() -> Rgb:
    """Cells of several colours around points, with dark joints between them."""
    random = np.random.default_rng(_SEED + 1)
    cells = np.stack(np.mgrid[:_CELLS, :_CELLS], axis=-1).reshape(-1, 2)
    points = (cells + random.uniform(0.1, 0.9, cells.shape)) * SIDE_PX / _CELLS
    colours = np.array([[178.0, 120.0, 88.0], [205.0, 190.0, 160.0], [120.0, 108.0, 98.0], [150.0, 138.0, 120.0]])
    row, col = np.mgrid[:SIDE_PX, :SIDE_PX]
    apart = np.hypot(*(_around(axis[..., None] - points[:, k]) for k, axis in enumerate((row, col))))
    nearest = np.argsort(apart, axis=2)[..., :2]
    first, second = (np.take_along_axis(apart, nearest[..., k : k + 1], axis=2)[..., 0] for k in (0, 1))
    shade = random.normal(0, 10, len(points))
    kind = random.integers(len(colours), size=len(points))
    body = colours[kind[nearest[..., 0]]] + shade[nearest[..., 0]][..., None] + 6 * _noise(random, 0.9)[..., None]
    joint = np.clip((second - first) / 3, 0, 1)[..., None]
    return _rounded(body * joint + 52 * (1 - joint))


def _noise(random: np.random.Generator, sigma: float) -> NDArray[np.float64]:
    noise = ndimage.gaussian_filter(random.normal(size=(SIDE_PX, SIDE_PX)), sigma, mode="wrap")
    return np.asarray(noise / noise.std())


def _around(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((distance + SIDE_PX / 2) % SIDE_PX - SIDE_PX / 2)


def _rounded(values: NDArray[np.float64]) -> Rgb:
    return np.rint(np.clip(values, 0, 255)).astype(np.uint8)
