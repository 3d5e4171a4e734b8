"""Defects: how many of those seeded are found, as what, and how many good tiles are refused.

Usage: python benchmarks/defects.py [--good N] [--each N] [--prints N] [--size MM] [--px-per-mm R] [--stones NAME ...]
                                    [--first N] [--jobs N] [--seed SEED]

Faces of several stones, most of them rougher than any that is sold, are printed with a spectral press, fired with a
drift of up to a mean ΔE of 3 in any direction, photographed in any position (turned, unevenly lit, blurred, noisy),
registered on the face as the press's profile predicts it, and searched. Good tiles have nothing seeded; marked tiles
have a nozzle line of 0.2 mm, a spot of 0.5 mm, a crack of 0.2 x 10 mm, a pinhole, a scratch and a chip; others are
wrong all over. What a defect's contrast is, is measured on the fired tile: mean CIEDE2000 between the tile with it and
without. The figures to reach count defects that can be seen at all: of a contrast of at least LEAST, below. Ends with 1
if a figure is missed.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from defect_stones import Stone, photographed, press, profile, random_firing, stone_of, stones
from figures import Figures
from machine import machine_name

from sim import defects as seeded
from sim.tile_photo import fired_rgb
from tilefab.colour import lab_from_xyz
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, delta_e_2000
from tilefab.inspection.defects import find_defects
from tilefab.inspection.records import Defect, Grade
from tilefab.types import FloatImage

LEAST = 4.0
"""Contrast, CIEDE2000, from which on a defect counts."""
FOUND, REFUSED = 0.99, 0.005
JUDGED = ("nozzle_line", "spot", "crack")
ALL_OVER = ("missing_ink", "misregistration", "double_print", "banding")
Maker = Callable[..., tuple[FloatImage, seeded.SeededDefect]]
STEPS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 8.0, 100.0)
MOST_DRIFT = 3.0
APART_MM = 1.5


@dataclass
class Tally:
    """What came of tiles.

    ``found``: of each kind and step of contrast how many were seeded, found, and rightly classed.
    """

    good: int = 0
    refused: int = 0
    false: Counter[str] = field(default_factory=Counter)
    found: dict[tuple[str, int], list[int]] = field(default_factory=dict)
    taken_for: Counter[tuple[str, str]] = field(default_factory=Counter)
    extra: int = 0
    marked: int = 0
    seconds: float = 0.0

    def add(self, other: Tally) -> None:
        """Count another's tiles, too."""
        self.good += other.good
        self.refused += other.refused
        self.false += other.false
        self.taken_for += other.taken_for
        self.extra += other.extra
        self.marked += other.marked
        self.seconds += other.seconds
        for key, counts in other.found.items():
            self.found[key] = [one + more for one, more in zip(self.found.get(key, [0, 0, 0]), counts, strict=True)]


def contrast(with_it: FloatImage, without: FloatImage, *, most: bool) -> float:
    """Mean CIEDE2000 of two fired tiles, where they differ most, or everywhere."""
    if most:
        apart = np.abs(with_it - without).max(axis=2)
        where = apart > 0.5 * np.quantile(apart[apart > 0.0], 0.9) if apart.any() else apart >= 0.0
        with_it, without = with_it[where], without[where]
    one, other = (lab_from_xyz(image.reshape(-1, 3) @ XYZ_D50_FROM_RGB_LIN.T) for image in (with_it, without))
    return float(delta_e_2000(one, other).mean())


def searched(
    stone: Stone, face: np.ndarray, fired: FloatImage, random: np.random.Generator, px_per_mm: float
) -> tuple[tuple[Defect, ...], float]:
    """What is found on a fired tile, and the CPU seconds that the search took."""
    predicted = stone.predicted_lab().astype(np.float32)[face]
    seen, inside = photographed(fired, predicted, random, px_per_mm)
    inks = (stone.counts / 255.0).astype(np.float32)[face]
    begin = time.process_time()
    found = find_defects(predicted, seen, inside, px_per_mm, inks=inks, press=profile().lab)
    return found, time.process_time() - begin


