"""Learning how a press has drifted since it was profiled, from a small chart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.drift import DriftState, drifted, no_drift, update_drift
from tilefab.colour.press_model import PressModel
from tilefab.colour.spaces import delta_e_2000
from tilefab.errors import ProfileError
from tilefab.io.atomic import refuse_overwriting
from tilefab.io.cgats import Measurements, read_measurements
from tilefab.io.drift_file import DriftFile, read_drift_file, write_drift_file
from tilefab.io.icc import read_icc_profile, require_press_profile
from tilefab.io.press_profile import require_inks
from tilefab.pipeline.carried import carried_press, same_inks
from tilefab.pipeline.plan import require_drift_of
from tilefab.pipeline.profiling import triple
from tilefab.pipeline.progress import Progress, Silent

FEWEST_PATCHES = 12
DEFAULT_NOISE_LAB = 0.4
HOPELESS_DELTA_E = 6.0
"""Mean difference that is left where data and press don't belong together at all: no state is written."""

NO_DRIFT_DELTA_E = 1.5
"""Mean difference that a fitted state may leave; above it the press has changed otherwise than states can say."""

_FITTING, _LEARNING = "Fitting the press", "Learning the drift"
_SMALL_PERCENT = 0.5


@dataclass(frozen=True)
class InkChange:
    """How an ink has changed; strength is the colour difference (CIE76) from the unprinted tile.

    Attributes
    ----------
    name
        The ink.
    full_percent, half_percent
        Change of the strength of a whole ink and of a half one, in percent.
    full_delta_e
        By how much its solid has moved, CIEDE2000.
    words
        The same for people.
    """

    name: str
    full_percent: float
    half_percent: float
    full_delta_e: float
    words: str


@dataclass(frozen=True)
class DriftReport:
    """What was learnt of a drift; colour differences are CIEDE2000.

    Attributes
    ----------
    path
        The state's file.
    ink_names
        The inks, in channel order.
    patches, patches_all
        Patches of this chart, and of all that the state was fitted to.
    before_mean, before_p95
        The chart against the press as it was profiled.
    known_mean, known_p95
        The chart against the state that this one goes on from; None without one.
    after_mean, after_p95
        The chart against the press with the new state.
    white_change_lab
        Change of the unprinted tile, L*, a*, b*.
    changes
        How each ink has changed, the strongest change first.
    warnings
        What is to be said.
    """

    path: str
    ink_names: tuple[str, ...]
    patches: int
    patches_all: int
    before_mean: float
    before_p95: float
    known_mean: float | None
    known_p95: float | None
    after_mean: float
    after_p95: float
    white_change_lab: tuple[float, float, float]
    changes: tuple[InkChange, ...]
    warnings: tuple[str, ...]


