"""A fired chart tile under a flatbed or camera: blurred, turned, unevenly lit, noisy, on a neutral backing."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sim.inks import Spectrum, xyz_from_reflectance
from sim.kiln import Firing
from sim.spectral_press import SpectralPress

# XYZ under D50 to linear sRGB: IEC 61966-2-1 primaries, adapted to D65 by Bradford's matrix.
_RGB_FROM_XYZ_D50 = np.array(
    [
        [3.1338561, -1.6168667, -0.4906146],
        [-0.9787684, 1.9161415, 0.0334540],
        [0.0719453, -0.2289914, 1.4052427],
    ]
)
_CURVE_STEPS = 1 << 14


def _srgb(linear: Spectrum) -> Spectrum:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0) ** (1.0 / 2.4) - 0.055)


def unique_recipes(pixels: NDArray[np.unsignedinteger]) -> tuple[NDArray[np.unsignedinteger], NDArray[np.int64]]:
    """Distinct recipes (U, N) of print data (rows, cols, N), and each pixel's place among them, (rows, cols)."""
    inks = pixels.shape[-1]
    flat = pixels.reshape(-1, inks)
    place: NDArray[np.int64] = np.zeros(len(flat), dtype=np.int64)
    # Four channels at a time fit an integer, which sorts much faster than rows do.
    for first in range(0, inks, 4):
        packed = np.zeros(len(flat), dtype=np.uint64)
        for ink in range(first, min(first + 4, inks)):
            packed = (packed << np.uint64(16)) | flat[:, ink].astype(np.uint64)
        words, part = np.unique(packed, return_inverse=True)
        place = np.unique(place * len(words) + part, return_inverse=True)[1]
    sample = np.zeros(int(place.max()) + 1, dtype=np.int64)
    sample[place] = np.arange(len(flat))
    return flat[sample], place.reshape(pixels.shape[:-1])


def fired_rgb(
    pixels: NDArray[np.unsignedinteger], press: SpectralPress, firing: Firing | None = None
) -> NDArray[np.float32]:
    """Linear sRGB (rows, cols, 3), 0 to 1, of a fired tile.

    Parameters
    ----------
    pixels
        (rows, cols, N) print data, uint8 or uint16, 0 = no ink.
    press
        The press that prints it.
    firing
        The firing; None is the normal one.

    Raises
    ------
    ValueError
        If the print data isn't (rows, cols, N) unsigned integers of the press's inks.
    """
    if pixels.ndim != 3 or pixels.shape[2] != len(press.ink_names) or pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"print data must be uint8 or uint16, (rows, cols, {len(press.ink_names)})")
    recipes, place = unique_recipes(pixels)
    xyz = xyz_from_reflectance(press.reflectance(recipes / float(np.iinfo(pixels.dtype).max), firing))
    colours = np.clip(xyz @ _RGB_FROM_XYZ_D50.T, 0.0, 1.0).astype(np.float32)
    return np.asarray(colours[place], dtype=np.float32)


def srgb_bytes(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear light of any shape through the curve of sRGB (IEC 61966-2-1), in 8 bits; what is outside 0 to 1 is cut."""
    curve = np.rint(255.0 * _srgb(np.linspace(0.0, 1.0, _CURVE_STEPS))).astype(np.uint8)
    steps = np.rint(np.clip(linear, 0.0, 1.0) * np.float32(_CURVE_STEPS - 1)).astype(np.int32)
    return np.asarray(curve[steps], dtype=np.uint8)


def scan_of(
    pixels: NDArray[np.unsignedinteger],
    press: SpectralPress,
    generator: np.random.Generator,
    *,
    rotation_deg: float = 0.0,
    scale: float = 1.0,
    margin_frac: float = 0.05,
    blur_px: float = 0.7,
    unevenness: float = 0.03,
    noise: float = 0.004,
    backing: float = 0.45,
    firing: Firing | None = None,
) -> NDArray[np.uint8]:
    """An sRGB scan (rows, cols, 3), uint8, of a fired tile, as a colorimetric scanner or camera sees it.

    Parameters
    ----------
    pixels
        (rows, cols, N) print data, uint8 or uint16, 0 = no ink.
    press
        The press that prints it.
    generator
        Source of the noise and of the light's direction.
    rotation_deg
        How far the tile lies turned, counter-clockwise, degrees.
    scale
        Resolution of the scan over that of the print.
    margin_frac
        Backing seen around the turned tile, share of its longer side.
    blur_px
        Standard deviation of the scanner's blur, scan pixels.
    unevenness
        How much brighter one side of the scan is lit than its middle, share.
    noise
        Standard deviation of each pixel's linear light where it is white, less where it is dark.
    backing
        Linear light of the neutral backing, 0 to 1.
    firing
        The firing; None is the normal one.

    Raises
    ------
    ValueError
        If the print data isn't (rows, cols, N) unsigned integers of the press's inks, or the scale isn't positive.
    """
    colours = fired_rgb(pixels, press, firing)
    if not scale > 0.0:
        raise ValueError(f"scale {scale} must be more than 0")

    angle = math.radians(rotation_deg)
    cos, sin = math.cos(angle), math.sin(angle)
    high, wide = pixels.shape[0] * scale, pixels.shape[1] * scale
    margin = 2.0 * margin_frac * max(high, wide)
    rows = math.ceil(abs(cos) * high + abs(sin) * wide + margin)
    cols = math.ceil(abs(sin) * high + abs(cos) * wide + margin)
    # From a scan pixel to the print's: turn back about the middles of both, pixel centres at +0.5.
    turn = np.array([[cos, sin], [-sin, cos]]) / scale
    middle = np.array(pixels.shape[:2]) / 2.0 - 0.5
    shift = middle - turn @ (np.array([rows, cols]) / 2.0 - 0.5)

    down = np.linspace(-1.0, 1.0, rows, dtype=np.float32)[:, np.newaxis]
    across = np.linspace(-1.0, 1.0, cols, dtype=np.float32)[np.newaxis, :]
    towards = float(generator.uniform(0.0, 2.0 * math.pi))
    light = 1.0 + np.float32(unevenness) * (math.sin(towards) * down + math.cos(towards) * across) / math.sqrt(2.0)
    light = light - np.float32(0.5 * unevenness) * (down * down + across * across) / 2.0

    out = np.empty((rows, cols, 3), dtype=np.uint8)
    for channel in range(3):
        plane = colours[:, :, channel]
        if scale < 1.0:
            # A scan pixel gathers the light of all print pixels under it.
            plane = ndimage.gaussian_filter(plane, 0.4 * math.sqrt(1.0 / scale**2 - 1.0), mode="nearest")
        seen = ndimage.affine_transform(
            plane, turn, shift, output_shape=(rows, cols), order=1, mode="constant", cval=backing, prefilter=False
        )
        seen = ndimage.gaussian_filter(seen, blur_px) * light
        scatter = np.float32(noise) * generator.standard_normal((rows, cols), dtype=np.float32)
        seen += scatter * np.sqrt(np.clip(seen, 0.0, 1.0) + np.float32(0.02))
        out[:, :, channel] = srgb_bytes(seen)
    return out
