"""Texture sequences: what a method makes of its own output, again and again, and how the quality panel falls.

The stress test of Kaspar et al. 2015, "Self tuning texture optimization", section 5: each texture becomes the exemplar
of the next, of the same size. What a method loses a little of every time (large structures, rare colours, sharpness)
is lost for all to see after eight rounds. Measures are against the first exemplar.

Draws the panel against the round for each method side by side, and a strip of the images under it.

Usage: python benchmarks/texture_sequences.py [--methods NAME ...] [--stones NAME ...] [--rounds N] [--seed N] [--fast]
                                              [--out FOLDER] [--study FOLDER [--only TEXTURE ...]]

Stones are those of `stones.py`, which may be shown, into docs/images/synthesis; --study takes textures of the study
instead, which may not: then say --out as well.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from contact_sheets import jpeg, sheet
from machine import machine_name
from numpy.typing import NDArray
from reportlab.lib.colors import Color
from stones import DRAWN, PHOTOGRAPHS, stone, study_exemplar

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.report.charts import Axes, draw_grid
from tilefab.report.picture_canvas import PictureCanvas
from tilefab.report.profile_charts import draw_curves, draw_line_legend
from tilefab.report.style import SUBHEADING, draw_text
from tilefab.synthesis import METHODS, SynthesisRequest
from tilefab.synthesis.protocol import render
from tilefab.texture.panel import Panel, measure_panel
from tilefab.texture.repetition import usage
from tilefab.types import SizePx

Rgb = NDArray[np.uint8]

DEFAULT_OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "synthesis"
ROUNDS = 8
MEASURES = (
    ("Portilla-Simoncelli", "portilla_simoncelli"),
    ("power spectrum", "radial_psd"),
    ("bidirectional, CIE76", "bidirectional_de76"),
    ("gradients", "gradient"),
    ("sharpness, over the exemplar's", "sharpness_ratio"),
    ("share of the first exemplar left", "left"),
)
COLOURS = (
    Color(0.1, 0.25, 0.6),
    Color(0.8, 0.35, 0.1),
    Color(0.1, 0.5, 0.3),
    Color(0.55, 0.2, 0.55),
    Color(0.3, 0.3, 0.3),
)
DPI = 110
WIDTH, CHART_HEIGHT, MARGIN = 560.0, 120.0, 14.0
STRIP_ROUNDS = (1, 2, 4, 8)


@dataclass(frozen=True)
class Round:
    """One texture of a sequence.

    Attributes
    ----------
    image
        (rows, cols, 3) sRGB.
    panel
        Against the first exemplar.
    left
        Share of the first exemplar's pixels that are still there.
    """

    image: Rgb
    panel: Panel
    left: float


def main() -> None:
    """Grow, measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", choices=sorted(METHODS), default=sorted(METHODS), metavar="NAME")
    parser.add_argument("--stones", nargs="+", choices=[*PHOTOGRAPHS, *DRAWN], default=["marble", "gravel"])
    parser.add_argument("--rounds", default=ROUNDS, type=int)
    parser.add_argument("--seed", default=1, type=int)
    parser.add_argument("--fast", action="store_true", help="the methods' faster ways")
    parser.add_argument("--out", default=DEFAULT_OUT, type=Path)
    parser.add_argument("--study", type=Path, metavar="FOLDER", help="folder of the study's textures")
    parser.add_argument("--only", nargs="+", metavar="TEXTURE", help="only these of the study")
    arguments = parser.parse_args()
    if arguments.study is None:
        exemplars = {name: stone(name) for name in arguments.stones}
    else:
        folders = sorted(path.parent for path in arguments.study.glob("*/exemplar.png"))
        exemplars = {
            folder.name: study_exemplar(folder)
            for folder in folders
            if not arguments.only or folder.name in arguments.only
        }
    print(f"texture sequences on {machine_name()}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, exemplar in exemplars.items():
        print(f"\n{name:14}{'round':>7}" + "".join(f"{label[:14]:>16}" for label, _ in MEASURES) + "  gates failed")
        sequences = {method: sequence(exemplar, method, arguments) for method in arguments.methods}
        png = chart(name, sequences)
        (arguments.out / f"sequence_{name}.png").write_bytes(png)
        pictures = strip(exemplar, sequences)
        (arguments.out / f"sequence_{name}.jpg").write_bytes(pictures)
        print(f"sequence_{name}.png: {len(png) / 1e3:.0f} kB, sequence_{name}.jpg: {len(pictures) / 1e3:.0f} kB")


def sequence(exemplar: Rgb, method: str, arguments: argparse.Namespace) -> list[Round]:
    """Feed what is grown back as the exemplar, and measure every time."""
    first = lab_of(exemplar)
    # Where in the first exemplar each pixel of the current one came from.
    origin = np.arange(exemplar.shape[0] * exemplar.shape[1], dtype=np.int32).reshape(exemplar.shape[:2])
    rounds = []
    for number in range(1, arguments.rounds + 1):
        current = render(first, origin)
        begin = time.perf_counter()
        request = SynthesisRequest(
            np.ascontiguousarray(current, dtype=np.float32),
            np.ones(origin.shape, dtype=bool),
            SizePx(*origin.shape),
            arguments.seed + number - 1,
            toroidal=False,
            fast=arguments.fast,
        )
        origin = render(origin, METHODS[method](request).source)
        seconds = time.perf_counter() - begin
        panel = measure_panel(first, render(first, origin))
        rounds.append(Round(render(exemplar, origin), panel, usage(origin, exemplar.shape[:2]).coverage))
        numbers = "".join(f"{value(rounds[-1], attribute):16.3f}" for _, attribute in MEASURES)
        print(f"{method:14}{number:7}{numbers}  {', '.join(panel.failed_gates) or '-'}  ({seconds:.1f} s)", flush=True)
    return rounds


def lab_of(rgb: Rgb) -> NDArray[np.float64]:
    """CIELAB of sRGB."""
    return np.asarray(lab_from_xyz(scan_to_xyz(rgb, None)), dtype=np.float64)


def value(of_round: Round, attribute: str) -> float:
    """A number of a round by its name."""
    return float(of_round.left if attribute == "left" else getattr(of_round.panel, attribute))


def chart(name: str, sequences: dict[str, list[Round]]) -> bytes:
    """The panel against the round, a chart for each measure and a curve for each method, as PNG."""
    lines = math.ceil(len(MEASURES) / 2)
    height = lines * (CHART_HEIGHT + 34) + 44
    canvas = PictureCanvas(WIDTH, height, DPI)
    draw_text(canvas, f"{name}: each texture is the exemplar of the next", MARGIN, height - 6, WIDTH, SUBHEADING)
    colours = [COLOURS[k % len(COLOURS)] for k in range(len(sequences))]
    draw_line_legend(canvas, list(sequences), colours, MARGIN, height - 22, WIDTH - 2 * MARGIN)
    width = WIDTH / 2 - 3 * MARGIN - 20
    for place, (label, attribute) in enumerate(MEASURES):
        curves = [np.array([value(one, attribute) for one in rounds]) for rounds in sequences.values()]
        highest = 1.08 * max(float(curve.max()) for curve in curves)
        axes = Axes(
            x=MARGIN + 34 + (place % 2) * WIDTH / 2,
            bottom=height - 52 - (place // 2) * (CHART_HEIGHT + 34) - CHART_HEIGHT,
            width=width,
            height=CHART_HEIGHT,
            x_low=1.0,
            x_high=max(2.0, float(len(curves[0]))),
            y_low=0.0,
            y_high=max(highest, 0.01),
        )
        draw_grid(canvas, axes, "round", label, x_most=8)
        draw_curves(canvas, axes, np.arange(1.0, len(curves[0]) + 1), curves, colours)
    return canvas.png()


def strip(exemplar: Rgb, sequences: dict[str, list[Round]]) -> bytes:
    """The exemplar and some rounds of each method, a line a method, as JPEG."""
    last = max(map(len, sequences.values()))
    shown = [number for number in STRIP_ROUNDS if number <= last]
    cells: list[tuple[str, Rgb]] = []
    for method, rounds in sequences.items():
        cells.append(("exemplar", exemplar))
        cells += [(f"{method}, round {number}", rounds[number - 1].image) for number in shown]
    return jpeg(sheet(cells, 1 + len(shown)))


if __name__ == "__main__":
    main()
