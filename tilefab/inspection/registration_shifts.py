"""How far blocks of one picture lie from where another has them: phase correlation of many blocks, that vote.

A block that is covered, broken off or plain says nothing of use; the others agree on one shift, and that stands out in
the sum of all blocks' correlations.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

_LEAST_SHARE = 0.35
_BAND = 0.22
_FLOOR = 0.3
_LEAST_BLOCKS = 3
_LEAST_VOTE, _LEAST_PEAK = 6.0, 4.0


@dataclass(frozen=True, eq=False)
class BlockShifts:
    """What blocks say.

    Attributes
    ----------
    at
        (B, 2) float64: middles (x, y) of the blocks that answer, pixels.
    shift
        (B, 2) float64: how far each lies from where the template has it, (x, y) pixels.
    weight
        (B,) how clearly, 0 upwards.
    common
        (x, y): the shift that all voted for; zero if they don't agree.
    vote
        Height of that vote over the standard deviation of all votes.
    """

    at: Float64Array = field(repr=False)
    shift: Float64Array = field(repr=False)
    weight: Float64Array = field(repr=False)
    common: tuple[float, float]
    vote: float

    @property
    def agreed(self) -> bool:
        """Whether the blocks agree."""
        return self.vote >= _LEAST_VOTE


def block_shifts(
    template: Float32Array, moved: Float32Array, weight: Float32Array, *, block: int, reach: float, apart: float
) -> BlockShifts:
    """Shifts of blocks by phase correlation.

    Parameters
    ----------
    template, moved
        (rows, cols) float32 of mean about 0.
    weight
        (rows, cols) float32, 0 to 1: how good a pixel is.
    block
        Side of a block, pixels, at most the shorter side; blocks overlap by half.
    reach
        Largest common shift looked for, pixels; shifts of more than half of it are believed less the longer they are,
        or patterns that repeat would be taken one period off.
    apart
        Largest distance of a block's own shift from the common one, pixels.

    Returns
    -------
    BlockShifts
        Empty, with a vote of 0, if fewer than 3 blocks can be used.

    Raises
    ------
    ValueError
        If the shapes differ or a block doesn't fit.

    References
    ----------
    C. D. Kuglin, D. C. Hines, "The phase correlation image alignment method", Proc. IEEE Int. Conf. on Cybernetics and
    Society (1975). Frequencies with little power in a block are whitened less, and fine ones count less.
    """
    if not template.shape == moved.shape == weight.shape:
        raise ValueError(f"shapes differ: {template.shape}, {moved.shape}, {weight.shape}")
    rows, cols = template.shape
    if not 8 <= block <= min(rows, cols):
        raise ValueError(f"a block of {block} pixels must be 8 or more and fit into {rows} x {cols}")
    nothing = BlockShifts(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), (0.0, 0.0), 0.0)
    tops, lefts = _starts(rows, block), _starts(cols, block)
    window = np.outer(np.hanning(block + 2)[1:-1], np.hanning(block + 2)[1:-1]).astype(np.float32)
    windows, ones, others, middles, shares = [], [], [], [], []
    for top in tops:
        for left in lefts:
            part = np.s_[top : top + block, left : left + block]
            tapered = window * weight[part]
            share = float(tapered.sum() / window.sum())
            if share < _LEAST_SHARE:
                continue
            pair = []
            for picture in (template, moved):
                values = picture[part]
                pair.append(tapered * (values - np.float32((tapered * values).sum() / tapered.sum())))
            windows.append(tapered)
            ones.append(pair[0])
            others.append(pair[1])
            middles.append((left + 0.5 * block, top + 0.5 * block))
            shares.append(share)
    if len(ones) < _LEAST_BLOCKS:
        return nothing
    surfaces = _correlations(np.array(ones), np.array(others))
    spread = surfaces.std(axis=(1, 2))
    usable = spread > 0
    if usable.sum() < _LEAST_BLOCKS:
        return nothing
    surfaces, share_of = surfaces[usable] / spread[usable, np.newaxis, np.newaxis], np.array(shares)[usable]
    at = np.array(middles)[usable]

    total = (share_of[:, np.newaxis, np.newaxis] * surfaces).sum(axis=0)
    total /= max(float(total.std()), 1e-12)
    steps = fft.fftfreq(block, 1.0 / block)
    far = np.hypot(steps[:, np.newaxis], steps[np.newaxis, :])
    judged = np.where(far <= reach, total * np.exp(-0.5 * (far / (0.75 * reach)) ** 2), -np.inf)
    best = np.unravel_index(int(np.argmax(judged)), judged.shape)
    vote = float(total[best])
    if vote < _LEAST_VOTE:
        return BlockShifts(nothing.at, nothing.shift, nothing.weight, (0.0, 0.0), vote)
    common = _top(total, (int(best[0]), int(best[1])))
    away = np.hypot(
        _wrapped(steps - common[1], block)[:, np.newaxis], _wrapped(steps - common[0], block)[np.newaxis, :]
    )
    near = np.where(away <= apart, surfaces, -np.inf)
    peaks = near.reshape(len(near), -1).argmax(axis=1)
    shifts, weights = np.empty((len(peaks), 2)), np.empty(len(peaks))
    for place, peak in enumerate(peaks):
        row, col = divmod(int(peak), block)
        shifts[place] = _top(surfaces[place], (row, col))
        weights[place] = max(float(surfaces[place, row, col]) - _LEAST_PEAK, 0.0)
    clear = weights > 0
    return BlockShifts(at[clear], shifts[clear], weights[clear], common, vote)


def _starts(length: int, block: int) -> list[int]:
    """Evenly spread first pixels of blocks that overlap by half or a little more."""
    count = max(1, -(-2 * (length - block) // block) + 1)
    return [round(place) for place in np.linspace(0, length - block, count)]


def _correlations(ones: Float32Array, others: Float32Array) -> Float32Array:
    """Phase correlation (B, block, block) of pairs of blocks; shift 0 is at [0, 0]."""
    block = ones.shape[1]
    cross = np.conj(fft.rfft2(ones)) * fft.rfft2(others)
    size = np.abs(cross)
    floor = _FLOOR * size.mean(axis=(1, 2), keepdims=True)
    down, across = fft.fftfreq(block)[:, np.newaxis], fft.rfftfreq(block)[np.newaxis, :]
    band = np.exp(-0.5 * (down**2 + across**2) / _BAND**2).astype(np.float32)
    return np.asarray(fft.irfft2(cross / np.maximum(size + floor, 1e-20) * band, s=(block, block)), dtype=np.float32)


def _wrapped(steps: Float64Array, block: int) -> Float64Array:
    return np.asarray((steps + 0.5 * block) % block - 0.5 * block, dtype=np.float64)


def _top(surface: Float32Array, peak: tuple[int, int]) -> tuple[float, float]:
    """Shift (x, y) of a peak, by parabolas through it and its neighbours."""
    block = len(surface)
    out = []
    for axis in (1, 0):
        before, after = list(peak), list(peak)
        before[axis], after[axis] = (peak[axis] - 1) % block, (peak[axis] + 1) % block
        low, mid, high = float(surface[tuple(before)]), float(surface[peak]), float(surface[tuple(after)])
        bend = low - 2.0 * mid + high
        part = 0.5 * (low - high) / bend if bend < 0 else 0.0
        whole = peak[axis] - block if 2 * peak[axis] >= block else peak[axis]
        out.append(whole + min(max(part, -0.5), 0.5))
    return out[0], out[1]
