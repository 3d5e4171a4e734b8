"""Reading scans and masks through OpenImageIO."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from tilefab.errors import ImageError
from tilefab.io.image_files import alpha_channel, icc_profile, open_image, orientation, resolution_dpi, unreadable
from tilefab.types import Array, Mask, SizePx

_OPAQUE = 0.999
_SEVERAL = "tilefab:several_images"
_BAND_ROWS = 512


@dataclass(frozen=True, eq=False)
class Scan:
    """A scan as it stands in its file.

    Attributes
    ----------
    path
        Where it was read from.
    pixels
        (rows, cols, 1, 3 or 4) uint8, uint16 or float32: gray, RGB or CMYK, without alpha.
    valid
        (rows, cols), False where the file says that a pixel is transparent.
    dpi
        Resolution the file states, if it states a plausible one.
    icc_profile
        Embedded profile, if any.
    notes
        What was unusual and what was done about it, a sentence each.
    """

    path: str
    pixels: Array
    valid: Mask
    dpi: float | None
    icc_profile: bytes | None
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ScanFacts:
    """What a scan's header says.

    Attributes
    ----------
    size
        Rows and columns.
    channels
        Colour channels, without alpha.
    dpi
        Resolution, if a plausible one is stated.
    icc_profile
        Embedded profile, if any.
    """

    size: SizePx
    channels: int
    dpi: float | None
    icc_profile: bytes | None


def read_scan(path: Path) -> Scan:
    """Read a scan: TIFF, PNG, JPEG, EXR or anything else that OpenImageIO knows; 8, 16 bit or float.

    Raises
    ------
    ImageError
        If the file is missing, damaged, empty, has a number of channels no colour has, or holds NaN or infinity.
    """
    pixels, spec = _read(path)
    notes: list[str] = []
    valid = np.ones(pixels.shape[:2], dtype=bool)
    alpha = alpha_channel(spec)
    if alpha is not None:
        full = np.float32(np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1)
        for band in _bands(pixels):
            valid[band] = pixels[band, :, alpha].astype(np.float32) / full >= _OPAQUE
        pixels = np.delete(pixels, alpha, axis=2)
        share = 100.0 * float((~valid).mean())
        notes.append(f"{path.name} has an alpha channel: {share:.1f} % of it is transparent and not used")
        if not valid.any():
            raise ImageError(f"{path}: the whole scan is transparent; give one with opaque pixels", path=str(path))
    channels = pixels.shape[2]
    if channels > 3 and [str(n) for n in spec.channelnames[:3]] == ["R", "G", "B"]:
        notes.append(f"{path.name} has {channels} channels: only R, G and B are used")
        pixels = pixels[..., :3]
    elif channels == 2 or channels > 4:
        raise ImageError(
            f"{path}: {channels} channels ({', '.join(spec.channelnames)}); a scan has 1 (gray), 3 (RGB) or 4 (CMYK)",
            path=str(path),
        )
    if channels == 1:
        notes.append(f"{path.name} is grayscale: it is used as a neutral grey stone")
    pixels = np.ascontiguousarray(pixels)
    if pixels.dtype.kind == "f":
        _make_finite(path, pixels, valid, notes)
    if spec.getattribute("Orientation") not in (None, 1):
        notes.append(f"{path.name} was turned upright, as its file says")
    if spec.getattribute(_SEVERAL):
        notes.append(f"{path.name} holds several images: only the first is used")
    return Scan(str(path), pixels, valid, resolution_dpi(spec), icc_profile(spec), tuple(notes))


def read_mask(path: Path, shape: tuple[int, int]) -> Mask:
    """Read a mask of areas not to use: white (or anything over half) is not used. True in the result = good.

    Raises
    ------
    ImageError
        If it can't be read or isn't as large as its scan.
    """
    grey = _read_grey(path, shape, "mask")
    limit = np.iinfo(grey.dtype).max / 2 if grey.dtype.kind == "u" else 0.5
    good: Mask = np.empty(shape, dtype=bool)
    for band in _bands(grey):
        good[band] = ~(grey[band].astype(np.float32).mean(axis=2) > limit)
    if not good.any():
        raise ImageError(
            f"{path}: the mask leaves nothing of the scan; white marks what is not to be used", path=str(path)
        )
    return good


def read_weights(path: Path, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Read weights of what must not be cut: black may be, white should not.

    Returns
    -------
    numpy.ndarray
        (rows, cols) uint8, 0 to 255.

    Raises
    ------
    ImageError
        If it can't be read or isn't as large as its scan.
    """
    grey = _read_grey(path, shape, "image of weights")
    full = np.float32(np.iinfo(grey.dtype).max if grey.dtype.kind == "u" else 1)
    weights = np.empty(shape, dtype=np.uint8)
    for band in _bands(grey):
        level = np.nan_to_num(grey[band].astype(np.float32).mean(axis=2) / full, posinf=1)
        weights[band] = np.rint(255 * np.clip(level, 0, 1))
    return weights


