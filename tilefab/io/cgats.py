"""Measurement files: CGATS and .ti3 text with ink percentages and measured colours.

The reader takes what instruments and profilers write (tabs or blanks, any column order, quoted identifiers,
comments, Windows line ends, a second table after the first; Lab, XYZ or spectra) and refuses, with the line's
number, what it can't be sure of.
"""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import lab_from_xyz
from tilefab.colour.spectra import MUST_REACH_NM, xyz_from_reflectance
from tilefab.errors import ProfileError
from tilefab.io.cgats_columns import (
    CMYK_COLUMNS,
    LAB_COLUMNS,
    XYZ_COLUMNS,
    band_columns,
    ink_columns,
    letter_names,
)
from tilefab.io.cgats_tables import Table, check_table, column_list, numbers, read_tables, read_text, refuse

_INK_SLACK_PERCENT = 0.5
_FEWEST_BANDS = 8
_MOST_REFLECTANCE = 1.6
_PERCENT_ABOVE = 2.5
_CREATED_FORMATS = ("%Y-%m-%d", "%Y-%m-%dT%H:%M:%S", "%a %b %d %H:%M:%S %Y", "%d %B %Y", "%B %Y", "%B %d, %Y")
_CREATED_LENGTH = 100


@dataclass(frozen=True)
class Measurements:
    """Measured patches of a press.

    Attributes
    ----------
    ink_frac
        (P, N) float64 ink fractions, 0 to 1.
    lab_d50
        (P, 3) float64 absolute Lab under D50, 2 degree observer.
    ink_names
        N names, in channel order.
    description
        The file's DESCRIPTOR, or its name.
    text
        The file's whole text, as read.
    created
        The day on which the file says that it was made; None where it says none that can be understood.
    reflectance
        (P, B) float64 reflectance, 1 = perfect reflector; None where none was measured.
    wavelengths_nm
        (B,) float64 centres of its bands, increasing; None where there are none.
    sample_ids
        P names of the patches, as the file has them; empty where it has none.
    """

    ink_frac: NDArray[np.float64] = field(repr=False)
    lab_d50: NDArray[np.float64] = field(repr=False)
    ink_names: tuple[str, ...]
    description: str
    text: str = field(repr=False)
    created: datetime.date | None = None
    reflectance: NDArray[np.float64] | None = field(default=None, repr=False)
    wavelengths_nm: NDArray[np.float64] | None = field(default=None, repr=False)
    sample_ids: tuple[str, ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class Readings:
    """Colours of an instrument's file, which may not know what was printed.

    Attributes
    ----------
    lab_d50
        (P, 3) float64 absolute Lab under D50, 2 degree observer.
    reflectance, wavelengths_nm
        As in `Measurements`.
    ink_frac
        (P, N) float64 ink fractions; None where the file has no ink columns.
    sample_ids, locations
        P names and places of the patches; empty where the file has none.
    """

    lab_d50: NDArray[np.float64] = field(repr=False)
    reflectance: NDArray[np.float64] | None = field(repr=False)
    wavelengths_nm: NDArray[np.float64] | None = field(repr=False)
    ink_frac: NDArray[np.float64] | None = field(repr=False)
    sample_ids: tuple[str, ...] = field(repr=False)
    locations: tuple[str, ...] = field(repr=False)


def _is_measured(columns: list[str]) -> bool:
    return (
        all(c in columns for c in LAB_COLUMNS)
        or all(c in columns for c in XYZ_COLUMNS)
        or len(band_columns(columns)) >= _FEWEST_BANDS
    )


def _choose_table(tables: list[Table], name: str, *, need_inks: bool) -> Table:
    if not tables:
        raise ProfileError(
            f"{name}: holds no measurement table (no BEGIN_DATA): give a CGATS or .ti3 measurement file",
            path=name,
        )
    good = [table for table in tables if _is_measured(table.columns) and (ink_columns(table.spelled) or not need_inks)]
    # Tools put a calibration beside the measurements; but two tables of measurements leave open which one is meant.
    kinds = {tuple(table.columns) for table in good}
    if len(good) > 1 and len(kinds) < len(good):
        raise ProfileError(
            f"{name}:{good[1].format_line}: a second table of measurements begins: keep one table in a file", path=name
        )
    if good:
        return good[0]
    first = tables[0]
    if need_inks and not ink_columns(first.spelled):
        missing = [column for column in CMYK_COLUMNS if column not in first.columns]
        what = f"ink columns {', '.join(missing)} are missing"
    else:
        what = "colour columns LAB_L LAB_A LAB_B or XYZ_X XYZ_Y XYZ_Z, or spectral ones, are missing"
    raise ProfileError(
        f"{name}:{first.format_line}: {what} (found: {column_list(first)}): export the file with ink "
        "percentages and measured Lab or XYZ",
        path=name,
    )


def _ink_frac(table: Table, columns: tuple[str, ...], name: str) -> NDArray[np.float64]:
    percent = numbers(table, columns, name, spelled=True)
    outside = (percent < -_INK_SLACK_PERCENT) | (percent > 100.0 + _INK_SLACK_PERCENT)
    refuse(table, outside, percent, columns, "but ink must be 0 to 100 percent", name)
    return np.clip(percent / 100.0, 0.0, 1.0)


def _reflectance(table: Table, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]] | tuple[None, None]:
    bands = band_columns(table.columns)
    if len(bands) < _FEWEST_BANDS:
        return None, None
    columns = tuple(column for _, column in bands)
    values = numbers(table, columns, name)
    norm = table.keywords.get("SPECTRAL_NORM", "")
    try:
        scale = float(norm[:20])
    except ValueError:
        scale = 100.0 if values.max() > _PERCENT_ABOVE or columns[0].startswith("SPECTRAL_PCT") else 1.0
    if not 0.5 <= scale <= 1000.0:
        raise ProfileError(f"{name}: SPECTRAL_NORM is {scale:g}, but it must be 1 or 100", path=name)
    outside = (values < -0.05 * scale) | (values > _MOST_REFLECTANCE * scale)
    refuse(table, outside, values, columns, f"but reflectance must be 0 to about {scale:g}", name)
    return np.maximum(values / scale, 0.0), np.array([nm for nm, _ in bands])


