"""From two press profiles to a device link, or from one to a link that saves ink on the same press."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.colour.inks import black_channel
from tilefab.colour.limits import limit_total_ink
from tilefab.colour.link import LinkTable, build_link
from tilefab.colour.lut import tone_curves
from tilefab.colour.node_fit import multilinear_weights
from tilefab.colour.press_model import fit_press_model
from tilefab.colour.separation import SeparationSettings, Separator
from tilefab.colour.spaces import absolute_lab, delta_e_2000, lab_from_xyz, relative_lab, xyz_from_lab
from tilefab.colour.stages import Curves
from tilefab.colour.transform import scan_to_xyz
from tilefab.errors import ProfileError
from tilefab.io.atomic import atomic_write_bytes, refuse_overwriting
from tilefab.io.icc import (
    IccProfile,
    encode_device_link,
    measurement_text,
    read_icc_profile,
    require_press_profile,
)
from tilefab.io.icc_tables import device_to_pcs, pcs_to_device
from tilefab.io.scans import read_scan
from tilefab.pipeline.carried import carried_press
from tilefab.pipeline.profiling import FORWARD_GRIDS, ROUNDING, FittedPress, by_ink
from tilefab.pipeline.progress import Progress, Silent

DEFAULT_TOLERANCE = 0.5
_SAMPLED_RECIPES = 1500
_JUDGED_COLOURS = 4000
_MOST_IMAGE_COLOURS = 20_000
_LIMIT_NODES = 17
_TRIED_COLOURS = 1200
_THRIFTS, _THRIFT_STEPS = (0.05, 60.0), 8
_MOST_OF_MEAN, _TABLE_DELTA_E = 1.7, 0.12
_COPYRIGHT = "No copyright, use freely"
_FITTING, _LINKING, _JUDGING = "Fitting the presses", "Linking inks to inks", "Judging the link"


@dataclass(frozen=True)
class LinkSettings:
    """How a link is built.

    Attributes
    ----------
    ink_limit_percent
        Total ink limit; None takes that of the profile that it leads to.
    tolerance_delta_e
        By how much colours may move for cheaper inks, CIEDE2000 on average; 0 keeps them exact. Of the colours judged,
        95 % move by twice that at most.
    ink_prices
        What each ink costs, by its name; others cost 1.
    version
        ICC version, 2 or 4.
    image
        An image for whose colours the link is made to save most; None: colours from all over the gamut.
    """

    ink_limit_percent: float | None = None
    tolerance_delta_e: float = DEFAULT_TOLERANCE
    ink_prices: Mapping[str, float] | None = None
    version: Literal[2, 4] = 2
    image: Path | None = None


@dataclass(frozen=True)
class LinkReport:
    """What a link does, judged through its own table and the press models; differences are CIEDE2000.

    Attributes
    ----------
    ink_names_in, ink_names_out
        The inks that come in and go out.
    ink_limit_percent
        Total ink limit.
    judged
        What colours were judged on.
    ink_in_percent, ink_out_percent
        Mean ink before and after, all inks added up.
    saved_percent
        Ink saved, of what came in.
    cost_saved_percent
        The same at the prices given; None where the inks differ.
    delta_e_mean, delta_e_p95, delta_e_max
        Between the colours before and after.
    size_bytes
        Size of the link.
    """

    ink_names_in: tuple[str, ...]
    ink_names_out: tuple[str, ...]
    ink_limit_percent: float
    judged: str
    ink_in_percent: float
    ink_out_percent: float
    saved_percent: float
    cost_saved_percent: float | None
    delta_e_mean: float
    delta_e_p95: float
    delta_e_max: float
    size_bytes: int


def press_of(profile: IccProfile) -> FittedPress:
    """The press that a profile was made for: of the measurements that it carries, else of its own tables.

    Raises
    ------
    ProfileError
        If its measurements can't be used, or its tables are damaged.
    """
    require_press_profile(profile)
    text = measurement_text(profile)
    if text is not None and "BEGIN_DATA" in text:
        return carried_press(profile)[0]
    recipes = rng.generator(0, "recipes that stand for a profile").random((_SAMPLED_RECIPES, profile.channels))
    recipes[::2] **= 2.0
    recipes[0] = 0.0
    corners = np.concatenate([np.eye(profile.channels), recipes])
    white = lab_from_xyz(profile.white_xyz)
    colours = _lab_of_pcs(profile, corners)
    try:
        model = fit_press_model(corners, absolute_lab(colours, white))
    except ValueError as error:
        raise ProfileError(
            f"{profile.path}: its table of inks to colours is none of a press ({error}): choose another profile",
            path=profile.path,
        ) from error
    solids = relative_lab(model.lab(np.eye(model.inks)), model.white_lab)
    return FittedPress(model, black_channel(profile.ink_names, solids), 0, ())


def _lab_of_pcs(profile: IccProfile, recipes: NDArray[np.float64]) -> NDArray[np.float64]:
    table = device_to_pcs(profile, "relative")
    found = table(recipes)
    return found if table.target == "lab" else lab_from_xyz(found)


def _inks_of_pcs(profile: IccProfile, lab_relative: NDArray[np.float64]) -> NDArray[np.float64]:
    table = pcs_to_device(profile, "relative")
    return table(lab_relative if table.source == "lab" else xyz_from_lab(lab_relative))


def limit_of(profile: IccProfile) -> float:
    """Total ink limit in percent that a profile's table of colours to inks keeps: the most that it has."""
    axes = np.linspace(0.0, 100.0, _LIMIT_NODES), *[np.linspace(-127.0, 127.0, _LIMIT_NODES)] * 2
    colours = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return float(100.0 * _inks_of_pcs(profile, colours).sum(axis=1).max())


