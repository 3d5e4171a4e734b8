"""Prints, fires and measures any chart list on the spectral press.

Run as ``python -m sim.print_chart CHART.cgats -o DATA.ti3 --press ceramic6``. The same arguments write the same
bytes. The reader here is the simulator's own, so that it can't agree with the product's by construction.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.ink_sets import PRESS_NAMES
from sim.inks import WAVELENGTHS_NM, Spectrum, lab_from_reflectance
from sim.instrument import measure, measure_spectra
from sim.kiln import Firing
from sim.spectral_press import SpectralPress
from tilefab.rng import generator

_CMYK = ("CMYK_C", "CMYK_M", "CMYK_Y", "CMYK_K")
_KEPT = ("SAMPLE_ID", "SAMPLE_LOC", "SAMPLE_NAME", "SAMPLEID")
_CREATED = "2026-11-22"


@dataclass(frozen=True)
class ChartList:
    """A chart to print.

    Attributes
    ----------
    columns
        Names of the kept identifying columns and of the ink columns, in this order.
    labels
        The kept identifying values of each patch, as written.
    ink_columns
        Names of the N ink columns, in channel order.
    ink_frac
        (P, N) ink fractions, 0 to 1.
    ink_names
        The chart's INK_NAMES; empty where it has none.
    """

    columns: tuple[str, ...]
    labels: tuple[tuple[str, ...], ...]
    ink_columns: tuple[str, ...]
    ink_frac: NDArray[np.float64]
    ink_names: str


def _section(text: str, name: str) -> list[str]:
    found = re.search(rf"^\s*BEGIN_{name}\s*$(.*?)^\s*END_{name}\s*$", text, re.MULTILINE | re.DOTALL)
    if found is None:
        raise ValueError(f"the chart has no BEGIN_{name} … END_{name}: give a CGATS chart list")
    return [line for line in found[1].splitlines() if line.strip() and not line.lstrip().startswith("#")]


def read_chart(text: str) -> ChartList:
    """The chart in a CGATS text, from columns CMYK_C … or nCLR_1 … in percent.

    Raises
    ------
    ValueError
        If tables or ink columns are missing, a row has another number of values, or an ink isn't 0 to 100.
    """
    columns = [word.upper() for line in _section(text, "DATA_FORMAT") for word in line.split()]
    n_colour = [column for column in columns if re.fullmatch(r"\d+CLR_\d+", column)]
    inks = _CMYK if all(column in columns for column in _CMYK) else tuple(sorted(n_colour, key=_channel))
    if not inks:
        raise ValueError("the chart has no ink columns: name them CMYK_C … CMYK_K or nCLR_1 … nCLR_n")
    rows = [re.findall(r'"[^"]*"|\S+', line) for line in _section(text, "DATA")]
    for number, row in enumerate(rows, start=1):
        if len(row) != len(columns):
            raise ValueError(f"row {number} of the chart has {len(row)} values for {len(columns)} columns")
    kept = [column for column in columns if column in _KEPT]
    percent = np.array([[float(row[columns.index(column)]) for column in inks] for row in rows]).reshape(-1, len(inks))
    if not ((percent >= 0.0) & (percent <= 100.0)).all():
        raise ValueError("the chart's inks must be 0 to 100 percent")
    named = re.search(r'^\s*INK_NAMES\s+"([^"]*)"', text, re.MULTILINE)
    labels = tuple(tuple(row[columns.index(column)] for column in kept) for row in rows)
    return ChartList((*kept, *inks), labels, inks, percent / 100.0, named[1] if named else "")


def _channel(column: str) -> int:
    return int(column.rpartition("_")[2])


def data_text(
    chart: ChartList,
    press: SpectralPress,
    *,
    spectral: bool = False,
    lab_noise: float = 0.3,
    firing: Firing | None = None,
    seed: int = 1,
) -> str:
    """The measurement file of a chart, ``.ti3`` text: inks in percent, absolute Lab D50, spectra in percent.

    With `spectral` the instrument scatters as `measure_spectra` does, scaled so that its Lab scatters roughly as
    `lab_noise` says, and Lab is computed from the scattered spectra.

    Raises
    ------
    ValueError
        If the chart has another number of inks than the press.
    """
    count = len(press.ink_names)
    if len(chart.ink_columns) != count:
        raise ValueError(f"the chart has {len(chart.ink_columns)} inks, but press {press.name} has {count}")
    source = generator(seed, "print chart")
    spectra: Spectrum | None = None
    if spectral:
        scale = lab_noise / 0.3
        spectra = measure_spectra(
            press, chart.ink_frac, source, firing=firing, level_noise=0.008 * scale, reading_noise=0.001 * scale
        )
        lab = lab_from_reflectance(spectra)
    else:
        lab = measure(press, chart.ink_frac, source, firing=firing, lab_noise=lab_noise)

    columns = list(chart.columns)
    if not chart.labels or not chart.labels[0]:
        columns.insert(0, "SAMPLE_ID")
    columns += ["LAB_L", "LAB_A", "LAB_B"]
    representation = "CMYK" if chart.ink_columns == _CMYK else f"{count}CLR"
    lines = [
        "CTI3",
        "",
        f'DESCRIPTOR "SYNTHETIC chart from tilefab\'s press simulator ({press.name}), not from a real press"',
        'ORIGINATOR "tilefab sim.print_chart"',
        f'CREATED "{_CREATED}"',
        'KEYWORD "DEVICE_CLASS"',
        'DEVICE_CLASS "OUTPUT"',
        'KEYWORD "COLOR_REP"',
        f'COLOR_REP "{representation}_LAB"',
        'KEYWORD "INK_NAMES"',
        f'INK_NAMES "{chart.ink_names or ",".join(press.ink_names)}"',
    ]
    if spectra is not None:
        columns += [f"SPEC_{wavelength:.0f}" for wavelength in WAVELENGTHS_NM]
        for keyword, value in (
            ("SPECTRAL_BANDS", f"{WAVELENGTHS_NM.size}"),
            ("SPECTRAL_START_NM", f"{WAVELENGTHS_NM[0]:.6f}"),
            ("SPECTRAL_END_NM", f"{WAVELENGTHS_NM[-1]:.6f}"),
        ):
            lines += [f'KEYWORD "{keyword}"', f'{keyword} "{value}"']
    lines += ["", f"NUMBER_OF_FIELDS {len(columns)}", "BEGIN_DATA_FORMAT", " ".join(columns), "END_DATA_FORMAT", ""]
    lines += [f"NUMBER_OF_SETS {len(lab)}", "BEGIN_DATA"]
    for number, (label, recipe, colour) in enumerate(zip(chart.labels, chart.ink_frac, lab, strict=True)):
        words = list(label) or [str(number + 1)]
        words += [f"{100.0 * value:.4f}" for value in recipe] + [f"{value:.4f}" for value in colour]
        if spectra is not None:
            words += [f"{100.0 * value:.4f}" for value in spectra[number]]
        lines.append(" ".join(words))
    return "\n".join([*lines, "END_DATA", ""])


def main(arguments: list[str] | None = None) -> None:
    """Print a chart list on the simulated press and write what an instrument reads after firing."""
    parser = argparse.ArgumentParser(prog="python -m sim.print_chart", description=main.__doc__)
    parser.add_argument("chart", type=Path, help="chart list to print (CGATS)")
    parser.add_argument("-o", "--output", type=Path, required=True, help="measurement file to write (.ti3)")
    parser.add_argument("--press", choices=PRESS_NAMES, required=True, help="the press")
    parser.add_argument("--spectral", action="store_true", help="write spectra too, 380 to 730 nm by 10 nm")
    parser.add_argument("--noise", type=float, default=0.3, help="scatter of readings, Lab units (default 0.3)")
    parser.add_argument("--peak-offset", type=float, default=0.0, help="peak above the normal one, kelvin")
    parser.add_argument("--soak-offset", type=float, default=0.0, help="time at the peak above normal, minutes")
    parser.add_argument("--moisture-offset", type=float, default=0.0, help="moisture above normal, percent points")
    parser.add_argument("--seed", type=int, default=1, help="seed of the scatter (default 1)")
    options = parser.parse_args(arguments)
    firing = Firing(options.peak_offset, options.soak_offset, options.moisture_offset)
    try:
        text = data_text(
            read_chart(options.chart.read_text(encoding="utf-8")),
            SpectralPress(options.press),
            spectral=options.spectral,
            lab_noise=options.noise,
            firing=firing,
            seed=options.seed,
        )
    except (OSError, ValueError) as error:
        parser.error(str(error))
    options.output.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
