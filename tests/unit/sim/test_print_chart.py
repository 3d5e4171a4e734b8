"""Charts printed on the spectral press, and scans of fired chart tiles."""

from pathlib import Path

import numpy as np
import pytest

from sim.inks import lab_from_reflectance
from sim.print_chart import data_text, main, read_chart
from sim.scanner import scan_of, unique_recipes
from sim.spectral_press import SpectralPress

SIX = """CGATS.17
INK_NAMES "Azul,Marron,Amarillo,Negro,Rosa,Beige"
# a comment
BEGIN_DATA_FORMAT
SAMPLE_ID SAMPLE_LOC 6CLR_2 6CLR_1
6CLR_3 6CLR_4 6CLR_5 6CLR_6
END_DATA_FORMAT
NUMBER_OF_SETS 3
BEGIN_DATA
7 "A 1" 20 10 30 0 0 0
8 A2 0 0 0 0 0 0
9 A3 0 0 0 100 0 0.5
END_DATA
"""
FOUR = "BEGIN_DATA_FORMAT\nCMYK_K CMYK_C CMYK_M CMYK_Y\nEND_DATA_FORMAT\nBEGIN_DATA\n40 10 20 30\n0 0 0 0\nEND_DATA\n"


def _rows(text: str) -> list[list[str]]:
    return [line.split() for line in text.partition("BEGIN_DATA\n")[2].partition("END_DATA\n")[0].splitlines()]


def test_chart_columns_are_read_in_any_order() -> None:
    chart = read_chart(SIX)
    np.testing.assert_allclose(chart.ink_frac[0], [0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    assert chart.labels[0] == ("7", '"A 1"')
    assert chart.ink_names == "Azul,Marron,Amarillo,Negro,Rosa,Beige"
    np.testing.assert_allclose(read_chart(FOUR).ink_frac[0], [0.1, 0.2, 0.3, 0.4])


def test_data_hold_what_was_printed_and_read() -> None:
    press = SpectralPress("ceramic6")
    text = data_text(read_chart(SIX), press, lab_noise=0.0)
    assert 'INK_NAMES "Azul,Marron,Amarillo,Negro,Rosa,Beige"' in text
    assert 'COLOR_REP "6CLR_LAB"' in text
    assert "SAMPLE_ID SAMPLE_LOC 6CLR_1 6CLR_2 6CLR_3 6CLR_4 6CLR_5 6CLR_6 LAB_L LAB_A LAB_B\n" in text
    read = np.array([[float(word) for word in row[-3:]] for row in _rows(text)])
    np.testing.assert_allclose(read, press.lab(read_chart(SIX).ink_frac), atol=1e-4)


def test_four_inks_keep_their_columns_and_get_names() -> None:
    text = data_text(read_chart(FOUR), SpectralPress("offset4"))
    assert 'COLOR_REP "CMYK_LAB"' in text
    assert 'INK_NAMES "Cyan,Magenta,Yellow,Black"' in text
    assert "SAMPLE_ID CMYK_C CMYK_M CMYK_Y CMYK_K LAB_L" in text
    assert [row[0] for row in _rows(text)] == ["1", "2"]


def test_spectral_data_agree_with_their_lab() -> None:
    text = data_text(read_chart(SIX), SpectralPress("ceramic6"), spectral=True)
    assert 'SPECTRAL_BANDS "36"' in text
    assert " SPEC_380 " in text
    assert " SPEC_730\n" in text
    rows = [row[-39:] for row in _rows(text)]
    values = np.array([[float(word) for word in row] for row in rows])
    np.testing.assert_allclose(lab_from_reflectance(values[:, 3:] / 100.0), values[:, :3], atol=2e-3)


def test_command_writes_the_same_bytes_again_and_others_when_hotter(tmp_path: Path) -> None:
    chart = tmp_path / "chart.cgats"
    chart.write_text(SIX, encoding="utf-8")
    written = []
    for name, extra in (("a", []), ("b", []), ("c", ["--seed", "2"]), ("d", ["--peak-offset", "6"])):
        out = tmp_path / f"{name}.ti3"
        main([str(chart), "-o", str(out), "--press", "ceramic6", *extra])
        written.append(out.read_bytes())
    assert written[0] == written[1]
    assert len(set(written)) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("CTI1\n", "no BEGIN_DATA_FORMAT"),
        (FOUR.replace("CMYK_K", "GRAY"), "no ink columns"),
        (FOUR.replace("10 20 30", "10 20"), "row 1 .* 3 values for 4"),
        (FOUR.replace("10 20 30", "10 20 130"), "0 to 100"),
    ],
)
def test_wrong_charts_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_chart(text)


