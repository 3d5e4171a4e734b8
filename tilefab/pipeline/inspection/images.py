"""Images of fired tiles, as cameras and scanners leave them: files in, colours out."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import scan_to_xyz
from tilefab.colour.transform import Intent
from tilefab.errors import ImageError, ProfileError
from tilefab.io.scans import read_scan

MOST_PX = 1 << 27
"""Larger images than this aren't taken: a tile of 1.2 m has 134 megapixels at 250 dpi."""


@dataclass(frozen=True, eq=False)
class CameraImage:
    """An image of a tile.

    Attributes
    ----------
    name
        Of its file.
    xyz
        (rows, cols, 3) float32 XYZ under D50, Y = 1 for the perfect white.
    px_per_mm
        As calibrated; ``None`` if that isn't known.
    grey
        Whether it has no colour: then none can be measured.
    """

    name: str
    xyz: NDArray[np.float32] = field(repr=False)
    px_per_mm: float | None = None
    grey: bool = False


def read_camera_image(
    path: Path, *, profile: bytes | None = None, px_per_mm: float | None = None, threads: int = 1
) -> CameraImage:
    """Read an image of a fired tile.

    Parameters
    ----------
    path
        TIFF, PNG, JPEG or EXR.
    profile
        The camera's ICC profile, which overrides one in the file; without any, sRGB.
    px_per_mm
        The camera's calibration.
    threads
        For converting.

    Raises
    ------
    ImageError
        If the file can't be read, or is too large.
    ProfileError
        If its profile can't be used.
    """
    scan = read_scan(path)
    if scan.pixels.shape[0] * scan.pixels.shape[1] > MOST_PX:
        raise ImageError(f"{path}: has more than 134 megapixels: give one tile at up to 250 dpi", path=str(path))
    used = scan.icc_profile if profile is None else profile
    # A camera's own profile knows its target's white; a working space has none but its own.
    intent: Intent = "absolute" if used is not None and used[12:16] == b"scnr" else "relative"
    try:
        xyz = scan_to_xyz(np.ascontiguousarray(scan.pixels), used, intent=intent, threads=threads)
    except ProfileError as error:
        raise ProfileError(f"{path}: {error.message}", path=str(path)) from error
    return CameraImage(path.name, xyz, px_per_mm, grey=scan.pixels.ndim == 2 or scan.pixels.shape[2] == 1)
