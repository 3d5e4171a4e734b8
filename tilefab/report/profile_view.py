"""What the sheet of a profile check shows: frozen records of finished figures, curves and pictures.

Colours named ``lab`` are relative to the medium's white under D50 unless their name says otherwise; colour differences
are CIEDE2000 unless their name says otherwise. Pictures are uint8 sRGB arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.report.view_model import HistogramView, Lab, Rgb, RgbImage

Float64Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpreadView:
    """How ``count`` differences are spread: mean, median, 95th percentile and largest."""

    count: int
    mean: float
    median: float
    p95: float
    largest: float


@dataclass(frozen=True)
class ProfileFactsView:
    """What a profile says of itself.

    Attributes
    ----------
    path, description, version, device_class, colour_space, pcs, size_bytes, sha256, tags
        As in `tilefab.io.icc.IccProfile`.
    ink_names
        One name for each channel.
    white_lab, dark_lab
        Absolute Lab of the unprinted medium, and of what the relative intent prints for black (None without one).
    ink_limit_percent
        Largest total ink in any table from colour to inks; None where there is none.
    ink_limits_percent
        The same for each intent that has a table of its own.
    ink_most_percent
        Largest amount of each ink in those tables; empty where there are none.
    embedded
        Measurements in the profile, in words.
    missing
        Tables that a complete profile would have, in words.
    same_tables
        Intents whose tables are those of the relative intent, byte for byte.
    """

    path: str
    description: str
    version: str
    device_class: str
    colour_space: str
    pcs: str
    size_bytes: int
    sha256: str
    tags: tuple[str, ...]
    ink_names: tuple[str, ...]
    white_lab: Lab
    dark_lab: Lab | None
    ink_limit_percent: float | None
    ink_limits_percent: tuple[tuple[str, float], ...]
    ink_most_percent: tuple[float, ...]
    embedded: str
    missing: tuple[str, ...]
    same_tables: tuple[str, ...]


@dataclass(frozen=True)
class PatchView:
    """A measured patch and what the profile says of it; Lab absolute, ``rgb`` relative to the medium for display."""

    sample: str
    ink_percent: tuple[float, ...]
    lab_measured: Lab
    lab_predicted: Lab
    delta_e_2000: float
    rgb_measured: Rgb
    rgb_predicted: Rgb


@dataclass(frozen=True)
class BiasView:
    """Mean of predicted less measured L*, a*, b* over the patches in which this ink is the largest."""

    ink: str
    patches: int
    lab: Lab
    delta_e_mean: float


@dataclass(frozen=True, eq=False)
class MatchView:
    """The table from inks to colour against measurements.

    Attributes
    ----------
    source
        Which measurements.
    spread
        Differences of all patches.
    histogram
        The same as a histogram.
    worst
        Patches with the largest differences, the worst first.
    biases
        One record an ink.
    white_delta_e
        Between the profile's white and the measured one; None where no bare patch was measured.
    """

    source: str
    spread: SpreadView
    histogram: HistogramView
    worst: tuple[PatchView, ...]
    biases: tuple[BiasView, ...]
    white_delta_e: float | None


@dataclass(frozen=True)
class RoundTripView:
    """Printable colours through an intent's table to inks and back to colour.

    ``share_below_1`` is the share of colours that come back within 1; ``colorimetric`` tells whether the intent leaves
    printable colours as they are.
    """

    intent: str
    spread: SpreadView
    share_below_1: float
    colorimetric: bool


@dataclass(frozen=True)
class SmoothnessView:
    """Steps along straight lines in Lab inside the gamut, and along ramps.

    Attributes
    ----------
    lines, step_delta_e
        How many lines were followed, and the CIE76 distance from one point to the next.
    ink_bend_percent, lab_bend
        Size of second differences of inks (the ink with the largest), and of printed colours (CIE76).
    jump_percent, jump_ink, jump_lab
        Largest change of an ink from one point to the next, which ink's, and at which colour.
    neutral_reversals
        Places where a darker neutral is printed lighter.
    ink_reversals
        For each ink, places where more of it turns lightness round.
    """

    lines: int
    step_delta_e: float
    ink_bend_percent: SpreadView | None
    lab_bend: SpreadView | None
    jump_percent: float | None
    jump_ink: str | None
    jump_lab: Lab | None
    neutral_reversals: int | None
    ink_reversals: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class PlaneView:
    """A slice of the gamut.

    Attributes
    ----------
    title
        Which slice.
    low, high
        Data coordinates (across, up) of the picture's corners.
    picture
        Colours that the tables reach, white elsewhere; first row on top. None where only the outline is shown.
    outline
        (S, 4) line pieces x0, y0, x1, y1 in data coordinates; in no order.
    points
        (K, 2) colours of the sample near the slice, in data coordinates.
    """

    title: str
    low: tuple[float, float]
    high: tuple[float, float]
    picture: RgbImage | None
    outline: Float64Array
    points: Float64Array


@dataclass(frozen=True, eq=False)
class SolidView:
    """The gamut's solid seen from one side; empty where it has no volume."""

    title: str
    picture: RgbImage | None


