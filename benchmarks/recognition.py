"""How surely a fired tile is recognised among 100,000 faces, and how surely one of another job is not.

Usage: python benchmarks/recognition.py [--faces N] [--tiles N] [--others N] [--stones NAME ...] [--textures FOLDER]
[--keep FOLDER]

Each stone becomes a job of 150 x 150 mm tiles at 60 dpi: its map is built and converted by the pipeline, its faces get
fingerprints, and faces drawn at random are fired on the simulated press, drifted by up to dE 3, and photographed at 4
pixels a millimetre: turned by any quarter and up to 4 degrees, shifted by up to 6 mm, scaled by up to 2 %, lit unevenly
by up to 15 %, 10 % too bright or dark with a cast; a third of them whole, a third covered by up to 30 %, a third broken
by up to 40 %. Tiles of others are of the same stone with another seed, and of all other stones. Also counted, but by no
figure's measure: faces of the same job that aren't among the fingerprints. Names of stones: of the photographs that
scikit-image carries, or of folders with an exemplar.png under --textures; "faint:" before one leaves a tenth of its
contrast, "tile:" takes the design of a repeatable tile. Times are of one thread's processor, from XYZ to the answer.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import tifffile
from figures import Figures
from machine import machine_name
from numpy.typing import NDArray
from PIL import Image

from sim.kiln import Firing, drift_of_size
from sim.spectral_press import SpectralPress
from sim.tile_photo import fired_rgb, photo_conditions, photo_of
from tilefab.colour import scan_to_xyz
from tilefab.config import load_job
from tilefab.inspection.fingerprint import FingerprintIndex, fingerprints
from tilefab.inspection.recognition import recognise
from tilefab.pipeline.faces import face_region
from tilefab.pipeline.inspection.predicting import PredictedFaces
from tilefab.pipeline.maps import job_maps
from tilefab.pipeline.plan import plan_job, shipped_profiles
from tilefab.pipeline.progress import Silent
from tilefab.sampling import TextureMap, render
from tilefab.types import FloatImage, SizeMm

STONES = ("gravel", "grass", "brick", "faint:gravel", "tile:gravel")
SIDE_MM, DPI, CAMERA_PX_PER_MM = 150.0, 60.0, 4.0
TILE_PX_PER_MM = DPI / 25.4
PRESS, PROFILE = "ceramic4", "demo_line.icc"
DRIFTS_DE = (0.0, 1.5, 3.0)
CASES: dict[str, dict[str, float]] = {"whole": {}, "covered": {"occluded": 0.3}, "broken": {"broken": 0.4}}
LEAST_RIGHT, MOST_FALSE, MOST_MS = 0.999, 0.0001, 100.0
FAINT = 0.1
JOB = """schema_version = 1
[job]
name = "{name}"
[slab]
scans = ["{scan}"]
dpi = 60
[texture]
design = "{design}"
seed = {seed}
[tile]
size_mm = [{side}, {side}]
dpi = {dpi}
count = {count}
layout = "scatter"
bleed_mm = 2
[colour]
press_profile = "{profile}"
[output]
directory = "out"
bits = 8
[report]
pdf = "report.pdf"
"""


@dataclass(frozen=True, eq=False)
class Stone:
    """A job of a stone: what its faces should look like, and its map fired with each drift, linear sRGB in 16 bits."""

    name: str
    faces: PredictedFaces
    fired: tuple[TextureMap, ...]

    def tile(self, face: int, drift: int) -> FloatImage:
        """Linear sRGB (rows, cols, 3) of a fired tile."""
        plan = self.faces.plan
        whole, bleed = face_region(plan, self.faces.maps.texture, face), plan.bleed_px
        rows, cols = whole.rows - 2 * bleed, whole.cols - 2 * bleed
        shown = render(self.fired[drift], whole.row + bleed, whole.col + bleed, rows, cols, seed=plan.seed, threads=1)
        return shown * np.float32(1.0 / 65535.0)


@dataclass
class Tally:
    """What came of the tiles of one kind."""

    tiles: int = 0
    right: int = 0
    false: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    ms: list[float] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Count those of another as well."""
        self.tiles, self.right, self.false = (
            self.tiles + other.tiles,
            self.right + other.right,
            self.false + other.false,
        )
        self.reasons += other.reasons
        self.ms += other.ms


