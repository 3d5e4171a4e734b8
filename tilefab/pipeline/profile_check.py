"""``tilefab profile check``: what can be told of a press profile from its own tables and from measurements."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tilefab.errors import OutputError, ProfileError
from tilefab.io.atomic import atomic_write_bytes
from tilefab.io.cgats import Measurements, parse_measurements, read_measurements
from tilefab.io.icc import IccProfile, measurement_text, read_icc_profile
from tilefab.pipeline.profile_gamut import cusps, gamut
from tilefab.pipeline.profile_match import match_image, match_measurements, rgb, round_trips, scan_colours, triple
from tilefab.pipeline.profile_smoothness import (
    LINES,
    hue_ramp,
    neutral_ramp,
    smooth_fields,
    smoothness,
    tone_curves,
)
from tilefab.pipeline.profile_solid import fill_solid
from tilefab.pipeline.profile_tables import (
    INTENTS,
    CheckedTables,
    Float64Array,
    check_tables,
    printable_colours,
)
from tilefab.pipeline.profile_verdict import verdicts, warnings_of
from tilefab.pipeline.progress import Progress, Silent
from tilefab.report.profile_sheet import build_profile_pictures, build_profile_sheet
from tilefab.report.profile_view import ImageMatchView, MatchView, ProfileCheckView, ProfileFactsView

STAGE = "Checking the profile"
SHEET_SUFFIXES = (".pdf", ".png")
_COLOURS = 4000
_HUE_RAMPS = {3: "red", 6: "orange", 9: "yellow", 16: "green", 27: "blue", 33: "magenta"}


def check_sheet_path(path: Path) -> None:
    """Refuse a sheet's path whose suffix names no format, before the work of checking.

    Raises
    ------
    OutputError
        If it is neither PDF nor PNG.
    """
    if path.suffix.lower() not in SHEET_SUFFIXES:
        raise OutputError(
            f"{path}: unknown format {path.suffix or '(no ending)'}; use .pdf, or .png for a picture of each page",
            path=str(path),
        )


def check_profile(
    path: str | Path,
    *,
    data: Path | None = None,
    image: Path | None = None,
    lines: int = LINES,
    progress: Progress | None = None,
) -> ProfileCheckView:
    """Check a press profile.

    Parameters
    ----------
    path
        ICC output profile for 1 to 8 inks, of whatever maker.
    data
        Measurements to hold it against; None takes those that the profile carries, if any.
    image
        A scan to tell how much of it the press reaches.
    lines
        How many straight lines in Lab to try for smoothness.
    progress
        Who watches.

    Raises
    ------
    ProfileError
        If the profile is damaged, of another kind, or has no table from inks to colour; if ``data`` can't be read or
        has another number of inks; or if the image's own profile can't be used.
    ImageError
        If the image can't be read.
    """
    watch = progress or Silent()
    watch.stage(STAGE, 0.0)
    profile = read_icc_profile(path)
    tables = check_tables(profile)
    measurements, source, embedded = _measurements(profile, data)
    match: MatchView | None = None
    sample, sample_name = np.zeros((0, 3)), "no colours to show"
    strange: tuple[str, ...] = ()
    if measurements is not None:
        match, sample, strange = match_measurements(tables, measurements, source)
        sample_name = "measured patches"
    scan: ImageMatchView | None = None
    if image is not None and tables.backward:
        scan, sample = match_image(tables, scan_colours(image), str(image))
        sample_name = f"colours of {image.name}"
    watch.stage(STAGE, 0.15)
    lab, _, printable = printable_colours(tables, _COLOURS)
    solid = fill_solid(printable)
    smooth = smoothness(tables, solid, lab, lines)
    watch.stage(STAGE, 0.35)
    reach = gamut(tables, solid, sample, sample_name)
    watch.stage(STAGE, 0.8)
    facts = _facts(tables, embedded)
    trips = round_trips(tables, lab)
    edge = cusps(solid)
    hues = tuple(hue_ramp(tables, name, edge[place]) for place, name in _HUE_RAMPS.items()) if tables.backward else ()
    fields = smooth_fields(tables, np.hypot(edge[:, 1], edge[:, 2])) if tables.backward else ()
    intents = [intent for intent in INTENTS if intent in tables.backward and intent not in tables.same]
    view = ProfileCheckView(
        facts=facts,
        match=match,
        round_trips=trips,
        smoothness=smooth,
        gamut=reach,
        image=scan,
        tone=tone_curves(tables),
        neutrals=tuple(neutral_ramp(tables, intent) for intent in intents),
        hues=hues,
        fields=fields,
        verdicts=verdicts(match, trips, smooth, scan),
        warnings=(*strange, *warnings_of(facts, smooth, match, asked_image=image is not None and scan is None)),
        ink_rgb=tuple(rgb(colour) for colour in tables.lab(np.eye(tables.inks))),
    )
    watch.stage(STAGE, 1.0)
    return view


def _measurements(profile: IccProfile, data: Path | None) -> tuple[Measurements | None, str, str]:
    """Measurements to compare with, what to call them, and in words what the profile carries."""
    carried: Measurements | None = None
    try:
        text = measurement_text(profile)
        if text is None:
            words = "none"
        else:
            carried = parse_measurements(text, f"{profile.path}, measurements in it")
            words = f"{len(carried.ink_frac)} patches"
            if carried.ink_frac.shape[1] != profile.channels:
                words, carried = f"of {carried.ink_frac.shape[1]} inks, which aren't this profile's", None
    except ProfileError as error:
        words = f"not readable: {error.message.removeprefix(profile.path).lstrip(':, ')}"
    if data is not None:
        return read_measurements(data), str(data), words
    return carried, "measurements in the profile", words


def _facts(tables: CheckedTables, embedded: str) -> ProfileFactsView:
    profile = tables.profile
    dark: Float64Array | None = None
    if tables.backward:
        dark = tables.absolute(tables.ink_frac(np.zeros((1, 3))))[0]
    limits = tables.limits_frac
    return ProfileFactsView(
        path=profile.path,
        description=profile.description,
        version=profile.version,
        device_class=profile.device_class,
        colour_space=profile.colour_space,
        pcs=profile.pcs,
        size_bytes=len(profile.data),
        sha256=profile.sha256,
        tags=profile.tags,
        ink_names=profile.ink_names,
        white_lab=triple(tables.absolute(np.zeros((1, tables.inks)))[0]),
        dark_lab=None if dark is None else triple(dark),
        ink_limit_percent=_percent(max(limits.values())) if limits else None,
        ink_limits_percent=tuple((intent, _percent(limit)) for intent, limit in limits.items()),
        ink_most_percent=tuple(_percent(value) for value in tables.most_frac) if limits else (),
        embedded=embedded,
        missing=tables.missing,
        same_tables=tables.same,
    )


def _percent(share: float) -> float:
    """In percent, less what 16-bit codes add."""
    return round(100.0 * float(share), 2)


def check_facts(view: ProfileCheckView) -> dict[str, Any]:
    """What ``--json`` prints; keys are kept from version to version.

    Returns
    -------
    dict
        ``profile`` (fields of `ProfileFactsView`), ``match`` (null without measurements: ``source``, ``patches``,
        ``delta_e_2000`` with ``count mean median p95 largest``, ``histogram`` with ``edges`` and ``counts``,
        ``white_delta_e``, ``worst`` with fields of `PatchView`, ``biases`` with fields of `BiasView`), ``round_trips``
        (a list with fields of `RoundTripView`), ``smoothness`` (fields of `SmoothnessView`), ``gamut`` (``volume`` and
        ``hull_volume`` in cubic units of Lab, ``share_reached`` or null), ``image`` (null without one: fields of
        `ImageMatchView`), ``verdicts`` (``what grade text``) and ``warnings``. The command adds ``files``.
    """
    match = view.match
    return {
        "profile": asdict(view.facts),
        "match": None
        if match is None
        else {
            "source": match.source,
            "patches": match.spread.count,
            "delta_e_2000": asdict(match.spread),
            "histogram": {
                "edges": match.histogram.edges.tolist(),
                "counts": match.histogram.counts.tolist(),
            },
            "white_delta_e": match.white_delta_e,
            "worst": [asdict(patch) for patch in match.worst],
            "biases": [asdict(bias) for bias in match.biases],
        },
        "round_trips": [asdict(trip) for trip in view.round_trips],
        "smoothness": asdict(view.smoothness),
        "gamut": {
            "volume": view.gamut.volume,
            "hull_volume": view.gamut.hull_volume,
            "share_reached": view.gamut.share_reached,
        },
        "image": None if view.image is None else asdict(view.image),
        "verdicts": [asdict(verdict) for verdict in view.verdicts],
        "warnings": list(view.warnings),
    }


def write_sheet(view: ProfileCheckView, path: Path, *, created: str, version: str) -> tuple[Path, ...]:
    """Write the sheet of a check: one PDF, or, for SHEET.png, a picture of each page: SHEET_1.png and on.

    Parameters
    ----------
    view
        What was found.
    path
        File to write.
    created
        The date as it is to be shown.
    version
        Version of the software.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    OutputError
        If the ending is unknown or a file can't be written.
    """
    check_sheet_path(path)
    if path.suffix.lower() == ".pdf":
        atomic_write_bytes(path, build_profile_sheet(view, created=created, version=version))
        return (path,)
    pictures = build_profile_pictures(view, created=created, version=version)
    files = tuple(path.with_name(f"{path.stem}_{place}{path.suffix}") for place in range(1, len(pictures) + 1))
    for file, picture in zip(files, pictures, strict=True):
        atomic_write_bytes(file, picture)
    return files
