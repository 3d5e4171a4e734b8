"""Layers of a texture (colour, height, gloss ...) as files: read, and written again, without changing a bit of a pixel.

Scans are read by `tilefab.io.scans`, which brings them to what a stone can be made of. A layer is kept as it is: 8, 16
or 32 bits, half, single or double floats, any number of channels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import tifffile
from numpy.typing import NDArray

import tilefab
from tilefab.errors import ImageError, OutputError
from tilefab.io.atomic import atomic_write
from tilefab.io.image_files import alpha_channel, icc_profile, open_image, orientation, resolution_dpi, unreadable
from tilefab.types import Array, Mask, SizePx

_OPAQUE = 0.999
_KINDS: dict[Any, str] = {
    oiio.UINT8: "uint8",
    oiio.INT8: "int8",
    oiio.UINT16: "uint16",
    oiio.INT16: "int16",
    oiio.UINT32: "uint32",
    oiio.INT32: "int32",
    oiio.HALF: "float16",
    oiio.FLOAT: "float32",
    oiio.DOUBLE: "float64",
}
_TYPES = {name: kind for kind, name in _KINDS.items()}
_COLOURS = {1: ("Y",), 3: ("R", "G", "B")}
_CMYK = ("C", "M", "Y", "K")
_UNASSOCIATED, _ASSOCIATED, _UNSPECIFIED = 2, 1, 0
_JPEG_QUALITY = 98
_HOLDS = {
    ".png": (("uint8", "uint16"), "gray or RGB of 8 or 16 bits"),
    ".jpg": (("uint8",), "gray or RGB of 8 bits"),
    ".tif": (tuple(_TYPES), "anything"),
    ".exr": (("float16", "float32", "uint32"), "half or single floats"),
}
_SUFFIXES = {".png": ".png", ".jpg": ".jpg", ".jpeg": ".jpg", ".tif": ".tif", ".tiff": ".tif", ".exr": ".exr"}


@dataclass(frozen=True, eq=False)
class Layer:
    """A layer as it stands in its file, upright.

    Attributes
    ----------
    path
        Where it was read from.
    pixels
        (rows, cols, channels), in the file's own type, alpha included.
    channels
        Their names.
    alpha
        Which of them is alpha, if one is.
    unassociated
        Whether colours are not multiplied by alpha.
    dpi
        Resolution, if a plausible one is stated.
    icc_profile
        Embedded profile, if any.
    notes
        What was unusual and what was done about it, a sentence each.
    """

    path: str
    pixels: Array
    channels: tuple[str, ...]
    alpha: int | None = None
    unassociated: bool = False
    dpi: float | None = None
    icc_profile: bytes | None = None
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> SizePx:
        """Rows and columns."""
        return SizePx(self.pixels.shape[0], self.pixels.shape[1])

    def opaque(self) -> tuple[Layer, Mask]:
        """The layer without alpha, and (rows, cols) True where it is opaque.

        Raises
        ------
        ImageError
            If no pixel is.
        """
        if self.alpha is None or len(self.channels) == 1:
            return self, np.ones(self.pixels.shape[:2], dtype=bool)
        values = self.pixels[..., self.alpha]
        full = np.iinfo(values.dtype).max if values.dtype.kind in "ui" else 1
        valid: Mask = np.asarray(values.astype(np.float64) >= _OPAQUE * full)
        if not valid.any():
            raise ImageError(
                f"{self.path}: the whole image is transparent; give one with opaque pixels", path=self.path
            )
        pixels = np.ascontiguousarray(np.delete(self.pixels, self.alpha, axis=2))
        names = tuple(name for k, name in enumerate(self.channels) if k != self.alpha)
        return replace(self, pixels=pixels, channels=names, alpha=None, unassociated=False), valid


def read_layer(path: Path) -> Layer:
    """Read an image of any kind without changing its pixels, but for turning it upright.

    Raises
    ------
    ImageError
        If the file is missing, damaged or empty, or its numbers are of a kind that can't be kept.
    """
    source = open_image(path)
    try:
        spec = source.spec()
        if spec.deep or spec.format.basetype not in _KINDS:
            raise ImageError(
                f"{path}: its pixels are of a kind that can't be kept ({spec.format}{', deep' if spec.deep else ''}); "
                "save it as TIFF or EXR of 8, 16 or 32 bits",
                path=str(path),
            )
        pixels = source.read_image(0, 0, 0, spec.nchannels, spec.format.basetype)
        if pixels is None or source.has_error:
            raise unreadable(path, source.geterror())
        spec = oiio.ImageSpec(spec)
        pixels = np.asarray(pixels, dtype=_KINDS[spec.format.basetype])
        pixels = orientation(spec)(pixels.reshape(spec.height, spec.width, spec.nchannels))
        several = bool(source.seek_subimage(1, 0))
    except (MemoryError, RuntimeError) as error:
        raise unreadable(path, str(error)) from error
    finally:
        source.close()
    notes = []
    if spec.getattribute("Orientation") not in (None, 1):
        notes.append(f"{path.name} was turned upright, as its file says")
    if several:
        notes.append(f"{path.name} holds several images: only the first is used")
    return Layer(
        str(path),
        np.ascontiguousarray(pixels),
        tuple(str(name) for name in spec.channelnames),
        alpha_channel(spec),
        bool(spec.getattribute("oiio:UnassociatedAlpha")),
        resolution_dpi(spec),
        icc_profile(spec),
        tuple(notes),
    )


def check_layer_path(path: Path, layer: Layer) -> None:
    """Refuse a file whose format can't hold a layer, before the work of making it.

    Raises
    ------
    OutputError
        If the ending names no known format, or one for other numbers or fewer channels.
    """
    suffix = _SUFFIXES.get(path.suffix.lower())
    if suffix is None:
        raise OutputError(
            f"{path}: unknown image format {path.suffix or '(no ending)'}; use {', '.join(_SUFFIXES)}", path=str(path)
        )
    kinds, held = _HOLDS[suffix]
    kind, channels = layer.pixels.dtype.name, len(layer.channels)
    colours = channels - (layer.alpha is not None and channels > 1)
    fits = kind in kinds
    if suffix == ".png":
        fits = fits and colours in _COLOURS and layer.alpha in (None, channels - 1)
    elif suffix == ".jpg":
        fits = fits and channels in _COLOURS
    if not fits:
        better = ".exr or .tif" if kind in _HOLDS[".exr"][0] else ".tif"
        raise OutputError(
            f"{path}: {suffix[1:].upper()} holds {held}, but {Path(layer.path).name} has {channels} "
            f"channel{'s' if channels > 1 else ''} of {kind}; use {better}",
            path=str(path),
        )


def write_layer(path: Path, pixels: Array, like: Layer) -> tuple[str, ...]:
    """Write pixels in the way of a layer, whole or not at all: its channels, resolution and profile.

    Parameters
    ----------
    path
        Its ending decides the format: PNG, TIFF, EXR or JPEG.
    pixels
        (rows, cols, channels), of the layer's type and channels.
    like
        The layer that they come from.

    Returns
    -------
    tuple of str
        What the format couldn't hold, a sentence each.

    Raises
    ------
    OutputError
        If the format can't hold the pixels, or the file can't be written.
    ValueError
        If the pixels aren't like the layer's.
    """
    if pixels.ndim != 3 or pixels.shape[2] != len(like.channels) or pixels.dtype != like.pixels.dtype:
        raise ValueError(f"pixels {pixels.shape} {pixels.dtype} aren't like those of {like.path}")
    check_layer_path(path, like)
    suffix, pixels = _SUFFIXES[path.suffix.lower()], np.ascontiguousarray(pixels)
    write: Callable[[Path], None]
    if suffix == ".tif":
        write = lambda temporary: _write_tiff(temporary, pixels, like)  # noqa: E731
    else:
        write = lambda temporary: _write_oiio(temporary, pixels, like, suffix)  # noqa: E731
    atomic_write(path, write)
    notes = []
    if like.icc_profile is not None and (suffix == ".exr" or (suffix == ".png" and "R" not in like.channels)):
        notes.append(f"{path.name} doesn't hold the colour profile of {Path(like.path).name}: its format can't")
    if suffix == ".jpg":
        notes.append(f"{path.name} is JPEG: its colours are only nearly those of {Path(like.path).name}")
    return tuple(notes)


def _write_tiff(path: Path, pixels: Array, like: Layer) -> None:
    channels = len(like.channels)
    photometric, colours = "minisblack", 1
    if like.channels[:3] == _COLOURS[3]:
        photometric, colours = "rgb", 3
    elif like.channels[:4] == _CMYK:
        photometric, colours = "separated", 4
    alpha = _UNASSOCIATED if like.unassociated else _ASSOCIATED
    extra = tuple(alpha if k == like.alpha else _UNSPECIFIED for k in range(colours, channels))
    integers = pixels.dtype.kind in "ui"
    tifffile.imwrite(
        path,
        pixels if channels > 1 else pixels[..., 0],
        byteorder="<",
        photometric=photometric,
        planarconfig="contig" if channels > 1 else None,
        extrasamples=extra or None,
        compression="zlib",
        predictor=integers,
        resolution=None if like.dpi is None else (like.dpi, like.dpi),
        resolutionunit=None if like.dpi is None else "INCH",
        iccprofile=like.icc_profile,
        software=f"tilefab {tilefab.__version__}",
        metadata=None,
    )


def _write_oiio(path: Path, pixels: Array, like: Layer, suffix: str) -> None:
    rows, cols, channels = pixels.shape
    spec: Any = oiio.ImageSpec(cols, rows, channels, _TYPES[pixels.dtype.name])
    spec.channelnames = _exr_names(like) if suffix == ".exr" else like.channels
    spec.alpha_channel = -1 if like.alpha is None else like.alpha
    if like.alpha is not None and like.unassociated:
        spec.attribute("oiio:UnassociatedAlpha", 1)
    if like.dpi is not None:
        spec.attribute("XResolution", float(like.dpi))
        spec.attribute("YResolution", float(like.dpi))
        spec.attribute("ResolutionUnit", "in")
    if like.icc_profile is not None and suffix != ".exr":
        profile: NDArray[np.uint8] = np.frombuffer(like.icc_profile, dtype=np.uint8)
        spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), profile)
    if suffix == ".jpg":
        spec.attribute("CompressionQuality", _JPEG_QUALITY)
        spec.attribute("jpeg:subsampling", "4:4:4")
    spec.attribute("Software", f"tilefab {tilefab.__version__}")
    target = oiio.ImageOutput.create(str(path))
    if target is None or not target.open(str(path), spec):
        raise OSError(None, oiio.geterror() if target is None else target.geterror())
    written = target.write_image(pixels)
    closed = target.close()
    if not (written and closed):
        raise OSError(None, target.geterror() or "the file could not be written: is the disk full?")


def _exr_names(like: Layer) -> tuple[str, ...]:
    """Names that are read back in this order: an EXR has no order but that of its names."""
    if Path(like.path).suffix.lower() == ".exr":
        return like.channels
    colours = _COLOURS[3] if len(like.channels) >= 3 else ("R", "G") if len(like.channels) == 2 else ("Y",)
    names = [*colours, *(f"channel{k:04}" for k in range(len(colours), len(like.channels)))]
    if like.alpha is not None:
        names[like.alpha] = "A"
    return tuple(names)
