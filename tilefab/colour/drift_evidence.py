"""What one fired tile says of the drift: its regions summed up as how likely each small change of the state is.

A tile has thousands of regions with known inks, and none of them is a patch: stray spots, the light over the tile and
the model's own error would make their mere number claim a certainty that no tile has. So regions that nothing explains
are left aside, regions of like inks count together as one colour that the model itself is only so sure of, and a
colour cast that all of them share is believed only as far as tiles of an unchanged press are alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.drift import MOST_TONE_CHANGE, DriftState, drift_slopes, drifted
from tilefab.colour.press_model import PressModel

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

_FIT_ROUNDS = 4
_NARROW = 0.02
_LEAST_TRUST = 1e-12
_FAR = 0.7
_MEDIAN_CHI2_OF_3 = 2.366


@dataclass(frozen=True)
class EvidenceSettings:
    """How far the regions of one tile are believed.

    Attributes
    ----------
    cells
        Most groups of like inks that regions are gathered in.
    region_noise_lab
        Spread of L*, a* and b* that any region has beside the noise told of it: grain, an ink that isn't even.
    model_noise_lab
        How far off the press model is for a group of like inks.
    tile_noise_lab
        Spread of a cast that all regions of a tile share: light, camera, its place in the kiln.
    cut_off
        Regions that differ by more than so many spreads are left aside, nearer ones count less the more they differ.
    """

    cells: int = 48
    region_noise_lab: float = 0.5
    model_noise_lab: float = 0.5
    tile_noise_lab: float = 0.3
    cut_off: float = 6.0


@dataclass(frozen=True, eq=False)
class DriftEvidence:
    """What a tile says of the state v of the press that fired it.

    For small changes the logarithm of its likelihood is
    ``vector @ (v - at) - (v - at) @ information @ (v - at) / 2``.

    Attributes
    ----------
    at
        (Q,) state around which that holds.
    information, vector
        (Q, Q) and (Q,).
    effect
        (Q, Q): ``d @ effect @ d`` is the mean square of CIE76 differences that a change d makes on the tile.
    watch
        (3, Q) slopes of the tile's mean L*, a* and b*.
    regions, used
        Regions that were measured, and those of them that were not left aside.
    misfit
        What is left of differences when the state has explained what it can, over what noise lets expect; about 1.
    residual_lab
        Mean L*, a* and b*, fired less what the given state says.
    """

    at: Float64Array = field(repr=False)
    information: Float64Array = field(repr=False)
    vector: Float64Array = field(repr=False)
    effect: Float64Array = field(repr=False)
    watch: Float64Array = field(repr=False)
    regions: int
    used: int
    misfit: float
    residual_lab: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class _Tile:
    """Measured regions (M, ...), each in a cell (M,) of C, cells' mean inks (C, N)."""

    inks: Float64Array
    lab: Float64Array
    noise: Float64Array
    share: Float64Array
    cell: Int64Array
    centres: Float64Array


