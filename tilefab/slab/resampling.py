"""A scan brought from its own resolution to that of the printer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tilefab.slab.bands import over_bands
from tilefab.slab.checks import check_pair
from tilefab.slab.kernels import cubic_taps, resample_columns, resample_rows
from tilefab.types import FloatImage, Mask, SizePx

_BAND_PX = 1 << 22


@dataclass(frozen=True)
class ResampleRecord:
    """What resampling did.

    Attributes
    ----------
    scale
        Output pixels per input pixel.
    size_before, size_after
        Sizes in pixels.
    valid_frac_before, valid_frac_after
        Share of valid pixels, 0 to 1.
    summary
        One sentence for the report.
    """

    scale: float
    size_before: SizePx
    size_after: SizePx
    valid_frac_before: float
    valid_frac_after: float
    summary: str


def resampled_size(size: SizePx, scale: float) -> SizePx:
    """Size after resampling: each side times ``scale``, to the nearest pixel (halves up), at least one.

    >>> resampled_size(SizePx(rows=1000, cols=333), 0.5)
    SizePx(rows=500, cols=167)
    """
    return SizePx(rows=max(1, math.floor(size.rows * scale + 0.5)), cols=max(1, math.floor(size.cols * scale + 0.5)))


def resample(image: FloatImage, valid: Mask, scale: float, threads: int = 1) -> tuple[FloatImage, Mask, ResampleRecord]:
    """Resample a linear image and its mask by one factor in both directions.

    Keys' cubic, interpolating when enlarging and widened by 1 / ``scale`` against aliasing when reducing,
    in linear light, clamped to the range of its support (no ringing, never below the darkest pixel around).
    The resolution is exact: the centre of output pixel i lies at (i + 0.5) / ``scale``, whatever rounding
    the size takes, so the last pixel may hang over the scan's edge by at most half an output pixel. Works
    in bands of rows; beside input and output it needs some tens of megabytes a thread.

    Parameters
    ----------
    image
        float32, (rows, cols, 3), linear light.
    valid
        bool, (rows, cols).
    scale
        Print resolution by scan resolution, > 0.
    threads
        Never changes the result.

    Returns
    -------
    image
        float32, size as `resampled_size` tells; where the scale is 1, image and mask are those given.
    valid
        True where every pixel of the support was valid. Pixels beyond the scan's edge do not count as
        invalid.
    record

    Raises
    ------
    ValueError
        If image or mask break the conventions or the scale is not a positive finite number.

    Notes
    -----
    Keys (1981), "Cubic convolution interpolation for digital image processing", IEEE TASSP 29(6).
    """
    check_pair(image, valid)
    if not (math.isfinite(scale) and scale > 0.0):
        raise ValueError(f"scale {scale} is not a positive finite number")
    before = SizePx(*valid.shape)
    after = resampled_size(before, scale)
    if scale == 1.0:
        frac = float(valid.mean())
        return (
            image,
            valid,
            ResampleRecord(1.0, before, after, frac, frac, "nothing, because the scan has the print's resolution"),
        )
    col_taps = cubic_taps(before.cols, after.cols, scale)
    first, count, weights = cubic_taps(before.rows, after.rows, scale)
    out = np.empty((after.rows, after.cols, 3), np.float32)
    out_valid = np.empty((after.rows, after.cols), np.bool_)
    rows_a_band = max(1, int(_BAND_PX * min(scale, 1.0) / max(before.cols, after.cols)))

    def one_band(band: slice) -> None:
        top, bottom = band.start, band.stop
        start = int(first[top:bottom].min())
        end = int((first[top:bottom] + count[top:bottom]).max())
        middle = np.empty((end - start, after.cols, 3), np.float32)
        middle_valid = np.empty(middle.shape[:2], np.bool_)
        resample_columns(image[start:end], valid[start:end], *col_taps, middle, middle_valid)
        resample_rows(
            middle,
            middle_valid,
            first[top:bottom] - start,
            count[top:bottom],
            weights[top:bottom],
            out[top:bottom],
            out_valid[top:bottom],
        )

    over_bands(one_band, after.rows, rows_a_band, threads)
    frac_before, frac_after = float(valid.mean()), float(out_valid.mean())
    verb = "reduced" if scale < 1.0 else "enlarged"
    summary = (
        f"{verb} by {scale:.4g} from {before.cols} x {before.rows} to {after.cols} x {after.rows} px; "
        f"{100 * frac_after:.1f} % of the pixels are valid"
    )
    return out, out_valid, ResampleRecord(scale, before, after, frac_before, frac_after, summary)
