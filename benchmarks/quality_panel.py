"""The quality panel of published methods on the textures of a study with people, and how often it agrees with them.

Each measure alone, products of measures without anything fitted, and combinations fitted to all textures but the one
judged. The images and mean ranks (59 people, seven images a texture) aren't part of this repository; without them the
script says so and ends.

Usage: python benchmarks/quality_panel.py [--textures FOLDER]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from itertools import combinations
from pathlib import Path

import numpy as np
from machine import machine_name
from numpy.typing import NDArray
from PIL import Image

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.texture.copies import large_copies
from tilefab.texture.coverage import estimate_source
from tilefab.texture.hard_seams import hard_seams
from tilefab.texture.lattice_error import lattice_error
from tilefab.texture.panel import Panel, measure_panel
from tilefab.texture.repetition import usage
from tilefab.texture.study import (
    Pair,
    agreement,
    agreement_with_one,
    chosen_left_out_scores,
    fit_weights,
    left_out_scores,
    one_person,
)

DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "shared" / "textures"
BEST = ("self_tuning", "Sykora", "resynthesizer", "quilting")
METHODS = ("reference", *BEST, "Ashikhmin", "CNNMRF")
LIKENESS = ("portilla_simoncelli", "radial_psd", "bidirectional_de76", "gradient")
SIGNIFICANT = 0.05
FLOORS = {"hard_share": 0.0025, "repetition": 0.05, "copies": 1.0, "lattice_px": 1.0}
"""Added before taking logarithms: what makes no difference."""
PRODUCTS = (
    ("portilla_simoncelli", "radial_psd"),
    ("portilla_simoncelli", "radial_psd", "bidirectional_de76"),
    ("portilla_simoncelli", "lattice_px"),
    ("portilla_simoncelli", "radial_psd", "bidirectional_de76", "lattice_px"),
)
FITTED = (
    ("portilla_simoncelli", "radial_psd"),
    ("portilla_simoncelli", "radial_psd", "bidirectional_de76"),
    ("portilla_simoncelli", "radial_psd", "bidirectional_de76", "lattice_px"),
    ("portilla_simoncelli", "radial_psd", "bidirectional_de76", "lattice_px", "hard_share", "repetition"),
)


@dataclass(frozen=True)
class Judged:
    """What is measured of an image.

    Attributes
    ----------
    panel
        Its panel.
    lattice_px
        How far the nodes of its lattice are off, 0 without a lattice.
    hard_share, copies, coverage
        By a map found by looking: share near hard seams, copies over their share, share of the exemplar shown.
    known_share
        Share of the image that the map explains.
    """

    panel: Panel
    lattice_px: float
    hard_share: float
    copies: float
    coverage: float
    known_share: float

    def value(self, measure: str) -> float:
        """A measure by its name."""
        return float(getattr(self.panel if hasattr(self.panel, measure) else self, measure))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--textures", default=DEFAULT_FOLDER, type=Path)
    folder = parser.parse_args().textures
    ranks_file = folder / "human_ranks.json"
    if not ranks_file.is_file():
        print(f"skipped: {ranks_file} isn't there; --textures names the folder that holds it")
        return
    study = json.loads(ranks_file.read_text())["textures"]
    names = [field.name for field in fields(Panel)]
    more = [field.name for field in fields(Judged)][1:]
    print(f"quality panel on {machine_name()}")
    print(f"{'':13}{'':14}{'rank':>6}" + "".join(f"{name[:11]:>12}" for name in [*names, *more]) + "  gates failed")
    judged: dict[tuple[str, str], Judged] = {}
    seconds = 0.0
    for texture in sorted(study):
        exemplar = lab_of(folder / texture / "exemplar.png")
        for method in METHODS:
            stem = method if method == "reference" else f"method_{method}"
            image = lab_of(folder / texture / f"{stem}.png")
            begin = time.perf_counter()
            found = judge(exemplar, image)
            seconds += time.perf_counter() - begin
            judged[texture, method] = found
            numbers = "".join(f"{value:12.3f}" for value in (*astuple(found.panel), *(found.value(m) for m in more)))
            rank = study[texture]["mean_rank"][method]
            failed = ", ".join(found.panel.failed_gates) or "-"
            print(f"{texture:13}{method:14}{rank:6.2f}{numbers}  {failed}", flush=True)
    print(f"{seconds / len(judged):.2f} s an image")
    print_agreement(judged, study)


def judge(exemplar: NDArray[np.float64], image: NDArray[np.float64]) -> Judged:
    """Measure an image of which nothing is known."""
    estimate = estimate_source(exemplar, image)
    shape = (exemplar.shape[0], exemplar.shape[1])
    lattice = lattice_error(exemplar[:, :, 0], image[:, :, 0])
    return Judged(
        panel=measure_panel(exemplar, image),
        lattice_px=0.0 if lattice is None else lattice.rms_px,
        hard_share=hard_seams(estimate.source, exemplar, image, estimate.known).share,
        copies=large_copies(estimate.source, shape, known=estimate.known).over_ratio,
        coverage=usage(estimate.source, shape).coverage,
        known_share=estimate.known_share,
    )


def lab_of(path: Path) -> NDArray[np.float64]:
    """CIELAB of an image file taken as sRGB, whatever its mode."""
    with Image.open(path) as image:
        return lab_from_xyz(scan_to_xyz(np.asarray(image.convert("RGB")), None))


def pairs_of(study: dict[str, dict], methods: Sequence[str], most_p: float = math.inf) -> list[Pair]:
    """Pairs of images of a texture that people differ on at least so clearly."""
    found = []
    for texture, facts in study.items():
        for first, second in combinations(methods, 2):
            straight = facts["pairs"].get(f"{first}|{second}")
            pair = straight or facts["pairs"][f"{second}|{first}"]
            share = pair["frac_first_preferred"]
            if pair["p"] < most_p:
                found.append(Pair(texture, first, second, share if straight else 1 - share))
    return found


def print_agreement(judged: dict[tuple[str, str], Judged], study: dict[str, dict]) -> None:
    """Each measure alone, products, and combinations fitted to other textures."""
    groups = {"best four": BEST, "and the reference": ("reference", *BEST), "all six": METHODS[1:]}
    clear = {label: pairs_of(study, methods, SIGNIFICANT) for label, methods in groups.items()}
    print(f"\npairs ordered as most people do, of those on which people differ at p < {SIGNIFICANT:g}")
    print(f"{'':58}" + "".join(f"{f'{label}, {len(pairs)}':>23}" for label, pairs in clear.items()))
    print(f"{'one person (includes themself: high by 1 %)':58}" + row([one_person(pairs) for pairs in clear.values()]))
    for measure in (*LIKENESS, "repetition", "lattice_px", "hard_share", "copies", "known_share"):
        scores = {image: found.value(measure) for image, found in judged.items()}
        print(f"{measure:58}" + row([agreement(scores, pairs) for pairs in clear.values()]))
    for product in PRODUCTS:
        scores = {image: float(values.sum()) for image, values in logs(judged, product).items()}
        print(f"{' x '.join(map(short, product)):58}" + row([agreement(scores, pairs) for pairs in clear.values()]))
    print("\nfitted to what 59 people say of all pairs of the six methods, one texture left out at a time")
    print(f"{'':58}{'best four, left out':>23}{'of single people':>23}{'fitted to all':>16}  weights fitted to all")
    every = pairs_of(study, METHODS[1:])
    of_best = clear["best four"]
    for measures in FITTED:
        values = logs(judged, measures)
        left_out = left_out_scores(values, every)
        weights = fit_weights(values, every)
        fitted = {image: float(value @ weights) for image, value in values.items()}
        print(
            f"{' + '.join(map(short, measures)):58}"
            + row([agreement(left_out, of_best), agreement_with_one(left_out, of_best)])
            + f"{agreement(fitted, of_best):16.2f}  "
            + " ".join(f"{weight:.2f}" for weight in weights)
        )
    chosen = chosen_left_out_scores([logs(judged, measures) for measures in FITTED], every)
    print(
        f"{'the set chosen anew for each texture left out':58}"
        + row([agreement(chosen, of_best), agreement_with_one(chosen, of_best)])
    )
    error = math.sqrt(0.8 * 0.2 / len(of_best))
    print(f"a standard error of {error:.2f}: among {len(of_best)} pairs, differences of one or two mean nothing")


def logs(judged: dict[tuple[str, str], Judged], measures: Sequence[str]) -> dict[tuple[str, str], NDArray[np.float64]]:
    """Logarithms of measures of each image."""
    return {
        image: np.log([found.value(measure) + FLOORS.get(measure, 1e-3) for measure in measures])
        for image, found in judged.items()
    }


def row(values: Sequence[float]) -> str:
    """Numbers of a line."""
    return "".join(f"{value:23.2f}" for value in values)


def short(measure: str) -> str:
    """A measure's name, shorter."""
    names = {"portilla_simoncelli": "PS", "radial_psd": "PSD", "bidirectional_de76": "bidirectional"}
    return names.get(measure, measure.partition("_")[0])


if __name__ == "__main__":
    main()
