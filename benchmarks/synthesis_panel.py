"""The quality panel of every synthesis method on the study's textures, over what a published method reaches on them.

Grows each texture at the study's size, or takes images that are there, measures them against their exemplars, and
divides by the same measures of the image that was published for self-tuning texture optimisation. Gates stand beside
it, and so does what they say of the published image. Textures aren't part of this repository; without them the script
says so and ends.

Usage: python benchmarks/synthesis_panel.py [--methods NAME ...] [--seeds N] [--only TEXTURE ...] [--fast] [--large]
                                            [--save FOLDER] [--jobs N] [--textures FOLDER]
       python benchmarks/synthesis_panel.py --images FOLDER [--only TEXTURE ...] [--jobs N] [--textures FOLDER]

In the second way FOLDER holds TEXTURE_LABEL.png and, where there is one, the source map TEXTURE_LABEL.npy, (rows,
cols) int32; maps that nobody kept are estimated. --save writes such a folder for each method. --large grows 3 x 3
exemplars as well, to count copies.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from machine import machine_name
from numpy.typing import NDArray
from PIL import Image
from quality_panel import DEFAULT_FOLDER, LIKENESS, lab_of

from tilefab.synthesis import METHODS, SynthesisRequest
from tilefab.synthesis.protocol import render
from tilefab.texture.copies import MAX_COPIES_OVER_RATIO, Copies, large_copies
from tilefab.texture.coverage import estimate_source
from tilefab.texture.hard_seams import MAX_HARD_SHARE, hard_seams
from tilefab.texture.lattice_error import LatticeError, lattice_error
from tilefab.texture.panel import Panel, measure_panel
from tilefab.texture.repetition import usage
from tilefab.texture.seam_cost import seam_cost
from tilefab.types import SizePx

PUBLISHED = "method_self_tuning.png"
LEFT_OUT = ("checkerboard",)
"""Textures that don't enter the mean of ratios."""
HEADS = ("PS", "PSD", "bidir", "grad")
TO_REACH = (0.95, 0.95, 0.95, 0.5)
LEAST_COVERAGE = 0.955
MORE_REPETITION = 0.03
MAX_LATTICE_PX = 1.0
LARGE = 3


@dataclass(frozen=True)
class Measured:
    """An image, measured.

    Attributes
    ----------
    texture, method, label
        What it is of, what made it, and its seed or name.
    panel
        Its panel.
    coverage
        Share of the exemplar shown.
    copies
        Large pieces of the exemplar.
    hard_share
        Share of the image near hard seams.
    seam_delta_e
        Mean cost of all seams.
    lattice
        None for textures without a lattice.
    estimated
        Whether the last five come of a map that was found by looking.
    seconds
        Growing took.
    large_copies
        Those of 3 x 3 exemplars, if they were grown.
    """

    texture: str
    method: str
    label: str
    panel: Panel
    coverage: float
    copies: Copies
    hard_share: float
    seam_delta_e: float
    lattice: LatticeError | None
    estimated: bool
    seconds: float | None = None
    large_copies: Copies | None = None


@dataclass(frozen=True)
class Growing:
    """What a process is to grow and measure."""

    folder: Path
    method: str
    seed: int
    fast: bool
    large: bool
    save: Path | None


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, help="measure TEXTURE_LABEL.png of this folder instead of growing")
    parser.add_argument("--methods", nargs="+", choices=sorted(METHODS), default=sorted(METHODS), metavar="NAME")
    parser.add_argument("--seeds", default=3, type=int, help="images of each texture")
    parser.add_argument("--only", nargs="+", metavar="TEXTURE", help="only these textures")
    parser.add_argument("--fast", action="store_true", help="the methods' faster ways")
    parser.add_argument("--large", action="store_true", help="count copies on 3 x 3 exemplars too (first seed)")
    parser.add_argument("--save", type=Path, metavar="FOLDER", help="keep images and maps, in a folder a method")
    parser.add_argument("--jobs", default=1, type=int, help="processes")
    parser.add_argument("--textures", default=DEFAULT_FOLDER, type=Path)
    arguments = parser.parse_args()
    found = sorted(path.parent.name for path in arguments.textures.glob("*/exemplar.png"))
    names = [name for name in found if not arguments.only or name in arguments.only]
    if not names:
        print(f"skipped: no TEXTURE/exemplar.png in {arguments.textures}; --textures names the folder that has them")
        return
    folders = [arguments.textures / name for name in names]
    print(f"panel over that of published self-tuning, on {machine_name()}")
    with ProcessPoolExecutor(arguments.jobs) as pool:
        published = dict(zip(names, pool.map(measure_published, folders), strict=True))
        for row in published.values():
            print(f"{row.texture:13}{'published':12}{line_of(row, row)}", flush=True)
        if arguments.images is not None:
            files = [
                (folder, path) for folder in folders for path in sorted(arguments.images.glob(f"{folder.name}_*.png"))
            ]
            if files:
                show("images", pool.map(measure_file, *zip(*files, strict=True)), published)
            return
        for method in arguments.methods:
            wanted = [
                Growing(
                    folder,
                    method,
                    seed,
                    arguments.fast,
                    arguments.large and seed == 1,
                    arguments.save and arguments.save / method,
                )
                for folder in folders
                for seed in range(1, arguments.seeds + 1)
            ]
            show(method, pool.map(grow, wanted), published)


