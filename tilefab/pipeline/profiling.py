"""From a measurement file to a press profile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.lut import build_backward, build_forward
from tilefab.colour.press_model import fit_press_model
from tilefab.colour.separation import SeparationSettings, Separator
from tilefab.colour.spaces import delta_e_2000, relative_lab, xyz_from_lab
from tilefab.colour.transform import PressTransform
from tilefab.errors import ProfileError
from tilefab.io.atomic import atomic_write_bytes
from tilefab.io.cgats import Measurements, read_measurements
from tilefab.io.icc import encode_output_profile

Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done, 0 to 1."""

FORWARD_GRID = 13
BACKWARD_GRID = 33
_CHECKED_RECIPES = 4000
_LEAST_LIMIT_PERCENT = 100.0
_COPYRIGHT = "No copyright, use freely"
_THREADS = 2


@dataclass(frozen=True)
class ProfileReport:
    """How good a profile is; colour differences are CIEDE2000.

    Attributes
    ----------
    patches
        Measured patches.
    ink_names
        The inks, in channel order.
    ink_limit_percent
        Total ink limit of the profile.
    model_fit_mean, model_fit_p95
        Press model against the patches it was fitted to.
    held_out_mean, held_out_p95
        Press model against patches it was not fitted to.
    round_trip_mean, round_trip_p95
        Printable colours through the profile to inks, and those inks through the press model.
    white_lab, dark_lab
        Absolute Lab of the unprinted tile and of the darkest print within the limit.
    size_bytes
        Size of the profile.
    """

    patches: int
    ink_names: tuple[str, ...]
    ink_limit_percent: float
    model_fit_mean: float
    model_fit_p95: float
    held_out_mean: float
    held_out_p95: float
    round_trip_mean: float
    round_trip_p95: float
    white_lab: tuple[float, float, float]
    dark_lab: tuple[float, float, float]
    size_bytes: int


def make_profile(
    measurements: Measurements,
    name: str,
    *,
    ink_limit_percent: float = 280.0,
    forward_grid: int | None = None,
    backward_grid: int | None = None,
    progress: Progress | None = None,
) -> tuple[bytes, ProfileReport]:
    """Profile of a press from its measurements, as bytes, with its report.

    Parameters
    ----------
    measurements
        Measured patches of 4 inks.
    name
        What to call the measurements in messages.
    ink_limit_percent
        Total ink limit, above 0 and up to 400, and not beyond what was measured.
    forward_grid, backward_grid
        Nodes for each ink and for each of L*, a*, b*; None takes `FORWARD_GRID` and `BACKWARD_GRID`.
    progress
        Told what is being done.

    Raises
    ------
    ProfileError
        If the measurements are not of 4 inks, are too few, or don't reach the ink limit.
    """
    tell = progress or (lambda _what, _share: None)
    inks = measurements.ink_frac.shape[1]
    if inks != 4:
        raise ProfileError(f"{name}: has {inks} inks, but profiles are built for 4: print a 4-ink chart", path=name)
    if not _LEAST_LIMIT_PERCENT <= ink_limit_percent <= 100.0 * inks:
        raise ProfileError(
            f"{name}: an ink limit of {ink_limit_percent:g} % makes no sense: give {_LEAST_LIMIT_PERCENT:g} to "
            f"{100 * inks} %",
            path=name,
        )
    most = 100.0 * float(measurements.ink_frac.sum(axis=1).max())
    if most < ink_limit_percent - 0.5:
        raise ProfileError(
            f"{name}: the chart has no patch with more than {most:.0f} % ink, but the ink limit is "
            f"{ink_limit_percent:g} %: lower the limit or print a chart that reaches it",
            path=name,
        )

    tell("fitting the press model", 0.0)
    try:
        model = fit_press_model(measurements.ink_frac, measurements.lab_d50)
    except ValueError as error:
        raise ProfileError(f"{name}: {error}: print and measure a larger chart", path=name) from error
    tell("tabulating inks to colour", 0.3)
    forward = build_forward(model, forward_grid or FORWARD_GRID)
    tell("separating colours into inks", 0.4)
    separator = Separator(model, SeparationSettings(total_limit=ink_limit_percent / 100.0), threads=_THREADS)
    backward = build_backward(separator, backward_grid or BACKWARD_GRID)
    tell("encoding the profile", 0.9)
    white_lab = model.lab(np.zeros((1, inks)))[0]
    data = encode_output_profile(
        forward,
        backward,
        white_xyz=_triple(xyz_from_lab(white_lab)),
        black_xyz=_triple(xyz_from_lab(separator.dark_lab)),
        description=measurements.description,
        copyright_text=_COPYRIGHT,
        ink_names=measurements.ink_names,
        measurement_text=measurements.text,
        created=measurements.created,
    )
    tell("checking the profile", 0.95)
    recipes = _checked_recipes(inks, ink_limit_percent)
    wanted = model.lab(recipes)
    press = PressTransform(data, "relative", inks)
    back = press.inks_from_lab(relative_lab(wanted, white_lab)[np.newaxis])[0]
    round_trip = delta_e_2000(model.lab(back), wanted)
    tell("done", 1.0)
    return data, ProfileReport(
        patches=len(measurements.ink_frac),
        ink_names=measurements.ink_names,
        ink_limit_percent=float(ink_limit_percent),
        model_fit_mean=model.fit_mean,
        model_fit_p95=model.fit_p95,
        held_out_mean=model.held_out_mean,
        held_out_p95=model.held_out_p95,
        round_trip_mean=float(round_trip.mean()),
        round_trip_p95=float(np.percentile(round_trip, 95)),
        white_lab=_triple(white_lab),
        dark_lab=_triple(separator.dark_lab),
        size_bytes=len(data),
    )


def build_profile(
    measurements_path: str | Path,
    out_path: str | Path,
    *,
    ink_limit_percent: float = 280.0,
    progress: Progress | None = None,
) -> ProfileReport:
    """Build the ICC profile of a press from a measurement file, and write it in one piece.

    Parameters
    ----------
    measurements_path
        CGATS or .ti3 file of a 4-ink chart.
    out_path
        Profile to write; an existing one is replaced, and stays whole until the new one is complete.
    ink_limit_percent
        Total ink limit.
    progress
        Told what is being done.

    Raises
    ------
    ProfileError
        If the measurements can't be read or used.
    OutputError
        If the profile can't be written.
    """
    measurements = read_measurements(measurements_path)
    data, report = make_profile(
        measurements, str(measurements_path), ink_limit_percent=ink_limit_percent, progress=progress
    )
    atomic_write_bytes(Path(out_path), data)
    return report


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    first, second, third = (float(value) for value in values)
    return (first, second, third)


def _checked_recipes(inks: int, ink_limit_percent: float) -> NDArray[np.float64]:
    """Recipes within the limit, spread evenly, always the same (an additive recurrence)."""
    root = 2.0
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (inks + 1))
    steps = root ** -np.arange(1.0, inks + 1.0)
    recipes = (0.5 + np.arange(1, 4 * _CHECKED_RECIPES)[:, np.newaxis] * steps) % 1.0
    kept = recipes[recipes.sum(axis=1) <= ink_limit_percent / 100.0]
    return np.asarray(kept[:_CHECKED_RECIPES], dtype=np.float64)
