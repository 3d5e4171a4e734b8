"""Colours of a scan into XYZ, through its ICC profile with Little CMS.

Little CMS gives floating point out, so nothing is resampled behind our back. Large images go through in strips of
rows, which bounds memory and feeds several threads; every pixel is computed alone, so strips and threads never change
a value.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, get_args

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, rgb_lin_from_srgb
from tilefab.colour.transform import Intent
from tilefab.errors import ProfileError

_INTENT_NUMBERS = {"perceptual": 0, "relative": 1, "saturation": 2, "absolute": 3}
_STRIP_PIXELS = 1 << 18
_SCAN_SPACES = {b"GRAY": (1, "gray"), b"RGB ": (3, "rgb"), b"CMYK": (4, "cmyk")}
_INK_SCALE = np.float32(100.0)  # Little CMS counts ink in percent in floating point


def _intent_number(intent: str) -> int:
    if intent not in _INTENT_NUMBERS:
        raise ValueError(f"intent {intent!r} is none of {', '.join(get_args(Intent))}")
    return _INTENT_NUMBERS[intent]


def _in_strips(
    convert: Callable[[NDArray[Any]], NDArray[np.float32]],
    image: NDArray[Any],
    channels_out: int,
    threads: int,
) -> NDArray[np.float32]:
    """Convert an image strip by strip, on ``threads`` threads."""
    if threads < 1:
        raise ValueError(f"threads {threads} must be 1 or more")
    rows, cols = image.shape[:2]
    out = np.empty((rows, cols, channels_out), dtype=np.float32)
    step = max(1, _STRIP_PIXELS // max(cols, 1))

    def one(start: int) -> None:
        strip = np.ascontiguousarray(image[start : start + step])
        out[start : start + step] = convert(strip)

    starts = range(0, rows if cols else 0, step)
    if threads == 1 or len(starts) < 2:
        for start in starts:
            one(start)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(one, starts))
    return out


def _cms(
    data: NDArray[Any], source: bytes, target: bytes, space_in: str, space_out: str, intent: int
) -> NDArray[np.float32]:
    try:
        result = imagecodecs.cms_transform(
            data, source, target, colorspace=space_in, outcolorspace=space_out, outdtype="f4", intent=intent
        )
    except imagecodecs.CmsError as error:
        raise ProfileError(
            f"Little CMS can't use the ICC profile ({error}): the profile is damaged or lacks the tables "
            "for this conversion; export it anew or choose another profile"
        ) from error
    return np.asarray(result, dtype=np.float32)


def scan_to_xyz(
    pixels: NDArray[Any], profile: bytes | None, *, intent: Intent = "relative", threads: int = 1
) -> NDArray[np.float32]:
    """Colours of a scan as tristimulus values under D50.

    Parameters
    ----------
    pixels
        (rows, cols) or (rows, cols, channels): uint8, uint16 or floating point; 1 channel grey, 3 RGB, 4 CMYK
        with 0 = no ink. Floating point is 0 to 1, and may exceed 1 where there is no profile.
    profile
        The scan's ICC profile. None takes integers as sRGB and floating point as linear light of the sRGB
        primaries (as in OpenEXR); grey then has the same curve and is neutral.
    intent
        Rendering intent; "relative" makes the profile's white the D50 white.
    threads
        Number of threads, 1 or more; never changes the result.

    Returns
    -------
    numpy.ndarray
        (rows, cols, 3) float32 XYZ under D50, Y = 1 for white.

    Raises
    ------
    ProfileError
        If the profile is unusable or for another number of channels, or CMYK comes without a profile.
    ValueError
        If shape or dtype are none of the above.

    References
    ----------
    ICC.1:2001-04; Little CMS 2; sRGB by IEC 61966-2-1.

    Examples
    --------
    >>> white = np.full((1, 1, 3), 255, np.uint8)
    >>> scan_to_xyz(white, None).round(4).tolist()
    [[[0.9642000198364258, 1.0, 0.8248999714851379]]]
    """
    image = pixels[:, :, np.newaxis] if pixels.ndim == 2 else pixels
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4):
        raise ValueError(f"pixels must be (rows, cols[, 1, 3 or 4]), but their shape is {pixels.shape}")
    integer = image.dtype in (np.dtype(np.uint8), np.dtype(np.uint16))
    if not integer and image.dtype.kind != "f":
        raise ValueError(f"pixels must be uint8, uint16 or floating point, not {image.dtype}")
    number = _intent_number(intent)
    channels = image.shape[2]

    if profile is None:
        return _in_strips(_convert_without_profile(image.dtype, channels), image, 3, threads)

    space = bytes(profile[16:20])
    expected, name = _SCAN_SPACES.get(space, (0, ""))
    if expected != channels:
        raise ProfileError(
            f"the scan has {channels} channel{'s' if channels > 1 else ''}, but its ICC profile is for "
            f"{space.decode('latin-1').strip() or 'nothing known'}: save the scan again with a matching "
            "profile"
        )
    xyz_profile = imagecodecs.cms_profile("xyz")

    def through_profile(strip: NDArray[Any]) -> NDArray[np.float32]:
        if not integer:
            strip = strip.astype(np.float32) * (_INK_SCALE if channels == 4 else np.float32(1.0))
        if channels == 1:
            strip = strip[:, :, 0]
        return _cms(strip, profile, xyz_profile, name, "xyz", number)

    return _in_strips(through_profile, image, 3, threads)


def _convert_without_profile(dtype: np.dtype[Any], channels: int) -> Callable[[NDArray[Any]], NDArray[np.float32]]:
    if channels == 4:
        raise ProfileError(
            "a CMYK scan carries no ICC profile, so its colours are unknown: embed the profile or scan as RGB"
        )
    matrix = XYZ_D50_FROM_RGB_LIN.T.astype(np.float32)
    decode = None
    if dtype.kind == "u":
        top = int(np.iinfo(dtype).max)
        decode = rgb_lin_from_srgb(np.arange(top + 1) / top).astype(np.float32)

    def convert(strip: NDArray[Any]) -> NDArray[np.float32]:
        rgb_lin = strip.astype(np.float32) if decode is None else decode[strip]
        if channels == 1:
            rgb_lin = np.repeat(rgb_lin, 3, axis=2)
        # Written out so that a pixel's sum has one order, whatever the strip.
        xyz = rgb_lin[..., 0:1] * matrix[0] + rgb_lin[..., 1:2] * matrix[1] + rgb_lin[..., 2:3] * matrix[2]
        return np.asarray(xyz, dtype=np.float32)

    return convert
