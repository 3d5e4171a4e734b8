"""What a run report shows: frozen records of finished figures, texts and pictures.

Whoever makes them has read every file and asked every clock; drawing needs nothing else. Pictures are uint8
RGB arrays of shape (rows, cols, 3). A *share* is a fraction, 0 to 1; a *percent* is a figure before a % sign.
Texts may hold any Unicode: what the report's font lacks is printed as "?".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tilefab.types import Array

RgbImage: TypeAlias = NDArray[np.uint8]
"""A picture for the page: uint8 RGB, (rows, cols, 3)."""

Lab: TypeAlias = tuple[float, float, float]
"""CIE L*, a*, b* (D50)."""

Rgb: TypeAlias = tuple[int, int, int]
"""A colour for the page: sRGB, 0 to 255 each."""


@dataclass(frozen=True, eq=False)
class FaceView:
    """One printed face.

    Parameters
    ----------
    index
        The face's index: the number it is re-created from.
    code
        The full string that goes into the QR code.
    thumbnail
        Its picture; None draws an empty frame. Only the faces that `contact_faces` picks need one.
    file_name
        Name of its print file.
    origin
        Where in the endless texture it was cut, in words.
    sha256
        Hash of its print data, in hex.
    """

    index: int
    code: str
    thumbnail: RgbImage | None
    file_name: str
    origin: str
    sha256: str


@dataclass(frozen=True)
class InkView:
    """How much of one ink the texture map takes.

    Parameters
    ----------
    name
        The channel's name.
    mean_percent, max_percent
        Mean and largest tonal value over the map's pixels, 0 to 100.
    full_coverage_m2_per_m2
        The same as square metres of 100 % ink for each square metre of tile.
    """

    name: str
    mean_percent: float
    max_percent: float
    full_coverage_m2_per_m2: float


@dataclass(frozen=True)
class SwatchView:
    """A main colour of the slab, and what the press makes of it.

    Parameters
    ----------
    lab_slab, lab_printed
        The colour on the slab, and as predicted after the kiln.
    delta_e_2000
        CIEDE2000 between them.
    share
        Share of the slab's pixels that it stands for.
    rgb_slab, rgb_printed
        Both for display.
    """

    lab_slab: Lab
    lab_printed: Lab
    delta_e_2000: float
    share: float
    rgb_slab: Rgb
    rgb_printed: Rgb


@dataclass(frozen=True, eq=False)
class ColourView:
    """Ink use and colour match.

    Parameters
    ----------
    press_profile
        The profile in words.
    intent
        Rendering intent.
    ink_limit_percent
        Largest total ink allowed, in percent of one full channel; None without a limit.
    max_total_ink_percent, mean_total_ink_percent
        What the map takes.
    share_limited
        Share of map pixels reduced to the limit.
    inks
        One record a channel.
    swatches
        The slab's main colours; may be empty.
    slab_lab_sample
        Colours of the slab, (K, 3); may be empty.
    gamut_ab
        Polygon around the press's colours in the a*b* plane, (K, 2) columns a*, b*; may be empty.
    gamut_lc
        Polygon around the press's colours in lightness and chroma, (K, 2) columns L*, C*; may be empty.
    delta_e_mean, delta_e_p95
        CIEDE2000 between slab and print over the map: mean and 95th percentile.
    out_of_gamut_share
        Share of map pixels that the press can't reach.
    out_of_gamut_mean, out_of_gamut_p95
        CIEDE2000 of those to the nearest colour that it can: mean and 95th percentile; 0 where there are none.
    """

    press_profile: str
    intent: str
    ink_limit_percent: float | None
    max_total_ink_percent: float
    mean_total_ink_percent: float
    share_limited: float
    inks: tuple[InkView, ...]
    swatches: tuple[SwatchView, ...]
    slab_lab_sample: Array
    gamut_ab: Array
    gamut_lc: Array
    delta_e_mean: float
    delta_e_p95: float
    out_of_gamut_share: float
    out_of_gamut_mean: float
    out_of_gamut_p95: float


@dataclass(frozen=True, eq=False)
class HistogramView:
    """A histogram: ``edges`` (n + 1,) rising, ``counts`` (n,) not negative; empty: no data."""

    edges: Array
    counts: Array


@dataclass(frozen=True, eq=False)
class PictureView:
    """A picture with its title and, in a line or two, what it shows."""

    title: str
    caption: str
    image: RgbImage


@dataclass(frozen=True, eq=False)
class ChartView:
    """A histogram with its title and what its axes count."""

    title: str
    x_label: str
    y_label: str
    histogram: HistogramView


@dataclass(frozen=True, eq=False)
class TextureMapView:
    """The texture map that all faces come from, of whichever design.

    Parameters
    ----------
    pictures
        What it was made from and how it is cut, side by side: one to four.
    facts
        Label and value pairs.
    charts
        Two histograms.
    """

    pictures: tuple[PictureView, ...]
    facts: tuple[tuple[str, str], ...]
    charts: tuple[ChartView, ...]


@dataclass(frozen=True, eq=False)
class RunReportView:
    """Everything that a run report shows.

    Parameters
    ----------
    title
        The job's name.
    job_file
        Where the job file is.
    job_hash, map_hash, profile_hash
        Hashes of the job, the texture map and the press profile, in hex.
    created
        The date as it is to be shown.
    software_version
        Version that made the run.
    facts
        Label and value pairs of the job.
    wall_preview, wall_caption
        Picture of many faces laid side by side, and what it shows.
    faces
        All faces of the run, in order.
    colour, texture_map
        The two technical parts.
    preparation
        What was done to the slab: step and sentence.
    warnings
        What the operator should know; may be empty.
    max_contact_faces
        How many faces the contact sheet shows at most.
    """

    title: str
    job_file: str
    job_hash: str
    map_hash: str
    profile_hash: str
    created: str
    software_version: str
    facts: tuple[tuple[str, str], ...]
    wall_preview: RgbImage
    wall_caption: str
    faces: tuple[FaceView, ...]
    colour: ColourView
    texture_map: TextureMapView
    preparation: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    max_contact_faces: int = 60


def contact_faces(count: int, limit: int) -> tuple[int, ...]:
    """Positions, of ``count`` faces, that a contact sheet of at most ``limit`` shows, ends included.

    >>> contact_faces(3, 60)
    (0, 1, 2)
    >>> contact_faces(1000, 4)
    (0, 333, 666, 999)
    """
    if count <= limit:
        return tuple(range(max(count, 0)))
    if limit <= 1:
        return (0,) if limit == 1 else ()
    return tuple(place * (count - 1) // (limit - 1) for place in range(limit))
