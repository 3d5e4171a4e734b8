"""Measurement files: what is read, and what is refused with which line."""

import datetime
import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.errors import ProfileError
from tilefab.io.cgats import parse_measurements, read_measurements

REAL = sorted(Path(os.environ.get("TILEFAB_MEASUREMENTS", "absent")).glob("*.ti3"))

GOOD = """CTI3

DESCRIPTOR "Press 3, # 7"   # a remark
CREATED "2026-11-22"
KEYWORD "INK_NAMES"
INK_NAMES "Blue, Brown, Yellow, Black"
NUMBER_OF_FIELDS 8
BEGIN_DATA_FORMAT
SAMPLE_ID CMYK_C CMYK_M CMYK_Y CMYK_K LAB_L LAB_A LAB_B
END_DATA_FORMAT
NUMBER_OF_SETS 2
BEGIN_DATA
1 0 0 0 0 93.0 -0.1 3.7
"A 2" 100 50.5 0 25 40.0 1.5 -2e1
END_DATA
"""


def test_good_file_is_read() -> None:
    read = parse_measurements(GOOD, "press.ti3")
    np.testing.assert_allclose(read.ink_frac, np.array([[0, 0, 0, 0], [1.0, 0.505, 0.0, 0.25]]))
    np.testing.assert_allclose(read.lab_d50, np.array([[93.0, -0.1, 3.7], [40.0, 1.5, -20.0]]))
    assert read.ink_names == ("Blue", "Brown", "Yellow", "Black")
    assert read.description == "Press 3, # 7"
    assert read.created == datetime.date(2026, 11, 22)
    assert read.text == GOOD


def test_columns_in_any_order_windows_lines_tabs_and_case() -> None:
    text = (
        "CGATS.17\r\nBEGIN_DATA_FORMAT\r\nLab_b\tLab_a\tLab_l\tSAMPLE_NAME\r\nCMYK_K CMYK_Y CMYK_M CMYK_C\r\n"
        'END_DATA_FORMAT\r\nBEGIN_DATA\r\n3\t2\t50\t"dark # 1"\t40\t30\t20\t10\r\nEND_DATA\r\n'
    )
    read = parse_measurements(text, "folder/a.txt")
    np.testing.assert_allclose(read.ink_frac, [[0.1, 0.2, 0.3, 0.4]])
    np.testing.assert_allclose(read.lab_d50, [[50, 2, 3]])
    assert read.ink_names == ("Cyan", "Magenta", "Yellow", "Black")
    assert read.description == "a"
    assert read.created is None


def test_xyz_becomes_lab_and_the_right_table_is_chosen() -> None:
    text = (
        "BEGIN_DATA_FORMAT\nINDEX RGB_R\nEND_DATA_FORMAT\nBEGIN_DATA\n1 2\nEND_DATA\n"
        "BEGIN_DATA_FORMAT\nCMYK_C CMYK_M CMYK_Y CMYK_K XYZ_X XYZ_Y XYZ_Z\nEND_DATA_FORMAT\n"
        "BEGIN_DATA\n0 0 0 0 96.42 100 82.49\n0 0 0 100 1.7355 1.8 1.4848\nEND_DATA\n"
    )
    read = parse_measurements(text, "x")
    np.testing.assert_allclose(read.lab_d50[0], [100, 0, 0], atol=1e-9)
    np.testing.assert_allclose(read.lab_d50[1], [14.39, 0, 0], atol=0.02)


