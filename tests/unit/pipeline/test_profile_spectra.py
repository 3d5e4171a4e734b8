"""What a profile's report says of measured spectra."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from sim.inks import WAVELENGTHS_NM
from sim.instrument import measure_spectra
from sim.spectral_press import SpectralPress
from tilefab.cli import profile_build
from tilefab.cli.profile import app
from tilefab.colour.spaces import delta_e_2000, lab_from_xyz
from tilefab.colour.spectra import xyz_from_reflectance
from tilefab.errors import ProfileError
from tilefab.io.cgats import Measurements, parse_measurements
from tilefab.io.cgats_write import measurements_text
from tilefab.pipeline.profiling import ProfileReport, ProfileSettings, fit_press, fit_spectra, make_profile

PATCHES = 90
SMALL = ProfileSettings(forward_grid=9, backward_grid=7)
PRESS = SpectralPress("ceramic4")


def spectra_of(recipes: np.ndarray) -> np.ndarray:
    """Two inks of the press, as an instrument reads them."""
    whole = np.zeros((len(recipes), 4))
    whole[:, :2] = recipes
    return measure_spectra(PRESS, whole, np.random.default_rng(2))


@pytest.fixture(scope="module")
def measurements() -> Measurements:
    recipes = np.random.default_rng(1).random((PATCHES, 2))
    recipes[:3] = 0.0
    recipes[3:6] = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    measured = spectra_of(recipes)
    text = measurements_text(
        recipes,
        lab_from_xyz(xyz_from_reflectance(measured, WAVELENGTHS_NM)),
        ink_names=("Blue", "Brown"),
        description="two inks",
        created="2026-11-24",
        reflectance=measured,
        wavelengths_nm=WAVELENGTHS_NM,
    )
    return parse_measurements(text, "two inks")


@pytest.fixture(scope="module")
def report(measurements: Measurements) -> ProfileReport:
    return make_profile(measurements, "two inks", SMALL)[1]


def test_the_report_has_the_error_of_spectra(measurements: Measurements, report: ProfileReport) -> None:
    model = fit_spectra(measurements, fit_press(measurements, "two inks"), "two inks")
    assert model is not None
    unseen = np.random.default_rng(3).random((300, 2))
    found, measured = model.reflectance(unseen), spectra_of(unseen)
    assert report.spectral_rms is not None
    assert report.spectral_delta_e_a is not None
    assert report.spectral_rms == pytest.approx(np.sqrt(np.square(found - measured).mean()), rel=0.5)
    lab = [lab_from_xyz(xyz_from_reflectance(spectra, WAVELENGTHS_NM, "A")) for spectra in (found, measured)]
    assert report.spectral_delta_e_a == pytest.approx(delta_e_2000(*lab).mean(), rel=0.4)


def test_without_spectra_nothing_is_said(measurements: Measurements, report: ProfileReport) -> None:
    bare = replace(measurements, reflectance=None, wavelengths_nm=None)
    without = make_profile(bare, "two inks", SMALL)[1]
    assert without == replace(report, spectral_rms=None, spectral_delta_e_a=None)


def test_outliers_are_left_out_of_spectra_too(measurements: Measurements, report: ProfileReport) -> None:
    press = fit_press(measurements, "two inks")
    assert press.outliers is not None
    assert press.outliers.shape == (PATCHES,)
    assert not press.outliers.any()
    assert measurements.reflectance is not None
    dirt = np.arange(PATCHES) == 40
    dirty = replace(measurements, reflectance=np.where(dirt[:, np.newaxis], 0.02, measurements.reflectance))
    told = [fit_spectra(dirty, replace(press, outliers=known), "dirty") for known in (dirt, None)]
    assert told[0] is not None
    assert told[1] is not None
    assert told[0].errors.rms == pytest.approx(report.spectral_rms, rel=0.2)
    assert told[1].errors.rms > 5.0 * told[0].errors.rms


def test_too_few_spectra_are_refused(measurements: Measurements) -> None:
    press = fit_press(measurements, "two inks")
    assert measurements.reflectance is not None
    few = replace(
        measurements, ink_frac=measurements.ink_frac[:8], reflectance=measurements.reflectance[:8], sample_ids=()
    )
    with pytest.raises(ProfileError, match=r"few: 6 distinct recipes .* measure a larger chart"):
        fit_spectra(few, replace(press, outliers=None), "few")


@pytest.mark.parametrize(
    ("rms", "lamp", "shown"),
    [(0.00123, 0.227, "0.0012 RMS, ΔE00 0.23"), (0.00123, None, "0.0012 RMS"), (None, None, None)],
)
def test_the_command_shows_it(
    report: ProfileReport, monkeypatch: pytest.MonkeyPatch, rms: float | None, lamp: float | None, shown: str | None
) -> None:
    told = replace(report, spectral_rms=rms, spectral_delta_e_a=lamp)
    monkeypatch.setattr(profile_build, "build_profile", lambda *_args, **_named: told)
    monkeypatch.setenv("COLUMNS", "200")
    said = CliRunner().invoke(app, ["build", "data.ti3", "-o", str(Path("out.icc"))])
    assert said.exit_code == 0
    if shown is None:
        assert "spectra" not in said.output
    else:
        assert shown in said.output
    as_json = CliRunner().invoke(app, ["build", "data.ti3", "-o", "out.icc", "--json"])
    facts = json.loads(as_json.stdout)
    assert (facts["spectral_rms"], facts["spectral_delta_e_a"]) == (rms, lamp)