def good_tile(stone: Stone, number: int, px: int, px_per_mm: float, seed: int) -> Tally:
    """A tile with nothing wrong."""
    random = np.random.default_rng([seed, zlib.crc32(stone.name.encode()), number, 1])
    face = stone.face(number, px)
    fired = stone.fired_rgb(random_firing(random, MOST_DRIFT))[face]
    found, seconds = searched(stone, face, fired, random, px_per_mm)
    wrong = [defect for defect in found if defect.grade is not Grade.FIRST]
    return Tally(1, int(bool(wrong)), Counter(defect.kind.value for defect in wrong), seconds=seconds)


def marked_tile(stone: Stone, number: int, px: int, px_per_mm: float, seed: int) -> Tally:
    """A tile with one defect of each local kind."""
    random = np.random.default_rng([seed, zlib.crc32(stone.name.encode()), number, 2])
    face = stone.face(number, px)
    firing = random_firing(random, MOST_DRIFT)
    fired = stone.fired_rgb(firing)[face]
    marks: list[tuple[seeded.SeededDefect, float]] = []

    # The line first, for it is in the print; only its columns are fired anew.
    data = stone.counts[face]
    out, line = seeded.nozzle_line(data, int(random.integers(data.shape[2])), random, px_per_mm=px_per_mm)
    columns = np.flatnonzero((out != data).any(axis=(0, 2)))
    if columns.size:
        part = slice(columns[0], columns[-1] + 1)
        changed = fired.copy()
        changed[:, part] = fired_rgb(out[:, part], press(), firing)
        marks.append((line, contrast(changed[:, part], fired[:, part], most=False)))
        fired = changed
    lighter, darker = float(random.uniform(1.15, 2.2)), float(random.uniform(0.25, 0.9))
    makers: tuple[Maker, ...] = (
        partial(seeded.spot, factor=darker if random.random() < 0.7 else lighter),
        partial(seeded.crack, factor=float(random.uniform(0.25, 0.9))),
        partial(seeded.pinhole, factor=float(random.uniform(0.15, 0.7))),
        partial(seeded.scratch, factor=float(random.uniform(1.15, 2.2)), length_mm=20.0),
        partial(seeded.chip, corner=bool(random.random() < 0.5), size_mm=float(random.uniform(1.5, 4.0))),
    )
    for make in makers:
        for _ in range(20):
            changed, truth = make(fired, random, px_per_mm=px_per_mm)
            if all(_apart(truth, other) for other, _ in marks):
                marks.append((truth, contrast(changed, fired, most=True)))
                fired = changed
                break
    found, seconds = searched(stone, face, fired, random, px_per_mm)
    tally = Tally(marked=1, seconds=seconds)
    left = list(found)
    for truth, seen in marks:
        hits = [defect for defect in found if _meets(defect, truth)]
        _count(tally, truth.kind, seen, hits)
        left = [defect for defect in left if defect not in hits]
    tally.extra = len(left)
    return tally


