"""Charts from settings to files, and from scans and instruments back to measurements."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from typer.testing import CliRunner

from tilefab.cli.profile import app
from tilefab.colour import lab_from_xyz
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, srgb_from_rgb_lin
from tilefab.colour.spectra import xyz_from_reflectance
from tilefab.errors import ImageError, OutputError, ProfileError
from tilefab.io.cgats import read_measurements
from tilefab.io.cgats_write import measurements_text
from tilefab.io.chart_list import read_chart_list
from tilefab.io.faces import read_print_pixels
from tilefab.pipeline.chart_reading import ReadingReport, read_chart
from tilefab.pipeline.charts import ChartReport, ChartSettings, make_chart
from tilefab.types import SizeMm

DAY = "2026-11-24"
NM = np.arange(400.0, 701.0, 10.0)
SETTINGS = ChartSettings(
    ink_names=("Blue", "Brown", "Yellow", "Black"),
    patches=150,
    tile_mm=SizeMm(110.0, 100.0),
    dpi=130.0,
    patch_mm=7.0,
    gap_mm=1.2,
    seed=4,
)
ABSORB = np.array([[0.9, 0.5, 0.1], [0.3, 0.6, 0.8], [0.02, 0.1, 0.8], [0.93, 0.93, 0.92]])


def rgb_of_ink(ink_frac: NDArray[np.float64]) -> NDArray[np.float64]:
    rgb = np.broadcast_to([0.88, 0.87, 0.83], (*ink_frac.shape[:-1], 3)).copy()
    for ink, absorb in enumerate(ABSORB):
        rgb *= 1.0 - absorb * ink_frac[..., ink, np.newaxis]
    return rgb


def spectra_of_ink(ink_frac: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.full((len(ink_frac), len(NM)), 0.85)
    for ink, centre in enumerate((620.0, 480.0, 420.0, 550.0)):
        out *= 1.0 - 0.9 * ink_frac[:, [ink]] * np.exp(-(((NM - centre) / (400.0 if ink == 3 else 60.0)) ** 2))
    return out


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ChartReport]:
    folder = tmp_path_factory.mktemp("chart")
    return folder, make_chart(folder / "chart", SETTINGS, created=DAY)


def scan(folder: Path, report: ChartReport, tile: int, turns: int = 0) -> Path:
    """A scan of a print file: turned, on a dark lid, in sRGB, a little dimmer to one side."""
    rgb = rgb_of_ink(read_print_pixels(Path(report.files[tile])) / 255.0)
    rgb = np.pad(np.rot90(rgb, turns), ((30, 25), (28, 40), (0, 0)), constant_values=0.03)
    rgb = rgb * np.linspace(1.02, 0.98, rgb.shape[1])[:, np.newaxis]
    path = folder / f"scan_{tile + 1}_{turns}.tif"
    pixels = np.rint(65535 * srgb_from_rgb_lin(rgb)).astype(np.uint16)
    tifffile.imwrite(path, pixels, photometric="rgb", resolution=(130, 130), resolutionunit="INCH")
    return path


def instrument(path: Path, report: ChartReport, *, drop: slice = slice(0), **changes: object) -> Path:
    """An instrument's file of the chart in another order."""
    chart = read_chart_list(report.list_file)
    order = np.random.default_rng(3).permutation(len(chart.sample_ids))
    order = np.delete(order, drop)
    ink = chart.layout.ink_counts[order] / 255.0
    spectra = spectra_of_ink(ink)
    arguments = {
        "ink_names": chart.ink_names,
        "description": "measured",
        "created": DAY,
        "reflectance": spectra,
        "wavelengths_nm": NM,
        "sample_ids": [chart.sample_ids[patch] for patch in order],
        "locations": [chart.locations[patch] for patch in order],
        **changes,
    }
    path.write_text(measurements_text(ink, lab_from_xyz(xyz_from_reflectance(spectra, NM)), **arguments))
    return path


def without(text: str, *columns: str) -> str:
    """The text of a measurement file without some columns."""
    lines = text.split("\n")
    names = next(line for line in lines if line.startswith("SAMPLE_ID")).split()
    keep = [place for place, name in enumerate(names) if name not in columns]
    return "\n".join(
        " ".join(words[place] for place in keep) if len(words := line.split()) == len(names) else line for line in lines
    )


def test_a_chart_is_written(made: tuple[Path, ChartReport]) -> None:
    folder, report = made
    assert report.tiles == 2
    assert sum(report.patches_per_tile) == report.patches == 150
    assert report.most_ink_percent <= report.ink_limit_percent == 300.0
    assert sum(report.kinds.values()) == 150
    assert sorted(path.name for path in folder.glob("chart*")) == ["chart.cgats", "chart_1.tif", "chart_2.tif"]
    with tifffile.TiffFile(report.files[0]) as file:
        assert file.pages[0].shape == (512, 563, 4)
        assert file.pages[0].tags[332].value == 1
    chart = read_chart_list(report.list_file)
    assert chart.ink_names == SETTINGS.ink_names
    pixels = read_print_pixels(Path(report.files[1]))
    for patch in chart.layout.on_tile(1):
        top, left = chart.layout.cell_corner(*(int(v) for v in chart.layout.places[patch, 1:]))
        assert (pixels[top + 5, left + 5] == chart.layout.ink_counts[patch]).all()


