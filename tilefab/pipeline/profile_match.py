"""How well a profile's tables agree with measurements, with each other, and with the colours of a scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.colour.spaces import delta_e_2000, lab_from_xyz, relative_lab
from tilefab.colour.transform import scan_to_xyz
from tilefab.errors import ImageError, ProfileError
from tilefab.io.cgats import Measurements
from tilefab.io.scans import read_scan
from tilefab.pipeline.profile_tables import INTENTS, CheckedTables, Float64Array, srgb8
from tilefab.report.profile_view import (
    BiasView,
    ImageMatchView,
    MatchView,
    PatchView,
    RoundTripView,
    SpreadView,
)
from tilefab.report.view_model import HistogramView, Lab, Rgb

OUTSIDE_DELTA_E = 2.0
"""Difference to the nearest printable colour that counts as out of gamut, as in the report of a run."""

_WORST = 10
_BINS = 40
_COLORIMETRIC_MEDIAN = 1.0
_OTHER_WHITE = 3.0
_OTHER_MEAN = 5.0
_SCAN_SAMPLES = 200_000
_SHOWN_SAMPLES = 4000


def spread(values: Float64Array) -> SpreadView:
    """Mean, median, 95th percentile and largest of one or more values."""
    return SpreadView(
        count=int(values.size),
        mean=float(values.mean()),
        median=float(np.median(values)),
        p95=float(np.percentile(values, 95)),
        largest=float(values.max()),
    )


def match_measurements(
    tables: CheckedTables, data: Measurements, source: str
) -> tuple[MatchView, Float64Array, tuple[str, ...]]:
    """Hold the table from inks to colour against measured patches.

    Parameters
    ----------
    tables
        The profile.
    data
        The measurements.
    source
        What to call them.

    Returns
    -------
    tuple
        What was found, the patches' relative Lab (P, 3), and warnings.

    Raises
    ------
    ProfileError
        If profile and measurements have other numbers of inks.
    """
    inks = data.ink_frac.shape[1]
    if inks != tables.inks:
        raise ProfileError(
            f"{source}: has {inks} inks, but the profile drives {tables.inks}: give the measurements that belong to it",
            path=source,
        )
    predicted = tables.absolute(data.ink_frac)
    difference = np.asarray(delta_e_2000(data.lab_d50, predicted))
    bare = data.ink_frac.max(axis=1) <= 0.0
    white = float(delta_e_2000(data.lab_d50[bare].mean(axis=0), tables.absolute(np.zeros((1, inks)))[0]))
    white_delta_e = white if bare.any() else None
    names = data.sample_ids or tuple(str(place) for place in range(1, len(difference) + 1))
    measured_relative = relative_lab(data.lab_d50, tables.white_lab)
    predicted_relative = tables.lab(data.ink_frac)
    worst = tuple(
        PatchView(
            sample=names[place],
            ink_percent=tuple(float(value) for value in 100.0 * data.ink_frac[place]),
            lab_measured=triple(data.lab_d50[place]),
            lab_predicted=triple(predicted[place]),
            delta_e_2000=float(difference[place]),
            rgb_measured=rgb(measured_relative[place]),
            rgb_predicted=rgb(predicted_relative[place]),
        )
        for place in np.argsort(-difference, kind="stable")[:_WORST]
    )
    top = max(float(np.percentile(difference, 99.5)), 0.5)
    counts, edges = np.histogram(np.minimum(difference, top), bins=_BINS, range=(0.0, top))
    found = MatchView(
        source=source,
        spread=spread(difference),
        histogram=HistogramView(edges, counts),
        worst=worst,
        biases=_biases(tables.profile.ink_names, data.ink_frac, predicted - data.lab_d50, difference),
        white_delta_e=white_delta_e,
    )
    return found, measured_relative, (*_stranger(found), *_renamed(tables.profile.ink_names, data.ink_names))


def _biases(
    names: tuple[str, ...], ink_frac: Float64Array, off: Float64Array, difference: Float64Array
) -> tuple[BiasView, ...]:
    largest = np.where(ink_frac.max(axis=1) > 0.0, ink_frac.argmax(axis=1), -1)
    found = []
    for ink, name in enumerate(names):
        chosen = largest == ink
        if chosen.any():
            mean = float(difference[chosen].mean())
            found.append(BiasView(name, int(chosen.sum()), triple(off[chosen].mean(axis=0)), mean))
        else:
            found.append(BiasView(name, 0, (0.0, 0.0, 0.0), 0.0))
    return tuple(found)


def _stranger(found: MatchView) -> tuple[str, ...]:
    """A warning where profile and measurements plainly don't belong together."""
    signs = []
    if found.white_delta_e is not None and found.white_delta_e > _OTHER_WHITE:
        signs.append(f"the bare medium differs by ΔE {found.white_delta_e:.1f}")
    if found.spread.mean > _OTHER_MEAN:
        signs.append(f"patches differ by ΔE {found.spread.mean:.1f} in the mean")
    if not signs:
        return ()
    return (f"profile and measurements don't belong together ({', '.join(signs)}): two charts of different presses?",)


