"""Colours of a scan into XYZ through its profile, and colours into the inks of a press and back through the press's.

Scans go through Little CMS, which gives floating point out, so nothing is resampled behind our back. The tables of a
press, of any number of inks, are interpolated by tilefab's own kernels, over tetrahedra and simplices, in floating
point too. Large images go through in strips of rows, which bounds memory and feeds several threads; every pixel is
computed alone, so strips and threads never change a value.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import imagecodecs
import numpy as np
from numpy.typing import DTypeLike, NDArray

from tilefab.colour.encoding import decode_lab16, encode_lab16
from tilefab.colour.grid_float import apply_float
from tilefab.colour.grid_layout import MOST_CHANNELS, channels_in, each_strip
from tilefab.colour.grid_table import compile_table, is_one_grid
from tilefab.colour.spaces import (
    XYZ_D50_FROM_RGB_LIN,
    absolute_lab,
    lab_from_xyz,
    relative_lab,
    rgb_lin_from_srgb,
    xyz_from_lab,
)
from tilefab.colour.stages import ColourTable
from tilefab.errors import ProfileError

Intent = Literal["perceptual", "relative", "saturation", "absolute"]
"""The four rendering intents of ICC profiles."""

Colorimetric = Literal["relative", "absolute"]
"""How a printed colour is stated: against the unprinted tile's white, or as an instrument reads it."""

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