def test_more_inks_are_read() -> None:
    text = (
        "BEGIN_DATA_FORMAT\n5CLR_1 5CLR_2 5CLR_3 5CLR_4 5CLR_5 LAB_L LAB_A LAB_B\nEND_DATA_FORMAT\n"
        "BEGIN_DATA\n0 10 20 30 40 50 0 0\nEND_DATA\n"
    )
    read = parse_measurements(text, "x")
    assert read.ink_frac.shape == (1, 5)
    assert read.ink_names == ("Ink 1", "Ink 2", "Ink 3", "Ink 4", "Ink 5")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("CMYK_K LAB", "LAB", r"press:8: ink columns CMYK_K are missing"),
        ("LAB_B\n", "HUE\n", r"press:8: colour columns LAB_L"),
        ("LAB_A LAB_B\n", "LAB_A LAB_B LAB_A\n", r"press:8: column LAB_A is named twice"),
        ("93.0 -0.1 3.7", "93.0 -0.1", r"press:13: this line has 7 values, but 8"),
        ("93.0 -0.1 3.7", "93,0 -0.1 3.7", r"press:13: LAB_L is '93,0'.*use a point"),
        ("93.0 -0.1 3.7", "nan -0.1 3.7", r"press:13: LAB_L is nan"),
        ("93.0 -0.1 3.7", "93.0 inf 3.7", r"press:13: LAB_A is inf"),
        ("93.0 -0.1 3.7", "193.0 -0.1 3.7", r"press:13: LAB_L is 193, which is no colour"),
        ("100 50.5 0 25", "100 150.5 0 25", r"press:14: CMYK_M is 150.5, but ink must be 0 to 100"),
        ("100 50.5 0 25", "100 -9 0 25", r"press:14: CMYK_M is -9"),
        ("NUMBER_OF_SETS 2", "NUMBER_OF_SETS 3", r"NUMBER_OF_SETS says 3 patches, but 2"),
        ("NUMBER_OF_SETS 2", "NUMBER_OF_SETS two", r"press:11: NUMBER_OF_SETS needs"),
        ("END_DATA\n", "", r"press:12: the file ends before END_DATA"),
        ('"A 2"', '"A 2', r"press:14: a quotation mark is never closed"),
        ("Yellow, Black", "Yellow", r"INK_NAMES names 3 inks, but there are 4"),
        ("BEGIN_DATA_FORMAT\n", "", r"press:11: data begins before BEGIN_DATA_FORMAT"),
    ],
)
def test_bad_files_are_refused_with_their_line(old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(ProfileError, match=message) as caught:
        parse_measurements(GOOD.replace(old, new, 1), "press")
    assert caught.value.path == "press"


def test_xyz_of_another_scale_is_refused() -> None:
    text = (
        "BEGIN_DATA_FORMAT\nCMYK_C CMYK_M CMYK_Y CMYK_K XYZ_X XYZ_Y XYZ_Z\nEND_DATA_FORMAT\n"
        "BEGIN_DATA\n0 0 0 0 0.9 1.0 0.8\nEND_DATA\n"
    )
    with pytest.raises(ProfileError, match="scale the columns by 100"):
        parse_measurements(text, "x")


def test_files_that_are_no_measurements(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="can't be read"):
        read_measurements(tmp_path / "absent.ti3")
    (tmp_path / "picture.ti3").write_bytes(b"II*\0\0\0")
    with pytest.raises(ProfileError, match="is no measurement text"):
        read_measurements(tmp_path / "picture.ti3")
    (tmp_path / "empty.ti3").write_bytes(b"")
    with pytest.raises(ProfileError, match="no measurement table"):
        read_measurements(tmp_path / "empty.ti3")
    (tmp_path / "old.ti3").write_bytes(GOOD.replace("Press 3", "Préss 3").encode("latin-1"))
    assert read_measurements(tmp_path / "old.ti3").description == "Préss 3, # 7"


@given(st.text(alphabet=st.sampled_from(list(GOOD)), max_size=400), st.integers(0, len(GOOD)))
@settings(max_examples=150, deadline=None)
def test_noise_is_read_or_refused_never_worse(noise: str, place: int) -> None:
    with suppress(ProfileError):
        parse_measurements(GOOD[:place] + noise + GOOD[place:], "x")


@pytest.mark.skipif(not REAL, reason="TILEFAB_MEASUREMENTS names no folder with .ti3 files of real presses")
def test_measurements_of_real_presses_are_read() -> None:
    for path in REAL:
        read = read_measurements(path)
        assert len(read.ink_frac) > 500
        assert read.ink_frac.max() == 1.0
        assert read.lab_d50[:, 0].max() > 85.0