def test_chart_for_another_press_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="4 inks, but press ceramic6 has 6"):
        data_text(read_chart(FOUR), SpectralPress("ceramic6"))
    (tmp_path / "chart.cgats").write_text(FOUR, encoding="utf-8")
    with pytest.raises(SystemExit):
        main([str(tmp_path / "chart.cgats"), "-o", str(tmp_path / "x.ti3"), "--press", "ceramic8"])


@pytest.mark.parametrize("inks", [3, 6, 8])
def test_unique_recipes_give_the_pixels_back(inks: int) -> None:
    pixels = np.random.default_rng(1).integers(0, 3, (20, 30, inks)).astype(np.uint16) * 20000
    recipes, place = unique_recipes(pixels)
    np.testing.assert_array_equal(recipes[place], pixels)
    assert len(np.unique(recipes, axis=0)) == len(recipes)


def _tile() -> np.ndarray:
    pixels = np.zeros((240, 160, 6), dtype=np.uint8)
    pixels[60:120, 40:80, 0] = 255
    pixels[120:180, 80:120, 3] = 255
    return pixels


def test_upright_scan_shows_the_fired_colours() -> None:
    seen = scan_of(_tile(), SpectralPress("ceramic6"), np.random.default_rng(1), unevenness=0.0, noise=0.0)
    assert seen.dtype == np.uint8
    assert seen.shape == (264, 184, 3)
    patch, bare, black, backing = seen[102, 72], seen[200, 40], seen[162, 112], seen[3, 3]
    assert patch[2] > patch[0] + 40
    assert bare.min() > 215
    assert black.max() < 60
    np.testing.assert_array_equal(backing, 179)  # 0.45 in linear light
    # Edges lie where they were printed: half way between patch and bare tile at row 60 + 12, column 40 + 12.
    assert seen[70, 72, 0] > seen[73, 72, 0] + 60
    assert seen[102, 50, 0] > seen[102, 53, 0] + 60


def test_turned_and_reduced_scan_keeps_places() -> None:
    press = SpectralPress("ceramic6")
    seen = scan_of(_tile(), press, np.random.default_rng(2), rotation_deg=3.0, scale=0.5, noise=0.0, unevenness=0.0)
    upright = scan_of(_tile(), press, np.random.default_rng(2), noise=0.0, unevenness=0.0)
    # Turned counter-clockwise, what lies above the middle moves to the left of it.
    angle, offset = np.radians(3.0), np.array([90.0 - 120.0, 60.0 - 80.0]) * 0.5
    turned = np.array(
        [
            np.cos(angle) * offset[0] - np.sin(angle) * offset[1],
            np.sin(angle) * offset[0] + np.cos(angle) * offset[1],
        ]
    )
    row, col = np.floor(np.array(seen.shape[:2]) / 2.0 + turned).astype(int)
    np.testing.assert_allclose(seen[row, col].astype(int), upright[102, 72].astype(int), atol=2)


def test_light_and_noise_come_from_the_generator() -> None:
    press = SpectralPress("ceramic6")
    first = scan_of(_tile(), press, np.random.default_rng(3), unevenness=0.08)
    np.testing.assert_array_equal(first, scan_of(_tile(), press, np.random.default_rng(3), unevenness=0.08))
    assert not np.array_equal(first, scan_of(_tile(), press, np.random.default_rng(4), unevenness=0.08))
    still = scan_of(_tile(), press, np.random.default_rng(3), unevenness=0.0)
    assert 0.2 < still[200:230, 20:140, 1].std() < 3.0


def test_wrong_print_data_are_refused() -> None:
    press = SpectralPress("ceramic6")
    with pytest.raises(ValueError, match="print data"):
        scan_of(np.zeros((4, 4, 4), dtype=np.uint8), press, np.random.default_rng(1))
    with pytest.raises(ValueError, match="scale"):
        scan_of(_tile(), press, np.random.default_rng(1), scale=0.0)