def scan_of(stone: str, textures: Path, folder: Path) -> str:
    """What a job file calls the scan of a stone."""
    _, _, plain = stone.rpartition(":")
    exemplar = textures / plain / "exemplar.png"
    scan = str(exemplar) if exemplar.exists() else f"package:skimage/data/{plain}.png"
    if not stone.startswith("faint:"):
        return scan
    if exemplar.exists():
        pixels = np.asarray(Image.open(exemplar).convert("RGB"))
    else:
        from skimage import data

        pixels = np.repeat(getattr(data, plain)()[..., np.newaxis], 3, axis=2)
    mean = pixels.mean(axis=(0, 1))
    path = folder / f"faint_{plain}.tif"
    tifffile.imwrite(path, np.rint((mean + FAINT * (pixels - mean)) * 257.0).astype(np.uint16), photometric="rgb")
    return str(path)


def make_stone(name: str, seed: int, count: int, textures: Path, folder: Path) -> Stone:
    """Build a job and fire its map."""
    home = folder / f"{name.replace(':', '_')}_{seed}"
    home.mkdir(parents=True, exist_ok=True)
    path = home / "job.toml"
    path.write_text(
        JOB.format(
            name=name,
            scan=scan_of(name, textures, home),
            design="tile" if name.startswith("tile:") else "crops",
            seed=seed,
            side=SIDE_MM,
            dpi=DPI,
            count=count,
            profile=shipped_profiles() / PROFILE,
        )
    )
    plan = plan_job(load_job(path), home / "out")
    maps = job_maps(plan, Silent())
    press = SpectralPress(PRESS)
    random = np.random.default_rng(seed)
    firings = [drift_of_size(press, random, size) if size else Firing() for size in DRIFTS_DE]
    fired = []
    for firing in firings:
        base = np.rint(fired_rgb(maps.press.base, press, firing) * 65535.0).astype(np.uint16)
        fired.append(maps.press.with_base(base, space="rgb16", channels=("R", "G", "B")))
    return Stone(name, PredictedFaces(plan, maps), tuple(fired))


def index_of(stone: Stone, faces: int, keep: Path | None) -> tuple[FingerprintIndex, float]:
    """Fingerprints of a stone's faces, and milliseconds a face took."""
    path = None if keep is None else keep / f"{stone.name.replace(':', '_')}_{faces}.npz"
    if path is not None and path.exists():
        with np.load(path) as stored:
            return FingerprintIndex.from_arrays(dict(stored)), 0.0
    begin = time.process_time()
    index = fingerprints(stone.faces.lightness, range(faces), SizeMm(SIDE_MM, SIDE_MM))
    took = 1000.0 * (time.process_time() - begin) / faces
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays = index.arrays()
        np.savez(path, about=arrays["about"], faces=arrays["faces"], codes=arrays["codes"])
    return index, took


def photographed(stone: Stone, face: int, case: str, random: np.random.Generator) -> tuple[NDArray[np.float32], int]:
    """A tile of a stone under the camera, as the core gets it, and how often it is turned."""
    conditions = photo_conditions(random, shift=0.04, size_mm=(SIDE_MM, SIDE_MM), **CASES[case])
    tile = stone.tile(face, int(random.integers(len(DRIFTS_DE))))
    photo = photo_of(tile, TILE_PX_PER_MM, conditions, random, px_per_mm=CAMERA_PX_PER_MM)
    xyz = np.ascontiguousarray(np.maximum(scan_to_xyz(photo.image, None), 0.0), dtype=np.float32)
    return xyz, conditions.quarter_turns