def measure_published(folder: Path) -> Measured:
    """The published image of a texture."""
    return measured(folder, "published", "", lab_of(folder / PUBLISHED), None)


def measure_file(folder: Path, path: Path) -> Measured:
    """An image of a texture, and the map beside it."""
    on_map = path.with_suffix(".npy")
    source = np.load(on_map) if on_map.is_file() else None
    return measured(folder, "images", path.stem.removeprefix(f"{folder.name}_"), lab_of(path), source)


def grow(wanted: Growing) -> Measured:
    """Grow a texture at the study's size and measure it."""
    with Image.open(wanted.folder / PUBLISHED) as image:
        size = SizePx(image.height, image.width)
    with Image.open(wanted.folder / "exemplar.png") as image:
        colours = np.asarray(image.convert("RGB"))
    lab = lab_of(wanted.folder / "exemplar.png")
    begin = time.perf_counter()
    source = grown(lab, size, wanted)
    seconds = time.perf_counter() - begin
    if wanted.save is not None:
        wanted.save.mkdir(parents=True, exist_ok=True)
        stem = f"{wanted.folder.name}_{wanted.seed}"
        np.save(wanted.save / f"{stem}.npy", source)
        Image.fromarray(render(colours, source)).save(wanted.save / f"{stem}.png")
    many = None
    if wanted.large:
        shape = (lab.shape[0], lab.shape[1])
        many = large_copies(grown(lab, SizePx(LARGE * shape[0], LARGE * shape[1]), wanted), shape)
    image_lab = render(lab, source)
    return measured(wanted.folder, wanted.method, str(wanted.seed), image_lab, source, seconds, many)


def grown(lab: NDArray[np.float64], size: SizePx, wanted: Growing) -> NDArray[np.int32]:
    """The map of a texture that needn't repeat."""
    exemplar = np.ascontiguousarray(lab, dtype=np.float32)
    valid = np.ones(exemplar.shape[:2], dtype=bool)
    request = SynthesisRequest(exemplar, valid, size, wanted.seed, toroidal=False, fast=wanted.fast)
    return METHODS[wanted.method](request).source


def measured(
    folder: Path,
    method: str,
    label: str,
    image_lab: NDArray[np.float64],
    source: NDArray[np.int32] | None,
    seconds: float | None = None,
    large: Copies | None = None,
) -> Measured:
    """Everything that is told of an image."""
    exemplar_lab = lab_of(folder / "exemplar.png")
    shape = (exemplar_lab.shape[0], exemplar_lab.shape[1])
    known = None
    estimated = source is None
    if source is None:
        estimate = estimate_source(exemplar_lab, image_lab)
        source, known = estimate.source, estimate.known
    return Measured(
        texture=folder.name,
        method=method,
        label=label,
        panel=measure_panel(exemplar_lab, image_lab),
        coverage=usage(source, shape).coverage,
        copies=large_copies(source, shape, known=known),
        hard_share=hard_seams(source, exemplar_lab, image_lab, known).share,
        seam_delta_e=seam_cost(source, exemplar_lab).mean_delta_e,
        lattice=lattice_error(exemplar_lab[:, :, 0], image_lab[:, :, 0]),
        estimated=estimated,
        seconds=seconds,
        large_copies=large,
    )


