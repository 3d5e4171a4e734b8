"""Building a profile from measurements: repeatable, good on the true press, and what is shipped."""

from pathlib import Path

import imagecodecs
import numpy as np
import pytest

from sim.press import CeramicPress
from sim.spectral_press import SpectralPress
from tilefab.colour.spaces import delta_e_2000, lab_from_xyz, relative_lab
from tilefab.colour.transform import Intent
from tilefab.errors import ProfileError
from tilefab.io.cgats import Measurements, read_measurements
from tilefab.io.icc import parse_icc_profile, read_icc_profile, require_press_profile
from tilefab.io.press_profile import press_transform
from tilefab.pipeline.profiling import ProfileReport, ProfileSettings, build_profile, by_ink, ink_limit, make_profile

PROFILES = Path(__file__).parents[3] / "profiles"
CHART = PROFILES / "demo_ceramic.ti3"
SHIPPED = PROFILES / "demo_ceramic.icc"
SMALL = ProfileSettings(forward_grid=5, backward_grid=9)


def chart_of(inks: int) -> Measurements:
    """The first inks of the simulated eight, measured without noise."""
    press = SpectralPress("ceramic8")
    draw = np.random.default_rng(inks)
    recipes = draw.random((30 + 24 * inks, inks)) ** 1.3
    rank = recipes.argsort(axis=1).argsort(axis=1)
    recipes[rank < inks - 4] = 0.0
    recipes[: inks + 1] = np.vstack([np.zeros((1, inks)), np.eye(inks)])
    lab = press.lab(np.pad(recipes, ((0, 0), (0, 8 - inks))))
    return Measurements(recipes, lab, press.ink_names[:inks], f"{inks} inks", "made up")


@pytest.fixture(scope="module")
def four() -> Measurements:
    return chart_of(4)


@pytest.fixture(scope="module")
def built(four: Measurements) -> dict[int, tuple[bytes, ProfileReport]]:
    return {
        version: make_profile(
            four, "four", ProfileSettings(version=4 if version == 4 else 2, forward_grid=5, backward_grid=9)
        )
        for version in (2, 4)
    }


def test_same_measurements_same_bytes(four: Measurements, built: dict[int, tuple[bytes, ProfileReport]]) -> None:
    assert make_profile(four, "four", SMALL) == built[2]


def test_versions_give_equal_colours(built: dict[int, tuple[bytes, ProfileReport]]) -> None:
    first, second = (press_transform(parse_icc_profile(built[version][0], "p"), "relative") for version in (2, 4))
    draw = np.random.default_rng(2)
    recipes = draw.random((1, 300, 4))
    np.testing.assert_allclose(first.lab_from_inks(recipes), second.lab_from_inks(recipes), atol=0.02)
    lab = draw.uniform([10, -40, -40], [100, 40, 40], (1, 300, 3))
    np.testing.assert_allclose(first.inks_from_lab(lab), second.inks_from_lab(lab), atol=2e-3)
    assert built[2][1].round_trip_mean == pytest.approx(built[4][1].round_trip_mean, abs=0.05)


@pytest.mark.parametrize("version", [2, 4])
def test_limit_holds_in_8_bit_lcms2(built: dict[int, tuple[bytes, ProfileReport]], version: int) -> None:
    data, report = built[version]
    lab = np.random.default_rng(3).integers(0, 256, (64, 512, 3), dtype=np.uint8)
    source = imagecodecs.cms_profile("lab4")
    for intent in (0, 1, 2):
        inks = imagecodecs.cms_transform(
            lab, source, data, colorspace="lab", outcolorspace="cmyk", outdtype=np.uint8, intent=intent
        )
        assert inks.shape == (64, 512, 4)
        assert 100.0 * inks.astype(int).sum(axis=-1).max() / 255.0 <= report.ink_limit_percent + 1e-9


@pytest.mark.parametrize("inks", [1, 2, 3, 5, 8])
def test_profiles_of_1_to_8_inks(inks: int) -> None:
    chart = chart_of(inks)
    data, report = make_profile(chart, "chart", ProfileSettings(forward_grid=3, backward_grid=5))
    profile = parse_icc_profile(data, "built")
    assert profile.ink_names == chart.ink_names == report.ink_names
    assert report.patches == len(chart.ink_frac)
    out = press_transform(profile, "relative").inks_from_lab(
        np.random.default_rng(4).uniform([0, -80, -80], [100, 80, 80], (1, 400, 3))
    )
    assert out.shape == (1, 400, inks)
    assert 100.0 * out.sum(axis=-1).max() <= report.ink_limit_percent + 0.01


