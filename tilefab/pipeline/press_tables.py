"""The press's tables as a job wants them: the profile's own, or rebuilt from the measurements that it carries.

A job may have its inks chosen otherwise than the profile does, may give the perceptual intent no more room than its
stone needs, and may tell how the press has drifted. Colours stay relative to the unprinted tile as it was profiled: a
glaze that has changed is a drift to be corrected, too.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from tilefab import rng
from tilefab.colour import lab_from_xyz, xyz_from_lab
from tilefab.colour.drift import drifted
from tilefab.colour.encoding import decode_lab16
from tilefab.colour.gamut import GamutBoundary, image_boundary
from tilefab.colour.grid_table import compile_table
from tilefab.colour.lut import (
    BackwardNodes,
    TabulatedIntent,
    backward_nodes,
    backward_table,
    build_forward,
)
from tilefab.colour.separation import SeparationStyle, Separator
from tilefab.colour.stages import ColourTable, Curves, Grid, lab_to_unit
from tilefab.colour.transform import Intent, PressTransform
from tilefab.errors import OutputError
from tilefab.io.manifest import folder_owner
from tilefab.io.press_profile import press_transform
from tilefab.pipeline.carried import carried_press
from tilefab.pipeline.plan import MAPS_FOLDER, Plan
from tilefab.pipeline.profiling import BACKWARD_GRID, FORWARD_GRIDS, separation_settings, triple
from tilefab.pipeline.progress import Progress, Silent
from tilefab.sampling import TextureMap

Float64Array = NDArray[np.float64]

_STAGE = "Tables of the press"
_MOST_SAMPLES = 200_000
_TABULATED: dict[Intent, TabulatedIntent] = {
    "perceptual": "perceptual",
    "relative": "relative",
    "absolute": "relative",
    "saturation": "saturation",
}


def job_press(
    plan: Plan, intent: Intent, texture: TextureMap | None = None, progress: Progress | None = None
) -> PressTransform:
    """The press's conversions for a job.

    Parameters
    ----------
    plan
        The job.
    intent
        "perceptual", "relative", "saturation" or "absolute".
    texture
        The job's texture map, whose colours the perceptual intent makes room for where the job says so.
    progress
        Who watches.

    Raises
    ------
    ProfileError
        If the profile's tables can't be used, or they have to be rebuilt and its measurements can't be used.
    ValueError
        If the job's gamut is that of its image, and the texture map is not given for a perceptual intent.
    """
    if not plan.rebuilds_tables:
        return press_transform(plan.press_profile, intent)
    watch = progress or Silent()
    key, tabulated = _key_of(plan), _TABULATED[intent]
    image: GamutBoundary | None = None
    image_hash = ""
    if tabulated == "perceptual" and plan.job.colour.gamut == "image":
        if texture is None:
            raise ValueError("the perceptual table of this job needs its texture map")
        image, image_hash = image_boundary(_colours(texture)), texture.hash
    watch.stage(_STAGE, 0.0)
    _white(key)
    watch.stage(_STAGE, 0.3)
    _nodes(key)
    watch.stage(_STAGE, 0.5)
    to_inks = _to_inks(_Table(key, tabulated, image_hash, image))
    watch.stage(_STAGE, 0.8)
    transform = PressTransform(to_inks, _to_lab(key), triple(xyz_from_lab(_white(key))), intent)
    watch.stage(_STAGE, 1.0)
    return transform


def fired_colours(plan: Plan, dtype: DTypeLike) -> tuple[Callable[..., NDArray[np.uint16]], Float64Array]:
    """How a job's print counts look fired, its drift included.

    Parameters
    ----------
    plan
        The job.
    dtype
        uint8 or uint16.

    Returns
    -------
    tuple
        ``convert(counts, threads=1)`` to 16-bit Lab (`tilefab.colour.encoding`) relative to a white, and that white as
        absolute Lab (3,).

    Raises
    ------
    ProfileError
        As `job_press`.
    """
    if not plan.rebuilds_tables:
        transform = press_transform(plan.press_profile, "relative")
        return transform.lab16_from_counts(dtype), lab_from_xyz(np.asarray(plan.press_profile.white_xyz))
    key = _key_of(plan)
    convert: Callable[..., NDArray[Any]] = compile_table(_to_lab(key), dtype, np.uint16).apply
    return convert, _white(key)


@dataclass(frozen=True)
class _Key:
    """All that a job's tables depend on; two jobs that agree in it share them."""

    profile_sha256: str
    drift_sha256: str
    style: SeparationStyle
    prices: tuple[tuple[str, float], ...]
    limit_percent: float
    plan: Plan = field(compare=False, repr=False)