@dataclass(frozen=True, eq=False)
class GamutView:
    """How far the press reaches.

    Attributes
    ----------
    volume
        Cubic units of CIELAB that the inks can mix within the profile's limits.
    hull_volume
        Volume of its convex hull, which overstates a hollow gamut.
    share_reached
        Share of that volume that goes through the relative tables to inks and comes back within 1 (CIE76); None
        without such tables.
    levels
        Slices at several lightnesses: value of L* and outline.
    hue_planes
        Slices along hues, chroma across (negative: the opposite hue), lightness up.
    solids
        The solid from two sides.
    sample
        (K, 3) colours of the image or of the patches.
    sample_name
        What they are.
    """

    volume: float
    hull_volume: float
    share_reached: float | None
    levels: tuple[tuple[float, PlaneView], ...]
    hue_planes: tuple[PlaneView, ...]
    solids: tuple[SolidView, ...]
    sample: Float64Array
    sample_name: str


@dataclass(frozen=True)
class ImageMatchView:
    """How much of a scan the press reaches; ``outside_delta_e`` is the difference that counts as outside."""

    path: str
    pixels: int
    outside_delta_e: float
    share_outside: float
    outside_mean: float
    outside_p95: float
    all_mean: float
    all_p95: float


@dataclass(frozen=True, eq=False)
class ToneView:
    """Each ink alone from 0 to 100 %: ``ink_frac`` (K,), ``lab`` (N, K, 3), ``to_white`` (N, K), ``rgb`` (N, K, 3)."""

    ink_frac: Float64Array
    lab: Float64Array
    to_white: Float64Array
    rgb: RgbImage


@dataclass(frozen=True, eq=False)
class RampView:
    """A path of colours through the tables.

    Attributes
    ----------
    title
        Which path.
    wanted, printed
        (K, 3) colours.
    ink_percent
        (K, N).
    rgb_wanted, rgb_printed
        (K, 3) uint8 for display.
    """

    title: str
    wanted: Float64Array
    printed: Float64Array
    ink_percent: Float64Array
    rgb_wanted: RgbImage
    rgb_printed: RgbImage


@dataclass(frozen=True, eq=False)
class FieldView:
    """A smooth field of colours as printed, to look for bands."""

    title: str
    picture: RgbImage


@dataclass(frozen=True)
class VerdictView:
    """One line of judgement; ``grade`` is ``good``, ``fair``, ``poor`` or ``none`` where it can't be told."""

    what: str
    grade: str
    text: str


@dataclass(frozen=True, eq=False)
class ProfileCheckView:
    """Everything that a profile check found."""

    facts: ProfileFactsView
    match: MatchView | None
    round_trips: tuple[RoundTripView, ...]
    smoothness: SmoothnessView
    gamut: GamutView
    image: ImageMatchView | None
    tone: ToneView
    neutrals: tuple[RampView, ...]
    hues: tuple[RampView, ...]
    fields: tuple[FieldView, ...]
    verdicts: tuple[VerdictView, ...]
    warnings: tuple[str, ...]
    ink_rgb: tuple[Rgb, ...] = field(default=())