def _renamed(ours: tuple[str, ...], theirs: tuple[str, ...]) -> tuple[str, ...]:
    mine, other = ([name.strip().lower() for name in names] for names in (ours, theirs))
    if mine == other:
        return ()
    what = "in another order" if sorted(mine) == sorted(other) else "by other names"
    return (f"the measurements have the inks {what} ({', '.join(theirs)}) than the profile ({', '.join(ours)})",)


def round_trips(tables: CheckedTables, lab: Float64Array) -> tuple[RoundTripView, ...]:
    """Printable colours through each intent with a table of its own to inks, and through the relative table back."""
    found = []
    for intent in INTENTS:
        if intent not in tables.backward or intent in tables.same:
            continue
        difference = np.asarray(delta_e_2000(tables.printed(lab, intent), lab))
        found.append(
            RoundTripView(
                intent=intent,
                spread=spread(difference),
                share_below_1=float((difference < 1.0).mean()),
                colorimetric=intent == "relative" or bool(np.median(difference) < _COLORIMETRIC_MEDIAN),
            )
        )
    return tuple(found)


def scan_colours(path: Path) -> Float64Array:
    """Colours of a scan, relative to white: up to 200,000 of its pixels (K, 3), evenly at random, always the same.

    Raises
    ------
    ImageError
        If it can't be read.
    ProfileError
        If its colours can't be converted.
    """
    scan = read_scan(path)
    places = np.flatnonzero(scan.valid.ravel())
    if len(places) > _SCAN_SAMPLES:
        places = np.sort(rng.generator(0, "checked pixels").choice(places, _SCAN_SAMPLES, replace=False))
    if not len(places):
        raise ImageError(f"{path}: no pixel is opaque; give a scan with opaque pixels", path=str(path))
    pixels = scan.pixels.reshape(-1, scan.pixels.shape[2])[places]
    return lab_from_xyz(scan_to_xyz(pixels[np.newaxis], scan.icc_profile)[0])


def match_image(tables: CheckedTables, lab: Float64Array, path: str) -> tuple[ImageMatchView, Float64Array]:
    """How much of a scan's colours (K, 3) the press reaches with the relative intent; with it a few of them, (S, 3)."""
    difference = np.asarray(delta_e_2000(tables.printed(lab), lab))
    outside = difference[difference > OUTSIDE_DELTA_E]
    random = rng.generator(0, "shown pixels")
    shown = lab[random.choice(len(lab), min(_SHOWN_SAMPLES, len(lab)), replace=False)]
    found = ImageMatchView(
        path=path,
        pixels=len(lab),
        outside_delta_e=OUTSIDE_DELTA_E,
        share_outside=len(outside) / len(lab),
        outside_mean=float(outside.mean()) if len(outside) else 0.0,
        outside_p95=float(np.percentile(outside, 95)) if len(outside) else 0.0,
        all_mean=float(difference.mean()),
        all_p95=float(np.percentile(difference, 95)),
    )
    return found, shown


def triple(values: NDArray[np.floating]) -> Lab:
    """A colour as three numbers."""
    return float(values[0]), float(values[1]), float(values[2])


def rgb(lab: NDArray[np.floating]) -> Rgb:
    """A relative Lab colour for display."""
    red, green, blue = (int(value) for value in srgb8(lab))
    return red, green, blue
