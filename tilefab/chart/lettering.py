"""Letters of 3 x 5 dots, for the names of rows, columns and tiles on a chart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GLYPH_ROWS, GLYPH_COLS = 5, 3

_GLYPHS = {
    "0": "75557", "1": "26227", "2": "71747", "3": "71717", "4": "55711", "5": "74717", "6": "74757", "7": "71122",
    "8": "75757", "9": "75717", "A": "25755", "B": "65656", "C": "34443", "D": "65556", "E": "74647", "F": "74644",
    "G": "34553", "H": "55755", "I": "72227", "J": "11152", "K": "55655", "L": "44447", "M": "57755", "N": "65555",
    "O": "25552", "P": "65644", "Q": "25563", "R": "65655", "S": "34216", "T": "72222", "U": "55557", "V": "55552",
    "W": "55775", "X": "55255", "Y": "55222", "Z": "71247", "/": "11244", "-": "00700", " ": "00000",
}  # fmt: skip


def letter_dots(text: str) -> NDArray[np.bool_]:
    """Dots of a line of capitals, digits, blanks, ``/`` and ``-``: (5, 4 x letters - 1), True = ink.

    Raises
    ------
    ValueError
        If there are no letters, or one has no shape.
    """
    if not text or not set(text) <= set(_GLYPHS):
        raise ValueError(f"{text!r} can't be lettered")
    dots = np.zeros((GLYPH_ROWS, (GLYPH_COLS + 1) * len(text)), dtype=bool)
    for place, letter in enumerate(text):
        for row, bits in enumerate(_GLYPHS[letter]):
            for col in range(GLYPH_COLS):
                dots[row, place * (GLYPH_COLS + 1) + col] = int(bits) >> (GLYPH_COLS - 1 - col) & 1
    return dots[:, :-1]


def row_name(row: int) -> str:
    """Name of a row: A to Z, then AA, AB and on.

    Examples
    --------
    >>> row_name(0), row_name(27)
    ('A', 'AB')
    """
    name = ""
    row += 1
    while row:
        row, letter = divmod(row - 1, 26)
        name = chr(ord("A") + letter) + name
    return name