def test_the_same_settings_write_the_same_files(made: tuple[Path, ChartReport], tmp_path: Path) -> None:
    again = make_chart(tmp_path / "chart", SETTINGS, created=DAY)
    for one, other in zip((*made[1].files, made[1].list_file), (*again.files, again.list_file), strict=True):
        assert Path(one).read_bytes() == Path(other).read_bytes()


def test_scans_become_measurements(made: tuple[Path, ChartReport], tmp_path: Path) -> None:
    _, report = made
    out = tmp_path / "data.ti3"
    scans = [scan(tmp_path, report, 1, 3), scan(tmp_path, report, 0, 2)]
    read: ReadingReport = read_chart(Path(report.list_file), scans, out, created=DAY)
    data = read_measurements(out)
    assert read.patches == len(data.lab_d50) == 150
    assert data.ink_names == SETTINGS.ink_names
    true = lab_from_xyz(rgb_of_ink(data.ink_frac) @ XYZ_D50_FROM_RGB_LIN.T)
    away = np.linalg.norm(data.lab_d50 - true, axis=1)
    assert away.mean() < 0.3
    assert away.max() < 1.0
    assert [note.tile for note in read.scans] == [2, 1]
    assert [round(note.turn_degrees) % 360 for note in read.scans] == [90, 180]
    assert all(note.residual_mm < 0.05 for note in read.scans)
    assert not read.notes
    assert not read.left_out
    assert read.noise_delta_e is not None
    assert read.noise_delta_e < 0.3
    assert len(read.warnings) == 2
    assert all("taken as sRGB" in warning for warning in read.warnings)


def test_scans_that_don_t_make_a_chart(made: tuple[Path, ChartReport], tmp_path: Path) -> None:
    _, report = made
    chart, out = Path(report.list_file), tmp_path / "x.ti3"
    first, again = scan(tmp_path, report, 0), scan(tmp_path, report, 0, 1)
    with pytest.raises(ProfileError, match="no scan shows tile 2 of 2"):
        read_chart(chart, [first], out, created=DAY)
    with pytest.raises(ProfileError, match=r"shows tile 1, as .*scan_1_0\.tif does"):
        read_chart(chart, [first, again], out, created=DAY)
    with pytest.raises(ProfileError, match="is a scan among measurement files"):
        read_chart(chart, [first, instrument(tmp_path / "m.txt", report)], out, created=DAY)
    other = make_chart(tmp_path / "other", ChartSettings(**{**SETTINGS.__dict__, "seed": 9}), created=DAY)
    with pytest.raises(ProfileError, match="another chart"):
        read_chart(Path(other.list_file), [first], out, created=DAY)
    with pytest.raises(ProfileError, match="can't be read"):
        read_chart(chart, [tmp_path / "absent.tif"], out, created=DAY)
    with pytest.raises(OutputError, match="is one of the files to read"):
        read_chart(chart, [first], first, created=DAY)
    with pytest.raises(ImageError, match="scan as RGB"):
        read_chart(chart, [Path(report.files[0])], out, created=DAY)
    with pytest.raises(ProfileError, match="no scan or measurement"):
        read_chart(chart, [], out, created=DAY)
    assert not out.exists()


@pytest.mark.parametrize(
    "columns", [(), ("CMYK_C", "CMYK_M", "CMYK_Y", "CMYK_K"), ("CMYK_C", "CMYK_M", "CMYK_Y", "CMYK_K", "SAMPLE_LOC")]
)
def test_an_instrument_s_file_is_put_in_order(
    made: tuple[Path, ChartReport], tmp_path: Path, columns: tuple[str, ...]
) -> None:
    _, report = made
    measured = instrument(tmp_path / "measured.txt", report)
    measured.write_text(without(measured.read_text(), *columns))
    out = tmp_path / "data.ti3"
    read = read_chart(Path(report.list_file), [measured], out, created=DAY)
    data = read_measurements(out)
    assert data.sample_ids == tuple(str(patch + 1) for patch in range(150))
    assert data.reflectance is not None
    np.testing.assert_allclose(data.reflectance, spectra_of_ink(data.ink_frac), atol=2e-5)
    np.testing.assert_allclose(data.lab_d50, lab_from_xyz(xyz_from_reflectance(data.reflectance, NM)), atol=0.02)
    assert read.bands == 31
    assert not read.warnings
    assert not read.notes


