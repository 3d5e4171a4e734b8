"""Measurement files of every kind: ink columns, spectra, several tables, written and read back, and mutated ones."""

from __future__ import annotations

import resource
import sys
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from tilefab.colour.spaces import lab_from_xyz
from tilefab.colour.spectra import xyz_from_reflectance
from tilefab.errors import ProfileError
from tilefab.io.cgats import Measurements, parse_measurements, parse_readings
from tilefab.io.cgats_columns import band_columns, ink_columns, letter_names
from tilefab.io.cgats_tables import read_tables
from tilefab.io.cgats_write import measurements_text

NM = np.arange(400, 701, 10)


def table(columns: str, *rows: str, head: str = "") -> str:
    return f"{head}\nBEGIN_DATA_FORMAT\n{columns}\nEND_DATA_FORMAT\nBEGIN_DATA\n" + "\n".join(rows) + "\nEND_DATA\n"


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        ("CMY_C CMY_M CMY_Y", ("Cyan", "Magenta", "Yellow")),
        ("CMY_Y CMY_C CMY_M", ("Cyan", "Magenta", "Yellow")),
        ("iCMY_C iCMY_M iCMY_Y", ("Cyan", "Magenta", "Yellow")),
        ("GRAY_K", ("Black",)),
        ("K", ("Black",)),
        ("1CLR_1", ("Ink 1",)),
        ("2CLR_2 2CLR_1", ("Ink 1", "Ink 2")),
        ("8CLR_1 8CLR_2 8CLR_3 8CLR_4 8CLR_5 8CLR_6 8CLR_7 8CLR_8", tuple(f"Ink {i}" for i in range(1, 9))),
        (
            "CMYKOG_C CMYKOG_M CMYKOG_Y CMYKOG_K CMYKOG_O CMYKOG_G",
            ("Cyan", "Magenta", "Yellow", "Black", "Orange", "Green"),
        ),
        (
            "CMYKcm_C CMYKcm_M CMYKcm_Y CMYKcm_K CMYKcm_c CMYKcm_m",
            ("Cyan", "Magenta", "Yellow", "Black", "Light Cyan", "Light Magenta"),
        ),
        ("CMYKW_C CMYKW_M CMYKW_Y CMYKW_K CMYKW_W", ("Cyan", "Magenta", "Yellow", "Black", "White")),
    ],
)
def test_ink_columns_of_every_spelling(columns: str, names: tuple[str, ...]) -> None:
    words = columns.split()
    values = " ".join(str(10 * k + 5) for k in range(len(words)))
    read = parse_measurements(table(f"LAB_B {columns} LAB_L LAB_A", f"3 {values} 50 2"), "x")
    assert read.ink_names == names
    channel = [ink_columns(words).index(word) for word in words]
    np.testing.assert_allclose(read.ink_frac[0, channel], [0.1 * k + 0.05 for k in range(len(words))])
    np.testing.assert_allclose(read.lab_d50, [[50, 2, 3]])


@pytest.mark.parametrize("columns", ["RGB_R RGB_G RGB_B", "iRGB_R iRGB_G iRGB_B", "LCH_L LCH_C LCH_H", "CMY_C CMY_M"])
def test_columns_that_are_no_inks(columns: str) -> None:
    assert ink_columns(columns.split()) == ()
    values = "1 " * len(columns.split())
    with pytest.raises(ProfileError, match="ink columns CMYK_C, CMYK_M, CMYK_Y, CMYK_K are missing"):
        parse_measurements(table(f"{columns} LAB_L LAB_A LAB_B", f"{values} 50 0 0"), "x")


def test_letters_that_are_known_name_inks() -> None:
    assert letter_names(("CMYKX_C", "CMYKX_X")) == ("Ink 1", "Ink 2")


@pytest.mark.parametrize("prefix", ["SPEC_", "SPECTRAL_NM", "SPECTRAL_NM_", "NM", "nm_", "R_", "SPECTRAL_"])
@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_spectra_become_colours(prefix: str, scale: float) -> None:
    spectra = np.array([np.full(len(NM), 0.9), 0.1 + 0.6 / (1 + np.exp((560 - NM) / 12))])
    turned = [f"{prefix}{nm}" for nm in NM[::-1]]
    rows = [
        f"{ink} 0 0 0 " + " ".join(f"{scale * v:.6f}" for v in row[::-1])
        for ink, row in zip((0, 80), spectra, strict=True)
    ]
    read = parse_measurements(table("CMYK_C CMYK_M CMYK_Y CMYK_K " + " ".join(turned), *rows), "x")
    assert read.reflectance is not None
    assert read.wavelengths_nm is not None
    np.testing.assert_array_equal(read.wavelengths_nm, NM)
    np.testing.assert_allclose(read.reflectance, spectra, atol=1e-6)
    np.testing.assert_allclose(read.lab_d50, lab_from_xyz(xyz_from_reflectance(spectra, NM)), atol=1e-3)


