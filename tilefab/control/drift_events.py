"""What the drift controller is told, and what it wants done: plain frozen values, nothing of colour in them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]


class HoldCode(StrEnum):
    """Why corrections are withheld.

    ``STALE``: tiles are fired, but none was measured for too long. ``UNREADABLE``: too many images show no tile that
    can be measured. ``MISFIT``: tiles differ from all that a drift can say. ``SCATTERED``: tiles contradict what is
    known, and each other.
    """

    STALE = "stale"
    UNREADABLE = "unreadable"
    MISFIT = "misfit"
    SCATTERED = "scattered"


@dataclass(frozen=True, eq=False)
class TileMeasured:
    """A fired tile that was recognised and measured.

    For small changes of the state v that the press seems to be in, the logarithm of its likelihood is
    ``vector @ (v - at) - (v - at) @ information @ (v - at) / 2``.

    Attributes
    ----------
    tile
        A number that no other tile has, such as that of its arm; a tile that is told of twice counts once.
    correction
        Number of the correction that it was printed with; 0: none.
    fired_at_s, measured_at_s
        When it left the kiln and when it was measured, seconds of the clock that `Tick` tells, too.
    at
        (Q,) state at which the tile's evidence was made straight, best `tilefab.control.drift_control.expected`.
    information, vector
        (Q, Q) and (Q,).
    effect
        (Q, Q): ``d @ effect @ d`` is the mean square by which a change d of the state shows on the tile, in the unit of
        the settings (colour differences).
    watch
        (D, Q) slopes of what charts are to watch (mean L*, a*, b*); `Innovation.values` are of these.
    misfit
        Root mean square of what the state leaves unexplained over what noise lets expect, about 1.
    """

    tile: int
    correction: int
    fired_at_s: float
    measured_at_s: float
    at: Float64Array = field(repr=False)
    information: Float64Array = field(repr=False)
    vector: Float64Array = field(repr=False)
    effect: Float64Array = field(repr=False)
    watch: Float64Array = field(repr=False)
    misfit: float = 1.0


@dataclass(frozen=True)
class Rejected:
    """An image was taken, but no tile of the run could be measured in it."""

    at_s: float
    reason: str = ""


@dataclass(frozen=True)
class Tick:
    """Time has passed; ``firing``: tiles of this run have been leaving the kiln since the last tick."""

    now_s: float
    firing: bool = True


@dataclass(frozen=True, eq=False)
class CorrectionApplied:
    """From now on faces are printed with a correction: one that was proposed, or one by hand.

    Attributes
    ----------
    number
        1 upwards; numbers may leave gaps.
    at_s
        When.
    mean
        (Q,) the state that the conversion assumes.
    """

    number: int
    at_s: float
    mean: Float64Array = field(repr=False)


Event = TileMeasured | Rejected | Tick | CorrectionApplied


@dataclass(frozen=True, eq=False)
class Propose:
    """Print further faces for this state.

    Attributes
    ----------
    mean, covariance
        (Q,) and (Q, Q).
    change
        By how much tiles change, root mean square, in the unit of `TileMeasured.effect`.
    reason
        For people and the log.
    """

    mean: Float64Array = field(repr=False)
    covariance: Float64Array = field(repr=False)
    change: float
    reason: str


@dataclass(frozen=True)
class Hold:
    """Corrections are withheld from now on: raise an alarm. Each code is told of once until it is released."""

    code: HoldCode
    text: str


@dataclass(frozen=True)
class Release:
    """A reason to withhold corrections is gone."""

    code: HoldCode
    text: str


@dataclass(frozen=True)
class Innovation:
    """What a tile says beyond what was known: for control charts, since it is white while all is well.

    Attributes
    ----------
    tile
        Of `TileMeasured`.
    values
        For each of `TileMeasured.watch`, mean 0 and spread 1.
    surprise
        Of all directions together, about standard normal; large where the tile doesn't fit.
    accepted
        Whether the tile has moved the estimate.
    """

    tile: int
    values: tuple[float, ...]
    surprise: float
    accepted: bool


@dataclass(frozen=True)
class StepSeen:
    """Several tiles that contradict what was known agree with each other: the press has made a step.

    Attributes
    ----------
    change
        Its size, root mean square, in the unit of `TileMeasured.effect`.
    text
        For people.
    """

    change: float
    text: str


@dataclass(frozen=True)
class Ignored:
    """An event was not used, and why: a tile told of twice, a correction that nobody knows."""

    text: str


Action = Propose | Hold | Release | Innovation | StepSeen | Ignored
