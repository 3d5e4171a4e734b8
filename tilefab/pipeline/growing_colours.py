"""What of an exemplar is compared while a texture is grown from it: CIELAB of colours, lightness of gray."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import scan_to_xyz, srgb_from_xyz, xyz_from_lab
from tilefab.colour.encoding import decode_lab16, encode_lab16
from tilefab.errors import ImageError, ProfileError
from tilefab.io.layers import Layer
from tilefab.pipeline.plan import check_scan_profile
from tilefab.pipeline.prepare import lab_in_place
from tilefab.types import Array, FloatImage, Mask

_RGB, _CMYK = ("R", "G", "B"), ("C", "M", "Y", "K")
_BRIGHT = 1.05
_BRIGHT_SHARE = 0.2
_WHITE_PERCENTILE = 99.0


@dataclass(frozen=True, eq=False)
class Comparison:
    """An exemplar as it is compared.

    Attributes
    ----------
    image
        (rows, cols, channels) float32: CIELAB (D50), lightness, or channels of any other kind scaled to 0 .. 100.
    valid
        (rows, cols), False where a pixel isn't a number.
    is_lab
        Whether it is CIELAB.
    notes
        What the user should know, a sentence each.
    white
        Luminance that is compared as white's.
    ranges
        Least and greatest value of each channel that is compared by its range; none of colours and lightness.
    """

    image: FloatImage
    valid: Mask
    is_lab: bool
    notes: tuple[str, ...]
    white: float = 1.0
    ranges: tuple[tuple[float, float], ...] = ()


def comparison_of(layer: Layer, valid: Mask, threads: int = 1, like: Comparison | None = None) -> Comparison:
    """Bring a layer without alpha to what is compared.

    Parameters
    ----------
    layer
        RGB of 8 or 16 bits or floats, and CMYK with a profile, become CIELAB: by the embedded profile, else as sRGB,
        or as linear light if floats. Gray becomes lightness. Of anything else each channel is scaled to 0 .. 100.
    valid
        (rows, cols), True where the layer may be used.
    threads
        Changes nothing else.
    like
        What it is to be compared with: its white and its ranges count, not the layer's own.

    Raises
    ------
    ImageError
        If no usable pixel is a number, or it isn't of the kind that it is to be compared with.
    ProfileError
        If the embedded profile can't be used.
    """
    name, notes = Path(layer.path).name, list[str]()
    pixels = layer.pixels
    finite: Mask = np.asarray(np.isfinite(pixels).all(axis=2))
    if not finite.all():
        count = int(np.count_nonzero(valid & ~finite))
        valid = valid & finite
        if not valid.any():
            raise ImageError(f"{layer.path}: no usable pixel is a number; export it again", path=layer.path)
        if count:
            notes.append(f"{name}: what is NaN or infinite, {count} of its pixels, is treated as a hole")
        pixels = np.where(finite[..., None], pixels, pixels.dtype.type(0))
    by_range = not _is_light(layer, pixels, valid) if like is None else bool(like.ranges)
    if like is not None and not _is_of_kind(layer, like):
        raise ImageError(
            f"{layer.path}: its {pixels.shape[2]} channel{'s' if pixels.shape[2] > 1 else ''} of {pixels.dtype} aren't "
            "of the kind that it is compared with; give both alike",
            path=layer.path,
        )
    if by_range:
        ranges = _ranges(pixels, valid) if like is None else like.ranges
        if like is None and layer.channels in (_RGB, ("Y",)):
            notes.append(f"{name}: its {pixels.dtype} aren't colours: they are compared by their range")
        return Comparison(_scaled(pixels, ranges), valid, is_lab=False, notes=tuple(notes), ranges=ranges)
    if pixels.dtype.kind == "f":
        pixels = np.maximum(pixels.astype(np.float32), 0)
    try:
        check_scan_profile(Path(layer.path), pixels.shape[2], layer.icc_profile)
        xyz = scan_to_xyz(pixels, layer.icc_profile, threads=threads)
    except ProfileError as error:
        path = layer.path
        raise ProfileError(error.message if path in error.message else f"{path}: {error.message}", path=path) from error
    light, white = xyz[..., 1], 1.0 if like is None else like.white
    if like is None and np.count_nonzero((light > _BRIGHT) & valid) > _BRIGHT_SHARE * np.count_nonzero(valid):
        white = float(np.percentile(light[valid], _WHITE_PERCENTILE))
        notes.append(f"{name}: much of it is brighter than white: it is compared as if {white:.3g} were white")
    if white != 1:
        xyz /= np.float32(white)
    lab_in_place(xyz, threads)
    # The numbers that texture maps store: a last bit that differs between machines is gone from them.
    lab = decode_lab16(encode_lab16(xyz))
    is_lab = layer.pixels.shape[2] > 1
    return Comparison(lab if is_lab else np.ascontiguousarray(lab[..., :1]), valid, is_lab, tuple(notes), white)


def preview_of(comparison: Comparison) -> NDArray[np.uint8]:
    """(rows, cols, 3) sRGB of what is compared: its colours, or its first channel as gray."""
    lab = np.zeros((*comparison.image.shape[:2], 3), dtype=np.float32)
    shown = 3 if comparison.is_lab else 1
    lab[..., :shown] = comparison.image[..., :shown]
    srgb = srgb_from_xyz(xyz_from_lab(lab))
    return np.rint(255 * np.clip(srgb, 0, 1)).astype(np.uint8)


def _is_light(layer: Layer, pixels: Array, valid: Mask) -> bool:
    """Whether a layer holds colours or gray as a picture does, and not heights or whatever else."""
    kind = pixels.dtype
    if layer.channels == _CMYK:
        return layer.icc_profile is not None and kind in (np.uint8, np.uint16)
    if layer.channels == _RGB:
        return kind in (np.uint8, np.uint16) or kind.kind == "f"
    if pixels.shape[2] != 1:
        return False
    if kind.kind == "f":
        values = pixels[..., 0][valid]
        return bool(values.min() >= 0 and values.max() <= 1)
    return kind in (np.uint8, np.uint16)


def _is_of_kind(layer: Layer, like: Comparison) -> bool:
    """Whether a layer's numbers mean what those of something compared mean."""
    channels, kind = layer.pixels.shape[2], layer.pixels.dtype
    if like.ranges:
        return bool(channels == len(like.ranges))
    if kind.name not in ("uint8", "uint16") and kind.kind != "f":
        return False
    if like.is_lab:
        return layer.channels == _RGB or (layer.channels == _CMYK and layer.icc_profile is not None)
    return bool(channels == 1)


def _ranges(pixels: Array, valid: Mask) -> tuple[tuple[float, float], ...]:
    seen = pixels[valid].astype(np.float64)
    return tuple((float(low), float(high)) for low, high in zip(seen.min(axis=0), seen.max(axis=0), strict=True))


def _scaled(pixels: Array, ranges: tuple[tuple[float, float], ...]) -> FloatImage:
    image = np.zeros(pixels.shape, dtype=np.float32)
    for channel, (low, high) in enumerate(ranges):
        if high > low:
            values = pixels[..., channel].astype(np.float64)
            image[..., channel] = np.clip((values - low) / (high - low), 0, 1) * 100
    return image