def make_link(
    source: IccProfile, target: IccProfile, settings: LinkSettings | None = None, *, progress: Progress | None = None
) -> tuple[bytes, LinkReport]:
    """Link from the inks of one press to the cheapest inks of another, or of the same, that fire to the same colours.

    Colours are matched relative to each press's unprinted tile.

    Raises
    ------
    ProfileError
        If a profile can't be used, or limits or prices make no sense.
    """
    bars = progress or Silent()
    chosen = settings or LinkSettings()
    if not 0.0 <= chosen.tolerance_delta_e <= 5.0:
        raise ProfileError(f"a tolerance of ΔE {chosen.tolerance_delta_e:g} makes no sense: give 0 to 5")
    bars.stage(_FITTING, 0.0)
    to_press = press_of(target)
    from_press = to_press if source.sha256 == target.sha256 else press_of(source)
    bars.stage(_FITTING, 1.0)
    limit = chosen.ink_limit_percent if chosen.ink_limit_percent is not None else limit_of(target)
    most = 100.0 * min(to_press.model.max_total, to_press.model.inks)
    if not 20.0 <= limit <= 100.0 * target.channels:
        raise ProfileError(
            f"{target.path}: an ink limit of {limit:g} % makes no sense: give 20 to {100 * target.channels} %",
            path=target.path,
        )
    limit = min(limit, most)
    # A limit that is asked for holds after rounding to 8 bits; a profile's own tables have that room in them already.
    reserve = ROUNDING * target.channels if chosen.ink_limit_percent is not None else 0.0
    prices = by_ink(chosen.ink_prices, target.ink_names, 1.0, target.path)
    plain = SeparationSettings(
        total_limit=limit / 100.0 - reserve, black_channel=to_press.black, style="least_ink", prices=prices
    )
    from_model = from_press.model

    def colours_of(recipes: NDArray[np.float64]) -> NDArray[np.float64]:
        measured = limit_total_ink(recipes, 100.0 * from_model.max_total, from_press.black)
        return relative_lab(from_model.lab(measured), from_model.white_lab)

    judged, recipes = _judged(source, from_press, chosen.image)
    bars.stage(_LINKING, 0.0)
    separator = _thrifty(to_press, plain, chosen.tolerance_delta_e, colours_of(recipes))
    nodes = FORWARD_GRIDS[source.channels]
    table = build_link(
        colours_of, tone_curves(from_model), separator, nodes, source_limit=limit_of(source) / 100.0 + 0.05
    )
    bars.stage(_LINKING, 1.0)
    data = encode_device_link(
        input_curves=table.curves,
        grid=table.grid,
        ink_names_in=source.ink_names,
        ink_names_out=target.ink_names,
        description=f"{source.description} to {target.description}, least ink",
        copyright_text=_COPYRIGHT,
        version=chosen.version,
    )
    bars.stage(_JUDGING, 0.0)
    out = _through(table, recipes)
    before = colours_of(recipes)
    after = relative_lab(to_press.model.lab(out), to_press.model.white_lab)
    apart = np.asarray(delta_e_2000(after, before))
    same = source.ink_names == target.ink_names
    price = np.array(prices)
    spent = float((recipes @ price).sum()) if same else 0.0
    bars.stage(_JUDGING, 1.0)
    return data, LinkReport(
        ink_names_in=source.ink_names,
        ink_names_out=target.ink_names,
        ink_limit_percent=limit,
        judged=judged,
        ink_in_percent=float(100.0 * recipes.sum(axis=1).mean()),
        ink_out_percent=float(100.0 * out.sum(axis=1).mean()),
        saved_percent=float(100.0 * (1.0 - out.sum() / max(recipes.sum(), 1e-9))),
        cost_saved_percent=float(100.0 * (1.0 - (out @ price).sum() / max(spent, 1e-9))) if same else None,
        delta_e_mean=float(apart.mean()),
        delta_e_p95=float(np.percentile(apart, 95)),
        delta_e_max=float(apart.max()),
        size_bytes=len(data),
    )


