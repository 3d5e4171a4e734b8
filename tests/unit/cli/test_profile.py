"""``profile build`` on the command line."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tilefab.cli.profile import app
from tilefab.errors import OutputError, ProfileError
from tilefab.io.cgats import read_measurements
from tilefab.io.cgats_write import measurements_text
from tilefab.io.icc import read_icc_profile
from tilefab.pipeline import profiling

CHART = Path(__file__).parents[3] / "profiles" / "demo_ceramic.ti3"


@pytest.fixture(autouse=True)
def _small_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(profiling, "FORWARD_GRIDS", {4: 3})
    monkeypatch.setattr(profiling, "BACKWARD_GRID", 5)


@pytest.fixture(scope="module")
def chart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every fourth patch of the demo's chart, and its solids."""
    whole = read_measurements(CHART)
    rows = sorted({*range(0, 800, 4), *(row for row in range(800) if whole.ink_frac[row].sum() in (0.0, 1.0))})
    path = tmp_path_factory.mktemp("chart") / "chart.ti3"
    text = measurements_text(
        whole.ink_frac[rows],
        whole.lab_d50[rows],
        ink_names=whole.ink_names,
        description="small",
        created="2026-11-24",
    )
    path.write_text(text)
    return path


def test_build_writes_a_profile_and_reports_as_json(chart: Path, tmp_path: Path) -> None:
    out = tmp_path / "press.icc"
    options = ["--ink-limit", "240", "--version", "4", "--separation", "least-ink", "--price", "Blue=2.5"]
    result = CliRunner().invoke(app, ["build", str(chart), "-o", str(out), *options, "--ink-max", "black=80", "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["patches"] > 200
    assert report["ink_limit_percent"] == 240.0
    assert report["separation"] == "least_ink"
    assert report["size_bytes"] == out.stat().st_size
    assert out.read_bytes()[8] == 4
    assert read_icc_profile(out).ink_names == ("Blue", "Brown", "Yellow", "Black")


def test_build_reports_for_people(chart: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["build", str(chart), "-o", str(tmp_path / "press.icc")])
    assert result.exit_code == 0, result.output
    for words in ("Blue, Brown, Yellow, Black", "round trip in gamut", "noise of a reading", "model against the press"):
        assert words in result.stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--version", "3"], "must be 2 or 4"),
        (["--price", "Blue"], "must be an ink and a number"),
        (["--price", "Blue=dear"], "must be an ink and a number"),
        (["--ink-max", "=80"], "must be an ink and a number"),
        (["--separation", "free"], "free"),
    ],
)
def test_misuse_is_refused(chart: Path, tmp_path: Path, options: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["build", str(chart), "-o", str(tmp_path / "x.icc"), *options])
    assert result.exit_code == 2
    assert message in result.output
    assert not (tmp_path / "x.icc").exists()


def test_errors_reach_the_caller(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["build", str(tmp_path / "absent.ti3"), "-o", str(tmp_path / "x.icc")])
    assert isinstance(result.exception, ProfileError)
    assert not (tmp_path / "x.icc").exists()


def test_a_result_never_takes_the_place_of_what_it_is_made_from(tmp_path: Path) -> None:
    chart = tmp_path / "chart.ti3"
    chart.write_text("CTI3\n")
    with pytest.raises(OutputError, match="one of the files to read"):
        profiling.build_profile(chart, tmp_path / "." / "chart.ti3")
    assert chart.read_text() == "CTI3\n"
