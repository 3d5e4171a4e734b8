"""Building a profile from measurements: repeatable, good on the true press, and what is shipped."""

from pathlib import Path

import numpy as np
import pytest

from sim.press import CeramicPress
from tilefab.colour.spaces import delta_e_2000, lab_from_xyz, relative_lab
from tilefab.colour.transform import Intent
from tilefab.errors import ProfileError
from tilefab.io.cgats import Measurements, read_measurements
from tilefab.io.icc import IccProfile, parse_icc_profile, read_icc_profile, require_press_profile
from tilefab.io.press_profile import press_transform
from tilefab.pipeline import profiling
from tilefab.pipeline.profiling import ProfileReport, build_profile, make_profile

PROFILES = Path(__file__).parents[3] / "profiles"
CHART = PROFILES / "demo_ceramic.ti3"
SHIPPED = PROFILES / "demo_ceramic.icc"


@pytest.fixture(scope="module")
def measurements() -> Measurements:
    return read_measurements(CHART)


@pytest.fixture(scope="module")
def small(measurements: Measurements) -> tuple[bytes, ProfileReport]:
    return make_profile(measurements, "chart", forward_grid=7, backward_grid=9)


@pytest.fixture(scope="module")
def recipes() -> np.ndarray:
    inks = np.random.default_rng(1).random((6000, 4))
    return np.asarray(inks[inks.sum(axis=1) <= 2.75][:1500])


def table_of(profile: IccProfile, tag: str) -> np.ndarray:
    """Grid of a lut16Type element, 0 to 1, one axis for each input and one for outputs (ICC.1:2001-04, 6.5.7)."""
    entry = profile.data.index(tag.encode(), 132)
    offset = int.from_bytes(profile.data[entry + 4 : entry + 8], "big")
    inputs, outputs, grid = profile.data[offset + 8 : offset + 11]
    entries = int.from_bytes(profile.data[offset + 48 : offset + 50], "big")
    begin = offset + 52 + 2 * inputs * entries
    table = np.frombuffer(profile.data, ">u2", grid**inputs * outputs, begin) / 65535.0
    return np.asarray(table.reshape((grid,) * inputs + (outputs,)))


def test_same_measurements_same_bytes(measurements: Measurements, small: tuple[bytes, ProfileReport]) -> None:
    assert make_profile(measurements, "chart", forward_grid=7, backward_grid=9) == small


def test_report_tells_the_quality(small: tuple[bytes, ProfileReport]) -> None:
    _, report = small
    assert report.patches == 800
    assert report.ink_names == ("Blue", "Brown", "Yellow", "Black")
    assert 0.05 < report.model_fit_mean < report.held_out_mean < 0.35
    assert report.round_trip_mean < 2.5
    assert 91.0 < report.white_lab[0] < 94.0
    assert report.dark_lab[0] < 20.0


def test_shipped_profile_is_of_these_measurements(small: tuple[bytes, ProfileReport]) -> None:
    shipped = require_press_profile(read_icc_profile(SHIPPED))
    rebuilt = parse_icc_profile(small[0], "rebuilt")
    assert len(shipped.data) < 1_000_000
    assert "SYNTHETIC" in shipped.description
    assert shipped.ink_names == rebuilt.ink_names
    assert shipped.white_xyz == pytest.approx(rebuilt.white_xyz, abs=2e-5)
    assert CHART.read_bytes() in shipped.data
    # Every second node of 13 is one of 7, and every fourth of 33 one of 9: there both must say the same.
    forward, again = table_of(shipped, "A2B1"), table_of(rebuilt, "A2B1")
    assert np.abs(forward[::2, ::2, ::2, ::2] - again).max() <= 4 / 65535
    printer = press_transform(shipped, "relative")
    printable = table_of(rebuilt, "gamt")[..., 0] == 0.0
    assert printable.sum() > 10
    for tag in ("B2A0", "B2A1"):
        inks = [table_of(shipped, tag)[::4, ::4, ::4][printable], table_of(rebuilt, tag)[printable]]
        prints = [printer.lab_from_inks(recipe[np.newaxis])[0] for recipe in inks]
        assert delta_e_2000(*prints).mean() < 0.1
        assert np.abs(inks[0] - inks[1]).mean() < 0.05


def test_shipped_profile_prints_true_on_the_press_it_was_never_shown(recipes: np.ndarray) -> None:
    """Wanted colours through the profile to inks, printed on the simulated press without noise."""
    shipped = read_icc_profile(SHIPPED)
    press = CeramicPress()
    wanted = press.lab(recipes)
    relative = relative_lab(wanted, lab_from_xyz(shipped.white_xyz))
    inks = press_transform(shipped, "relative").inks_from_lab(relative[np.newaxis])[0]
    assert inks.sum(axis=1).max() <= 2.8 + 2e-4
    error = delta_e_2000(press.lab(np.clip(inks, 0.0, 1.0)), wanted)
    assert error.mean() < 0.3
    assert np.percentile(error, 95) < 0.6
    inks = press_transform(shipped, "absolute").inks_from_lab(wanted[np.newaxis])[0]
    assert delta_e_2000(press.lab(inks), wanted).mean() < 0.3


@pytest.mark.parametrize("intent", ["relative", "perceptual"])
def test_greys_stay_grey_and_rise(intent: Intent) -> None:
    shipped = read_icc_profile(SHIPPED)
    press = press_transform(shipped, intent)
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
        assert inks.sum(axis=2).max() <= 2.8 + 2e-4


def test_written_in_one_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(profiling, "FORWARD_GRID", 3)
    monkeypatch.setattr(profiling, "BACKWARD_GRID", 5)
    told: list[float] = []
    report = build_profile(
        CHART, tmp_path / "out.icc", ink_limit_percent=250, progress=lambda _what, share: told.append(share)
    )
    assert [path.name for path in tmp_path.iterdir()] == ["out.icc"]
    assert (tmp_path / "out.icc").stat().st_size == report.size_bytes
    assert report.ink_limit_percent == 250.0
    assert told == sorted(told)
    assert told[-1] == 1.0


@pytest.mark.parametrize(("limit", "message"), [(0.0, "makes no sense"), (401.0, "makes no sense"), (350.0, "320 %")])
def test_limits_that_can_t_be_kept_are_refused(measurements: Measurements, limit: float, message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        make_profile(measurements, "chart", ink_limit_percent=limit)


def test_measurements_that_can_t_be_used_are_refused(measurements: Measurements) -> None:
    few = Measurements(measurements.ink_frac[-10:], measurements.lab_d50[-10:], measurements.ink_names, "few", "")
    with pytest.raises(ProfileError, match="measure a larger chart"):
        make_profile(few, "few", ink_limit_percent=100.0)
    three = Measurements(np.zeros((5, 3)), np.zeros((5, 3)), ("a", "b", "c"), "three", "")
    with pytest.raises(ProfileError, match="has 3 inks"):
        make_profile(three, "three")