def _lab(
    table: Table,
    reflectance: NDArray[np.float64] | None,
    wavelengths_nm: NDArray[np.float64] | None,
    name: str,
) -> NDArray[np.float64]:
    if all(column in table.columns for column in LAB_COLUMNS):
        lab = numbers(table, LAB_COLUMNS, name)
        colour_columns: tuple[str, ...] = LAB_COLUMNS
    elif all(column in table.columns for column in XYZ_COLUMNS):
        xyz = numbers(table, XYZ_COLUMNS, name)
        refuse(
            table,
            (xyz < -0.5) | (xyz > 130.0),
            xyz,
            XYZ_COLUMNS,
            "but XYZ must be 0 to about 100 (white = 100)",
            name,
        )
        if xyz.max() < 2.0:
            raise ProfileError(
                f"{name}:{table.format_line}: XYZ never passes {xyz.max():g}, so white is not 100: scale the "
                "columns by 100",
                path=name,
            )
        lab = lab_from_xyz(np.maximum(xyz, 0.0) / 100.0)
        colour_columns = XYZ_COLUMNS
    else:
        assert reflectance is not None
        assert wavelengths_nm is not None
        try:
            lab = lab_from_xyz(xyz_from_reflectance(reflectance, wavelengths_nm))
        except ValueError as error:
            raise ProfileError(
                f"{name}:{table.format_line}: colours can't be made of the spectra: {error}: export "
                f"{MUST_REACH_NM[0]:g} to {MUST_REACH_NM[1]:g} nm or more, in steps of 20 nm or less",
                path=name,
            ) from error
        colour_columns = ("L* of the spectrum", "a* of the spectrum", "b* of the spectrum")
    sense = (lab < [-1.0, -170.0, -170.0]) | (lab > [115.0, 170.0, 170.0])
    refuse(table, sense, lab, colour_columns, "which is no colour that can be measured", name)
    return lab