def drift_evidence(
    model: PressModel,
    state: DriftState,
    ink_frac: NDArray[np.floating],
    fired_lab: NDArray[np.floating],
    noise_lab: float | NDArray[np.floating],
    *,
    share: NDArray[np.floating] | None = None,
    settings: EvidenceSettings | None = None,
) -> DriftEvidence:
    """Sum up the regions of a tile.

    Parameters
    ----------
    model
        The press as it was profiled.
    state
        What the tile is expected to show: its mean, and how far that may be off.
    ink_frac, fired_lab
        (M, N) mean inks of each region, and (M, 3) the absolute Lab it fired to; regions that aren't finite are left
        out. The mean colour of a region that isn't even is not that of its mean inks: for such ones give ``model.lab(
        ink_frac)`` plus what was measured less the mean of the colours that the press as it was profiled makes of the
        region's pixels.
    noise_lab
        Spread of L*, a* and b* of each region, one number or (M,), 0 upwards.
    share
        (M,) how much of the tile each region is, 0 upwards; None: all the same.
    settings
        How far to believe them.

    Returns
    -------
    DriftEvidence
        Without any information if no region is finite.

    Raises
    ------
    ValueError
        If shapes don't fit, or a noise or share is negative.

    References
    ----------
    Weights: A. E. Beaton, J. W. Tukey, "The fitting of power series, meaning polynomials, illustrated on
    band-spectroscopic data", Technometrics 16 (1974), section 8.
    """
    chosen = settings or EvidenceSettings()
    tile = _tile(model, state, ink_frac, fired_lab, noise_lab, share, chosen)
    if not len(tile.lab):
        size = len(state.mean)
        nothing = np.zeros((size, size))
        mean = state.mean.copy()
        return DriftEvidence(mean, nothing, np.zeros(size), nothing, np.zeros((3, size)), 0, 0, 1.0, (0.0, 0.0, 0.0))
    known = np.asarray(np.linalg.inv(state.covariance), dtype=np.float64)
    fit = _Fit(model, state, tile, chosen)
    first = np.average(fit.miss, axis=0, weights=fit.part)
    change = fit.settle(known, state.mean)
    if change @ fit.effect() @ change > _FAR**2:
        # A step: slopes are those of where it leads to.
        there = state.mean + change
        there[: 2 * state.inks] = np.clip(there[: 2 * state.inks], -MOST_TONE_CHANGE, MOST_TONE_CHANGE)
        fit = _Fit(model, replace(state, mean=there), tile, chosen)
        fit.settle(known, state.mean)
    information, vector = fit.sums()
    return DriftEvidence(
        at=fit.state.mean.copy(),
        information=information,
        vector=vector,
        effect=fit.effect(),
        watch=np.einsum("c,ckq->kq", fit.cell_part, fit.slopes),
        regions=len(tile.lab),
        used=int(np.count_nonzero(fit.weight > 0.0)),
        misfit=fit.misfit,
        residual_lab=(float(first[0]), float(first[1]), float(first[2])),
    )


def _tile(
    model: PressModel,
    state: DriftState,
    ink_frac: NDArray[np.floating],
    fired_lab: NDArray[np.floating],
    noise_lab: float | NDArray[np.floating],
    share: NDArray[np.floating] | None,
    settings: EvidenceSettings,
) -> _Tile:
    inks = np.asarray(ink_frac, dtype=np.float64)
    lab = np.asarray(fired_lab, dtype=np.float64)
    if state.inks != model.inks or inks.ndim != 2 or inks.shape[1] != model.inks or lab.shape != (len(inks), 3):
        raise ValueError(f"inks {inks.shape} and colours {lab.shape} don't fit a press of {model.inks} inks")
    noise = np.broadcast_to(np.asarray(noise_lab, dtype=np.float64), (len(inks),))
    part = np.broadcast_to(np.asarray(1.0 if share is None else share, dtype=np.float64), (len(inks),))
    if (noise < 0.0).any() or (part < 0.0).any():
        raise ValueError("noise and share of a region must not be negative")
    good = np.isfinite(inks).all(axis=1) & np.isfinite(lab).all(axis=1) & np.isfinite(noise) & (part > 0.0)
    inks, lab, part = inks[good], lab[good], part[good]
    cell = ink_cells(inks, settings.cells)
    sizes = np.bincount(cell)
    centres = np.stack([np.bincount(cell, inks[:, i]) / sizes for i in range(inks.shape[1])], axis=1)
    return _Tile(inks, lab, np.hypot(noise[good], settings.region_noise_lab), part / part.sum(), cell, centres)


def ink_cells(inks: Float64Array, most: int) -> Int64Array:
    """Gather regions of like inks.

    Parameters
    ----------
    inks
        (M, N) ink fractions.
    most
        Most groups, 1 upwards.

    Returns
    -------
    int64 (M,)
        Group of each region, 0 upwards without gaps: the widest is split in the middle of its widest ink again and
        again.
    """
    cell = np.zeros(len(inks), dtype=np.int64)
    members = [np.arange(len(inks))]
    widths = [_width(inks)]
    while len(members) < most and (size := max(widths)[0]) > _NARROW:
        widest = next(place for place, width in enumerate(widths) if width[0] == size)
        rows, ink = members[widest], widths[widest][1]
        levels = inks[rows, ink]
        upper = levels > 0.5 * (levels.min() + levels.max())
        cell[rows[upper]] = len(members)
        members[widest] = rows[~upper]
        members.append(rows[upper])
        widths[widest] = _width(inks[members[widest]])
        widths.append(_width(inks[members[-1]]))
    return cell