def looked_at(
    ours: Stone, index: FingerprintIndex, theirs: Stone, faces: NDArray[np.int64], seed: int, *, expected: bool
) -> Tally:
    """Tiles photographed and looked for among the faces of a job; ``expected``: whether they are of those."""
    out = Tally()
    size = SizeMm(SIDE_MM, SIDE_MM)
    names = list(CASES)
    for number, face in enumerate(faces.tolist()):
        random = np.random.default_rng([seed, number])
        xyz, turns = photographed(theirs, face, names[number % len(names)], random)
        begin = time.process_time()
        said = recognise(xyz, index, ours.faces.lightness, size, px_per_mm=CAMERA_PX_PER_MM)
        out.ms.append(1000.0 * (time.process_time() - begin))
        out.tiles += 1
        if said.face is None:
            out.right += not expected
            out.reasons[said.problem or said.reason.partition(":")[0].partition(" can be")[0]] += 1
        elif expected and (said.face, said.quarter_turns) == (face, turns):
            out.right += 1
        else:
            out.false += 1
    return out


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faces", type=int, default=100_000, help="faces looked among, of each stone")
    parser.add_argument("--tiles", type=int, default=10_000, help="tiles of ours, over all stones")
    parser.add_argument("--others", type=int, default=10_000, help="tiles of others, over all stones")
    parser.add_argument("--stones", nargs="*", default=list(STONES))
    parser.add_argument("--textures", type=Path, default=Path("../shared/textures"))
    parser.add_argument("--keep", type=Path, help="folder that keeps fingerprints from run to run")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    figures = Figures()
    figures.title(f"Tiles recognised among {arguments.faces} faces\n{machine_name()}")
    names: list[str] = arguments.stones
    each, each_other = -(-arguments.tiles // len(names)), -(-arguments.others // len(names))
    ours, others, strangers = Tally(), Tally(), Tally()
    print(
        f"{'stone':<20}{'ms/face':>8}{'tiles':>7}{'right':>8}{'false':>6}{'others':>8}{'taken':>6}"
        f"{'ms p50':>8}{'p95':>6}"
    )
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        stones = {name: make_stone(name, 1, arguments.faces, arguments.textures, folder) for name in names}
        for place, name in enumerate(names):
            stone = stones[name]
            index, took = index_of(stone, arguments.faces, arguments.keep)
            random = np.random.default_rng([arguments.seed, place])
            own = looked_at(stone, index, stone, random.integers(0, arguments.faces, each), 1, expected=True)
            again = make_stone(name, 2, arguments.faces, arguments.textures, folder)
            elsewhere = [again, *(stones[other] for other in names if other != name)]
            theirs = Tally()
            for part, other in enumerate(elsewhere):
                # Half are of the same stone: those are the hardest.
                count = each_other - each_other // 2 if part == 0 else -(-(each_other // 2) // (len(elsewhere) - 1))
                drawn = random.integers(0, arguments.faces, count)
                theirs.add(looked_at(stone, index, other, drawn, 100 + part, expected=False))
            unknown = random.integers(arguments.faces, 2 * arguments.faces, each_other // 10)
            strangers.add(looked_at(stone, index, stone, unknown, 50, expected=False))
            ours.add(own)
            others.add(theirs)
            ms = np.percentile(own.ms, (50, 95))
            print(
                f"{name:<20}{took:>8.1f}{own.tiles:>7}{own.right / own.tiles:>8.2%}{own.false:>6}{theirs.tiles:>8}"
                f"{theirs.false:>6}{ms[0]:>8.0f}{ms[1]:>6.0f}   {dict(own.reasons)}",
                flush=True,
            )
    right, false = ours.right / ours.tiles, ours.false / ours.tiles
    figures.check("recognised", f"{right:.3%} of {ours.tiles}", right >= LEAST_RIGHT, f"{LEAST_RIGHT:.1%}")
    figures.check("taken for another", f"{ours.false} of {ours.tiles}", false <= MOST_FALSE, f"{MOST_FALSE:.2%}")
    figures.check("of others taken for ours", f"{others.false} of {others.tiles}", others.false == 0, "0")
    took_ms = float(np.mean(ours.ms))
    figures.check("processor time, ms a tile", f"{took_ms:.0f}", took_ms <= MOST_MS, f"{MOST_MS:.0f}")
    figures.note("of others, ms a tile", f"{np.mean(others.ms):.0f}")
    figures.note("of the job's other faces taken for ours", f"{strangers.false} of {strangers.tiles}")
    figures.end()
    return 0 if figures.reached == figures.judged else 1


if __name__ == "__main__":
    sys.exit(main())
