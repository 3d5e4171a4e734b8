"""The corner marks: what is drawn is read, turned or not, and nothing else is."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tilefab.chart.lettering import letter_dots, row_name
from tilefab.chart.marks import Mark, draw_mark, read_mark


@pytest.mark.parametrize("turns", range(4))
def test_every_mark_is_read_back(turns: int) -> None:
    for corner, tile, chart in itertools.product(range(4), (0, 1, 77, 127), (0, 9, 15)):
        mark = Mark(corner, tile, chart)
        assert read_mark(np.rot90(draw_mark(mark), -turns)) == (mark, turns)


def test_up_to_three_wrong_modules_are_found_out() -> None:
    drawn = draw_mark(Mark(2, 5, 3))
    for cells in itertools.chain.from_iterable(itertools.combinations(range(25), count) for count in (1, 2, 3)):
        spoiled = drawn.copy()
        for cell in cells:
            spoiled[1 + cell // 5, 1 + cell % 5] ^= True
        said = read_mark(spoiled)
        assert said is None or said[1] != 0


def test_patches_and_noise_are_no_marks() -> None:
    assert read_mark(np.ones((7, 7), dtype=bool)) is None
    assert read_mark(np.zeros((7, 7), dtype=bool)) is None
    random = np.random.default_rng(2)
    found = 0
    for _ in range(3000):
        modules = np.ones((7, 7), dtype=bool)
        modules[1:-1, 1:-1] = random.random((5, 5)) < 0.5
        found += read_mark(modules) is not None
    assert found < 12


def test_a_mirrored_mark_is_none() -> None:
    for corner in range(4):
        assert read_mark(draw_mark(Mark(corner, 0, 1))[:, ::-1]) is None


@pytest.mark.parametrize("mark", [Mark(4, 0, 0), Mark(0, 128, 0), Mark(0, 0, 16), Mark(-1, 0, 0)])
def test_numbers_out_of_range(mark: Mark) -> None:
    with pytest.raises(ValueError):
        draw_mark(mark)


def test_letters() -> None:
    assert letter_dots("TILE 1/2 CHART Z").shape == (5, 63)
    shapes = {letter_dots(letter).tobytes() for letter in "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789/-"}
    assert len(shapes) == 38
    with pytest.raises(ValueError):
        letter_dots("é")
    assert [row_name(row) for row in (0, 25, 26, 701, 702)] == ["A", "Z", "AA", "ZZ", "AAA"]
