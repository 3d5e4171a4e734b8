"""A characterisation chart, printed and measured on the simulated press.

Run as ``python -m sim.chart -o profiles/demo_ceramic.ti3``. The same seed writes the same bytes.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.press import CeramicPress, measure
from tilefab.rng import generator

PATCHES = 800
MAX_TOTAL_PERCENT = 320.0
SEED = 2026
DESCRIPTOR = "SYNTHETIC ceramic 4-ink chart from tilefab's press simulator, not from a real press"
CREATED = "2026-11-22"

_RAMP_PERCENT = (2, 4, 7, 10, 15, 20, 30, 40, 50, 60, 70, 80, 90, 100)
_GRIDS_PERCENT: tuple[tuple[int, tuple[int, ...]], ...] = (
    (0, (0, 25, 50, 75, 100)),
    (20, (0, 33, 67, 100)),
    (45, (0, 33, 67, 100)),
    (70, (0, 50, 100)),
    (100, (0, 50, 100)),
)
_WHITE_REPEATS = 8
_PRIMES = (2, 3, 5, 7)


def _halton(index: int, base: int) -> float:
    """Radical inverse of an index: J. Halton, Numerische Mathematik 2 (1960)."""
    value, share = 0.0, 1.0 / base
    while index:
        index, digit = divmod(index, base)
        value += digit * share
        share /= base
    return value


def chart_percent() -> NDArray[np.float64]:
    """Recipes of the chart, (800, 4) ink percentages with one decimal, each sum at most 320.

    Ramps of single inks, chromatic grids at five amounts of black, repeated bare tiles for the white, and
    scattered recipes, denser where there is little ink, since eyes are most critical there.
    """
    inks = len(_PRIMES)
    patches: list[tuple[float, ...]] = [(0.0,) * inks] * _WHITE_REPEATS
    for ink in range(inks):
        patches += [tuple(float(p) if i == ink else 0.0 for i in range(inks)) for p in _RAMP_PERCENT]
    for black, levels in _GRIDS_PERCENT:
        for chromatic in itertools.product(levels, repeat=inks - 1):
            recipe = (*map(float, chromatic), float(black))
            if sum(recipe) <= MAX_TOTAL_PERCENT and recipe not in patches:
                patches.append(recipe)
    index = 1
    while len(patches) < PATCHES:
        power = 1.0 if index % 2 else 2.0
        recipe = tuple(round(100.0 * _halton(index, base) ** power, 1) for base in _PRIMES)
        if sum(recipe) <= MAX_TOTAL_PERCENT:
            patches.append(recipe)
        index += 1
    return np.array(patches)


def chart_text() -> str:
    """The chart's measurement file: CGATS text in the layout of ``.ti3`` files."""
    press = CeramicPress()
    percent = chart_percent()
    lab = measure(press, percent / 100.0, generator(SEED, "chart"))
    lines = [
        "CTI3",
        "",
        f'DESCRIPTOR "{DESCRIPTOR}"',
        'ORIGINATOR "tilefab sim.chart"',
        f'CREATED "{CREATED}"',
        'KEYWORD "DEVICE_CLASS"',
        'DEVICE_CLASS "OUTPUT"',
        'KEYWORD "COLOR_REP"',
        'COLOR_REP "CMYK_LAB"',
        'KEYWORD "INK_NAMES"',
        f'INK_NAMES "{",".join(press.ink_set.names)}"',
        "",
        "NUMBER_OF_FIELDS 8",
        "BEGIN_DATA_FORMAT",
        "SAMPLE_ID CMYK_C CMYK_M CMYK_Y CMYK_K LAB_L LAB_A LAB_B",
        "END_DATA_FORMAT",
        "",
        f"NUMBER_OF_SETS {len(percent)}",
        "BEGIN_DATA",
    ]
    for number, (recipe, colour) in enumerate(zip(percent, lab, strict=True), start=1):
        amounts = " ".join(f"{value:.1f}" for value in recipe)
        lines.append(f"{number} {amounts} " + " ".join(f"{value:.2f}" for value in colour))
    lines += ["END_DATA", ""]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Write the chart's measurement file."""
    parser = argparse.ArgumentParser(prog="python -m sim.chart", description=main.__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="measurement file to write (.ti3)")
    options = parser.parse_args(arguments)
    options.output.write_text(chart_text(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
