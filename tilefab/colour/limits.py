"""Total ink: keeping what is laid on a tile under the limit that glaze and press bear, in integers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.types import PrintImage


def max_total_counts(limit_percent: float, dtype: np.dtype[Any]) -> int:
    """Largest sum of the counts of one pixel under a total ink limit: floor(limit / 100 * largest count).

    >>> max_total_counts(280, np.dtype(np.uint8))
    714
    """
    return int(limit_percent * int(np.iinfo(dtype).max) // 100)


def limit_total_ink(
    ink_frac: NDArray[np.floating], limit_percent: float, black_channel: int | None
) -> NDArray[np.float32]:
    """Scale inks down until their sum keeps a limit, taking from the chromatic inks and keeping black.

    Parameters
    ----------
    ink_frac
        (..., N) ink fractions, 0 to 1.
    limit_percent
        Largest total area coverage in percent; 280 means a sum of 2.8.
    black_channel
        Index of the black ink, which is kept where the limit allows it; None scales all inks alike.

    Returns
    -------
    numpy.ndarray
        (..., N) float32. Pixels within the limit are unchanged. Sums hold to float32 rounding;
        `quantise_inks` makes them exact.

    Raises
    ------
    ValueError
        If the limit is not above zero, or there is no such channel.
    """
    inks = np.asarray(ink_frac, dtype=np.float64)
    if not limit_percent > 0.0:
        raise ValueError(f"limit_percent {limit_percent} must be above 0")
    if black_channel is not None and not 0 <= black_channel < inks.shape[-1]:
        raise ValueError(f"black_channel {black_channel} is outside 0 .. {inks.shape[-1] - 1}")
    limit = limit_percent / 100.0
    total = inks.sum(axis=-1, keepdims=True)
    if black_channel is None:
        scale = np.where(total > limit, limit / np.maximum(total, limit), 1.0)
        return (inks * scale).astype(np.float32)
    black = inks[..., black_channel : black_channel + 1]
    chromatic = total - black
    room = np.maximum(limit - black, 0.0)
    scale = np.where(total > limit, room / np.where(chromatic > 0.0, chromatic, 1.0), 1.0)
    limited = inks * scale
    limited[..., black_channel] = np.minimum(black[..., 0], np.maximum(limit, 0.0))
    return limited.astype(np.float32)


@kernel
def quantise_rows(ink_frac: NDArray[np.float32], max_count: int, max_total: int, counts: NDArray[np.uint16]) -> int:
    """Round (M, N) ink fractions to counts whose sum never passes ``max_total``.

    Fractions are clipped to 0 .. 1 and scaled to exact counts; where their sum passes the limit they are
    scaled down together. Each is rounded to nearest, halves up; where rounding alone passes the limit, the
    inks that were rounded up furthest go down by one, the lowest channel first among equals.

    Returns the number of values that are not finite; their pixels are left without ink.
    """
    pixels, inks = ink_frac.shape
    exact = np.empty(inks, np.float64)
    rounded = np.empty(inks, np.int64)
    bad = 0
    for pixel in range(pixels):
        total = 0.0
        finite = True
        for ink in range(inks):
            value = np.float64(ink_frac[pixel, ink])
            if not np.isfinite(value):
                bad += 1
                finite = False
            exact[ink] = min(max(value, 0.0), 1.0) * max_count
            total += exact[ink]
        if not finite:
            for ink in range(inks):
                counts[pixel, ink] = 0
            continue
        scale = 1.0
        if total > max_total:
            scale = max_total / total
        excess = -max_total
        for ink in range(inks):
            exact[ink] *= scale
            rounded[ink] = np.int64(np.floor(exact[ink] + 0.5))
            excess += rounded[ink]
        while excess > 0:
            worst = -1
            furthest = 0.0
            for ink in range(inks):
                if rounded[ink] > 0:
                    distance = rounded[ink] - exact[ink]
                    if worst < 0 or distance > furthest:
                        worst = ink
                        furthest = distance
            rounded[worst] -= 1
            excess -= 1
        for ink in range(inks):
            counts[pixel, ink] = rounded[ink]
    return bad


def quantise_inks(
    ink_frac: NDArray[np.floating],
    dtype: type[np.uint8] | type[np.uint16] | np.dtype[np.uint8] | np.dtype[np.uint16],
    limit_percent: float,
) -> PrintImage:
    """Round ink fractions to print counts that keep the total ink limit exactly, pixel by pixel.

    Parameters
    ----------
    ink_frac
        (..., N) ink fractions; values outside 0 to 1 are clipped.
    dtype
        ``numpy.uint8`` or ``numpy.uint16``; full ink is its largest count.
    limit_percent
        Largest total area coverage in percent.

    Returns
    -------
    numpy.ndarray
        (..., N) counts of ``dtype``, 0 = no ink. For every pixel their sum is at most `max_total_counts`.
        Within the limit each count is the nearest one, halves up.

    Raises
    ------
    ValueError
        If a value is not finite, the limit is below 0 or the dtype is another.

    Examples
    --------
    >>> quantise_inks(np.array([[1.0, 1.0, 1.0, 0.5]]), np.uint8, 280.0).tolist()
    [[204, 204, 204, 102]]
    """
    target = np.dtype(dtype)
    if target not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise ValueError(f"dtype {target} is not uint8 or uint16")
    if not limit_percent >= 0.0:
        raise ValueError(f"limit_percent {limit_percent} must be 0 or more")
    source = np.asarray(ink_frac)
    inks = np.ascontiguousarray(source.reshape(-1, source.shape[-1]), dtype=np.float32)
    counts = np.empty(inks.shape, dtype=target)
    bad = quantise_rows(inks, int(np.iinfo(target).max), max_total_counts(limit_percent, target), counts)
    if bad:
        raise ValueError(f"ink_frac holds {bad} values that are not finite")
    return counts.reshape(source.shape)
