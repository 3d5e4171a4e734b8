"""``profile build`` on the command line."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tilefab.cli.profile import app
from tilefab.errors import ProfileError
from tilefab.pipeline import profiling

CHART = Path(__file__).parents[3] / "profiles" / "demo_ceramic.ti3"


@pytest.fixture(autouse=True)
def _small_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(profiling, "FORWARD_GRID", 3)
    monkeypatch.setattr(profiling, "BACKWARD_GRID", 5)


def test_build_writes_a_profile_and_reports_as_json(tmp_path: Path) -> None:
    out = tmp_path / "press.icc"
    result = CliRunner().invoke(app, ["build", str(CHART), "-o", str(out), "--ink-limit", "260", "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["patches"] == 800
    assert report["ink_limit_percent"] == 260.0
    assert report["size_bytes"] == out.stat().st_size


def test_build_reports_for_people(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["build", str(CHART), "-o", str(tmp_path / "press.icc")])
    assert result.exit_code == 0, result.output
    assert "Blue, Brown, Yellow, Black" in result.stdout
    assert "round trip in gamut" in result.stdout


def test_errors_reach_the_caller(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["build", str(tmp_path / "absent.ti3"), "-o", str(tmp_path / "x.icc")])
    assert isinstance(result.exception, ProfileError)
    assert not (tmp_path / "x.icc").exists()
