"""Measurement files: CGATS and .ti3 text with ink percentages and measured colours.

The reader takes what instruments and profilers write (tabs or blanks, any column order, quoted identifiers,
comments, Windows line ends, a second table after the first) and refuses, with the line's number, what it
can't be sure of.
"""

from __future__ import annotations

import datetime
import math
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import lab_from_xyz
from tilefab.errors import ProfileError

_MAX_BYTES = 64 * 1024 * 1024
_INK_SLACK_PERCENT = 0.5
_CMYK_COLUMNS = ("CMYK_C", "CMYK_M", "CMYK_Y", "CMYK_K")
_LAB_COLUMNS = ("LAB_L", "LAB_A", "LAB_B")
_XYZ_COLUMNS = ("XYZ_X", "XYZ_Y", "XYZ_Z")
_CREATED_FORMATS = ("%Y-%m-%d", "%Y-%m-%dT%H:%M:%S", "%a %b %d %H:%M:%S %Y", "%d %B %Y", "%B %Y", "%B %d, %Y")


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
    """

    ink_frac: NDArray[np.float64] = field(repr=False)
    lab_d50: NDArray[np.float64] = field(repr=False)
    ink_names: tuple[str, ...]
    description: str
    text: str = field(repr=False)
    created: datetime.date | None = None


@dataclass
class _Table:
    """One table of the file while it is read."""

    keywords: dict[str, str] = field(default_factory=dict)
    columns: list[str] = field(default_factory=list)
    format_line: int = 0
    sets: int | None = None
    rows: list[tuple[int, list[str]]] = field(default_factory=list)


def _tokens(line: str, number: int, name: str) -> list[str]:
    """Words of a line: quoted text is one word, a hash outside quotes begins a comment."""
    if '"' not in line:
        return line.partition("#")[0].split()
    lexer = shlex.shlex(line, posix=True)
    lexer.whitespace_split = True
    lexer.quotes = '"'
    lexer.escape = ""
    lexer.commenters = "#"
    try:
        return list(lexer)
    except ValueError as error:
        raise ProfileError(
            f"{name}:{number}: a quotation mark is never closed: close it on the same line", path=name
        ) from error


def _tables(text: str, name: str) -> list[_Table]:
    tables: list[_Table] = []
    table = _Table()
    section, opened = "", 0
    for number, line in enumerate(text.splitlines(), start=1):
        words = _tokens(line, number, name)
        if not words:
            continue
        word = words[0].upper()
        if section == "format":
            if word == "END_DATA_FORMAT":
                section = ""
            else:
                table.columns += [column.upper() for column in words]
        elif section == "data":
            if word == "END_DATA":
                tables.append(table)
                table, section = _Table(), ""
            else:
                table.rows.append((number, words))
        elif word == "BEGIN_DATA_FORMAT":
            section, opened, table.format_line = "format", number, number
        elif word == "BEGIN_DATA":
            if not table.columns:
                raise ProfileError(
                    f"{name}:{number}: data begins before BEGIN_DATA_FORMAT names its columns: export the "
                    "file again with its column names",
                    path=name,
                )
            section, opened = "data", number
        elif word == "NUMBER_OF_SETS":
            try:
                table.sets = int(words[1])
            except (IndexError, ValueError) as error:
                raise ProfileError(f"{name}:{number}: NUMBER_OF_SETS needs a whole number", path=name) from error
        elif word != "KEYWORD" and len(words) > 1:
            table.keywords[word] = " ".join(words[1:])
    if section:
        end = "END_DATA_FORMAT" if section == "format" else "END_DATA"
        raise ProfileError(
            f"{name}:{opened}: the file ends before {end}: it is cut short; copy or export it again",
            path=name,
        )
    return tables


def _ink_columns(columns: list[str]) -> tuple[str, ...]:
    if all(column in columns for column in _CMYK_COLUMNS):
        return _CMYK_COLUMNS
    for inks in range(15, 0, -1):
        names = tuple(f"{inks}CLR_{ink}" for ink in range(1, inks + 1))
        if all(column in columns for column in names):
            return names
    return ()


def _is_measured(columns: list[str]) -> bool:
    return all(c in columns for c in _LAB_COLUMNS) or all(c in columns for c in _XYZ_COLUMNS)


def _choose_table(tables: list[_Table], name: str) -> _Table:
    if not tables:
        raise ProfileError(
            f"{name}: holds no measurement table (no BEGIN_DATA): give a CGATS or .ti3 measurement file",
            path=name,
        )
    for table in tables:
        if _ink_columns(table.columns) and _is_measured(table.columns):
            return table
    first = tables[0]
    if not _ink_columns(first.columns):
        missing = [column for column in _CMYK_COLUMNS if column not in first.columns]
        what = f"ink columns {', '.join(missing)} are missing"
    else:
        what = "colour columns LAB_L LAB_A LAB_B or XYZ_X XYZ_Y XYZ_Z are missing"
    raise ProfileError(
        f"{name}:{first.format_line}: {what} (found: {' '.join(first.columns)}): export the file with ink "
        "percentages and measured Lab or XYZ",
        path=name,
    )


def _numbers(table: _Table, wanted: tuple[str, ...], name: str) -> NDArray[np.float64]:
    places = [table.columns.index(column) for column in wanted]
    out = np.empty((len(table.rows), len(wanted)))
    for row, (line, words) in enumerate(table.rows):
        if len(words) != len(table.columns):
            raise ProfileError(
                f"{name}:{line}: this line has {len(words)} values, but {len(table.columns)} columns are "
                "named: put every patch on one line with all its values",
                path=name,
            )
        for place, (column, index) in enumerate(zip(wanted, places, strict=True)):
            try:
                value = float(words[index])
            except ValueError as error:
                hint = "; use a point for decimals" if "," in words[index] else ""
                raise ProfileError(
                    f"{name}:{line}: {column} is {words[index]!r}, which is not a number{hint}", path=name
                ) from error
            if not math.isfinite(value):
                raise ProfileError(
                    f"{name}:{line}: {column} is {words[index]}: measure this patch again or delete its line",
                    path=name,
                )
            out[row, place] = value
    return out


def _refuse(
    table: _Table,
    bad: NDArray[np.bool_],
    values: NDArray[np.float64],
    columns: tuple[str, ...],
    why: str,
    name: str,
) -> None:
    if bad.any():
        row, place = (int(i) for i in np.argwhere(bad)[0])
        raise ProfileError(f"{name}:{table.rows[row][0]}: {columns[place]} is {values[row, place]:g}, {why}", path=name)


def parse_measurements(text: str, name: str) -> Measurements:
    """Read measurements from the text of a CGATS or .ti3 file.

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
    table = _choose_table(_tables(text, name), name)
    duplicate = next((c for c in table.columns if table.columns.count(c) > 1), None)
    if duplicate:
        raise ProfileError(
            f"{name}:{table.format_line}: column {duplicate} is named twice: export the file again", path=name
        )
    if not table.rows:
        raise ProfileError(f"{name}:{table.format_line}: the table has no patches", path=name)
    ink_columns = _ink_columns(table.columns)
    percent = _numbers(table, ink_columns, name)
    if table.sets is not None and table.sets != len(table.rows):
        raise ProfileError(
            f"{name}: NUMBER_OF_SETS says {table.sets} patches, but {len(table.rows)} are there: the file is "
            "cut short or was edited; export it again",
            path=name,
        )
    outside = (percent < -_INK_SLACK_PERCENT) | (percent > 100.0 + _INK_SLACK_PERCENT)
    _refuse(table, outside, percent, ink_columns, "but ink must be 0 to 100 percent", name)

    if all(column in table.columns for column in _LAB_COLUMNS):
        lab = _numbers(table, _LAB_COLUMNS, name)
        colour_columns: tuple[str, ...] = _LAB_COLUMNS
    else:
        xyz = _numbers(table, _XYZ_COLUMNS, name)
        _refuse(
            table,
            (xyz < -0.5) | (xyz > 130.0),
            xyz,
            _XYZ_COLUMNS,
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
        colour_columns = _XYZ_COLUMNS
    sense = (lab < [-1.0, -170.0, -170.0]) | (lab > [115.0, 170.0, 170.0])
    _refuse(table, sense, lab, colour_columns, "which is no colour that can be measured", name)

    return Measurements(
        ink_frac=np.clip(percent / 100.0, 0.0, 1.0),
        lab_d50=lab,
        ink_names=_ink_names(table, ink_columns, name),
        description=table.keywords.get("DESCRIPTOR", "").strip() or Path(name).stem,
        text=text,
        created=_created(table.keywords.get("CREATED", "")),
    )


def _ink_names(table: _Table, ink_columns: tuple[str, ...], name: str) -> tuple[str, ...]:
    given = table.keywords.get("INK_NAMES")
    if given is None:
        if ink_columns == _CMYK_COLUMNS:
            return ("Cyan", "Magenta", "Yellow", "Black")
        return tuple(f"Ink {ink}" for ink in range(1, len(ink_columns) + 1))
    names = tuple(part.strip() for part in given.split(","))
    if len(names) != len(ink_columns) or not all(names):
        raise ProfileError(
            f"{name}: INK_NAMES names {len(names)} inks, but there are {len(ink_columns)} ink columns: give "
            "one name for each, separated by commas",
            path=name,
        )
    return names


def _created(text: str) -> datetime.date | None:
    stamp = re.sub(r"\s+", " ", text).strip()
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
    file = Path(path)
    try:
        with file.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ProfileError(
            f"{file}: can't be read: {error.strerror}: check the path and its permissions", path=str(file)
        ) from error
    if len(data) > _MAX_BYTES or b"\0" in data:
        raise ProfileError(f"{file}: is no measurement text: give a CGATS or .ti3 measurement file", path=str(file))
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return parse_measurements(text, str(file))
