"""The quality panel of published methods on the textures of a study with people, and how often it agrees with them.

The images and mean ranks (59 people, seven images a texture) aren't part of this repository; without them the script
says so and ends.

Usage: python benchmarks/quality_panel.py [--textures FOLDER]
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import astuple, fields
from itertools import combinations
from pathlib import Path

import numpy as np
from machine import machine_name
from numpy.typing import NDArray
from PIL import Image

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.texture.panel import Panel, measure_panel

DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "shared" / "textures"
BEST = ("self_tuning", "Sykora", "resynthesizer", "quilting")
METHODS = ("reference", *BEST, "Ashikhmin", "CNNMRF")
LIKENESS = ("portilla_simoncelli", "radial_psd", "bidirectional_de76", "gradient")
SIGNIFICANT = 0.05


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--textures", default=DEFAULT_FOLDER, type=Path)
    folder = parser.parse_args().textures
    ranks_file = folder / "human_ranks.json"
    if not ranks_file.is_file():
        print(f"skipped: {ranks_file} isn't there; --textures names the folder that holds it")
        return
    study = json.loads(ranks_file.read_text())["textures"]
    names = [field.name for field in fields(Panel)]
    print(f"quality panel on {machine_name()}")
    print(f"{'':13}{'':14}{'rank':>6}" + "".join(f"{name[:13]:>14}" for name in names) + "  gates failed")
    panels: dict[str, dict[str, Panel]] = {}
    images, seconds = 0, 0.0
    for texture in sorted(study):
        exemplar = lab_of(folder / texture / "exemplar.png")
        panels[texture] = {}
        for method in METHODS:
            stem = method if method == "reference" else f"method_{method}"
            image = lab_of(folder / texture / f"{stem}.png")
            begin = time.perf_counter()
            panel = measure_panel(exemplar, image)
            seconds += time.perf_counter() - begin
            images += 1
            panels[texture][method] = panel
            numbers = "".join(f"{value:14.3f}" for value in astuple(panel))
            rank = study[texture]["mean_rank"][method]
            print(f"{texture:13}{method:14}{rank:6.2f}{numbers}  {', '.join(panel.failed_gates) or '-'}")
    print(f"{seconds / images:.2f} s an image\n")
    print("pairs of images ordered as people order them (and of those in which people differ at p < .05)")
    compared = {"best four methods": BEST, "and the reference": ("reference", *BEST), "all six methods": METHODS[1:]}
    for measure in (*LIKENESS, "portilla_simoncelli x radial_psd"):
        print(f"  {measure:34}", end="")
        for label, methods in compared.items():
            every, clear = agreement(panels, study, measure.split(" x "), methods)
            print(f"{label} {every} ({clear})   ", end="")
        print()


def lab_of(path: Path) -> NDArray[np.float64]:
    """CIELAB of an image file taken as sRGB, whatever its mode."""
    with Image.open(path) as image:
        return lab_from_xyz(scan_to_xyz(np.asarray(image.convert("RGB")), None))


def agreement(
    panels: dict[str, dict[str, Panel]], study: dict[str, dict], measures: list[str], methods: tuple[str, ...]
) -> tuple[str, str]:
    """Share of pairs ordered as by mean rank, less of the product of the measures being better; all, and clear ones."""
    right: list[bool] = []
    clear: list[bool] = []
    for texture, facts in study.items():
        value = {
            method: np.prod([getattr(panels[texture][method], measure) for measure in measures]) for method in methods
        }
        for first, second in combinations(methods, 2):
            pair = facts["pairs"].get(f"{first}|{second}") or facts["pairs"][f"{second}|{first}"]
            as_people = (value[first] < value[second]) == (facts["mean_rank"][first] < facts["mean_rank"][second])
            right.append(as_people)
            if pair["p"] < SIGNIFICANT:
                clear.append(as_people)
    return f"{np.mean(right):.2f} of {len(right)}", f"{np.mean(clear):.2f} of {len(clear)}"


if __name__ == "__main__":
    main()