def test_report_tells_the_quality(built: dict[int, tuple[bytes, ProfileReport]]) -> None:
    data, report = built[2]
    assert report.size_bytes == len(data)
    assert report.left_out == 0
    assert report.warnings == ()
    assert report.model_fit_mean < report.held_out_mean < 1.0
    assert report.round_trip_mean < 2.5
    assert report.white_lab[0] > 88.0
    assert report.dark_lab[0] < 30.0


def test_shipped_profile_is_of_these_measurements() -> None:
    shipped = require_press_profile(read_icc_profile(SHIPPED))
    assert len(shipped.data) < 2_000_000
    assert "SYNTHETIC" in shipped.description
    assert shipped.ink_names == ("Blue", "Brown", "Yellow", "Black")
    assert CHART.read_bytes() in shipped.data


@pytest.fixture(scope="module")
def recipes() -> np.ndarray:
    inks = np.random.default_rng(1).random((6000, 4))
    return np.asarray(inks[inks.sum(axis=1) <= 2.75][:1500])


def test_shipped_profile_prints_true_on_the_press_it_was_never_shown(recipes: np.ndarray) -> None:
    """Wanted colours through the profile to inks, printed on the simulated press without noise."""
    shipped = read_icc_profile(SHIPPED)
    press = CeramicPress()
    wanted = press.lab(recipes)
    relative = relative_lab(wanted, lab_from_xyz(shipped.white_xyz))
    inks = press_transform(shipped, "relative").inks_from_lab(relative[np.newaxis])[0]
    assert inks.sum(axis=1).max() <= 2.8
    error = delta_e_2000(press.lab(np.clip(inks, 0.0, 1.0)), wanted)
    assert error.mean() < 0.2
    assert np.percentile(error, 95) < 0.5


@pytest.mark.parametrize("intent", ["relative", "perceptual"])
def test_greys_stay_grey_and_rise(intent: Intent) -> None:
    press = press_transform(read_icc_profile(SHIPPED), intent)
    greys = np.zeros((1, 161, 3))
    greys[0, :, 0] = np.linspace(20.0, 100.0, 161)
    lab = press.lab_from_inks(press.inks_from_lab(greys))[0]
    assert (np.diff(lab[:, 0]) > -0.02).all()
    assert np.hypot(lab[20:, 1], lab[20:, 2]).max() < 0.5


def test_inks_never_pass_the_limit_anywhere() -> None:
    shipped = read_icc_profile(SHIPPED)
    axis = np.linspace(-128.0, 127.0, 40)
    lab = np.stack(np.meshgrid(np.linspace(0.0, 100.0, 40), axis, axis, indexing="ij"), axis=-1)
    for intent in ("relative", "perceptual", "saturation"):
        inks = press_transform(shipped, intent).inks_from_lab(lab.reshape(40, -1, 3))
        assert inks.sum(axis=2).max() <= 2.8


def test_limits(four: Measurements) -> None:
    most = 100.0 * four.ink_frac.sum(axis=1).max()
    assert ink_limit(four, "chart", None) == min(280.0, most)
    assert ink_limit(four, "chart", 200.0) == 200.0
    for limit, message in ((0.0, "makes no sense"), (401.0, "makes no sense"), (399.0, "no patch with more")):
        with pytest.raises(ProfileError, match=message):
            ink_limit(four, "chart", limit)


def test_values_by_ink() -> None:
    names = ("Blue", "Brown")
    assert by_ink(None, names, 1.0, "x") == (1.0, 1.0)
    assert by_ink({"bROWN": 2.0}, names, 1.0, "x") == (1.0, 2.0)
    with pytest.raises(ProfileError, match="no ink 'Green'"):
        by_ink({"Green": 2.0}, names, 1.0, "x")
    with pytest.raises(ProfileError, match="above 0"):
        by_ink({"Blue": 0.0}, names, 1.0, "x")


def test_measurements_that_can_t_be_used_leave_no_file(tmp_path: Path) -> None:
    demo = read_measurements(CHART)
    few = Measurements(demo.ink_frac[-10:], demo.lab_d50[-10:], demo.ink_names, "few", "")
    with pytest.raises(ProfileError, match="measure a larger chart"):
        make_profile(few, "few", SMALL)
    nine = Measurements(np.zeros((5, 9)), np.zeros((5, 3)), tuple("abcdefghi"), "nine", "")
    with pytest.raises(ProfileError, match=r"makes no sense|9 inks"):
        make_profile(nine, "nine", SMALL)
    with pytest.raises(ProfileError):
        build_profile(tmp_path / "absent.ti3", tmp_path / "out.icc", SMALL)
    assert not list(tmp_path.iterdir())
