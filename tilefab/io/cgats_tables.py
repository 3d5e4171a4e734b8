"""The structure of CGATS text: keywords, column names and rows of words, before anyone asks what they mean.

Work and memory are bounded by the text's length: words are cut by one regular expression that never goes back, and
texts of more words than any chart has are refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.errors import ProfileError
from tilefab.io.cgats_columns import ink_columns

MAX_BYTES = 64 * 1024 * 1024
_MAX_LINE = 1 << 20
_MAX_WORDS = 4_000_000
_MAX_NUMBER = 64
_SHOWN = 40
_SHOWN_COLUMNS = 300

_LINE = re.compile(r"\r\n|\r|\n")
# A word (quoted parts belong to it), a comment, or a quotation mark that is never closed.
_WORD = re.compile(r'(?:[^\s"#]+|"[^"]*")+|#.*|"')


@dataclass
class Table:
    """One table of a file.

    Attributes
    ----------
    keywords
        What stands before the table, by upper-case keyword; tables after the first have only their own.
    columns
        Column names in upper case.
    spelled
        The same names as the file spells them.
    format_line
        Line of BEGIN_DATA_FORMAT.
    sets
        What NUMBER_OF_SETS says, if it says anything.
    rows
        Line number and words of each row.
    """

    keywords: dict[str, str] = field(default_factory=dict)
    columns: list[str] = field(default_factory=list)
    spelled: list[str] = field(default_factory=list)
    format_line: int = 0
    sets: int | None = None
    rows: list[tuple[int, list[str]]] = field(default_factory=list)

    def column(self, *names: str) -> list[str] | None:
        """Words of the first of these columns that the table has."""
        for name in names:
            if name in self.columns:
                place = self.columns.index(name)
                return [words[place] for _, words in self.rows if place < len(words)]
        return None


def shown(text: str, most: int = _SHOWN) -> str:
    """Text of a file as a message may quote it: not too long."""
    return text if len(text) <= most else f"{text[:most]}…"


def _lines(text: str) -> Iterator[str]:
    start = 0
    for end in _LINE.finditer(text):
        yield text[start : end.start()]
        start = end.end()
    yield text[start:]


def _words(line: str, number: int, name: str) -> list[str]:
    """Words of a line: quoted text is one word, a hash outside quotes begins a comment."""
    if len(line) > _MAX_LINE:
        raise ProfileError(
            f"{name}:{number}: this line has {len(line)} characters: give a CGATS or .ti3 measurement file", path=name
        )
    if '"' not in line:
        return line.partition("#")[0].split()
    words: list[str] = []
    for match in _WORD.finditer(line):
        word = match.group()
        if word.startswith("#"):
            break
        if word == '"':
            raise ProfileError(
                f"{name}:{number}: a quotation mark is never closed: close it on the same line", path=name
            )
        words.append(word.replace('"', ""))
    return words


def read_tables(text: str, name: str) -> list[Table]:
    """Tables of a CGATS text, in order.

    Parameters
    ----------
    text
        The file's text.
    name
        What to call the file in messages.

    Raises
    ------
    ProfileError
        With the line's number: where a quotation mark or section is not closed, data come before their column names,
        or there is more of it than a chart has.

    References
    ----------
    CGATS.17, "Exchange format for colour and process control data using XML or ASCII text".
    """
    tables: list[Table] = []
    table = Table()
    section, opened, total = "", 0, 0
    for number, line in enumerate(_lines(text), start=1):
        words = _words(line, number, name)
        if not words:
            continue
        total += len(words)
        if total > _MAX_WORDS:
            raise ProfileError(f"{name}:{number}: has more than {_MAX_WORDS} values: split the chart", path=name)
        word = words[0].upper()
        if section == "format":
            if word == "END_DATA_FORMAT":
                section = ""
            else:
                table.spelled += words
                table.columns += [column.upper() for column in words]
        elif section == "data":
            if word == "END_DATA":
                tables.append(table)
                table, section = Table(), ""
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


def check_table(table: Table, name: str) -> None:
    """Refuse a table whose shape contradicts itself.

    Raises
    ------
    ProfileError
        If a column is named twice, there are no rows, a row has too few or too many values, or their number is not
        what NUMBER_OF_SETS says.
    """
    # Case tells light inks from full ones, and nothing else.
    inks = set(ink_columns(table.spelled))
    seen: set[str] = set()
    for spelled, column in zip(table.spelled, table.columns, strict=True):
        known = spelled if spelled in inks else column
        if known in seen:
            raise ProfileError(
                f"{name}:{table.format_line}: column {shown(column)} is named twice: export the file again", path=name
            )
        seen.add(known)
    if not table.rows:
        raise ProfileError(f"{name}:{table.format_line}: the table has no patches", path=name)
    for line, words in table.rows:
        if len(words) != len(table.columns):
            raise ProfileError(
                f"{name}:{line}: this line has {len(words)} values, but {len(table.columns)} columns are "
                "named: put every patch on one line with all its values",
                path=name,
            )
    if table.sets is not None and table.sets != len(table.rows):
        raise ProfileError(
            f"{name}: NUMBER_OF_SETS says {table.sets} patches, but {len(table.rows)} are there: the file is "
            "cut short or was edited; export it again",
            path=name,
        )


def numbers(table: Table, wanted: tuple[str, ...], name: str, *, spelled: bool = False) -> NDArray[np.float64]:
    """Columns of a checked table as numbers, (P, columns) float64, in the order asked for.

    Parameters
    ----------
    table
        Checked by `check_table`.
    wanted
        Columns, all there, in upper case, or with ``spelled`` as the file spells them.
    name
        What to call the file in messages.
    spelled
        Whether case matters.

    Raises
    ------
    ProfileError
        With the line's number, where a word is not a finite number.
    """
    places = [(table.spelled if spelled else table.columns).index(column) for column in wanted]
    out = np.empty((len(table.rows), len(wanted)))
    for row, (line, words) in enumerate(table.rows):
        for place, (column, index) in enumerate(zip(wanted, places, strict=True)):
            word = words[index]
            try:
                value = float(word) if len(word) <= _MAX_NUMBER else float("no number")
            except ValueError as error:
                hint = "; use a point for decimals" if "," in word else ""
                raise ProfileError(
                    f"{name}:{line}: {column} is {shown(word)!r}, which is not a number{hint}", path=name
                ) from error
            if not math.isfinite(value):
                raise ProfileError(
                    f"{name}:{line}: {column} is {word}: measure this patch again or delete its line", path=name
                )
            out[row, place] = value
    return out


def refuse(
    table: Table,
    bad: NDArray[np.bool_],
    values: NDArray[np.float64],
    columns: tuple[str, ...],
    why: str,
    name: str,
) -> None:
    """Refuse a table where any value is marked bad, with the first one's line and column.

    Raises
    ------
    ProfileError
        If any is.
    """
    if bad.any():
        row, place = (int(i) for i in np.argwhere(bad)[0])
        raise ProfileError(f"{name}:{table.rows[row][0]}: {columns[place]} is {values[row, place]:g}, {why}", path=name)


def column_list(table: Table) -> str:
    """Names of a table's columns, as a message may list them."""
    return shown(" ".join(table.columns), _SHOWN_COLUMNS)


def read_text(path: str | Path) -> str:
    """Text of a measurement file.

    Raises
    ------
    ProfileError
        If the file can't be read, is no text, or is above 64 MiB.
    """
    file = Path(path)
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise ProfileError(
            f"{file}: can't be read: {error.strerror}: check the path and its permissions", path=str(file)
        ) from error
    if len(data) > MAX_BYTES or b"\0" in data:
        raise ProfileError(f"{file}: is no measurement text: give a CGATS or .ti3 measurement file", path=str(file))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