def show(title: str, rows: Iterable[Measured], published: dict[str, Measured]) -> None:
    """Ratios to the published image and what has no counterpart there; then means by texture and over all."""
    print(
        f"\n{title}\n{'':25}"
        + "".join(f"{head:>7}" for head in HEADS)
        + f"{'sharp':>7}{'repeat':>8}{'cover':>7}{'copies':>8}{'3 x 3':>7}{'hard %':>8}{'seam':>6}{'lattice':>9}"
        f"{'s':>7}  gates failed"
    )
    by_texture: dict[str, list[Measured]] = defaultdict(list)
    for row in rows:
        by_texture[row.texture].append(row)
        print(f"{row.texture:13}{row.label:12}{line_of(row, published[row.texture])}", flush=True)
    print("mean over images")
    ratios, covered = {}, []
    for texture, of_texture in by_texture.items():
        ratios[texture] = np.mean([ratio(row, published[texture]) for row in of_texture], axis=0)
        excess = float(np.mean([row.panel.repetition for row in of_texture]))
        coverage = float(np.mean([row.coverage for row in of_texture]))
        if texture not in LEFT_OUT:
            covered.append(coverage)
        print(
            f"{texture:13}{len(of_texture):<12}"
            + "".join(f"{value:7.2f}" for value in ratios[texture])
            + f"{'':7}{excess:8.3f}{coverage:7.3f}"
            f"   repetition at most {published[texture].panel.repetition + MORE_REPETITION:.3f}: "
            f"{said(excess <= published[texture].panel.repetition + MORE_REPETITION)}"
        )
    counted = [value for texture, value in ratios.items() if texture not in LEFT_OUT]
    if not counted:
        return
    means = np.exp(np.log(counted).mean(axis=0))
    print(
        f"{f'geometric mean of {len(counted)}':25}"
        + "".join(f"{value:7.3f}" for value in means)
        + f"   to reach {' / '.join(str(value) for value in TO_REACH)}: "
        + ", ".join(said(mean <= most) for mean, most in zip(means, TO_REACH, strict=True))
    )
    everything = [row for of_texture in by_texture.values() for row in of_texture]
    copies = [found.over_ratio for row in everything for found in (row.copies, row.large_copies) if found is not None]
    lattices = [row.lattice.rms_px for row in everything if row.lattice is not None]
    gates = [
        f"coverage {np.mean(covered):.3f}, at least {LEAST_COVERAGE}: {said(np.mean(covered) >= LEAST_COVERAGE)}",
        f"copies {max(copies):.2f} times their share, at most {MAX_COPIES_OVER_RATIO}: "
        f"{said(max(copies) <= MAX_COPIES_OVER_RATIO)}",
        f"hard seams {100 * max(row.hard_share for row in everything):.2f} % of the worst, at most "
        f"{100 * MAX_HARD_SHARE:g} %: {said(all(row.hard_share <= MAX_HARD_SHARE for row in everything))}",
    ]
    if lattices:
        gates.append(
            f"lattice {max(lattices):.2f} px, at most {MAX_LATTICE_PX:g}: {said(max(lattices) <= MAX_LATTICE_PX)}"
        )
    print("\n".join(gates), flush=True)


def ratio(row: Measured, published: Measured) -> list[float]:
    """The measures of likeness over the published image's: less than 1 is nearer to the exemplar."""
    return [getattr(row.panel, name) / getattr(published.panel, name) for name in LIKENESS]


def line_of(row: Measured, published: Measured) -> str:
    """The numbers of one row of the table."""
    panel = row.panel
    numbers = "".join(f"{value:7.2f}" for value in ratio(row, published))
    numbers += f"{panel.sharpness_ratio:7.2f}{panel.repetition:8.3f}{row.coverage:7.3f}{row.copies.over_ratio:8.2f}"
    numbers += f"{'-':>7}" if row.large_copies is None else f"{row.large_copies.over_ratio:7.2f}"
    numbers += f"{100 * row.hard_share:8.2f}{row.seam_delta_e:6.1f}"
    numbers += f"{'-':>9}" if row.lattice is None else f"{row.lattice.rms_px:9.2f}"
    numbers += f"{'-':>7}" if row.seconds is None else f"{row.seconds:7.1f}"
    failed = list(panel.failed_gates)
    if row.copies.too_many or (row.large_copies is not None and row.large_copies.too_many):
        failed.append("copies")
    if row.hard_share > MAX_HARD_SHARE:
        failed.append("hard seams")
    return numbers + f"  {', '.join(failed) or '-'}{' (map estimated)' if row.estimated else ''}"


def said(good: bool | np.bool_) -> str:
    """How a figure is judged."""
    return "reached" if good else "NOT reached"


if __name__ == "__main__":
    main()
