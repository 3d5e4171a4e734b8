"""How a press has drifted since it was profiled: a small state between profile and kiln, with how sure it is.

Firing hotter or longer fades inks, moisture spreads drops, a glaze changes its tint. Few numbers say most of it: for
each ink a gain and a bend of its tone and a fading in three bands, for each two inks what they fade less or more
together, and a change of the glaze. They are learnt from fired colours of known inks, be it a small chart or regions of
production tiles, by Kalman updates: each new set moves the state as far as its noise and the state's own covariance
say, and no farther.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.neugebauer import neugebauer_rows, overlap_bits
from tilefab.colour.press_model import PressModel, ink_pairs

Float64Array = NDArray[np.float64]

_GAIN_SPREAD, _BEND_SPREAD = 0.05, 0.08
_FADE_SPREAD = 0.06
_CROSS_SPREAD = 0.03
_GLAZE_SPREAD = 0.02
_ROUNDS = 6
MOST_TONE_CHANGE = 0.5
"""Largest gain or bend of an ink that is believed."""

_LAB_OF_ROOTS = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])
"""Lab, but for a constant, of the cube roots of X, Y and Z over those of the white."""

_GROWTH_LIGHTNESS = 50.0
"""Lightness by which residuals grow as their model says; see `tilefab.colour.residual.add_residual`."""


@dataclass(frozen=True)
class DriftState:
    """What is known of a press's drift.

    Attributes
    ----------
    mean
        (Q,) for N inks: gain and bend of each, the glaze's change in each band, the fading of each ink in each band,
        and of each pair of inks; in the meaning of `tilefab.colour.press_model.PressModel.with_drift`.
    covariance
        (Q, Q) of ``mean``.
    inks
        N.
    """

    mean: Float64Array = field(repr=False)
    covariance: Float64Array = field(repr=False)
    inks: int

    def parts(self) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array, Float64Array]:
        """Gain (N,), bend (N,), glaze (3,), fade (N, 3) and cross (N (N - 1) / 2, 3)."""
        inks = self.inks
        gain, bend, glaze, fade, cross = np.split(self.mean, [inks, 2 * inks, 2 * inks + 3, 5 * inks + 3])
        return gain, bend, glaze, fade.reshape(-1, 3), cross.reshape(-1, 3)

    def spread(self) -> Float64Array:
        """(Q,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))


def no_drift(inks: int) -> DriftState:
    """The state of a press just profiled: nothing has changed, and this is how far it usually does."""
    spread = np.concatenate(
        [
            np.full(inks, _GAIN_SPREAD),
            np.full(inks, _BEND_SPREAD),
            np.full(3, _GLAZE_SPREAD),
            np.full(3 * inks, _FADE_SPREAD),
            np.full(3 * len(ink_pairs(inks)), _CROSS_SPREAD),
        ]
    )
    return DriftState(np.zeros(len(spread)), np.diag(spread**2), inks)


def drifted(model: PressModel, state: DriftState) -> PressModel:
    """The press as it prints now.

    Raises
    ------
    ValueError
        If the state is of another number of inks.
    """
    if state.inks != model.inks:
        raise ValueError(f"the drift is of {state.inks} inks, the press of {model.inks}")
    return model.with_drift(*state.parts())


def aged(state: DriftState, share: float) -> DriftState:
    """The same state some time later: as it was, but less sure, by ``share`` of the usual covariance of a fresh one."""
    return replace(state, covariance=state.covariance + share * no_drift(state.inks).covariance)


