"""From a measurement file to a press profile."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.chart_checks import check_chart
from tilefab.colour.inks import black_channel
from tilefab.colour.lut import build_backward, build_forward
from tilefab.colour.press_model import PressModel, fit_press_model
from tilefab.colour.separation import SeparationSettings, SeparationStyle, Separator
from tilefab.colour.spaces import delta_e_2000, relative_lab, xyz_from_lab
from tilefab.colour.spectral_model import SpectralModel, fit_spectral_model
from tilefab.errors import ProfileError
from tilefab.io.atomic import atomic_write_bytes, refuse_overwriting
from tilefab.io.cgats import Measurements, read_measurements
from tilefab.io.icc import encode_output_profile, parse_icc_profile
from tilefab.io.press_profile import press_transform
from tilefab.pipeline.progress import Progress, Silent

FORWARD_GRIDS = {1: 255, 2: 65, 3: 33, 4: 17, 5: 11, 6: 9, 7: 6, 8: 5}
"""Nodes for each ink, by the number of inks."""

BACKWARD_GRID = 33
DEFAULT_LIMIT_PERCENT = 280.0
MOST_INKS = 8
_CHECKED_RECIPES = 4000
_LEAST_LIMIT_PERCENT = 100.0
_OUTLIER_ROUNDS = 4
_ROUGH_DELTA_E = 1.0
_FITTING, _TABULATING = "Fitting the press", "Inks to colours"
_SEPARATING, _CHECKING = "Colours to inks", "Checking the profile"
_COPYRIGHT = "No copyright, use freely"
ROUNDING = 0.5 / 255.0
"""What rounding to 8 bits may add to an ink: tables stay that far under the limit for each ink."""


@dataclass(frozen=True)
class ProfileSettings:
    """How a profile is built.

    Attributes
    ----------
    ink_limit_percent
        Total ink limit; None takes 280 %, or what the chart reaches where that is less.
    version
        ICC version, 2 or 4.
    separation
        ``"standard"`` or ``"least_ink"``; see `tilefab.colour.separation`.
    ink_prices
        What each ink costs, by its name; others cost 1.
    ink_limits_percent
        Largest amount of each ink, by its name; others go up to 100.
    forward_grid, backward_grid
        Nodes for each ink and for each of L*, a*, b*; None takes `FORWARD_GRIDS` and `BACKWARD_GRID`.
    """

    ink_limit_percent: float | None = None
    version: Literal[2, 4] = 2
    separation: SeparationStyle = "standard"
    ink_prices: Mapping[str, float] | None = None
    ink_limits_percent: Mapping[str, float] | None = None
    forward_grid: int | None = None
    backward_grid: int | None = None


@dataclass(frozen=True)
class ProfileReport:
    """How good a profile is; colour differences are CIEDE2000.

    Attributes
    ----------
    patches, left_out
        Measured patches, and how many of them were left out as outliers.
    ink_names
        The inks, in channel order.
    ink_limit_percent
        Total ink limit of the profile.
    separation
        Style of separation.
    model_fit_mean, model_fit_p95
        Press model against the patches it was fitted to.
    held_out_mean, held_out_p95
        Press model against patches it was not fitted to, their noise included.
    expected_error
        Press model against the press itself, an estimate free of the measurements' noise.
    noise_lab
        Spread of a single reading of L*, a* and b*.
    round_trip_mean, round_trip_p95
        Printable colours through the profile to inks, and those inks through the press model.
    white_lab, dark_lab
        Absolute Lab of the unprinted tile and of the darkest print within the limit.
    size_bytes
        Size of the profile.
    warnings
        What is to be said about the chart.
    spectral_rms, spectral_delta_e_a
        Spectral model against patches it was not fitted to, their noise included: root mean square of reflectance, and
        mean difference under illuminant A. None where no spectra were measured, or none that make colours.
    """

    patches: int
    left_out: int
    ink_names: tuple[str, ...]
    ink_limit_percent: float
    separation: str
    model_fit_mean: float
    model_fit_p95: float
    held_out_mean: float
    held_out_p95: float
    expected_error: float
    noise_lab: float
    round_trip_mean: float
    round_trip_p95: float
    white_lab: tuple[float, float, float]
    dark_lab: tuple[float, float, float]
    size_bytes: int
    warnings: tuple[str, ...]
    spectral_rms: float | None = None
    spectral_delta_e_a: float | None = None


@dataclass(frozen=True)
class FittedPress:
    """A press model with what is known of its measurements.

    Attributes
    ----------
    model
        The model.
    black
        Channel of the black ink, if there is one.
    left_out
        Patches left out as outliers.
    warnings
        What is to be said about the chart.
    outliers
        (P,) bool, which measured patches were left out; None where that is not known any more.
    """

    model: PressModel
    black: int | None
    left_out: int
    warnings: tuple[str, ...]
    outliers: NDArray[np.bool_] | None = field(default=None, repr=False, compare=False)


def fit_press(measurements: Measurements, name: str) -> FittedPress:
    """Fit a press model to measurements, patches that fit nothing left out.

    Raises
    ------
    ProfileError
        If the measurements are of more than 8 inks, are too few, or can't be believed.
    """
    inks = measurements.ink_frac.shape[1]
    if inks > MOST_INKS:
        raise ProfileError(f"{name}: has {inks} inks, but profiles are built for 1 to {MOST_INKS}", path=name)
    recipes, lab = measurements.ink_frac, measurements.lab_d50
    ids = measurements.sample_ids or tuple(str(row + 1) for row in range(len(recipes)))
    kept = np.ones(len(recipes), dtype=np.bool_)
    warnings: dict[str, None] = {}
    try:
        model = fit_press_model(recipes, lab)
        for _ in range(_OUTLIER_ROUNDS):
            rows = np.flatnonzero(kept)
            found = check_chart(model, recipes[rows], lab[rows], measurements.ink_names, [ids[row] for row in rows])
            if found.refusal is not None:
                raise ProfileError(f"{name}: {found.refusal}", path=name)
            warnings |= dict.fromkeys(found.warnings)
            if not found.outliers.any():
                break
            kept[rows[found.outliers]] = False
            model = fit_press_model(recipes[kept], lab[kept])
    except ValueError as error:
        raise ProfileError(f"{name}: {error}: print and measure a larger chart", path=name) from error
    if model.errors.expected_mean > _ROUGH_DELTA_E:
        warnings[
            f"{int(kept.sum())} patches of {inks} inks leave the press uncertain by about ΔE "
            f"{model.errors.expected_mean:.1f}: print a larger chart"
        ] = None
    solids = relative_lab(model.lab(np.eye(inks)), model.white_lab)
    black = black_channel(measurements.ink_names, solids)
    return FittedPress(model, black, int((~kept).sum()), tuple(warnings), ~kept)


def fit_spectra(measurements: Measurements, press: FittedPress, name: str) -> SpectralModel | None:
    """Spectral model of the patches that the press model was fitted to; None where no spectra were measured.

    Raises
    ------
    ProfileError
        If the patches are too few.
    """
    if measurements.reflectance is None or measurements.wavelengths_nm is None:
        return None
    kept = np.ones(len(measurements.ink_frac), dtype=bool) if press.outliers is None else ~press.outliers
    try:
        return fit_spectral_model(
            measurements.ink_frac[kept], measurements.reflectance[kept], measurements.wavelengths_nm
        )
    except ValueError as error:
        raise ProfileError(f"{name}: {error}: print and measure a larger chart", path=name) from error


def ink_limit(measurements: Measurements, name: str, wanted_percent: float | None) -> float:
    """Total ink limit in percent: the one that is wanted, if it makes sense, else a usual one that was measured.

    Raises
    ------
    ProfileError
        If it makes no sense or no patch has as much ink.
    """
    inks = measurements.ink_frac.shape[1]
    most = 100.0 * float(measurements.ink_frac.sum(axis=1).max())
    if wanted_percent is None:
        return min(DEFAULT_LIMIT_PERCENT, most)
    least = min(_LEAST_LIMIT_PERCENT, most)
    if not least <= wanted_percent <= 100.0 * inks:
        raise ProfileError(
            f"{name}: an ink limit of {wanted_percent:g} % makes no sense: give {least:g} to {100 * inks} %", path=name
        )
    if most < wanted_percent - 0.5:
        raise ProfileError(
            f"{name}: the chart has no patch with more than {most:.0f} % ink, but the ink limit is "
            f"{wanted_percent:g} %: lower the limit or print a chart that reaches it",
            path=name,
        )
    return wanted_percent


def by_ink(given: Mapping[str, float] | None, ink_names: tuple[str, ...], usual: float, name: str) -> tuple[float, ...]:
    """One value for each ink, in channel order, of values by name (capitals don't matter).

    Raises
    ------
    ProfileError
        If a name is none of the inks, or a value is not above 0.
    """
    values = dict.fromkeys((ink.casefold() for ink in ink_names), usual)
    for ink, value in (given or {}).items():
        if ink.casefold() not in values:
            raise ProfileError(
                f"{name}: there is no ink {ink!r}; the inks are {', '.join(ink_names)}: correct the name", path=name
            )
        if not 0.0 < value < float("inf"):
            raise ProfileError(f"{name}: {value:g} for ink {ink} makes no sense: give a number above 0", path=name)
        values[ink.casefold()] = value
    return tuple(values[ink.casefold()] for ink in ink_names)


def separation_settings(
    press: FittedPress,
    ink_names: tuple[str, ...],
    name: str,
    *,
    limit_percent: float,
    style: SeparationStyle,
    ink_prices: Mapping[str, float] | None = None,
    ink_limits_percent: Mapping[str, float] | None = None,
) -> SeparationSettings:
    """Settings of a separation that stays under a total limit even when its inks are rounded to 8 bits.

    Raises
    ------
    ProfileError
        If prices or limits don't fit the inks.
    """
    limits = tuple(min(value, 100.0) / 100.0 for value in by_ink(ink_limits_percent, ink_names, 100.0, name))
    return SeparationSettings(
        total_limit=limit_percent / 100.0 - ROUNDING * press.model.inks,
        ink_limits=limits,
        black_channel=press.black,
        style=style,
        prices=by_ink(ink_prices, ink_names, 1.0, name),
    )


def make_profile(
    measurements: Measurements,
    name: str,
    settings: ProfileSettings | None = None,
    *,
    progress: Progress | None = None,
) -> tuple[bytes, ProfileReport]:
    """Profile of a press from its measurements, as bytes, with its report.

    Parameters
    ----------
    measurements
        Measured patches of 1 to 8 inks.
    name
        What to call the measurements in messages.
    settings
        How to build it; None: as usual.
    progress
        Told what is being done.

    Raises
    ------
    ProfileError
        If the measurements can't be believed, are too few, or don't reach the ink limit.
    """
    bars = progress or Silent()
    chosen = settings or ProfileSettings()
    inks = measurements.ink_frac.shape[1]
    limit = ink_limit(measurements, name, chosen.ink_limit_percent)
    # Wrong names are told before the work, not after.
    by_ink(chosen.ink_prices, measurements.ink_names, 1.0, name)
    by_ink(chosen.ink_limits_percent, measurements.ink_names, 100.0, name)
    bars.stage(_FITTING, 0.0)
    press = fit_press(measurements, name)
    model = press.model
    bars.stage(_FITTING, 0.9)
    spectra = fit_spectra(measurements, press, name)
    bars.stage(_FITTING, 1.0)
    for warning in press.warnings:
        bars.note(warning)
    bars.stage(_TABULATING, 0.0)
    forward = build_forward(model, chosen.forward_grid or FORWARD_GRIDS[inks], black_channel=press.black)
    bars.stage(_TABULATING, 1.0)
    separation = separation_settings(
        press,
        measurements.ink_names,
        name,
        limit_percent=limit,
        style=chosen.separation,
        ink_prices=chosen.ink_prices,
        ink_limits_percent=chosen.ink_limits_percent,
    )
    separator = Separator(model, separation, threads=os.cpu_count() or 1)
    backward = build_backward(
        separator,
        chosen.backward_grid or BACKWARD_GRID,
        tell=lambda share: bars.stage(_SEPARATING, share),
    )
    white_lab = model.white_lab
    data = encode_output_profile(
        forward,
        backward,
        white_xyz=triple(xyz_from_lab(white_lab)),
        black_xyz=triple(xyz_from_lab(separator.dark_lab)),
        description=measurements.description,
        copyright_text=_COPYRIGHT,
        ink_names=measurements.ink_names,
        measurement_text=measurements.text,
        created=measurements.created,
        version=chosen.version,
    )
    bars.stage(_CHECKING, 0.0)
    wanted = model.lab(separator.separate(model.lab(_checked_recipes(inks, limit))))
    transform = press_transform(parse_icc_profile(data, name), "relative")
    back = transform.inks_from_lab(relative_lab(wanted, white_lab)[np.newaxis])[0]
    round_trip = delta_e_2000(model.lab(back), wanted)
    bars.stage(_CHECKING, 1.0)
    return data, ProfileReport(
        patches=len(measurements.ink_frac),
        left_out=press.left_out,
        ink_names=measurements.ink_names,
        ink_limit_percent=float(limit),
        separation=chosen.separation,
        model_fit_mean=model.errors.fit_mean,
        model_fit_p95=model.errors.fit_p95,
        held_out_mean=model.errors.held_out_mean,
        held_out_p95=model.errors.held_out_p95,
        expected_error=model.errors.expected_mean,
        noise_lab=model.errors.noise,
        round_trip_mean=float(round_trip.mean()),
        round_trip_p95=float(np.percentile(round_trip, 95)),
        white_lab=triple(white_lab),
        dark_lab=triple(separator.dark_lab),
        size_bytes=len(data),
        warnings=press.warnings,
        spectral_rms=None if spectra is None else spectra.errors.rms,
        spectral_delta_e_a=None if spectra is None else spectra.errors.delta_e_a_mean,
    )


def build_profile(
    measurements_path: str | Path,
    out_path: str | Path,
    settings: ProfileSettings | None = None,
    *,
    progress: Progress | None = None,
) -> ProfileReport:
    """Build the ICC profile of a press from a measurement file, and write it in one piece.

    Parameters
    ----------
    measurements_path
        CGATS or .ti3 file of a chart of 1 to 8 inks.
    out_path
        Profile to write; an existing one is replaced, and stays whole until the new one is complete.
    settings
        How to build it.
    progress
        Told what is being done.

    Raises
    ------
    ProfileError
        If the measurements can't be read or used.
    OutputError
        If the profile can't be written.
    """
    refuse_overwriting(Path(out_path), (Path(measurements_path),))
    measurements = read_measurements(measurements_path)
    data, report = make_profile(measurements, str(measurements_path), settings, progress=progress)
    atomic_write_bytes(Path(out_path), data)
    return report


def triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    """Three numbers of an array."""
    first, second, third = (float(value) for value in values)
    return (first, second, third)


def _checked_recipes(inks: int, ink_limit_percent: float) -> NDArray[np.float64]:
    """Recipes within the limit, spread evenly, always the same (an additive recurrence)."""
    root = 2.0
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (inks + 1))
    steps = root ** -np.arange(1.0, inks + 1.0)
    recipes = (0.5 + np.arange(1, 4 * _CHECKED_RECIPES)[:, np.newaxis] * steps) % 1.0
    # Where there are many inks, recipes have only some of them, as separations do.
    rank = recipes.argsort(axis=1).argsort(axis=1)
    recipes[rank < inks - 4] = 0.0
    kept = recipes[recipes.sum(axis=1) <= ink_limit_percent / 100.0]
    return np.asarray(kept[:_CHECKED_RECIPES], dtype=np.float64)
