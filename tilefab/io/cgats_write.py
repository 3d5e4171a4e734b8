"""Writing measurements as CGATS text in the layout of ``.ti3`` files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tilefab.io.cgats_columns import CMYK_COLUMNS


def ink_column_names(inks: int) -> tuple[str, ...]:
    """Columns for a number of inks: CMYK for four, nCLR else.

    Examples
    --------
    >>> ink_column_names(2)
    ('2CLR_1', '2CLR_2')
    """
    return CMYK_COLUMNS if inks == 4 else tuple(f"{inks}CLR_{ink}" for ink in range(1, inks + 1))


def quoted(text: str) -> str:
    """Text between quotation marks, on one line and without such marks inside."""
    return '"' + " ".join(text.replace('"', "'").split()) + '"'


def amount(value: float) -> str:
    """An ink percentage in as few digits as keep it to 0.0001."""
    return f"{value:.4f}".rstrip("0").rstrip(".") or "0"


def cgats_text(kind: str, keywords: Mapping[str, str], columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A CGATS file of one table.

    Parameters
    ----------
    kind
        The file's first word, say ``CTI3``.
    keywords
        Keyword and value; every one is declared before it is used.
    columns, rows
        Column names, and the words of each row.
    """
    lines = [kind, ""]
    for keyword, value in keywords.items():
        lines += [f'KEYWORD "{keyword}"', f"{keyword} {quoted(value)}"]
    lines += ["", f"NUMBER_OF_FIELDS {len(columns)}", "BEGIN_DATA_FORMAT", " ".join(columns), "END_DATA_FORMAT", ""]
    lines += [f"NUMBER_OF_SETS {len(rows)}", "BEGIN_DATA", *(" ".join(row) for row in rows), "END_DATA", ""]
    return "\n".join(lines)


def measurements_text(
    ink_frac: NDArray[np.float64],
    lab_d50: NDArray[np.float64],
    *,
    ink_names: tuple[str, ...],
    description: str,
    created: str,
    reflectance: NDArray[np.float64] | None = None,
    wavelengths_nm: NDArray[np.float64] | None = None,
    sample_ids: Sequence[str] | None = None,
    locations: Sequence[str] | None = None,
    keywords: Mapping[str, str] | None = None,
) -> str:
    """Measurements as the text of a ``.ti3`` file, which `tilefab.io.cgats.parse_measurements` reads back.

    Parameters
    ----------
    ink_frac
        (P, N) ink fractions, 0 to 1.
    lab_d50
        (P, 3) absolute Lab under D50.
    ink_names
        N names without commas.
    description, created
        What was measured, and the day, as ``2026-11-24``.
    reflectance, wavelengths_nm
        (P, B) reflectance, 0 to 1, and (B,) centres of the bands in nm; both or neither.
    sample_ids, locations
        Names and places of the patches; names default to 1, 2, 3.
    keywords
        Further keywords.

    Raises
    ------
    ValueError
        If shapes disagree, an ink's name holds a comma, or a patch has no name.
    """
    patches, inks = ink_frac.shape
    if lab_d50.shape != (patches, 3) or len(ink_names) != inks or any("," in name for name in ink_names):
        raise ValueError("ink_frac, lab_d50 and ink_names must agree, and names have no commas")
    if (reflectance is None) != (wavelengths_nm is None):
        raise ValueError("reflectance and wavelengths_nm go together")
    device = "CMYK" if inks == 4 else f"{inks}CLR"
    head = {
        "DESCRIPTOR": description,
        "ORIGINATOR": "tilefab",
        "CREATED": created,
        "DEVICE_CLASS": "OUTPUT",
        "COLOR_REP": f"{device}_LAB",
        "INK_NAMES": ",".join(ink_names),
        **(keywords or {}),
    }
    columns = ["SAMPLE_ID"]
    if locations is not None:
        columns.append("SAMPLE_LOC")
    columns += [*ink_column_names(inks), "LAB_L", "LAB_A", "LAB_B"]
    if reflectance is not None and wavelengths_nm is not None:
        if reflectance.shape != (patches, len(wavelengths_nm)):
            raise ValueError("reflectance must be (patches, bands)")
        head |= {
            "SPECTRAL_BANDS": str(len(wavelengths_nm)),
            "SPECTRAL_START_NM": f"{wavelengths_nm[0]:g}",
            "SPECTRAL_END_NM": f"{wavelengths_nm[-1]:g}",
            "SPECTRAL_NORM": "1",
        }
        columns += [f"SPEC_{nm:g}" for nm in wavelengths_nm]
    rows = []
    for patch in range(patches):
        row = [str(patch + 1) if sample_ids is None else _word(sample_ids[patch])]
        if locations is not None:
            row.append(_word(locations[patch]))
        row += [amount(100.0 * float(value)) for value in ink_frac[patch]]
        row += [f"{value:.4f}" for value in lab_d50[patch]]
        if reflectance is not None:
            row += [f"{value:.5f}" for value in reflectance[patch]]
        rows.append(row)
    return cgats_text("CTI3", head, columns, rows)


def _word(text: str) -> str:
    if text.upper() in ("END_DATA", ""):
        raise ValueError(f"a patch can't be called {text!r}")
    return quoted(text) if any(mark.isspace() or mark in '"#' for mark in text) else text
