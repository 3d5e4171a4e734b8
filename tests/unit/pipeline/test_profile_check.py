"""What ``profile check`` finds, on a press that is a formula."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from tests.profile_samples import formula_data, formula_profile
from tilefab.cli.profile import app
from tilefab.errors import OutputError, ProfileError
from tilefab.pipeline.profile_check import check_facts, check_profile, check_sheet_path
from tilefab.pipeline.profile_gamut import contour
from tilefab.pipeline.profile_smoothness import reversals
from tilefab.pipeline.profile_solid import fill_solid
from tilefab.report.profile_view import ProfileCheckView

LINES = 500


def write(folder: Path, inks: int, **changes: object) -> Path:
    path = folder / f"press{inks}.icc"
    path.write_bytes(formula_profile(inks, **changes))  # type: ignore[arg-type]
    return path


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory) -> ProfileCheckView:
    return check_profile(write(tmp_path_factory.mktemp("four"), 4), lines=LINES)


def test_a_sound_profile_is_told_so(four: ProfileCheckView) -> None:
    assert four.facts.ink_limit_percent == pytest.approx(260.0, abs=0.1)
    assert four.facts.same_tables == ("saturation",)
    assert four.match is not None
    assert four.match.source == "measurements in the profile"
    assert four.match.spread.count == 200
    assert four.match.spread.mean < 0.3
    assert four.match.white_delta_e == pytest.approx(0.0, abs=0.05)
    assert [trip.intent for trip in four.round_trips] == ["relative", "perceptual"]
    relative, perceptual = four.round_trips
    assert relative.spread.count >= 2000
    assert relative.spread.mean < 1.0 < perceptual.spread.mean
    assert not perceptual.colorimetric
    assert four.smoothness.lines == LINES
    assert four.smoothness.neutral_reversals == 0
    assert four.smoothness.ink_reversals == (0, 0, 0, 0)
    assert 0.8 < four.gamut.volume / four.gamut.hull_volume < 1.05


def test_a_dent_in_the_table_shows(four: ProfileCheckView, tmp_path: Path) -> None:
    dented = check_profile(write(tmp_path, 4, dent=0.3), lines=LINES).smoothness
    assert dented.jump_percent is not None
    assert four.smoothness.jump_percent is not None
    assert dented.jump_percent > 1.5 * four.smoothness.jump_percent
    assert dented.jump_ink == "Cyan"


def test_measurements_of_another_press_are_noticed(tmp_path: Path) -> None:
    data = tmp_path / "other.ti3"
    data.write_text(formula_data(4, shift=-8.0))
    view = check_profile(write(tmp_path, 4), data=data, lines=LINES)
    assert any("two charts of different presses?" in warning for warning in view.warnings)
    assert next(verdict.grade for verdict in view.verdicts if verdict.what == "Inks to colour") == "poor"
    data.write_text(formula_data(6))
    with pytest.raises(ProfileError, match="has 6 inks, but the profile drives 4"):
        check_profile(write(tmp_path, 4), data=data, lines=LINES)


@pytest.mark.parametrize("inks", [1, 6])
def test_other_numbers_of_inks(tmp_path: Path, inks: int) -> None:
    view = check_profile(write(tmp_path, inks), lines=LINES)
    assert view.tone.lab.shape[0] == inks
    assert (view.gamut.volume > 1000.0) == (inks > 2)
    json.dumps(check_facts(view))


def test_missing_tables_are_named(tmp_path: Path) -> None:
    view = check_profile(write(tmp_path, 4, leave_out=("B2A0", "B2A1", "B2A2"), embed=False), lines=LINES)
    assert view.match is None
    assert view.round_trips == ()
    assert any("no B2A1" in what for what in view.facts.missing)
    with pytest.raises(ProfileError):
        check_profile(write(tmp_path, 4, leave_out=("A2B0", "A2B1")), lines=LINES)


def test_an_image_is_judged(tmp_path: Path) -> None:
    picture = np.full((20, 20, 3), 150, np.uint8)
    picture[:10] = (0, 255, 0)
    Image.fromarray(picture).save(tmp_path / "slab.png")
    found = check_profile(write(tmp_path, 4), image=tmp_path / "slab.png", lines=LINES).image
    assert found is not None
    assert found.share_outside == 0.5
    assert found.outside_mean > 5.0


def test_the_command_prints_and_draws(tmp_path: Path) -> None:
    profile = write(tmp_path, 4)
    arguments = ["check", str(profile), "--lines", "200", "--json", "-o", str(tmp_path / "sheet.pdf")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    keys = {"profile", "match", "round_trips", "smoothness", "gamut", "image", "verdicts", "warnings", "files"}
    assert set(facts) == keys
    assert (tmp_path / "sheet.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(OutputError):
        check_sheet_path(Path("sheet.svg"))


def test_the_volume_of_a_ball_is_right() -> None:
    draw = np.random.default_rng(1)
    way = draw.normal(size=(200_000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    ball = fill_solid(20.0 * way * draw.random((len(way), 1)) ** 0.25 + [50.0, 0.3, 0.7])
    assert ball.volume == pytest.approx(4.0 / 3.0 * np.pi * 20.0**3, rel=0.03)
    assert ball.at(np.array([[50.0, 0.0, 0.0], [50.0, 30.0, 0.0]])).tolist() == pytest.approx([1.0, 0.0], abs=1e-6)


def test_contours_lie_on_the_level() -> None:
    across = np.linspace(-2.0, 2.0, 81)
    x, y = np.meshgrid(across, across)
    pieces = contour(np.hypot(x, y), across, across, 1.0)
    assert np.abs(np.hypot(pieces[:, 0], pieces[:, 1]) - 1.0).max() < 0.01
    assert np.hypot(*(pieces[:, :2] - pieces[:, 2:]).T).sum() == pytest.approx(2.0 * np.pi, rel=0.01)


def test_reversals_count_what_goes_back() -> None:
    assert reversals(np.linspace(0.0, 9.0, 20), 1.0) == 0
    assert reversals(np.array([0.0, 3.0, 2.0, 5.0, 4.5, 6.0]), 1.0) == 2
    assert reversals(np.array([9.0, 7.0, 7.05, 5.0]), -1.0) == 0