def wrong_print(stone: Stone, number: int, px: int, px_per_mm: float, seed: int, kind: str) -> Tally:
    """A tile whose print is wrong all over."""
    random = np.random.default_rng([seed, zlib.crc32(stone.name.encode()), number, 3 + ALL_OVER.index(kind)])
    face = stone.face(number, px)
    firing = random_firing(random, MOST_DRIFT)
    data = stone.counts[face]
    ink = int(random.integers(data.shape[2]))
    if kind == "missing_ink":
        out, truth = seeded.missing_ink(data, ink, px_per_mm=px_per_mm)
    elif kind == "misregistration":
        towards, far = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.2, 0.6)
        shift = (float(far * np.cos(towards)), float(far * np.sin(towards)))
        out, truth = seeded.misregistered(data, ink, shift, px_per_mm=px_per_mm)
    elif kind == "double_print":
        shift = (float(random.uniform(1.2, 5.0)), float(random.uniform(-5.0, 5.0)))
        out, truth = seeded.double_print(data, shift, float(random.uniform(0.1, 0.5)), px_per_mm=px_per_mm)
    else:
        pitch = float(random.uniform(6.0, 16.0))
        depth = float(random.uniform(0.03, 0.25))
        out, truth = seeded.banding(data, depth, random, px_per_mm=px_per_mm, pitch_mm=pitch)
    fired = fired_rgb(out, press(), firing)
    size = contrast(fired, stone.fired_rgb(firing)[face], most=False)
    found, seconds = searched(stone, face, fired, random, px_per_mm)
    tally = Tally(seconds=seconds)
    hits = [defect for defect in found if defect.kind.value == truth.kind] or list(found)
    _count(tally, truth.kind, size, hits)
    return tally


def _apart(one: seeded.SeededDefect, other: seeded.SeededDefect) -> bool:
    return (
        abs(one.x_mm - other.x_mm) > (one.width_mm + other.width_mm) / 2 + APART_MM
        or abs(one.y_mm - other.y_mm) > (one.height_mm + other.height_mm) / 2 + APART_MM
    )


def _meets(defect: Defect, truth: seeded.SeededDefect) -> bool:
    """Whether a find lies on what was seeded: its middle in the box around that, or the other way round."""
    near = APART_MM / 2
    in_truth = (
        abs(defect.x_mm - truth.x_mm) <= truth.width_mm / 2 + near
        and abs(defect.y_mm - truth.y_mm) <= truth.height_mm / 2 + near
    )
    around = (
        abs(defect.x_mm - truth.x_mm) <= defect.width_mm / 2 + near
        and abs(defect.y_mm - truth.y_mm) <= defect.height_mm / 2 + near
    )
    return in_truth or around


def _count(tally: Tally, kind: str, size: float, hits: list[Defect]) -> None:
    step = max(index for index, least in enumerate(STEPS) if size >= least)
    counts = tally.found.setdefault((kind, step), [0, 0, 0])
    counts[0] += 1
    counts[1] += bool(hits)
    counts[2] += any(defect.kind.value == kind for defect in hits)
    if hits and size >= LEAST:
        tally.taken_for[kind, max(hits, key=lambda defect: defect.area_mm2).kind.value] += 1


def of_stone(
    name: str, good: int, each: int, prints: int, first: int, size_mm: float, px_per_mm: float, seed: int
) -> tuple[str, Tally]:
    """All tiles of a stone, from a number on."""
    stone = stone_of(name)
    px = round(size_mm * px_per_mm)
    tally = Tally()
    for number in range(first, first + good):
        tally.add(good_tile(stone, number, px, px_per_mm, seed))
    for number in range(first, first + each):
        tally.add(marked_tile(stone, number, px, px_per_mm, seed))
    for number in range(first, first + prints):
        for kind in ALL_OVER:
            tally.add(wrong_print(stone, number, px, px_per_mm, seed, kind))
    return name, tally