def _thrifty(
    press: FittedPress, settings: SeparationSettings, tolerance: float, lab_relative: NDArray[np.float64]
) -> Separator:
    """A separator that saves as much ink as a mean difference of ``tolerance`` on some colours allows."""
    threads = os.cpu_count() or 1
    exact = Separator(press.model, settings, threads=threads)
    if tolerance == 0.0:
        return exact
    step = max(1, len(lab_relative) // _TRIED_COLOURS)
    wanted = absolute_lab(lab_relative[::step], exact.white_lab)
    start = exact.separate(wanted)
    reached = press.model.lab(start)
    low, high = _THRIFTS
    for _ in range(_THRIFT_STEPS):
        middle = float(np.sqrt(low * high))
        tried = Separator(
            press.model, replace(settings, tolerance=_MOST_OF_MEAN * tolerance, thrift=middle), threads=threads
        )
        moved = np.asarray(delta_e_2000(press.model.lab(tried.follow(reached, start)), reached))
        if float(moved.mean()) + _TABLE_DELTA_E > tolerance:
            high = middle
        else:
            low = middle
    return Separator(press.model, replace(settings, tolerance=_MOST_OF_MEAN * tolerance, thrift=low), threads=threads)


def _through(table: LinkTable, recipes: NDArray[np.float64]) -> NDArray[np.float64]:
    shape = table.grid.shape[:-1]
    weights = multilinear_weights(Curves(tuple(table.curves))(recipes) * (shape[0] - 1), shape)
    return np.asarray(weights @ table.grid.reshape(-1, table.grid.shape[-1]))


def _judged(source: IccProfile, press: FittedPress, image: Path | None) -> tuple[str, NDArray[np.float64]]:
    """What a link is judged on, in words, and the recipes that the first profile makes of those colours."""
    if image is not None:
        scan = read_scan(image)
        pixels = scan.pixels.reshape(1, -1, scan.pixels.shape[-1])
        step = max(1, pixels.shape[1] // _MOST_IMAGE_COLOURS)
        xyz = scan_to_xyz(np.ascontiguousarray(pixels[:, ::step]), scan.icc_profile)
        return f"the colours of {image}", _inks_of_pcs(source, lab_from_xyz(xyz[0].astype(np.float64)))
    random = rng.generator(0, "colours that judge a link").random((4 * _JUDGED_COLOURS, press.model.inks))
    rank = random.argsort(axis=1).argsort(axis=1)
    random[rank < press.model.inks - 4] = 0.0
    random = random[random.sum(axis=1) <= press.model.max_total][:_JUDGED_COLOURS]
    colours = relative_lab(press.model.lab(random), press.model.white_lab)
    return "colours from all over the gamut", _inks_of_pcs(source, colours)


def link_profiles(
    source_path: Path,
    target_path: Path,
    output: Path,
    settings: LinkSettings | None = None,
    *,
    progress: Progress | None = None,
) -> LinkReport:
    """Build a device link from two profile files and write it in one piece; see `make_link`.

    Raises
    ------
    ProfileError
        If a profile can't be read or used.
    OutputError
        If the link can't be written.
    """
    refuse_overwriting(output, (source_path, target_path, settings.image if settings else None))
    source, target = read_icc_profile(source_path), read_icc_profile(target_path)
    data, report = make_link(source, target, settings, progress=progress)
    atomic_write_bytes(output, data)
    return report