def parse_measurements(text: str, name: str) -> Measurements:
    """Read measurements from the text of a CGATS or .ti3 file.

    Lab is taken where the file has it, else XYZ, else it is computed from the spectra.

    Parameters
    ----------
    text
        The file's text.
    name
        What to call the file in messages.

    Returns
    -------
    Measurements

    Raises
    ------
    ProfileError
        With the line's number: where columns are missing, a line has too few or too many values, a value is
        not a finite number, ink is outside 0 to 100 %, a colour is no colour, or counts disagree.

    References
    ----------
    CGATS.17, "Exchange format for colour and process control data using XML or ASCII text".
    """
    table = _choose_table(read_tables(text, name), name, need_inks=True)
    check_table(table, name)
    inks = ink_columns(table.spelled)
    ink_frac = _ink_frac(table, inks, name)
    reflectance, wavelengths_nm = _reflectance(table, name)
    lab = _lab(table, reflectance, wavelengths_nm, name)
    return Measurements(
        ink_frac=ink_frac,
        lab_d50=lab,
        ink_names=read_ink_names(table, inks, name),
        description=table.keywords.get("DESCRIPTOR", "").strip() or Path(name).stem,
        text=text,
        created=_created(table.keywords.get("CREATED", "")),
        reflectance=reflectance,
        wavelengths_nm=wavelengths_nm,
        sample_ids=tuple(table.column("SAMPLE_ID", "SAMPLE_NAME") or ()),
    )


def parse_readings(text: str, name: str) -> Readings:
    """Read an instrument's colours; as `parse_measurements`, but the inks may be missing.

    Raises
    ------
    ProfileError
        As `parse_measurements`.
    """
    table = _choose_table(read_tables(text, name), name, need_inks=False)
    check_table(table, name)
    inks = ink_columns(table.spelled)
    reflectance, wavelengths_nm = _reflectance(table, name)
    return Readings(
        lab_d50=_lab(table, reflectance, wavelengths_nm, name),
        reflectance=reflectance,
        wavelengths_nm=wavelengths_nm,
        ink_frac=_ink_frac(table, inks, name) if inks else None,
        sample_ids=tuple(table.column("SAMPLE_ID", "SAMPLEID", "SAMPLE_NAME") or ()),
        locations=tuple(table.column("SAMPLE_LOC", "LOCATION", "SAMPLE_NAME") or ()),
    )


def read_ink_names(table: Table, columns: tuple[str, ...], name: str) -> tuple[str, ...]:
    """Names of the inks: what INK_NAMES says, or what the columns' letters stand for.

    Raises
    ------
    ProfileError
        If INK_NAMES names another number of inks than there are columns.
    """
    given = table.keywords.get("INK_NAMES")
    if given is None:
        return letter_names(columns)
    names = tuple(part.strip() for part in given.split(","))
    if len(names) != len(columns) or not all(names):
        raise ProfileError(
            f"{name}: INK_NAMES names {len(names)} inks, but there are {len(columns)} ink columns: give "
            "one name for each, separated by commas",
            path=name,
        )
    return names


def _created(text: str) -> datetime.date | None:
    stamp = re.sub(r"\s+", " ", text[:_CREATED_LENGTH]).strip()
    for form in _CREATED_FORMATS:
        try:
            return datetime.datetime.strptime(stamp, form).date()
        except ValueError:
            continue
    return None


def read_measurements(path: str | Path) -> Measurements:
    """Read a CGATS or .ti3 measurement file; see `parse_measurements`.

    Raises
    ------
    ProfileError
        If the file can't be read, is no text, is above 64 MiB, or for what `parse_measurements` refuses.
    """
    return parse_measurements(read_text(path), str(path))


def read_readings(path: str | Path) -> Readings:
    """Read an instrument's file; see `parse_readings`.

    Raises
    ------
    ProfileError
        If the file can't be read, is no text, is above 64 MiB, or for what `parse_readings` refuses.
    """
    return parse_readings(read_text(path), str(path))