def report(figures: Figures, tallies: dict[str, Tally]) -> None:
    """Print all tables."""
    total = Tally()
    for tally in tallies.values():
        total.add(tally)
    figures.title("Good tiles")
    for name, tally in tallies.items():
        false = ", ".join(f"{count} {kind}" for kind, count in tally.false.most_common())
        figures.note(name, f"{tally.refused} of {tally.good} refused{': ' + false if false else ''}")
    if total.good:
        share = total.refused / total.good
        figures.check(
            "good tiles refused",
            f"{100 * share:.2f} % ({total.refused} of {total.good})",
            share <= REFUSED,
            f"at most {100 * REFUSED:g} %",
        )
    figures.title("Defects found, by their contrast in CIEDE2000: found / seeded")
    labels = [f"{low:g}-{high:g}" for low, high in itertools.pairwise(STEPS[:-1])] + [f"{STEPS[-2]:g}+"]
    print(
        f"{'':<18}"
        + "".join(f"{label:>12}" for label in labels)
        + f"{'from ' + format(LEAST, 'g') + ' on':>16}"
        + "  classed"
    )
    kinds = list(dict.fromkeys(kind for kind, _ in total.found))
    for kind in kinds:
        cells = [total.found.get((kind, step), [0, 0, 0]) for step in range(len(labels))]
        shown = "".join(f"{f'{found}/{count}' if count else '-':>12}" for count, found, _ in cells)
        from_least = [cell for cell, least in zip(cells, STEPS, strict=False) if least >= LEAST]
        count, found, classed = (sum(column) for column in zip(*from_least, strict=True))
        of_them = f"{100 * found / count:.1f} %" if count else "-"
        rightly = f"{100 * classed / found:.0f} %" if found else "-"
        print(f"{kind:<18}{shown}{of_them:>16}{rightly:>9}")
        if kind in JUDGED and count:
            figures.check(
                f"  {kind.replace('_', ' ')}s of ΔE {LEAST:g} or more found",
                f"{100 * found / count:.2f} % ({found} of {count})",
                found / count >= FOUND,
                f"{100 * FOUND:g} %",
            )
    wrong = [(pair, count) for pair, count in total.taken_for.most_common() if pair[0] != pair[1]]
    figures.note("taken for another kind", ", ".join(f"{a} for {b} {count} x" for (a, b), count in wrong[:8]) or "none")
    if total.marked:
        figures.note("finds on marked tiles where nothing was seeded", f"{total.extra / total.marked:.3f} a tile")


def main() -> int:
    """Print, fire, photograph, search, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--good", type=int, default=250, help="good tiles of each stone")
    parser.add_argument("--each", type=int, default=80, help="marked tiles of each stone")
    parser.add_argument("--prints", type=int, default=8, help="tiles of each stone wrong all over, of each kind")
    parser.add_argument("--size", type=float, default=60.0, help="side of a tile, mm")
    parser.add_argument("--px-per-mm", type=float, default=10.0, help="resolution of print and camera")
    parser.add_argument("--stones", nargs="*", default=stones(), help="only these")
    parser.add_argument("--first", type=int, default=0, help="number of the first face")
    parser.add_argument("--jobs", type=int, default=1, help="stones at once")
    parser.add_argument("--seed", type=int, default=1, help="of what is left to chance")
    arguments = parser.parse_args()
    figures = Figures()
    figures.title(
        f"Defects on tiles of {arguments.size:g} mm at {arguments.px_per_mm:g} px/mm, drifts to ΔE {MOST_DRIFT:g}\n"
        f"{machine_name()}"
    )
    begin = time.perf_counter()
    tallies: dict[str, Tally] = {}
    with ProcessPoolExecutor(arguments.jobs) as pool:
        tasks = [
            pool.submit(
                of_stone,
                name,
                arguments.good,
                arguments.each,
                arguments.prints,
                arguments.first,
                arguments.size,
                arguments.px_per_mm,
                arguments.seed,
            )
            for name in arguments.stones
        ]
        for task in tasks:
            name, tally = task.result()
            tallies[name] = tally
            print(f"  {name} done after {time.perf_counter() - begin:.0f} s", flush=True)
    report(figures, tallies)
    searches = sum(t.good + t.marked for t in tallies.values()) + arguments.prints * len(ALL_OVER) * len(tallies)
    if searches:
        seconds = sum(t.seconds for t in tallies.values()) / searches
        figures.note("search, a tile, one core", f"{seconds:.2f} CPU s")
    figures.note("took", f"{time.perf_counter() - begin:.0f} s")
    figures.end()
    return int(figures.reached < figures.judged)


if __name__ == "__main__":
    sys.exit(main())
