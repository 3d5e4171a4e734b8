"""Whether a measured chart can be believed: what a press model says of patches that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.inks import black_channel
from tilefab.colour.press_model import PressModel, merge_repeats
from tilefab.colour.spaces import delta_e_2000, relative_lab

Float64Array = NDArray[np.float64]

_OUTLIER_DELTA_E, _OUTLIER_TIMES = 3.0, 6.0
_AS_BAD = 0.5
_SURPRISE = 4.0
_FLAT_DELTA_E = 1.5
_HOPELESS_SHARE, _HOPELESS_MEAN = 0.1, 3.5
_REPEAT_DELTA_E = 2.5
_DISAGREEING_SHARE = 0.25
_SWAP_GAIN = 3.0
_NAMED = 5
_STALLED_DELTA_E, _MOVED_DELTA_E = 0.25, 4.0
_DARKER_L, _NEUTRAL_CHROMA = 12.0, 15.0
_COLOURFUL = 15.0
_HUES_DEG = {
    "cyan": (150.0, 280.0),
    "blue": (200.0, 310.0),
    "magenta": (300.0, 410.0),
    "pink": (300.0, 440.0),
    "red": (340.0, 420.0),
    "yellow": (60.0, 120.0),
    "brown": (10.0, 100.0),
    "orange": (20.0, 85.0),
    "green": (110.0, 200.0),
    "beige": (30.0, 110.0),
}


@dataclass(frozen=True)
class ChartFindings:
    """What is wrong with a chart.

    Attributes
    ----------
    refusal
        Why no profile should be built from it; None if one can be.
    warnings
        What whoever measured it should know.
    outliers
        (P,) True for patches that fit nothing around them and are better left out; without them, others may show.
    """

    refusal: str | None
    warnings: tuple[str, ...]
    outliers: NDArray[np.bool_]


def check_chart(
    model: PressModel,
    ink_frac: Float64Array,
    lab_d50: Float64Array,
    ink_names: Sequence[str],
    sample_ids: Sequence[str],
) -> ChartFindings:
    """Judge a chart by the model fitted to it.

    Parameters
    ----------
    model
        Fitted to all patches.
    ink_frac, lab_d50
        (P, N) and (P, 3), as they were given to the fit.
    ink_names, sample_ids
        N and P names, for messages.
    """
    error = model.errors.held_out
    typical = float(np.median(error))
    # A patch far from all others, such as the only bare one, may be missed by much without being wrong.
    suspect = (error > max(_OUTLIER_DELTA_E, _OUTLIER_TIMES * typical)) & (model.errors.surprise > _SURPRISE)
    # A gross outlier drags its neighbours along: only those about as bad are believed to be bad themselves.
    outliers = suspect & (error >= _AS_BAD * float(error.max()))
    warnings: list[str] = []
    refusal = _refusal(model, error, ink_frac, lab_d50, ink_names)
    if outliers.any():
        swapped = _swapped(model, lab_d50, suspect)
        if len(swapped) > _NAMED:
            named = ", ".join(f"{sample_ids[first]} and {sample_ids[second]}" for first, second in swapped[:_NAMED])
            warnings.append(
                f"{len(swapped)} pairs of patches seem to be swapped ({named} ...): a part of the chart was read in "
                "another order; all are left out: measure it again"
            )
        for first, second in swapped if len(swapped) <= _NAMED else []:
            warnings.append(
                f"patches {sample_ids[first]} and {sample_ids[second]} seem to be swapped: each has the other's "
                "colour; both are left out"
            )
        known = {patch for pair in swapped for patch in pair}
        outliers[list(known)] = True
        worst = [patch for patch in np.argsort(-error) if outliers[patch] and patch not in known]
        if worst:
            named = ", ".join(f"{sample_ids[patch]} (ΔE {error[patch]:.1f})" for patch in worst[:_NAMED])
            more = f" and {len(worst) - _NAMED} more" if len(worst) > _NAMED else ""
            warnings.append(
                f"{len(worst)} patches fit nothing around them and are left out: {named}{more}: measure them again"
                if len(worst) > 1
                else f"patch {named} fits nothing around it and is left out: measure it again"
            )
    warnings += _repeats(ink_frac, lab_d50, sample_ids)
    warnings += _stalled(model, ink_frac, ink_names)
    warnings += _misnamed(model, ink_names)
    return ChartFindings(refusal, tuple(warnings), outliers)


def _refusal(
    model: PressModel, error: Float64Array, ink_frac: Float64Array, lab_d50: Float64Array, ink_names: Sequence[str]
) -> str | None:
    far = float((error > _OUTLIER_DELTA_E).mean())
    bad = far > _HOPELESS_SHARE and float(error.mean()) > _HOPELESS_MEAN
    merged = merge_repeats(ink_frac, lab_d50)
    again = merged.counts[merged.rows] > 1
    if again.any():
        apart = delta_e_2000(lab_d50[again], merged.lab[merged.rows[again]])
        if float(np.median(apart)) > _REPEAT_DELTA_E:
            return (
                f"recipes that were measured more than once differ by ΔE {2 * float(np.median(apart)):.1f}: the file "
                "mixes charts of different presses or firings; build from one of them"
            )
    if float(np.percentile(delta_e_2000(lab_d50, np.median(lab_d50, axis=0)), 90)) < _FLAT_DELTA_E:
        return "its patches all have about one colour: the inks did not print, or a column was filled with one value"
    black = black_channel(tuple(ink_names))
    if black is not None and model.inks > 1:
        solids = model.lab(np.eye(model.inks))
        darkest = int(np.argmin(solids[:, 0]))
        chroma = float(np.hypot(solids[darkest, 1], solids[darkest, 2]))
        if solids[darkest, 0] < solids[black, 0] - _DARKER_L and chroma < _NEUTRAL_CHROMA:
            return (
                f"ink {ink_names[black]} fires to L* {solids[black, 0]:.0f}, but {ink_names[darkest]} to a neutral L* "
                f"{solids[darkest, 0]:.0f}: the ink columns are in the wrong order; put them right"
            )
    if bad:
        return (
            f"{100 * far:.0f} % of the patches fit nothing around them (ΔE {float(error.mean()):.1f} on average): rows "
            "are shifted or shuffled against the chart, or the ink columns are in another order; check both"
        )
    return None


def _swapped(model: PressModel, lab_d50: Float64Array, suspect: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Pairs of suspect patches whose colours fit far better the other way round."""
    rows = np.flatnonzero(suspect)[:200]
    expected = model.errors.held_out_lab[rows]
    distance = np.asarray(delta_e_2000(lab_d50[rows][:, np.newaxis], expected[np.newaxis]))
    own = np.diag(distance)
    pairs: list[tuple[int, int]] = []
    used: set[int] = set()
    for first in range(len(rows)):
        both = distance[first] + distance[:, first]
        both[[first, *used]] = np.inf
        second = int(np.argmin(both))
        if first not in used and both[second] * _SWAP_GAIN < own[first] + own[second]:
            pairs.append((int(rows[first]), int(rows[second])))
            used |= {first, second}
    return pairs