def learn_drift(
    profile_path: str | Path,
    data_path: str | Path,
    out_path: str | Path,
    *,
    from_path: str | Path | None = None,
    noise_lab: float = DEFAULT_NOISE_LAB,
    progress: Progress | None = None,
) -> DriftReport:
    """Fit the drift state of a press to a small chart, and write it.

    Parameters
    ----------
    profile_path
        Profile of the press, which carries the measurements that it was built from.
    data_path
        CGATS or .ti3 file of at least 12 patches of the same inks, fired now.
    out_path
        State file to write; an existing one is replaced, and stays whole until the new one is complete.
    from_path
        State to go on from; None: the press as it was profiled.
    noise_lab
        Spread of a reading of L*, a* and b*, above 0; the kiln's unevenness and the model's error included.
    progress
        Told what is being done.

    Raises
    ------
    ProfileError
        If a file can't be used, they don't belong together, or no drift can be what the chart shows.
    OutputError
        If the state can't be written, or would take the place of the profile or the chart.
    """
    watch = progress or Silent()
    # Going on in the same state file is meant; anything else that is read stays.
    refuse_overwriting(Path(out_path), (Path(profile_path), Path(data_path)))
    profile = require_inks(require_press_profile(read_icc_profile(profile_path)))
    data = _chart(data_path)
    same_inks(data.ink_names, profile, str(data_path))
    before: DriftFile | None = None
    if from_path is not None:
        before, _ = read_drift_file(from_path)
        require_drift_of(before, profile, str(from_path))
    watch.stage(_FITTING, 0.0)
    model = carried_press(profile)[0].model
    watch.stage(_FITTING, 1.0)
    watch.stage(_LEARNING, 0.0)
    start = no_drift(model.inks) if before is None else before.state
    state = update_drift(model, start, data.ink_frac, data.lab_d50, noise_lab)
    now = drifted(model, state)
    patches_all = len(data.ink_frac) + (0 if before is None else before.patches)
    drift = DriftFile(state, profile.ink_names, profile.sha256, patches_all, f"of {Path(data_path).name}")
    first = _errors(model, data)
    known = None if before is None else _errors(drifted(model, start), data)
    last = _errors(now, data)
    if last[0] > HOPELESS_DELTA_E:
        raise ProfileError(
            f"{data_path}: differs by ΔE {last[0]:.1f} in the mean from all that a drift can explain: rows "
            "or ink columns are mixed up, or it is another press's; check the file, or profile anew",
            path=str(data_path),
        )
    warnings = []
    if last[0] > NO_DRIFT_DELTA_E:
        warnings.append(
            f"the chart still differs by ΔE {last[0]:.1f} in the mean: not a drift that the state can say: profile anew"
        )
    write_drift_file(Path(out_path), drift)
    watch.stage(_LEARNING, 1.0)
    return DriftReport(
        path=str(out_path),
        ink_names=profile.ink_names,
        patches=len(data.ink_frac),
        patches_all=patches_all,
        before_mean=first[0],
        before_p95=first[1],
        known_mean=None if known is None else known[0],
        known_p95=None if known is None else known[1],
        after_mean=last[0],
        after_p95=last[1],
        white_change_lab=triple(now.white_lab - model.white_lab),
        changes=ink_changes(model, state, profile.ink_names),
        warnings=tuple(warnings),
    )


def ink_changes(model: PressModel, state: DriftState, ink_names: tuple[str, ...]) -> tuple[InkChange, ...]:
    """How each ink has changed in a drift, the strongest change first."""
    now = drifted(model, state)
    solids, halves = np.eye(model.inks), 0.5 * np.eye(model.inks)
    full = _strengths(now, solids) / _strengths(model, solids)
    half = _strengths(now, halves) / _strengths(model, halves)
    moved = np.asarray(delta_e_2000(now.lab(solids), model.lab(solids)))
    changes = [
        InkChange(
            name,
            float(100.0 * (full[ink] - 1.0)),
            float(100.0 * (half[ink] - 1.0)),
            float(moved[ink]),
            f"{_percent(full[ink])} in full, {_percent(half[ink])} at half; solid moved by ΔE {moved[ink]:.1f}",
        )
        for ink, name in enumerate(ink_names)
    ]
    return tuple(sorted(changes, key=lambda change: -max(abs(change.full_percent), abs(change.half_percent))))


def _strengths(model: PressModel, recipes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Differences (M,) from the unprinted tile, CIE76, never 0."""
    return np.asarray(np.maximum(np.linalg.norm(model.lab(recipes) - model.white_lab, axis=1), 1e-6))


def _percent(ratio: float) -> str:
    change = 100.0 * (ratio - 1.0)
    if abs(change) < _SMALL_PERCENT:
        return "as before"
    return f"{abs(change):.1f} % {'stronger' if change > 0.0 else 'weaker'}"


def _chart(path: str | Path) -> Measurements:
    found = read_measurements(path)
    if len(found.ink_frac) < FEWEST_PATCHES:
        raise ProfileError(
            f"{path}: has {len(found.ink_frac)} patches, but a drift needs {FEWEST_PATCHES} or more: print and measure "
            "a larger chart",
            path=str(path),
        )
    return found


def _errors(model: PressModel, data: Measurements) -> tuple[float, float]:
    """Mean and 95th percentile of the differences between a model and patches."""
    difference = np.asarray(delta_e_2000(model.lab(data.ink_frac), data.lab_d50))
    return float(difference.mean()), float(np.percentile(difference, 95))