def _width(inks: Float64Array) -> tuple[float, int]:
    """Range of the ink that ranges widest, and which it is."""
    if not len(inks):
        return 0.0, 0
    ranges = inks.max(axis=0) - inks.min(axis=0)
    ink = int(ranges.argmax())
    return float(ranges[ink]), ink


class _Fit:
    """Regions against a state, and the weights under which they are believed."""

    def __init__(self, model: PressModel, state: DriftState, tile: _Tile, settings: EvidenceSettings) -> None:
        self.state = state
        self._settings = settings
        self._tile = tile
        lab, by_ink = drifted(model, state).lab_and_slopes(tile.centres)
        _, self.slopes = drift_slopes(model, state, tile.centres)
        offset = tile.inks - tile.centres[tile.cell]
        self.miss = tile.lab - lab[tile.cell] - np.einsum("mkn,mn->mk", by_ink[tile.cell], offset)
        self.part = tile.share
        self.cell_part = np.bincount(tile.cell, tile.share, minlength=len(tile.centres))
        self.weight = np.ones(len(tile.lab))
        self.misfit = 1.0

    def settle(self, known: Float64Array, mean: Float64Array) -> Float64Array:
        """Find the weights; (Q,) the change from the state that suits regions and what is known of it best.

        known and mean: (Q, Q) inverse covariance and (Q,) mean of what is known.
        """
        change: Float64Array = np.zeros(len(mean))
        for _ in range(_FIT_ROUNDS):
            left = self.miss - (self.slopes @ change)[self._tile.cell]
            left = left - np.median(left, axis=0)
            far = np.linalg.norm(left, axis=1) / self._tile.noise
            self.misfit = math.sqrt(float(np.median(far * far)) / _MEDIAN_CHI2_OF_3)
            reach = self._settings.cut_off * max(self.misfit, 1.0)
            self.weight = np.maximum(1.0 - (far / reach) ** 2, 0.0) ** 2
            information, vector = self.sums()
            pulled = vector + known @ (mean - self.state.mean)
            change = np.asarray(np.linalg.solve(information + known, pulled), dtype=np.float64)
        return change

    def sums(self) -> tuple[Float64Array, Float64Array]:
        """Information (Q, Q) and vector (Q,)."""
        cell, cells = self._tile.cell, len(self._tile.centres)
        trust = self.weight / (self._tile.noise * max(self.misfit, 1.0)) ** 2
        total = np.bincount(cell, trust, minlength=cells)
        summed = [np.bincount(cell, trust * self.miss[:, k], minlength=cells) for k in range(3)]
        missed = np.stack(summed, axis=1) / np.maximum(total, _LEAST_TRUST)[:, np.newaxis]
        # The mean of a group is as sure as its regions are many, but never surer than the model.
        sure = total / (1.0 + total * self._settings.model_noise_lab**2)
        lean = self.slopes.reshape(3 * cells, -1)
        weighted = np.repeat(sure, 3)[:, np.newaxis] * lean
        information = lean.T @ weighted
        vector = weighted.T @ missed.reshape(-1)
        # A cast of the whole tile, whatever it is, is taken out again: the margin of the likelihood over it.
        cast = float(sure.sum()) + self._settings.tile_noise_lab**-2
        shared = weighted.reshape(cells, 3, -1).sum(axis=0)
        information -= shared.T @ shared / cast
        vector -= shared.T @ (sure @ missed) / cast
        return 0.5 * (information + information.T), vector

    def effect(self) -> Float64Array:
        """(Q, Q) mean square that a change of the state shows by."""
        lean = self.slopes.reshape(3 * len(self.cell_part), -1)
        return lean.T @ (np.repeat(self.cell_part, 3)[:, np.newaxis] * lean)