def _repeats(ink_frac: Float64Array, lab_d50: Float64Array, sample_ids: Sequence[str]) -> list[str]:
    merged = merge_repeats(ink_frac, lab_d50)
    apart = np.asarray(delta_e_2000(lab_d50, merged.lab[merged.rows]))
    bad = np.flatnonzero((merged.counts[merged.rows] > 1) & (apart > _REPEAT_DELTA_E))
    if not len(bad):
        return []
    named = ", ".join(sample_ids[patch] for patch in bad[np.argsort(-apart[bad])][:_NAMED])
    return [
        f"patches of one recipe disagree by up to ΔE {2 * float(apart[bad].max()):.1f} ({named}): the press or the "
        "firing is uneven, or a patch was measured in another's place"
    ]


def _stalled(model: PressModel, ink_frac: Float64Array, ink_names: Sequence[str]) -> list[str]:
    """Inks whose upper end changes nothing: clipped by the printer, or saturated."""
    found = []
    for ink in range(model.inks):
        top = float(ink_frac[:, ink].max())
        ramp = np.zeros((11, model.inks))
        ramp[:, ink] = np.linspace(0.0, top, 11)
        steps = np.asarray(delta_e_2000(ramp_lab := model.lab(ramp), ramp_lab[-1]))
        still = np.flatnonzero(steps > _STALLED_DELTA_E)
        if steps[0] > _MOVED_DELTA_E and len(still) and still[-1] < 8:
            found.append(
                f"ink {ink_names[ink]} no longer changes the colour above {100 * ramp[still[-1] + 1, ink]:.0f} %: the "
                "printer clips it, or the glaze takes no more; lower its limit"
            )
    return found


def _misnamed(model: PressModel, ink_names: Sequence[str]) -> list[str]:
    solids = relative_lab(model.lab(np.eye(model.inks)), model.white_lab)
    found = []
    for name, solid in zip(ink_names, solids, strict=True):
        hue = float(np.degrees(np.arctan2(solid[2], solid[1])) % 360.0)
        for word, (low, high) in _HUES_DEG.items():
            if word in name.casefold() and np.hypot(solid[1], solid[2]) > _COLOURFUL:
                if not (low <= hue <= high or low <= hue + 360.0 <= high):
                    found.append(
                        f"ink {name} fires to Lab {solid[0]:.0f} {solid[1]:.0f} {solid[2]:.0f}, which nobody calls "
                        f"{word}: check the order of the ink columns"
                    )
                break
    return found