def test_parts_and_repeated_readings(made: tuple[Path, ChartReport], tmp_path: Path) -> None:
    _, report = made
    parts = [
        instrument(tmp_path / "a.txt", report, drop=slice(0, 60)),
        instrument(tmp_path / "b.txt", report, drop=slice(90, 150)),
    ]
    read = read_chart(Path(report.list_file), parts, tmp_path / "data.ti3", created=DAY)
    assert read.patches == 150
    data = read_measurements(tmp_path / "data.ti3")
    assert data.reflectance is not None
    np.testing.assert_allclose(data.reflectance, spectra_of_ink(data.ink_frac), atol=2e-5)


def test_instrument_s_files_of_something_else(made: tuple[Path, ChartReport], tmp_path: Path) -> None:
    _, report = made
    chart, out, path = Path(report.list_file), tmp_path / "x.ti3", tmp_path / "m.txt"
    with pytest.raises(ProfileError, match=r"20 of the chart's 150 patches are not measured"):
        read_chart(chart, [instrument(path, report, drop=slice(0, 20))], out, created=DAY)
    ids = [f"P{k}" for k in range(150)]
    with pytest.raises(ProfileError, match=r"150 of its 150 patches are not on the chart of 150, the first is 'P0'"):
        read_chart(chart, [instrument(path, report, sample_ids=ids, locations=ids)], out, created=DAY)
    twice = ["1", *(str(k) for k in range(1, 150))]
    with pytest.raises(ProfileError, match="patch 1 is there twice"):
        read_chart(chart, [instrument(path, report, sample_ids=twice)], out, created=DAY)
    in_order = [str(k + 1) for k in range(150)]
    with pytest.raises(ProfileError, match="patches have other ink than on the chart"):
        read_chart(chart, [instrument(path, report, sample_ids=in_order)], out, created=DAY)
    nameless = instrument(path, report)
    nameless.write_text(without(nameless.read_text(), "SAMPLE_LOC").replace("SAMPLE_ID", "NUMBER_"))
    with pytest.raises(ProfileError, match="neither SAMPLE_ID nor SAMPLE_LOC"):
        read_chart(chart, [nameless], out, created=DAY)


def test_colours_in_another_order_are_warned_about(made: tuple[Path, ChartReport], tmp_path: Path) -> None:
    _, report = made
    path = instrument(tmp_path / "m.txt", report, sample_ids=[str(k + 1) for k in range(150)])
    path.write_text(without(path.read_text(), "CMYK_C", "CMYK_M", "CMYK_Y", "CMYK_K", "SAMPLE_LOC"))
    read = read_chart(Path(report.list_file), [path], tmp_path / "x.ti3", created=DAY)
    assert any("repeats of a recipe differ" in warning for warning in read.warnings)
    assert any("doesn't make it darker" in warning for warning in read.warnings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ink_names": ("a", "a")}, "names that differ"),
        ({"ink_names": ("a,b", "c")}, "no commas"),
        ({"ink_limit_percent": 900.0}, "total limit of 900"),
        ({"patch_mm": 90.0}, "holds no patch"),
    ],
)
def test_settings_that_make_no_chart(tmp_path: Path, change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_chart(tmp_path / "x", ChartSettings(**{**SETTINGS.__dict__, **change}), created=DAY)
    assert not list(tmp_path.iterdir())


def test_on_the_command_line(tmp_path: Path) -> None:
    stem = tmp_path / "six"
    run = CliRunner()
    options = ["--inks", "6", "--patches", "60", "--tile-mm", "120,100", "--dpi", "100", "--bits", "16"]
    result = run.invoke(app, ["chart", "-o", str(stem), *options, "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["tiles"] == 1
    assert tifffile.imread(report["files"][0]).dtype == np.uint16
    chart = read_chart_list(report["list_file"])
    rows = [f"{sample} {90 - 0.1 * k} 0 0" for k, sample in enumerate(chart.sample_ids)]
    measured = tmp_path / "m.txt"
    measured.write_text(
        "BEGIN_DATA_FORMAT\nSAMPLE_ID LAB_L LAB_A LAB_B\nEND_DATA_FORMAT\nBEGIN_DATA\n"
        + "\n".join(rows)
        + "\nEND_DATA\n"
    )
    result = run.invoke(app, ["read", report["list_file"], str(measured), "-o", str(tmp_path / "out.ti3")])
    assert result.exit_code == 0, result.output
    assert "60" in result.stdout
    assert read_measurements(tmp_path / "out.ti3").ink_frac.shape == (60, 6)
    for wrong in (["--tile-mm", "3"], ["--ink-names", "a,b", "--inks", "3"], ["--ink-limit", "9"], ["--bits", "12"]):
        assert run.invoke(app, ["chart", "-o", str(stem), *wrong]).exit_code == 2
