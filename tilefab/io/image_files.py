"""What reading any image through OpenImageIO takes: opening it as it is, and what its header says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from tilefab.errors import ImageError
from tilefab.types import Array

_INCH_IN = {"in": 1.0, "inch": 1.0, "cm": 2.54, "m": 0.0254}
_PLAUSIBLE_DPI = (10.0, 20000.0)


def open_image(path: Path) -> Any:
    """Open an image so that its colours stay as they are in the file; the caller closes it.

    Returns
    -------
    OpenImageIO.ImageInput

    Raises
    ------
    ImageError
        If the file is missing, damaged, or not a flat image of at least one pixel.
    """
    if not path.is_file():
        what = "is a folder, not an image" if path.is_dir() else "there is no such file"
        raise ImageError(f"{path}: {what}", path=str(path))
    config = oiio.ImageSpec()
    config.attribute("oiio:RawColor", 1)
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), config)
    if source is None:
        raise unreadable(path, oiio.geterror())
    spec = source.spec()
    if str(spec.getattribute("jpeg:ColorSpace") or "") in ("CMYK", "YCCK"):
        source.close()
        raise ImageError(
            f"{path}: a CMYK JPEG can't be read without changing its colours; save it as TIFF, or scan as RGB",
            path=str(path),
        )
    if spec.width < 1 or spec.height < 1 or spec.nchannels < 1 or spec.depth > 1:
        source.close()
        raise ImageError(f"{path}: not a flat image of at least one pixel", path=str(path))
    return source


def unreadable(path: Path, reason: str) -> ImageError:
    """Explain why an image can't be read."""
    first_line = (reason or "unknown reason").strip().splitlines()[0]
    return ImageError(f"{path}: damaged or not an image: {first_line}; scan or export it again", path=str(path))


def orientation(spec: Any) -> Callable[[Array], Array]:
    """How to turn an image upright that a camera or scanner marked as lying otherwise (TIFF 6.0, Orientation)."""
    turns: dict[int, Callable[[Array], Array]] = {
        2: lambda image: image[:, ::-1],
        3: lambda image: image[::-1, ::-1],
        4: lambda image: image[::-1],
        5: lambda image: image.swapaxes(0, 1),
        6: lambda image: image.swapaxes(0, 1)[:, ::-1],
        7: lambda image: image.swapaxes(0, 1)[::-1, ::-1],
        8: lambda image: image.swapaxes(0, 1)[::-1],
    }
    return turns.get(spec.getattribute("Orientation") or 1, lambda image: image)


def alpha_channel(spec: Any) -> int | None:
    """Which channel is alpha, if one is."""
    # OpenImageIO takes the K of CMYK for an alpha channel: only the name tells.
    alpha = int(spec.alpha_channel)
    is_alpha = 0 <= alpha < spec.nchannels and str(spec.channelnames[alpha]).upper() in ("A", "ALPHA")
    return alpha if is_alpha else None


def icc_profile(spec: Any) -> bytes | None:
    """Embedded profile, if any."""
    profile = spec.getattribute("ICCProfile")
    return None if profile is None else bytes(np.asarray(profile, dtype=np.uint8).tobytes())


def resolution_dpi(spec: Any) -> float | None:
    """Resolution that the file states, if it states a plausible one."""
    resolution = spec.getattribute("XResolution")
    unit = _INCH_IN.get(str(spec.getattribute("ResolutionUnit") or "").lower())
    if not isinstance(resolution, int | float) or unit is None:
        return None
    dpi = float(resolution) * unit
    return dpi if _PLAUSIBLE_DPI[0] <= dpi <= _PLAUSIBLE_DPI[1] else None
