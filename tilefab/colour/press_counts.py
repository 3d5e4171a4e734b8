"""Print data kept within a total ink limit in place, and the ink that it takes, for large images."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.grid_layout import each_strip
from tilefab.colour.limits import limit_total_ink, max_total_counts, quantise_inks
from tilefab.colour.press_kernels import add_up_inks

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
        Kept where others are reduced; see `limit_total_ink`.
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
    most = _NO_LIMIT if limit_percent is None else max_total_counts(limit_percent, counts.dtype)
    flat = counts.reshape(-1, inks)
    lock = threading.Lock()
    sums, largest, limited = np.zeros(inks, np.int64), 0, 0

    def convert(strip: NDArray[Any], to: int) -> None:
        nonlocal largest, limited
        part = flat[to : to + strip.shape[0] * strip.shape[1]]
        own = np.zeros(inks, np.int64)
        top, above = add_up_inks(part, most, own)
        if above and limit_percent is not None:
            over = part.sum(axis=1, dtype=np.int64) > most
            frac = part[over].astype(np.float32) / np.float32(full)
            part[over] = quantise_inks(limit_total_ink(frac, limit_percent, black_channel), counts.dtype, limit_percent)
            own[:] = 0
            top, _ = add_up_inks(part, most, own)
        with lock:
            sums[:] += own
            largest, limited = max(largest, int(top)), limited + above

    each_strip(counts, convert, threads)
    pixels = max(1, len(flat))
    return InkUse(tuple((sums / (full * pixels)).tolist()), largest / full, limited / pixels)
