"""Which columns of a CGATS table are inks, and which are bands of a spectrum."""

from __future__ import annotations

import re

CMYK_COLUMNS = ("CMYK_C", "CMYK_M", "CMYK_Y", "CMYK_K")
LAB_COLUMNS = ("LAB_L", "LAB_A", "LAB_B")
XYZ_COLUMNS = ("XYZ_X", "XYZ_Y", "XYZ_Z")
MOST_INKS = 15

_ONE_INK = ("GRAY_K", "GRAY", "K_K", "K", "1CLR_1")
# Their letters are colours or coordinates of light, not inks.
_NO_INKS = frozenset({"RGB", "LAB", "XYZ", "LCH", "LUV", "XYY", "YXY", "HSV", "HSL", "HSB", "YUV", "LMS"})
_LETTERS = re.compile(r"([A-Za-z]{2,15})_([A-Za-z])")
_BAND = re.compile(r"(SPECTRAL_NM|SPECTRAL_PCT|SPECTRAL_DEC|SPECTRAL|SPEC|NM|R)_?(\d{3,4}(?:\.\d{1,4})?)")

_LETTER_NAMES = {
    "C": "Cyan",
    "M": "Magenta",
    "Y": "Yellow",
    "K": "Black",
    "O": "Orange",
    "R": "Red",
    "G": "Green",
    "B": "Blue",
    "W": "White",
    "c": "Light Cyan",
    "m": "Light Magenta",
    "y": "Light Yellow",
    "k": "Light Black",
}


def ink_columns(spelled: list[str]) -> tuple[str, ...]:
    """Columns of inks, as the file spells them and in channel order; none if there are none.

    Looked for in turn: CMYK_C M Y K; nCLR_1 .. n with the most inks; the columns of a group of letters that stand for
    one ink each, as CMY_C M Y or CMYKOG_C M Y K O G; one column of black alone.

    Examples
    --------
    >>> ink_columns(["LAB_L", "CMYKOG_C", "CMYKOG_M", "CMYKOG_Y", "CMYKOG_K", "CMYKOG_O", "CMYKOG_G"])
    ('CMYKOG_C', 'CMYKOG_M', 'CMYKOG_Y', 'CMYKOG_K', 'CMYKOG_O', 'CMYKOG_G')
    """
    upper = {column.upper(): column for column in reversed(spelled)}
    if all(column in upper for column in CMYK_COLUMNS):
        return tuple(upper[column] for column in CMYK_COLUMNS)
    for inks in range(MOST_INKS, 0, -1):
        for count in {str(inks), f"{inks:X}"}:
            names = tuple(f"{count}CLR_{ink}" for ink in range(1, inks + 1))
            if all(column in upper for column in names):
                return tuple(upper[column] for column in names)
    there = set(spelled)
    groups = {match.group(1) for match in map(_LETTERS.fullmatch, spelled) if match}
    found: tuple[str, ...] = ()
    for group in sorted(groups):
        # Argyll marks subtractive sets that are not the usual ones with a small i, which is no ink.
        letters = group[1:] if group.startswith("i") and len(group) > 2 and group[1:].isupper() else group
        if letters.upper() in _NO_INKS or len(set(letters)) != len(letters):
            continue
        names = tuple(f"{group}_{letter}" for letter in letters)
        if not there.issuperset(names):
            # Some write every name in capitals or in small letters.
            names = tuple(upper.get(name.upper(), "") for name in names)
        if all(names) and len(set(names)) == len(names) and len(names) > len(found):
            found = names
    if found:
        return found
    return next(((upper[column],) for column in _ONE_INK if column in upper), ())


def letter_names(columns: tuple[str, ...]) -> tuple[str, ...]:
    """Names of inks that their columns' letters stand for; ``Ink 1`` and so on where they stand for none."""
    letters = [column.rpartition("_")[2] for column in columns]
    if columns and all(letter in _LETTER_NAMES for letter in letters) and "CLR_" not in columns[0].upper():
        return tuple(_LETTER_NAMES[letter] for letter in letters)
    if len(columns) == 1 and columns[0].upper() in _ONE_INK[:-1]:
        return ("Black",)
    return tuple(f"Ink {ink}" for ink in range(1, len(columns) + 1))


def band_columns(columns: list[str]) -> tuple[tuple[float, str], ...]:
    """Bands of a spectrum, (wavelength in nm, upper-case column), by wavelength; none if there are none.

    Of several spellings in one table (say SPECTRAL_PCT and SPECTRAL_DEC), the one with the most bands is taken.

    Examples
    --------
    >>> band_columns(["SPEC_390", "LAB_L", "SPEC_380"])
    ((380.0, 'SPEC_380'), (390.0, 'SPEC_390'))
    """
    kinds: dict[str, list[tuple[float, str]]] = {}
    for column in columns:
        match = _BAND.fullmatch(column)
        if match:
            kinds.setdefault(match.group(1), []).append((float(match.group(2)), column))
    if not kinds:
        return ()
    most: list[tuple[float, str]] = max(kinds.values(), key=lambda bands: len(bands))
    return tuple(sorted(most))
