"""Print data kept within a total ink limit in place, and the ink that it takes, for large images."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.grid_layout import each_strip
from tilefab.colour.limits import max_total_counts
from tilefab.colour.press_kernels import keep_limit

_NO_LIMIT = 1 << 62


@dataclass(frozen=True)
class InkUse:
    """Ink that print data takes; 1 is one ink in full.

    Attributes
    ----------
    mean
        Of each ink, over all pixels.
    largest_total
        Of all inks of a pixel added up.
    share_limited
        Share of pixels that were above the limit before.
    """

    mean: tuple[float, ...]
    largest_total: float
    share_limited: float


def limit_counts(
    counts: NDArray[Any], limit_percent: float | None, black_channel: int | None, *, threads: int = 1
) -> InkUse:
    """Reduce, in place, print data that is above a total limit, and tell what it takes then.

    Parameters
    ----------
    counts
        (rows, cols, N) uint8 or uint16, C-contiguous.
    limit_percent
        Largest total area coverage in percent, above 0; None for none.
    black_channel
        Kept where the others are reduced in proportion; None: all are.
    threads
        Number of threads, 1 or more; never changes the result.

    Raises
    ------
    ValueError
        If the counts, the limit or threads are none of the above.
    """
    if not counts.flags.c_contiguous or counts.ndim != 3:
        raise ValueError(f"counts must be (rows, cols, inks), C-contiguous, but are {counts.shape}")
    inks, full = counts.shape[2], int(np.iinfo(counts.dtype).max)
    if limit_percent is not None and not limit_percent > 0.0:
        raise ValueError(f"limit_percent {limit_percent} must be above 0")
    if black_channel is not None and not 0 <= black_channel < inks:
        raise ValueError(f"black_channel {black_channel} is outside 0 .. {inks - 1}")
    most = _NO_LIMIT if limit_percent is None else max_total_counts(limit_percent, counts.dtype)
    black = -1 if black_channel is None else black_channel
    flat = counts.reshape(-1, inks)
    lock = threading.Lock()
    sums, largest, limited = np.zeros(inks, np.int64), 0, 0

    def convert(strip: NDArray[Any], to: int) -> None:
        nonlocal largest, limited
        own = np.zeros(inks, np.int64)
        top, above = keep_limit(flat[to : to + strip.shape[0] * strip.shape[1]], most, black, own)
        with lock:
            sums[:] += own
            largest, limited = max(largest, int(top)), limited + above

    each_strip(counts, convert, threads)
    pixels = max(1, len(flat))
    return InkUse(tuple((sums / (full * pixels)).tolist()), largest / full, limited / pixels)
