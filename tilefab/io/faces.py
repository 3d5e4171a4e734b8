"""Writing faces: print data as TIFF, previews for people as PNG, JPEG or TIFF."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import tifffile
from numpy.typing import NDArray

import tilefab
from tilefab.errors import ImageError, OutputError
from tilefab.io.atomic import atomic_write
from tilefab.io.tiff_inks import make_separated
from tilefab.types import Array, PrintImage

_INK_SET_CMYK, _INK_SET_OTHER = 1, 2
_CMYK_INKS = 4
_MOST_INKS = 8
_TAG_INK_SET, _TAG_INK_NAMES, _TAG_NUMBER_OF_INKS = 332, 333, 334
_STRIP_BYTES = 1 << 18
PREVIEW_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


@dataclass(frozen=True)
class PrintTags:
    """What a print file says about itself.

    Attributes
    ----------
    dpi
        Resolution in both directions.
    icc_profile
        Press profile to embed; None for none.
    ink_names
        One name a channel.
    description
        What re-creates the face, in a line of ASCII.
    compression
        ``"none"``, ``"lzw"`` or ``"deflate"``.
    """

    dpi: float
    icc_profile: bytes | None
    ink_names: tuple[str, ...]
    description: str
    compression: str = "none"


def pixel_hash(pixels: Array) -> str:
    """SHA-256 of raw pixels, C-contiguous and little-endian, as 64 hexadecimal digits."""
    little = np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("<"))
    return hashlib.sha256(little.data).hexdigest()


def write_print_tiff(path: Path, pixels: PrintImage, tags: PrintTags) -> None:
    """Write a face or chart for the press: separated TIFF with profile, resolution, ink names; whole or not at all.

    Four inks are marked as CMYK, whatever their names, for that is how presses take them; others as not CMYK.

    Parameters
    ----------
    path
        The file to write.
    pixels
        (rows, cols, N) uint8 or uint16, 0 = no ink, of 1 to 8 inks.
    tags
        What the file says about itself; one name for each ink.

    Raises
    ------
    OutputError
        If it can't be written.
    ValueError
        If there are more inks, or not as many names as inks.
    """
    inks = pixels.shape[2]
    if not 1 <= inks <= _MOST_INKS or len(tags.ink_names) != inks:
        raise ValueError(f"{inks} inks with {len(tags.ink_names)} names can't be written")
    is_cmyk = inks == _CMYK_INKS
    rows_per_strip = max(1, _STRIP_BYTES // max(1, pixels[:1].nbytes))
    names = "".join(f"{name}\0" for name in tags.ink_names).encode("ascii", "replace")
    extra = [
        (_TAG_INK_SET, "H", 1, _INK_SET_CMYK if is_cmyk else _INK_SET_OTHER, True),
        # Bytes written as an ASCII field: its names are separated by NUL, which text fields can't hold.
        (_TAG_INK_NAMES, "s", len(names), names, True),
        (_TAG_NUMBER_OF_INKS, "H", 1, len(tags.ink_names), True),
    ]
    compression = {"none": None, "lzw": "lzw", "deflate": "zlib"}[tags.compression]

    def write(temporary: Path) -> None:
        tifffile.imwrite(
            temporary,
            pixels if inks > 1 else pixels[..., 0],
            byteorder="<",
            photometric="separated" if is_cmyk else "minisblack",
            planarconfig="contig" if inks > 1 else None,
            rowsperstrip=rows_per_strip,
            compression=compression,
            predictor=compression is not None,
            resolution=(tags.dpi, tags.dpi),
            resolutionunit="INCH",
            iccprofile=tags.icc_profile,
            description=tags.description,
            software=f"tilefab {tilefab.__version__}",
            extratags=extra,
            metadata=None,
        )
        if not is_cmyk:
            make_separated(temporary)

    atomic_write(path, write)


def read_print_pixels(path: Path) -> Array:
    """Read back the pixels of a print file, (rows, cols, channels).

    Raises
    ------
    ImageError
        If the file can't be read.
    """
    try:
        pixels = tifffile.imread(path)
    except Exception as error:  # a damaged file makes tifffile and its codecs raise nearly anything
        raise ImageError(f"{path}: can't be read back: {error}", path=str(path)) from error
    return np.asarray(pixels[:, :, np.newaxis] if pixels.ndim == 2 else pixels)


def check_preview_path(path: Path) -> None:
    """Refuse a picture's path whose suffix names no format, before the work of drawing it.

    Raises
    ------
    OutputError
        If it is none of `PREVIEW_SUFFIXES`.
    """
    if path.suffix.lower() not in PREVIEW_SUFFIXES:
        raise OutputError(
            f"{path}: unknown picture format {path.suffix or '(no ending)'}; use {', '.join(PREVIEW_SUFFIXES)}",
            path=str(path),
        )


def write_preview(path: Path, rgb: NDArray[np.uint8], dpi: float) -> None:
    """Write an sRGB picture for people; the suffix decides the format.

    Parameters
    ----------
    path
        A file ending in .png, .jpg, .jpeg, .tif or .tiff.
    rgb
        (rows, cols, 3) uint8 sRGB.
    dpi
        Resolution to state.

    Raises
    ------
    OutputError
        If the suffix is another, or the file can't be written.
    """
    check_preview_path(path)

    def write(temporary: Path) -> None:
        spec: Any = oiio.ImageSpec(rgb.shape[1], rgb.shape[0], 3, oiio.UINT8)
        spec.attribute("XResolution", float(dpi))
        spec.attribute("YResolution", float(dpi))
        spec.attribute("ResolutionUnit", "in")
        spec.attribute("oiio:ColorSpace", "sRGB")
        spec.attribute("CompressionQuality", 92)
        spec.attribute("Software", f"tilefab {tilefab.__version__}")
        target = oiio.ImageOutput.create(str(temporary))
        if target is None or not target.open(str(temporary), spec):
            raise OSError(None, oiio.geterror() if target is None else target.geterror())
        written = target.write_image(np.ascontiguousarray(rgb))
        closed = target.close()
        if not (written and closed):
            raise OSError(None, target.geterror() or "the file could not be written: is the disk full?")

    atomic_write(path, write)
