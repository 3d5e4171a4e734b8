"""The field of patches at one scale: which patch of the exemplar stands where, and what the patches vote for.

Texture optimisation (Kwatra et al. 2005; Wexler et al. 2007) takes turns: each patch of the result is given its
cheapest place in the exemplar, then each pixel the mean of all patches that cover it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.synthesis.patch_kernels import CHANNELS, PATCH_PX, search
from tilefab.synthesis.pyramid import Scale
from tilefab.synthesis.usage import Prices, Shifts
from tilefab.synthesis.vote_kernels import choose, settle, tally, tally_weighted
from tilefab.types import SizePx

_BANDS_PER_THREAD = 4
_LEAST_BAND_ROWS = 16
_MIDDLE_PX = PATCH_PX // 2
WEIGHT_UNIT = 64
"""Weight of an ordinary vote; a whole number, so that sums are exact."""


class Workers:
    """Threads that share out the rows of an image; the result never depends on how many there are.

    Parameters
    ----------
    threads
        How many, 1 or more.
    """

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def over(self, rows: int, work: Callable[[int, int], None]) -> None:
        """Call ``work(begin, end)`` for bands that make up all rows."""
        bands = max(1, min(self._threads * _BANDS_PER_THREAD, rows // _LEAST_BAND_ROWS))
        if self._pool is None or bands == 1:
            work(0, rows)
            return
        edges = [rows * band // bands for band in range(bands + 1)]
        list(self._pool.map(work, edges[:-1], edges[1:]))

    def close(self) -> None:
        """Let the threads go."""
        if self._pool is not None:
            self._pool.shutdown()


class PatchField:
    """Patches of one scale of the exemplar on a grid over the result.

    Parameters
    ----------
    scale
        The exemplar.
    size
        Of the result, two patches or more a side.
    toroidal
        Whether it repeats.
    stride_px
        How far patches are apart: 1 or 2.
    workers
        Who does the work.

    Attributes
    ----------
    places
        (field rows, field cols) int32: flat index of the exemplar's pixel at which each patch begins.
    difference
        Squared difference of each patch to the target that it was last searched for.
    rows_px, cols_px
        Where patches begin in the result.
    """

    places: NDArray[np.int32]

    def __init__(self, scale: Scale, size: SizePx, toroidal: bool, stride_px: int, workers: Workers) -> None:
        self.scale, self.size, self.toroidal = scale, size, toroidal
        self._workers = workers
        self.rows_px, rows = _grid(size.rows, toroidal, stride_px)
        self.cols_px, cols = _grid(size.cols, toroidal, stride_px)
        # With a stride of two the last patch may reach beyond the result by a pixel.
        self._rows, self._cols = rows, cols
        self._period = (rows, cols) if toroidal else (0, 0)
        self._wide_cols = cols + PATCH_PX - 1 if toroidal else cols
        self._image = scale.image.reshape(-1)
        self._exemplar_cols = scale.image.shape[1]
        self.places = np.zeros((len(self.rows_px), len(self.cols_px)), dtype=np.int32)
        self.difference = np.zeros(self.places.shape, dtype=np.int64)
        self._covering = (
            _covering(self.rows_px, rows, toroidal),
            _covering(self.cols_px, cols, toroidal),
        )
        counts = [(covering >= 0).sum(axis=1) for covering in self._covering]
        self._votes = np.outer(counts[0], counts[1])[..., np.newaxis]

    def start_from(self, source: NDArray[np.int32]) -> None:
        """Take the patches whose middles a map of places shows, or the nearest that are allowed.

        Parameters
        ----------
        source
            (size.rows, size.cols), flat index into the exemplar of each pixel.
        """
        rows, cols = self.rows_px + _MIDDLE_PX, self.cols_px + _MIDDLE_PX
        if self.toroidal:
            shown = source[rows[:, np.newaxis] % self.size.rows, cols % self.size.cols]
        else:
            rows, cols = np.minimum(rows, self.size.rows - 1), np.minimum(cols, self.size.cols - 1)
            shown = source[rows[:, np.newaxis], cols]
        place_rows, place_cols = np.divmod(shown.astype(np.int64), self._exemplar_cols)
        self._put(place_rows - (rows - self.rows_px)[:, np.newaxis], place_cols - (cols - self.cols_px))

    def _put(self, wanted_rows: NDArray[np.int64], wanted_cols: NDArray[np.int64]) -> None:
        # At the nearest places at which a whole patch is allowed.
        height, width = self.scale.allowed.shape
        rows = np.clip(wanted_rows, 0, height - PATCH_PX)
        cols = np.clip(wanted_cols, 0, width - PATCH_PX)
        if not self.scale.allowed[rows, cols].all():
            nearest_rows, nearest_cols = nearest_allowed(self.scale.allowed)
            rows, cols = nearest_rows[rows, cols], nearest_cols[rows, cols]
        self.places = (rows * self._exemplar_cols + cols).astype(np.int32)

    def vote(self, weights: NDArray[np.int64] | None = None) -> NDArray[np.int16]:
        """Mean of all patches over each pixel.

        Parameters
        ----------
        weights
            (exemplar rows, exemplar cols), weight of each of its pixels, `WEIGHT_UNIT` or so; ``None``: all alike.

        Returns
        -------
        ndarray
            (rows, cols, 4) int16, for `search`: where the result repeats, its first rows and columns once more.
        """
        if weights is None:
            sums = np.zeros((self._rows, self._wide_cols * CHANNELS), dtype=np.int32)
            self._workers.over(
                self._rows,
                lambda begin, end: tally(
                    self._image, self._exemplar_cols, self.places, self.rows_px, self.cols_px, self._period[0], begin,
                    end, sums[begin:end],
                ),
            )  # fmt: skip
            total = self._folded(sums.reshape(self._rows, self._wide_cols, CHANNELS))
            mean = (2 * total + self._votes) // (2 * self._votes)
        else:
            flat = weights.reshape(-1)
            weighted = np.zeros((self._rows, self._wide_cols * CHANNELS), dtype=np.int64)
            totals = np.zeros((self._rows, self._wide_cols), dtype=np.int64)
            self._workers.over(
                self._rows,
                lambda begin, end: tally_weighted(
                    self._image, flat, self._exemplar_cols, self.places, self.rows_px, self.cols_px, self._period[0],
                    begin, end, weighted[begin:end], totals[begin:end],
                ),
            )  # fmt: skip
            total = self._folded(weighted.reshape(self._rows, self._wide_cols, CHANNELS))
            votes = self._folded(totals[..., np.newaxis])
            mean = (2 * total + votes) // (2 * votes)
        target = mean.astype(np.int16)
        if self.toroidal:
            target = np.pad(target, ((0, PATCH_PX - 1), (0, PATCH_PX - 1), (0, 0)), mode="wrap")
        return np.ascontiguousarray(target)

    def search(
        self, target: NDArray[np.int16], prices: Prices, shifts: Shifts, colour: int, key: np.uint64, tries: int
    ) -> None:
        """Look for cheaper places for the patches of one colour of the checkerboard; see the kernel of that name."""
        found = self.places.copy()
        image, flat, allowed = target.reshape(-1), self._image, self.scale.allowed.reshape(-1)
        self._workers.over(
            len(self.rows_px),
            lambda begin, end: search(
                image, target.shape[1], self.rows_px, self.cols_px, self._period, flat, self._exemplar_cols, allowed,
                prices.price, prices.crowd, prices.most, shifts.starts, shifts.order, shifts.price, self.places, found,
                self.difference, colour, begin, end, key, tries,
            ),
        )  # fmt: skip
        self.places = found

    def chosen(self, target: NDArray[np.int16], settling: int, seam_weight: int) -> NDArray[np.int32]:
        """What each pixel shows in the end: a pixel of one of the patches over it, near their mean, on cheap seams.

        Parameters
        ----------
        target
            The mean of the votes.
        settling
            How often each pixel may join a neighbour's piece.
        seam_weight
            Of the cost of seams, over that of differing from the mean.

        Returns
        -------
        ndarray
            (size.rows, size.cols) int32, flat index into the exemplar.
        """
        source = np.zeros((self._rows, self._cols), dtype=np.int32)
        mean = target.reshape(-1)
        self._workers.over(
            self._rows,
            lambda begin, end: choose(
                self._image, self._exemplar_cols, self.places, mean, target.shape[1], *self._covering, begin, end,
                source,
            ),
        )  # fmt: skip
        valid = self.scale.valid.reshape(-1)
        dearness = np.ones(valid.shape, dtype=np.int64)
        if self.scale.weights is not None:
            dearness += self.scale.weights.reshape(-1)
        for turn in range(2 * settling):
            before, after = source, source.copy()

            def work(begin: int, end: int, before: NDArray[np.int32] = before, after: NDArray[np.int32] = after,
                     colour: int = turn & 1) -> None:  # fmt: skip
                settle(
                    self._image, self._exemplar_cols, valid, dearness, mean, target.shape[1], self.toroidal,
                    seam_weight, colour, begin, end, before, after,
                )  # fmt: skip

            self._workers.over(self._rows, work)
            source = after
        return np.ascontiguousarray(source[: self.size.rows, : self.size.cols])

    def shown_at(self, scale: Scale, size: SizePx) -> NDArray[np.int32]:
        """What a larger result shows if each patch is moved as a whole: offsets are scaled, not places.

        Parameters
        ----------
        scale
            The exemplar at the scale of the larger result.
        size
            Of the larger result.

        Returns
        -------
        ndarray
            (size.rows, size.cols) int32, flat index into ``scale``'s pixels, always a valid one.
        """
        rows, cols = np.arange(size.rows), np.arange(size.cols)
        i = _nearest_of(self.rows_px, rows, size.rows, self.size.rows)
        j = _nearest_of(self.cols_px, cols, size.cols, self.size.cols)
        place_rows, place_cols = np.divmod(self.places.astype(np.int64)[i[:, np.newaxis], j], self._exemplar_cols)
        height, width = scale.valid.shape
        down = (place_rows - self.rows_px[i][:, np.newaxis]) * (height / self.scale.valid.shape[0])
        right = (place_cols - self.cols_px[j]) * (width / self.scale.valid.shape[1])
        found_rows = np.clip(rows[:, np.newaxis] + np.rint(down).astype(np.int64), 0, height - 1)
        found_cols = np.clip(cols + np.rint(right).astype(np.int64), 0, width - 1)
        if not scale.valid[found_rows, found_cols].all():
            nearest_rows, nearest_cols = nearest_allowed(scale.valid)
            found_rows, found_cols = nearest_rows[found_rows, found_cols], nearest_cols[found_rows, found_cols]
        return np.asarray(found_rows * width + found_cols, dtype=np.int32)

    def _folded(self, sums: NDArray[np.integer]) -> NDArray[np.int64]:
        total = sums[:, : self._cols].astype(np.int64)
        if self.toroidal:
            total[:, : PATCH_PX - 1] += sums[:, self._cols :]
        return total


def nearest_allowed(allowed: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of the nearest True of each pixel."""
    rows, cols = ndimage.distance_transform_edt(~allowed, return_distances=False, return_indices=True)
    return rows.astype(np.int64), cols.astype(np.int64)


