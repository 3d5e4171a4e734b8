"""Large images gone through in bands of rows, on several threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")


def over_bands(work: Callable[[slice], Result], rows: int, band_rows: int, threads: int = 1) -> list[Result]:
    """Call ``work`` for each band of rows.

    Parameters
    ----------
    work
        Takes the rows of a band. Bands must not depend on each other.
    rows
        Rows of the image.
    band_rows
        Rows of a band; fewer in the last.
    threads
        Number of threads, 1 or more.

    Returns
    -------
    list
        What ``work`` returned, from the first band to the last.

    Raises
    ------
    ValueError
        If there is no thread to work on.

    Examples
    --------
    >>> over_bands(lambda band: band.stop - band.start, 10, 4, threads=2)
    [4, 4, 2]
    """
    if threads < 1:
        raise ValueError(f"threads {threads} must be 1 or more")
    bands = [slice(top, min(top + band_rows, rows)) for top in range(0, rows, max(band_rows, 1))]
    if threads == 1 or len(bands) < 2:
        return [work(band) for band in bands]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, bands))