def drift_slopes(
    model: PressModel, state: DriftState, ink_frac: NDArray[np.floating]
) -> tuple[Float64Array, Float64Array]:
    """What the drifted press prints, and how that leans on the drift.

    Parameters
    ----------
    model
        The press as it was profiled.
    state
        Where the slopes are taken; only its mean counts.
    ink_frac
        (M, N) ink fractions.

    Returns
    -------
    tuple
        Absolute Lab (M, 3), and its slopes (M, 3, Q) for the state.

    Raises
    ------
    ValueError
        If the state or the inks are of another number than the press.
    """
    now = drifted(model, state).arrays
    inks = np.asarray(ink_frac, dtype=np.float64)
    if inks.ndim != 2 or inks.shape[1] != model.inks:
        raise ValueError(f"ink_frac must be (M, {model.inks}), but its shape is {inks.shape}")
    bell = inks * (1.0 - inks)
    printed = inks * (1.0 + now.gain) + now.bend * bell
    toneless = replace(model, arrays=now._replace(gain=np.zeros(model.inks), bend=np.zeros(model.inks)))
    lab, by_ink = toneless.lab_and_slopes(printed)
    physics, by_primary = np.empty_like(lab), np.empty((len(inks), *now.primaries.shape))
    by_curve, by_factor = np.empty((len(inks), *now.curves.shape)), np.empty_like(lab)
    neugebauer_rows(printed, now.curves, now.primaries, now.factor, physics, by_curve, by_primary, by_factor)

    # Cube roots of the bands lean on each overlap's logarithm, which is a sum of what its inks do alone and in pairs.
    overlaps = overlap_bits(model.inks)
    pairs = [overlaps[:, one] * overlaps[:, two] for one, two in ink_pairs(model.inks)]
    sums = np.column_stack([np.ones(len(overlaps)), overlaps, *pairs])
    # How far each overlap can fade at all: what a press whose glaze is lighter by one shows.
    none = no_drift(model.inks).parts()
    lighter = model.with_drift(none[0], none[1], np.ones(3), none[3], none[4]).arrays.primaries
    faded = np.log(lighter / model.arrays.primaries)
    by_fading = np.einsum("mcb,cb,cs->msb", by_primary, now.primaries * faded, sums)
    lean = np.einsum("kb,msb->mksb", _LAB_OF_ROOTS, by_fading).reshape(len(inks), 3, -1)
    # The residual is the larger, the lighter physics says that the colour is.
    lean += (now.growth / _GROWTH_LIGHTNESS * (lab - physics))[:, :, np.newaxis] * lean[:, :1]
    return lab, np.concatenate([by_ink * inks[:, np.newaxis], by_ink * bell[:, np.newaxis], lean], axis=2)


def update_drift(
    model: PressModel,
    state: DriftState,
    ink_frac: NDArray[np.floating],
    lab_d50: NDArray[np.floating],
    noise_lab: float | NDArray[np.floating],
) -> DriftState:
    """Learn from fired colours of known inks.

    Parameters
    ----------
    model
        The press as it was profiled; a drift in it is left aside.
    state
        What was known before.
    ink_frac, lab_d50
        (M, N) inks of patches or image regions, and (M, 3) the absolute Lab they fired to. A region's inks are the mean
        over it, which is right where it is even.
    noise_lab
        Spread of L*, a* and b* of each, one number or (M,): measuring, the kiln's unevenness, the model's own error.

    Returns
    -------
    DriftState

    Raises
    ------
    ValueError
        If shapes don't fit, a value is not finite, or a noise is not above 0.

    Notes
    -----
    The iterated extended Kalman update: B. M. Bell, F. W. Cathey, "The iterated Kalman filter update as a Gauss-Newton
    method", IEEE Transactions on Automatic Control 38 (1993).
    """
    inks = np.asarray(ink_frac, dtype=np.float64)
    colours = np.asarray(lab_d50, dtype=np.float64)
    noise = np.broadcast_to(np.asarray(noise_lab, dtype=np.float64), (len(inks),))
    if state.inks != model.inks or inks.ndim != 2 or inks.shape[1] != model.inks or colours.shape != (len(inks), 3):
        raise ValueError(f"inks {inks.shape} and colours {colours.shape} don't fit a press of {model.inks} inks")
    if not (np.isfinite(inks).all() and np.isfinite(colours).all() and (noise > 0.0).all()):
        raise ValueError("inks and colours must be finite, and noise above 0")
    known = np.linalg.inv(state.covariance)
    weight = np.repeat(1.0 / noise**2, 3)
    mean = state.mean
    precision = known
    for _ in range(_ROUNDS):
        lab, slopes = drift_slopes(model, replace(state, mean=mean), inks)
        lean = slopes.reshape(-1, len(mean))
        miss = (colours - lab).reshape(-1)
        precision = known + lean.T @ (weight[:, np.newaxis] * lean)
        step = np.linalg.solve(precision, lean.T @ (weight * miss) + known @ (state.mean - mean))
        mean = mean + step
        mean[: 2 * state.inks] = np.clip(mean[: 2 * state.inks], -MOST_TONE_CHANGE, MOST_TONE_CHANGE)
    covariance = np.linalg.inv(precision)
    return DriftState(mean, 0.5 * (covariance + covariance.T), state.inks)