def test_lab_is_taken_before_spectra_and_both_are_kept() -> None:
    columns = "CMYK_C CMYK_M CMYK_Y CMYK_K LAB_L LAB_A LAB_B " + " ".join(f"SPEC_{nm}" for nm in NM)
    read = parse_measurements(table(columns, "0 0 0 0 91 1 2 " + "0.5 " * len(NM)), "x")
    np.testing.assert_allclose(read.lab_d50, [[91, 1, 2]])
    assert read.reflectance is not None
    assert read.reflectance.shape == (1, len(NM))


def test_bands_by_name() -> None:
    assert band_columns(["NM_400.5", "SPECTRAL_NM", "NM_390", "R_X"]) == ((390.0, "NM_390"), (400.5, "NM_400.5"))


@pytest.mark.parametrize(
    ("bands", "value", "head", "message"),
    [
        (range(400, 601, 10), "0.5", "", "colours can't be made of the spectra: bands from 400 to 600"),
        (range(400, 701, 25), "0.5", "", "bands are up to 25 nm apart"),
        (range(400, 701, 10), "-0.4", "", "SPEC_400 is -0.4, but reflectance must be 0"),
        (range(400, 701, 10), "300", "", "SPEC_400 is 300, but reflectance must be 0 to about 100"),
        (range(400, 701, 10), "50", 'SPECTRAL_NORM "1"', "SPEC_400 is 50, but reflectance must be 0 to about 1"),
        (range(400, 701, 10), "50", 'SPECTRAL_NORM "-7"', "SPECTRAL_NORM is -7"),
        (range(400, 701, 50), "0.5", "", "colour columns LAB_L"),
    ],
)
def test_spectra_that_make_no_colour(bands: range, value: str, head: str, message: str) -> None:
    columns = "CMYK_C CMYK_M CMYK_Y CMYK_K " + " ".join(f"SPEC_{nm}" for nm in bands)
    with pytest.raises(ProfileError, match=message):
        parse_measurements(table(columns, "0 0 0 0 " + f"{value} " * len(bands), head=head), "x")


def test_two_tables_of_measurements_leave_open_which_is_meant() -> None:
    one = table("CMYK_C CMYK_M CMYK_Y CMYK_K LAB_L LAB_A LAB_B", "0 0 0 0 90 0 0")
    with pytest.raises(ProfileError, match="a second table of measurements begins"):
        parse_measurements(one + one, "x")


def test_readings_need_no_inks() -> None:
    read = parse_readings(table("SAMPLE_ID SAMPLE_LOC LAB_L LAB_A LAB_B", "a 1-A1 50 0 0", "b 1-A2 60 0 0"), "x")
    assert read.ink_frac is None
    assert read.sample_ids == ("a", "b")
    assert read.locations == ("1-A1", "1-A2")
    with pytest.raises(ProfileError, match="colour columns"):
        parse_readings(table("SAMPLE_ID", "1"), "x")


def written(inks: int = 5, **changes: object) -> str:
    random = np.random.default_rng(inks)
    arguments = {
        "ink_names": tuple(f"Ink {k}" for k in range(inks)),
        "description": 'a "quoted" # name',
        "created": "2026-11-24",
        "reflectance": random.random((7, len(NM))),
        "wavelengths_nm": NM.astype(float),
        "sample_ids": ["1", "A 2", "#3", "4", "5", "six", "7"],
        "locations": list("abcdefg"),
        **changes,
    }
    lab = random.random((7, 3)) * [90, 40, 40] + [5, -20, -20]
    return measurements_text(np.rint(random.random((7, inks)) * 255) / 255, lab, **arguments)


@pytest.mark.parametrize("inks", range(1, 9))
def test_what_is_written_is_read_back(inks: int) -> None:
    read = parse_measurements(written(inks), "x")
    random = np.random.default_rng(inks)
    reflectance = random.random((7, len(NM)))
    lab = random.random((7, 3)) * [90, 40, 40] + [5, -20, -20]
    ink = np.rint(random.random((7, inks)) * 255) / 255
    np.testing.assert_allclose(read.ink_frac, ink, atol=1e-6)
    np.testing.assert_allclose(read.lab_d50, lab, atol=1e-4)
    assert read.reflectance is not None
    np.testing.assert_allclose(read.reflectance, reflectance, atol=1e-5)
    assert read.sample_ids == ("1", "A 2", "#3", "4", "5", "six", "7")
    assert read.description == "a 'quoted' # name"
    assert str(read.created) == "2026-11-24"
    assert len(read.ink_names) == inks


