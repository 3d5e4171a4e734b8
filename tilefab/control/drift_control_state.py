"""What the drift controller goes by and what it knows at one moment: plain values that survive a restart."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tilefab.control.drift_events import HoldCode
from tilefab.control.drift_filter import Estimate

Float64Array = NDArray[np.float64]

SCHEMA_VERSION = 1
_MOST_STATES = 1000


@dataclass(frozen=True)
class ControlSettings:
    """How the drift controller goes about it; one set serves every process.

    Attributes
    ----------
    walk_per_hour
        Share of a fresh state's covariance by which a press wanders in an hour; learnt from there.
    adaptation
        How fast the wandering and the noise are learnt, as a share per tile.
    excess_spread, excess_walk_per_hour, most_excess
        How far a press's answer to corrections usually lies off its model's, by how much that changes in an hour, and
        the most of it that is believed, below 1; all as shares.
    gate
        Standard deviations beyond which a tile is not believed by itself.
    step_share, step_tiles, step_evidence
        How far a step leads, as a share of a fresh state's covariance; how many tiles must agree on one before it is
        believed; and how much likelier it must be then than that they are wrong, as a natural logarithm.
    least_interval_s
        Least time between corrections.
    least_change, largest_step
        Least change that is worth a correction, and the most that one changes, in the unit of `TileMeasured.effect`.
    fewest_tiles
        Tiles that must have been measured before the first correction.
    stale_after_s
        How long tiles may be fired without any being measured.
    most_misfit
        Misfit beyond which a tile is senseless.
    """

    walk_per_hour: float = 0.03
    adaptation: float = 0.01
    excess_spread: float = 0.15
    excess_walk_per_hour: float = 0.005
    most_excess: float = 0.5
    gate: float = 3.2
    step_share: float = 1.0
    step_tiles: int = 3
    step_evidence: float = 6.0
    least_interval_s: float = 300.0
    least_change: float = 0.1
    largest_step: float = 4.0
    fewest_tiles: int = 3
    stale_after_s: float = 1200.0
    most_misfit: float = 4.0

    def __post_init__(self) -> None:
        positive = (self.walk_per_hour, self.gate, self.largest_step, self.stale_after_s, self.most_misfit)
        if not all(0.0 < value < math.inf for value in (*positive, self.excess_spread, self.step_share)):
            raise ValueError(f"settings of the drift controller must be above 0: {self}")
        not_negative = (self.least_interval_s, self.least_change, self.excess_walk_per_hour, self.step_evidence)
        if not all(0.0 <= value < math.inf for value in not_negative):
            raise ValueError(f"settings of the drift controller must not be negative: {self}")
        if not (0.0 <= self.adaptation <= 0.2 and 0.0 <= self.most_excess < 1.0):
            raise ValueError(f"adaptation must be 0 to 0.2 and most_excess 0 to below 1: {self}")
        if self.step_tiles < 2 or self.fewest_tiles < 1:
            raise ValueError(f"a step takes 2 tiles or more, a correction 1 or more: {self}")


@dataclass(frozen=True, eq=False)
class Rival:
    """What the press would be like if it had made a step.

    Attributes
    ----------
    estimate
        That.
    score
        How much likelier it is, a natural logarithm.
    agreeing, judged
        Tiles that agree with it, and all since it came up.
    """

    estimate: Estimate
    score: float
    agreeing: int
    judged: int


@dataclass(frozen=True, eq=False)
class DriftControl:
    """All that the controller knows; made by `tilefab.control.drift_control.start_control`.

    Attributes
    ----------
    settings
        What it goes by.
    prior
        (Q, Q) covariance of a fresh state.
    estimate, estimate_s
        What is known, and of which moment of the controller's own time.
    rival
        A step that may have been, or none.
    clock_s, time_s
        The clock as it was last, and the controller's own time, which stands or goes forward whatever the clock does.
    walk_scale, noise_scale
        How much faster the press wanders and how much larger the variance of tiles is than told.
    trend
        (Q,) where recent tiles pulled.
    corrections
        Number and state (Q,) of the latest ones, the one in use last.
    effect
        (Q, Q) mean of `TileMeasured.effect`.
    corrected_s
        When the last correction was proposed or applied, in own time.
    silent_s
        How long tiles have been fired since one was measured.
    unread_share, misfit_share, scattered_share
        Shares of recent images or tiles that couldn't be read, are senseless, or contradict what is known.
    tiles, tiles_since
        Tiles that were believed or judged, in all and since the last correction.
    seen
        Numbers of the latest ones.
    holds
        Why corrections are withheld.
    """

    settings: ControlSettings
    prior: Float64Array = field(repr=False)
    estimate: Estimate
    estimate_s: float
    rival: Rival | None
    clock_s: float
    time_s: float
    walk_scale: float
    noise_scale: float
    trend: Float64Array = field(repr=False)
    corrections: tuple[tuple[int, Float64Array], ...] = field(repr=False)
    effect: Float64Array = field(repr=False)
    corrected_s: float
    silent_s: float = 0.0
    unread_share: float = 0.0
    misfit_share: float = 0.0
    scattered_share: float = 0.0
    tiles: int = 0
    tiles_since: int = 0
    seen: tuple[int, ...] = field(default=(), repr=False)
    holds: tuple[HoldCode, ...] = ()

    @property
    def size(self) -> int:
        """Q."""
        return len(self.prior)

    @property
    def applied(self) -> Float64Array:
        """(Q,) the state that faces are printed for now."""
        return self.corrections[-1][1]

    @property
    def excess(self) -> float:
        """By which share the press answers less to corrections than its model does."""
        return float(self.estimate.mean[-1])


_NUMBERS = (
    "estimate_s",
    "clock_s",
    "time_s",
    "walk_scale",
    "noise_scale",
    "corrected_s",
    "silent_s",
    "unread_share",
    "misfit_share",
    "scattered_share",
)


def control_record(control: DriftControl) -> dict[str, object]:
    """Everything but the settings as plain JSON values; arrays are kept to the bit, as Base64 of little-endian doubles.

    Symmetric ones are kept as their lower triangles: a record takes about 50 kB for four inks, 150 kB for six.
    """
    rival = control.rival
    return {
        "schema_version": SCHEMA_VERSION,
        "size": control.size,
        **{name: getattr(control, name) for name in _NUMBERS},
        "prior": _packed(control.prior),
        "estimate": _estimate_record(control.estimate),
        "rival": None
        if rival is None
        else {
            "estimate": _estimate_record(rival.estimate),
            "score": rival.score,
            "agreeing": rival.agreeing,
            "judged": rival.judged,
        },
        "trend": _text(control.trend),
        "corrections": [[number, _text(mean)] for number, mean in control.corrections],
        "effect": _packed(control.effect),
        "tiles": control.tiles,
        "tiles_since": control.tiles_since,
        "seen": list(control.seen),
        "holds": [code.value for code in control.holds],
    }


def control_from_record(record: Mapping[str, object], settings: ControlSettings | None = None) -> DriftControl:
    """The controller of a record, to go on with.

    Parameters
    ----------
    record
        Of `control_record`.
    settings
        What it goes by from now on; None: as usual.

    Raises
    ------
    ValueError
        If it is none.
    """
    values = cast(Mapping[str, Any], record)
    try:
        if values["schema_version"] != SCHEMA_VERSION:
            raise ValueError(f"schema_version is {values['schema_version']!r:.40}, not {SCHEMA_VERSION}")
        size = int(values["size"])
        if not 1 <= size <= _MOST_STATES:
            raise ValueError(f"a state of {size} values")
        rival = values["rival"]
        control = DriftControl(
            settings=settings or ControlSettings(),
            prior=_unpacked(values["prior"], size),
            estimate=_estimate(values["estimate"], size),
            rival=None
            if rival is None
            else Rival(
                _estimate(rival["estimate"], size),
                _number(rival["score"]),
                int(rival["agreeing"]),
                int(rival["judged"]),
            ),
            trend=_array(values["trend"], size),
            corrections=tuple((int(number), _array(mean, size)) for number, mean in values["corrections"]),
            effect=_unpacked(values["effect"], size),
            tiles=int(values["tiles"]),
            tiles_since=int(values["tiles_since"]),
            seen=tuple(int(tile) for tile in values["seen"]),
            holds=tuple(HoldCode(code) for code in values["holds"]),
            **{name: _number(values[name]) for name in _NUMBERS},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"no record of the drift controller: {error}: begin anew") from error
    if not control.corrections:
        raise ValueError("no record of the drift controller: it names no correction: begin anew")
    return control


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r:.40} is no number")
    return float(value)


def _text(values: Float64Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode("ascii")


def _array(text: str, count: int) -> Float64Array:
    values = np.frombuffer(base64.b64decode(text, validate=True), dtype="<f8").astype(np.float64)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ValueError(f"an array isn't {count} finite numbers")
    return values


def _packed(matrix: Float64Array) -> str:
    return _text(matrix[np.tril_indices(len(matrix))])


def _unpacked(text: str, size: int) -> Float64Array:
    lower = np.zeros((size, size))
    lower[np.tril_indices(size)] = _array(text, size * (size + 1) // 2)
    return np.asarray(lower + np.tril(lower, -1).T)


def _estimate_record(estimate: Estimate) -> dict[str, str]:
    return {"mean": _text(estimate.mean), "covariance": _packed(estimate.covariance)}


def _estimate(record: Mapping[str, str], size: int) -> Estimate:
    return Estimate(_array(record["mean"], size + 1), _unpacked(record["covariance"], size + 1))
