"""Reading images whose channels are inks, count by count, as presses get them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile

from tilefab.errors import ImageError
from tilefab.io.scans import scan_facts
from tilefab.types import PrintImage

_ALPHA = (tifffile.EXTRASAMPLE.ASSOCALPHA, tifffile.EXTRASAMPLE.UNASSALPHA)


@dataclass(frozen=True, eq=False)
class InkImage:
    """Print data as it stands in its file.

    Attributes
    ----------
    pixels
        (rows, cols, inks) uint8 or uint16, 0 = no ink, C-contiguous.
    dpi
        Resolution the file states, if it states a plausible one.
    notes
        What was unusual and what was done about it, a sentence each.
    """

    pixels: PrintImage
    dpi: float | None
    notes: tuple[str, ...]


def read_ink_image(path: Path) -> InkImage:
    """Read a separated TIFF of 8 or 16 bits.

    Raises
    ------
    ImageError
        If it is missing, damaged or no TIFF, or its channels are no inks.
    """
    facts = scan_facts(path)
    notes = []
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            if page.photometric != tifffile.PHOTOMETRIC.SEPARATED:
                raise ImageError(
                    f"{path}: its channels are {tifffile.PHOTOMETRIC(page.photometric).name}, not inks; give a "
                    "separated TIFF, as tilefab writes them",
                    path=str(path),
                )
            pixels = page.asarray().reshape(page.shape)
            if page.planarconfig == tifffile.PLANARCONFIG.SEPARATE and page.samplesperpixel > 1:
                pixels = np.moveaxis(pixels, 0, 2)
            extra = tuple(page.extrasamples)
            several = len(file.pages) > 1
    except ImageError:
        raise
    except Exception as error:  # a damaged file makes tifffile and its codecs raise nearly anything
        raise ImageError(f"{path}: can't be read as a TIFF of inks: {error}", path=str(path)) from error
    pixels = pixels[:, :, np.newaxis] if pixels.ndim == 2 else pixels
    if pixels.ndim != 3 or pixels.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise ImageError(
            f"{path}: {pixels.dtype} in {pixels.ndim} dimensions; print data is flat and has 8 or 16 bits",
            path=str(path),
        )
    alpha = [pixels.shape[2] - len(extra) + place for place, kind in enumerate(extra) if kind in _ALPHA]
    if alpha:
        pixels = np.delete(pixels, alpha, axis=2)
        notes.append(f"{path.name} has an alpha channel: it is not used")
    if several:
        notes.append(f"{path.name} holds several images: only the first is used")
    # The machine's own byte order, whatever the file's.
    native = np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("="))
    return InkImage(native, facts.dpi, tuple(notes))