def test_what_can_t_be_written() -> None:
    with pytest.raises(ValueError):
        written(ink_names=("a", "b,c", "d", "e", "f"))
    with pytest.raises(ValueError):
        written(reflectance=None)
    with pytest.raises(ValueError):
        written(wavelengths_nm=np.arange(3.0))


def test_huge_files_are_refused_at_once() -> None:
    with pytest.raises(ProfileError, match="characters"):
        read_tables("A " * 600_000, "x")
    with pytest.raises(ProfileError, match="more than 4000000 values"):
        read_tables("BEGIN_DATA_FORMAT\n" + ("a b c d e f g h i j\n" * 10) * 41_000, "x")
    with pytest.raises(ProfileError, match="quotation mark is never closed"):
        read_tables('"" ' * 200_000 + '"', "x")
    with pytest.raises(ProfileError, match="is not a number"):
        parse_measurements(table("CMYK_C CMYK_M CMYK_Y CMYK_K LAB_L LAB_A LAB_B", "0 0 0 0 1 1 " + "1" * 900_000), "x")
    with pytest.raises(ProfileError, match="NUMBER_OF_SETS"):
        parse_measurements("NUMBER_OF_SETS " + "9" * 100_000 + "\n", "x")


def mutate(text: str, random: np.random.Generator) -> str:
    """The text with a few things done to it that happen to files, or that nobody would do."""
    for _ in range(int(random.integers(1, 5))):
        lines = text.split("\n")
        place = int(random.integers(len(lines)))
        at = int(random.integers(len(text) + 1))
        kind = int(random.integers(10))
        if kind == 0:
            text = text[:at]
        elif kind == 1:
            text = text[:at] + chr(int(random.integers(1, 0x2FF))) + text[at + 1 :]
        elif kind == 2:
            del lines[place]
            text = "\n".join(lines)
        elif kind == 3:
            text = "\n".join([*lines[:place], lines[place], *lines[place:]])
        elif kind == 4:
            words = lines[place].split()
            if words:
                odd = ("nan", "inf", "-1e308", "1e999", "", '"', "0x10", "1_0", "1,5", "BEGIN_DATA", "LAB_L", "9" * 400)
                words[int(random.integers(len(words)))] = odd[int(random.integers(len(odd)))]
            text = "\n".join([*lines[:place], " ".join(words), *lines[place + 1 :]])
        elif kind == 5:
            text = text[:at] + '"' * int(random.integers(1, 2000)) + text[at:]
        elif kind == 6:
            other = int(random.integers(len(lines)))
            lines[place], lines[other] = lines[other], lines[place]
            text = "\n".join(lines)
        elif kind == 7:
            text = text[:at] + text[int(random.integers(len(text) + 1)) :]
        elif kind == 8:
            text = text.replace(" ", "\t" if random.random() < 0.5 else "", int(random.integers(1, 40)))
        else:
            text = text.replace("\n", "\r\n" if random.random() < 0.5 else "\r")
    return text


def is_sound(read: Measurements) -> bool:
    patches, inks = read.ink_frac.shape
    good = patches > 0 and 1 <= inks <= 15 and read.lab_d50.shape == (patches, 3) and len(read.ink_names) == inks
    good &= bool(np.isfinite(read.ink_frac).all() and ((read.ink_frac >= 0) & (read.ink_frac <= 1)).all())
    good &= bool(np.isfinite(read.lab_d50).all() and (np.abs(read.lab_d50) <= 170).all())
    if read.reflectance is not None and read.wavelengths_nm is not None:
        good &= read.reflectance.shape == (patches, len(read.wavelengths_nm))
        good &= bool(np.isfinite(read.reflectance).all() and (np.diff(read.wavelengths_nm) > 0).all())
    return good and len(read.sample_ids) in (0, patches)


def fuzz(count: int, seed: int) -> tuple[int, int]:
    """Read ``count`` mutated files: how many were read and are sound, and how many refused in one line."""
    random = np.random.default_rng(seed)
    texts = [
        written(4),
        written(8, locations=None),
        table("CMYKOG_C CMYKOG_M CMYKOG_Y CMYKOG_K CMYKOG_O CMYKOG_G XYZ_X XYZ_Y XYZ_Z", *["0 1 2 3 4 5 80 82 70"] * 5),
    ]
    accepted = refused = 0
    for _ in range(count):
        text = mutate(texts[int(random.integers(len(texts)))], random)
        try:
            read = parse_measurements(text, "mutated")
        except ProfileError as error:
            refused += "\n" not in error.message and len(error.message) < 1000
        else:
            accepted += is_sound(replace(read, text=""))
        with suppress(ProfileError):
            parse_readings(text, "mutated")
    return accepted, refused


def test_mutated_files_are_refused_or_sound() -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    accepted, refused = fuzz(500, 1)
    assert accepted + refused == 500
    assert min(accepted, refused) > 50
    if sys.platform == "linux":
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000
