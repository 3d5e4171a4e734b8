"""Small made-up tiles for the tests of defects: inks, a press of four filters, and a camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.colour.spaces import WHITE_XYZ_D50, lab_from_xyz
from tilefab.inspection.defects import find_defects
from tilefab.inspection.records import Defect
from tilefab.types import FloatImage

PX_PER_MM = 8.0
# What a full cover of each ink lets through, of X, Y and Z: blue, brown, yellow, black.
_FILTERS = np.array([[0.25, 0.28, 0.55], [0.45, 0.35, 0.2], [0.85, 0.85, 0.25], [0.08, 0.08, 0.08]])


def press_light(ink_frac: NDArray[np.floating]) -> NDArray[np.float64]:
    """Linear light (..., 3), XYZ over the white's, of ink fractions (..., 4)."""
    inks = np.asarray(ink_frac, dtype=np.float64)
    return np.asarray(0.85 * np.prod(1.0 - inks[..., np.newaxis] * (1.0 - _FILTERS), axis=-2))


def press_lab(ink_frac: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIELAB of ink fractions."""
    return lab_from_xyz(press_light(ink_frac) * np.array(WHITE_XYZ_D50))


def stone_inks(seed: int, rows: int = 256, cols: int = 256) -> FloatImage:
    """Ink fractions (rows, cols, 4) of a stone with grain and veins; every ink has a pattern of its own."""
    random = np.random.default_rng(seed)
    planes = []
    for level, swing in ((0.15, 0.2), (0.35, 0.35), (0.3, 0.25), (0.2, 0.25)):
        grain = sum(
            ndimage.gaussian_filter(random.standard_normal((rows, cols)), sigma, mode="wrap") * sigma
            for sigma in (1.2, 4.0, 12.0)
        )
        planes.append(np.clip(level + swing * grain / (3.0 * np.std(grain)), 0.0, 1.0))
    return np.stack(planes, axis=-1).astype(np.float32)


def photographed(
    light: NDArray[np.floating], seed: int, *, shift_px: float = 0.2, blur_px: float = 0.6, noise: float = 0.003
) -> FloatImage:
    """CIELAB (rows, cols, 3) of a tile's light as a camera sees it, registered but for a shift."""
    random = np.random.default_rng(seed)
    rows, cols = light.shape[:2]
    fall = 1.0 + 0.04 * np.linspace(-1.0, 1.0, cols) - 0.03 * np.linspace(-1.0, 1.0, rows)[:, np.newaxis] ** 2
    out = np.empty((rows, cols, 3))
    for channel in range(3):
        plane = ndimage.shift(
            np.asarray(light[..., channel], dtype=np.float64), (shift_px, -shift_px), order=1, mode="nearest"
        )
        plane = ndimage.gaussian_filter(plane, blur_px) * fall
        out[..., channel] = plane + noise * np.sqrt(np.maximum(plane, 0.0) + 0.02) * random.standard_normal(
            (rows, cols)
        )
    return lab_from_xyz(out * np.array(WHITE_XYZ_D50)).astype(np.float32)


def drifted_light(ink_frac: NDArray[np.floating]) -> NDArray[np.float64]:
    """Light of a firing that fades the blue by 12 % and the black by 5 %, and yellows the glaze."""
    faded = np.asarray(ink_frac, dtype=np.float64) * np.array([0.88, 1.0, 1.0, 0.95])
    return press_light(faded) * np.array([0.99, 0.985, 0.96])


def defects_of(
    inks: FloatImage, light: NDArray[np.floating], seed: int = 5, *, with_press: bool = True
) -> tuple[Defect, ...]:
    """Defects found on a tile printed with inks that sends out the light given."""
    predicted = press_lab(inks.astype(np.float64)).astype(np.float32)
    return find_defects(
        predicted,
        photographed(light, seed),
        np.ones(inks.shape[:2], dtype=bool),
        PX_PER_MM,
        inks=inks,
        press=press_lab if with_press else None,
    )