@dataclass(frozen=True)
class PressTransform:
    """A press's conversions, both ways; `tilefab.io.press_profile` makes it of a profile.

    Attributes
    ----------
    to_inks
        From CIELAB or XYZ, against the unprinted tile's white, to 1 to 8 inks: the table of the intent.
    to_lab
        From the inks to CIELAB or XYZ, against the unprinted tile's white: the colorimetric table.
    white_xyz
        Media white under D50, Y = 1 for a perfect diffuser, each above 0.
    intent
        "perceptual", "relative", "saturation" or "absolute".

    Raises
    ------
    ValueError
        If the tables don't belong together, the white is dark, or the intent has no such name.

    References
    ----------
    ICC.1:2010 section 6.3 (connection space, media white).
    """

    to_inks: ColourTable = field(repr=False)
    to_lab: ColourTable = field(repr=False)
    white_xyz: tuple[float, float, float]
    intent: Intent

    def __post_init__(self) -> None:
        if self.intent not in get_args(Intent):
            raise ValueError(f"intent {self.intent!r} is none of {', '.join(get_args(Intent))}")
        ends = (self.to_inks.target, self.to_lab.source)
        colours = {self.to_inks.source, self.to_lab.target}
        if ends != ("ink", "ink") or not colours <= {"lab", "xyz"}:
            raise ValueError("a press's tables go from CIELAB or XYZ to inks, and from inks to CIELAB or XYZ")
        found = len(self.to_inks(np.zeros(3)))
        if not 1 <= self.inks <= MOST_CHANNELS or found != self.inks:
            raise ValueError(f"tables to {found} and from {self.inks} inks: both must be for the same 1 to 8")
        if not min(self.white_xyz) > 0.0:
            raise ValueError(f"a media white of {self.white_xyz} is none: all its values must be above 0")

    @property
    def inks(self) -> int:
        """Number of ink channels."""
        return channels_in(self.to_lab.stages[0])

    def inks_from_lab(self, lab_d50: NDArray[np.floating], *, threads: int = 1) -> NDArray[np.float32]:
        """Inks that print given colours.

        Parameters
        ----------
        lab_d50
            (rows, cols, 3): L*, a*, b* under D50; relative to the unprinted tile's white unless the intent is
            "absolute".
        threads
            Number of threads, 1 or more; never changes the result.

        Returns
        -------
        numpy.ndarray
            (rows, cols, inks) float32 ink fractions, 0 to 1, before any total ink limit but the profile's
            own.

        Raises
        ------
        ValueError
            If the shape is not (rows, cols, 3), or threads are below 1.
        """
        if lab_d50.ndim != 3 or lab_d50.shape[2] != 3:
            raise ValueError(f"lab_d50 must be (rows, cols, 3), but its shape is {lab_d50.shape}")
        if self.intent != "absolute" and self.to_inks.source == "lab":
            return apply_float(self.to_inks, lab_d50.astype(np.float32, copy=False), threads=threads)
        colours = np.empty(lab_d50.shape, np.float32)
        flat = colours.reshape(-1, 3)

        def convert(strip: NDArray[np.floating], to: int) -> None:
            lab = strip.reshape(-1, 3).astype(np.float64)
            if self.intent == "absolute":
                lab = relative_lab(lab, lab_from_xyz(self.white_xyz))
            flat[to : to + len(lab)] = xyz_from_lab(lab) if self.to_inks.source == "xyz" else lab

        each_strip(lab_d50, convert, threads)
        return apply_float(self.to_inks, colours, threads=threads)

    def counts_from_lab16(self, dtype: DTypeLike) -> Callable[..., NDArray[Any]]:
        """The same for images in 16 bits, as texture maps keep them, to print counts.

        Parameters
        ----------
        dtype
            uint8 or uint16.

        Returns
        -------
        Callable
            ``convert(lab16, threads=1)``: (rows, cols, 3) uint16 of `tilefab.colour.encoding` to (rows, cols, inks)
            of ``dtype``, 0 = no ink, before any total ink limit but the profile's own. Within one count of the rounded
            `inks_from_lab`, and several times as fast where the table is one grid from CIELAB.

        Raises
        ------
        ValueError
            If the dtype is another.
        """
        if self.intent != "absolute" and self.to_inks.source == "lab" and is_one_grid(self.to_inks):
            return compile_table(self.to_inks, np.uint16, dtype).apply
        full = np.float32(_full_count(dtype))

        def convert(lab16: NDArray[np.uint16], *, threads: int = 1) -> NDArray[Any]:
            ink_frac = self.inks_from_lab(decode_lab16(lab16), threads=threads)
            return np.asarray(np.rint(ink_frac * full), dtype=dtype)

        return convert

    def lab_from_inks(
        self, ink_frac: NDArray[np.floating], *, intent: Colorimetric = "relative", threads: int = 1
    ) -> NDArray[np.float32]:
        """Colours that given inks print: the profile backwards.

        Parameters
        ----------
        ink_frac
            (rows, cols, inks) ink fractions, 0 to 1.
        intent
            "relative" gives colours against the unprinted tile's white, "absolute" as an instrument reads
            them.
        threads
            Number of threads, 1 or more; never changes the result.

        Returns
        -------
        numpy.ndarray
            (rows, cols, 3) float32: L*, a*, b* under D50.

        Raises
        ------
        ValueError
            If the shape is not (rows, cols, inks), threads are below 1, or the intent has no such name.
        """
        if ink_frac.ndim != 3 or ink_frac.shape[2] != self.inks:
            raise ValueError(f"ink_frac must be (rows, cols, {self.inks}), but its shape is {ink_frac.shape}")
        if intent not in get_args(Colorimetric):
            raise ValueError(f"intent {intent!r} is none of {', '.join(get_args(Colorimetric))}")
        found = apply_float(self.to_lab, ink_frac.astype(np.float32, copy=False), threads=threads)
        if intent == "relative" and self.to_lab.target == "lab":
            return found
        flat = found.reshape(-1, 3)

        def convert(strip: NDArray[np.floating], to: int) -> None:
            lab = strip.reshape(-1, 3).astype(np.float64)
            if self.to_lab.target == "xyz":
                lab = lab_from_xyz(lab)
            if intent == "absolute":
                lab = absolute_lab(lab, lab_from_xyz(self.white_xyz))
            flat[to : to + len(lab)] = lab

        each_strip(found, convert, threads)
        return found

    def lab16_from_counts(self, dtype: DTypeLike) -> Callable[..., NDArray[np.uint16]]:
        """Colours of print counts in 16 bits, against the unprinted tile's white.

        Parameters
        ----------
        dtype
            uint8 or uint16.

        Returns
        -------
        Callable
            ``convert(counts, threads=1)``: (rows, cols, inks) of ``dtype``, 0 = no ink, to (rows, cols, 3) uint16 of
            `tilefab.colour.encoding`. Within one count of the rounded `lab_from_inks`.

        Raises
        ------
        ValueError
            If the dtype is another.
        """
        if self.to_lab.target == "lab" and is_one_grid(self.to_lab):
            return compile_table(self.to_lab, dtype, np.uint16).apply
        full = np.float32(_full_count(dtype))

        def convert(counts: NDArray[Any], *, threads: int = 1) -> NDArray[np.uint16]:
            return encode_lab16(self.lab_from_inks(counts.astype(np.float32) / full, threads=threads))

        return convert


def _full_count(dtype: DTypeLike) -> int:
    if np.dtype(dtype) not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise ValueError(f"counts must be uint8 or uint16, not {np.dtype(dtype)}")
    return int(np.iinfo(np.dtype(dtype)).max)