def scan_facts(path: Path) -> ScanFacts:
    """Read what a scan's header says, without its pixels.

    Raises
    ------
    ImageError
        If the file is missing or its header can't be read.
    """
    source = open_image(path)
    try:
        spec = source.spec()
        channels = spec.nchannels - (alpha_channel(spec) is not None)
        upright = orientation(spec)(np.empty((spec.height, spec.width, 0))).shape
        return ScanFacts(SizePx(upright[0], upright[1]), channels, resolution_dpi(spec), icc_profile(spec))
    finally:
        source.close()


def _read(path: Path) -> tuple[Array, Any]:
    source = open_image(path)
    try:
        spec = source.spec()
        # Whole numbers of other widths are taken to 16 bits, for they are encoded as those are; only floats are linear.
        kind, dtype = {
            oiio.UINT8: (oiio.UINT8, np.uint8),
            oiio.HALF: (oiio.FLOAT, np.float32),
            oiio.FLOAT: (oiio.FLOAT, np.float32),
            oiio.DOUBLE: (oiio.FLOAT, np.float32),
        }.get(spec.format.basetype, (oiio.UINT16, np.uint16))
        pixels = source.read_image(0, 0, 0, spec.nchannels, kind)
        if pixels is None or source.has_error:
            raise unreadable(path, source.geterror())
        spec = oiio.ImageSpec(spec)
        turn = orientation(spec)
        pixels = turn(np.asarray(pixels, dtype=dtype).reshape(spec.height, spec.width, spec.nchannels))
        spec.attribute(_SEVERAL, int(source.seek_subimage(1, 0)))
    except (MemoryError, RuntimeError) as error:
        raise unreadable(path, str(error)) from error
    finally:
        source.close()
    return pixels, spec


def _read_grey(path: Path, shape: tuple[int, int], what: str) -> Array:
    """Pixels of an image that lies over a scan, (rows, cols, channels) without alpha."""
    pixels, spec = _read(path)
    if pixels.shape[:2] != shape:
        raise ImageError(
            f"{path}: the {what} has {pixels.shape[1]} x {pixels.shape[0]} pixels but its scan {shape[1]} x "
            f"{shape[0]}; both must be of one size",
            path=str(path),
        )
    alpha = alpha_channel(spec)
    return pixels if alpha is None or pixels.shape[2] == 1 else np.delete(pixels, alpha, axis=2)


def _bands(pixels: Array) -> Iterator[slice]:
    return (slice(top, top + _BAND_ROWS) for top in range(0, len(pixels), _BAND_ROWS))


def _make_finite(path: Path, pixels: Array, valid: Mask, notes: list[str]) -> None:
    """Set to 0, in place, what is negative or transparent."""
    wrong, first, negative = 0, (0, 0), 0
    for band in _bands(pixels):
        bad = ~np.isfinite(pixels[band]).all(axis=2) & valid[band]
        if bad.any() and not wrong:
            row, col = (int(k) for k in np.argwhere(bad)[0])
            first = (band.start + row, col)
        wrong += int(np.count_nonzero(bad))
        negative += int(np.count_nonzero((pixels[band] < 0).any(axis=2) & valid[band]))
        pixels[band] = np.where(valid[band][..., None], np.maximum(pixels[band], 0), 0)
    if wrong:
        raise ImageError(
            f"{path}: {wrong} pixels are NaN or infinite, the first at row {first[0]}, column {first[1]}; "
            "export the scan again without them",
            path=str(path),
        )
    if negative:
        notes.append(f"{path.name} has {negative} pixels with negative values: they are set to 0")