def _grid(length: int, toroidal: bool, stride_px: int) -> tuple[NDArray[np.int64], int]:
    """Where patches begin along an axis, and how many pixels they cover."""
    last = length if toroidal else length - PATCH_PX + stride_px
    begins = np.arange(0, last, stride_px, dtype=np.int64)
    return begins, length if toroidal else int(begins[-1]) + PATCH_PX


def _covering(begins: NDArray[np.int64], length: int, toroidal: bool) -> NDArray[np.int64]:
    """(length, PATCH_PX): which patch lies over each pixel with its k-th one, or -1."""
    found = np.full((length, PATCH_PX), -1, dtype=np.int64)
    for k in range(PATCH_PX):
        at = begins + k
        if toroidal:
            at %= length
        found[at, k] = np.arange(len(begins))
    return found


def _nearest_of(begins: NDArray[np.int64], pixels: NDArray[np.int64], length: int, coarse: int) -> NDArray[np.int64]:
    """For each pixel of a larger result, the patch whose middle lies nearest below the same place."""
    middle = (pixels + 0.5) * (coarse / length) - 0.5 * PATCH_PX
    stride = int(begins[1] - begins[0]) if len(begins) > 1 else 1
    return np.clip(np.rint(middle / stride).astype(np.int64), 0, len(begins) - 1)