@dataclass(frozen=True)
class _Table:
    press: _Key
    intent: TabulatedIntent
    image_hash: str
    image: GamutBoundary | None = field(compare=False, repr=False)


def _key_of(plan: Plan) -> _Key:
    colour = plan.job.colour
    return _Key(
        plan.press_profile.sha256,
        plan.drift_sha256,
        "least_ink" if colour.separation == "least_ink" else "standard",
        tuple(sorted((colour.ink_prices or {}).items())),
        colour.ink_limit_percent,
        plan,
    )


def _kept_in(plan: Plan) -> Path | None:
    """Where the fitted press is kept: beside the job's maps, once there are any."""
    folder = plan.output / MAPS_FOLDER
    try:
        return folder if folder.is_dir() and folder_owner(plan.output) in (None, plan.job_hash) else None
    except OutputError:
        return None


def _white(key: _Key) -> Float64Array:
    """Absolute Lab (3,) of the unprinted tile as it was profiled."""
    press, _ = carried_press(key.plan.press_profile, _kept_in(key.plan))
    return press.model.white_lab


@lru_cache(maxsize=2)
def _nodes(key: _Key) -> BackwardNodes:
    plan = key.plan
    press, measurements = carried_press(plan.press_profile, _kept_in(plan))
    model = press.model if plan.drift is None else drifted(press.model, plan.drift.state)
    measured_percent = 100.0 * float(measurements.ink_frac.sum(axis=1).max())
    settings = separation_settings(
        press,
        plan.ink_names,
        str(plan.job_file.path),
        limit_percent=min(key.limit_percent, measured_percent),
        style=key.style,
        ink_prices=dict(key.prices),
    )
    separator = Separator(model, settings, threads=os.cpu_count() or 1)
    return backward_nodes(separator, BACKWARD_GRID, white_lab=_white(key))


@lru_cache(maxsize=4)
def _to_inks(table: _Table) -> ColourTable:
    nodes = _nodes(table.press)
    grid = backward_table(nodes, table.intent, image=table.image)
    return ColourTable("lab", "ink", (lab_to_unit(2), Curves(tuple(nodes.axes.curves)), Grid(grid)))


@lru_cache(maxsize=2)
def _to_lab(key: _Key) -> ColourTable:
    plan = key.plan
    press, _ = carried_press(plan.press_profile, _kept_in(plan))
    model = press.model if plan.drift is None else drifted(press.model, plan.drift.state)
    found = build_forward(model, FORWARD_GRIDS[model.inks], black_channel=press.black, white_lab=_white(key))
    return ColourTable("ink", "lab", (Curves(tuple(found.curves)), Grid(found.grid)))


def _colours(texture: TextureMap) -> Float64Array:
    """Colours (M, 3) of a texture map's pixels, evenly at random where there are many, always the same."""
    pixels = texture.base.reshape(-1, 3)
    if len(pixels) > _MOST_SAMPLES:
        chosen = rng.generator(0, "colours that the gamut makes room for").integers(len(pixels), size=_MOST_SAMPLES)
        pixels = pixels[np.sort(chosen)]
    return decode_lab16(np.ascontiguousarray(pixels)).astype(np.float64)
