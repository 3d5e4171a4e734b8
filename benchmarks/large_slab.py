"""A large slab made ready for printing: time and peak memory of each stage, in a process of its own.

Usage: python benchmarks/large_slab.py [--side PIXELS] [--bits 8|16] [--upright] [--print-dpi DPI] [--prepare-only]
                                       [--keep FOLDER]

Draws a veined slab of SIDE x SIDE pixels lying askew on a dark bed under uneven light, writes it as TIFF, and has the
pipeline clean it, build its texture map and convert that to inks.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from machine import machine_name
from numpy.typing import NDArray

from tilefab.config import load_job
from tilefab.pipeline.maps import job_maps
from tilefab.pipeline.plan import plan_job
from tilefab.pipeline.prepare import prepare_slab

DPI = 300
STRIP_ROWS = 256
ANGLE_DEG = 0.4
BED_SHARE = 0.02
BED_LIGHT = 0.015
FALL_OFF = 0.3
# Grid cells along the slab, strength: cloud, mottle, veins' bends.
LAYERS = ((9, 0.2), (60, 0.35), (500, 0.25))
BENDS = ((7, 1.0), (31, 0.3), (140, 0.08))
JOB = """schema_version = 1
[slab]
scans = ["slab.tif"]
[tile]
size_mm = [{tile_mm}, {tile_mm}]
dpi = {dpi}
count = 1
[colour]
press_profile = "demo_ceramic.icc"
ink_limit_percent = 260
[output]
directory = "out"
bits = 8
"""


def main() -> None:
    """Make a slab, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=12_000)
    parser.add_argument("--bits", type=int, choices=(8, 16), default=8)
    parser.add_argument("--upright", action="store_true", help="a scan without bed and under even light: nothing to do")
    parser.add_argument("--print-dpi", type=int, default=DPI, help=f"other than the scan's {DPI}: it is resampled")
    parser.add_argument("--prepare-only", action="store_true", help="stop at the cleaned slab")
    parser.add_argument("--keep", type=Path, help="a folder for the slab, used again if it is there")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure is not None:
        measure(arguments.measure, arguments.prepare_only)
        return
    with contextlib.ExitStack() as stack:
        folder = arguments.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        job = folder / f"slab_{arguments.side}_{arguments.bits}{'_upright' if arguments.upright else ''}" / "job.toml"
        if not job.parent.exists():
            job.parent.mkdir(parents=True)
            draw_slab(job.parent / "slab.tif", arguments.side, arguments.bits, arguments.upright)
        tile_mm = round(0.1 * arguments.side / DPI * 25.4)
        job.write_text(JOB.format(tile_mm=tile_mm, dpi=arguments.print_dpi))
        flags = ["--prepare-only"] if arguments.prepare_only else []
        told = subprocess.run(
            [sys.executable, __file__, "--measure", str(job), *flags], check=True, stdout=subprocess.PIPE, text=True
        )
        print(f"{arguments.side} x {arguments.side} px slab, {arguments.bits} bit, on {machine_name()}")
        print(told.stdout, end="")


def measure(job: Path, prepare_only: bool) -> None:
    """Take a job as far as its map in inks, and print what each stage took."""
    with tempfile.TemporaryDirectory() as output:
        plan = plan_job(load_job(job), Path(output))
        watch = StageWatch()
        if prepare_only:
            slab = prepare_slab(plan, watch)
            watch.close()
            print(*(f"{step}: {sentence}" for step, sentence in slab.log), sep="\n")
        else:
            maps = job_maps(plan, watch)
            watch.close()
            print(
                f"map of {maps.press.base.shape[1]} x {maps.press.base.shape[0]} px in {len(maps.press.channels)} inks"
            )
    for name, seconds, peak in watch.stages:
        print(f"{name:<28}{seconds:8.1f} s {peak:6.2f} GB at most")
    print(
        f"{'in all':<28}{sum(stage[1] for stage in watch.stages):8.1f} s "
        f"{max(stage[2] for stage in watch.stages):6.2f} GB at most"
    )


class StageWatch:
    """A `Progress` that notes how long each stage took and how much memory was in use at most meanwhile."""

    def __init__(self) -> None:
        self.stages: list[tuple[str, float, float]] = []
        self._name = "planning"
        self._start = time.perf_counter()
        forget_peak()

    def stage(self, name: str, share: float) -> None:  # noqa: ARG002
        """Note the end of the stage before, if this is another."""
        if name != self._name:
            self.close()
            self._name = name

    def note(self, message: str) -> None:
        """Pass it on."""
        print(message)

    def close(self) -> None:
        """Note the end of the last stage."""
        now = time.perf_counter()
        self.stages.append((self._name, now - self._start, peak_gb()))
        self._start = now
        forget_peak()


def peak_gb() -> float:
    """Most memory that this process had in use since `forget_peak`, in 10^9 bytes (Linux)."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024 / 1e9


def forget_peak() -> None:
    """Begin to count anew; where the system doesn't let us, peaks only rise from stage to stage."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def draw_slab(path: Path, side: int, bits: int, upright: bool) -> None:
    """Write a slab lying on a scanner's bed as sRGB TIFF, strip by strip."""
    full = side if upright else round(side * (1 + 2 * BED_SHARE))
    spec = oiio.ImageSpec(full, full, 3, oiio.UINT8 if bits == 8 else oiio.UINT16)
    spec.attribute("XResolution", float(DPI))
    spec.attribute("YResolution", float(DPI))
    spec.attribute("ResolutionUnit", "in")
    target = oiio.ImageOutput.create(str(path))
    if not target.open(str(path), spec):
        raise OSError(target.geterror())
    layers, bends = fields(LAYERS, 0), fields(BENDS, 1)
    levels = np.arange(4097) / 4096
    curve = np.where(levels <= 0.0031308, 12.92 * levels, 1.055 * np.maximum(levels, 1e-9) ** (1 / 2.4) - 0.055)
    curve = np.rint(curve * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    col = (np.arange(full) + 0.5) / full
    for top in range(0, full, STRIP_ROWS):
        row = (np.arange(top, min(top + STRIP_ROWS, full)) + 0.5) / full
        grain = np.random.default_rng([2, top]).standard_normal((len(row), full), dtype=np.float32)
        light = stone(row, col, layers, bends, grain)
        if not upright:
            y, x = row[:, None] - 0.5, col[None, :] - 0.5
            light *= (1 - FALL_OFF * (2 * x * x + 2 * y * y))[..., np.newaxis]
            cos, sin = math.cos(math.radians(ANGLE_DEG)), math.sin(math.radians(ANGLE_DEG))
            inward_px = (
                0.5 / (1 + 2 * BED_SHARE) - np.maximum(np.abs(cos * x + sin * y), np.abs(cos * y - sin * x))
            ) * full
            light = BED_LIGHT + (light - BED_LIGHT) * np.clip(inward_px + 0.5, 0, 1)[..., None]
        pixels = curve[np.clip(np.rint(light * 4096), 0, 4096).astype(np.int16)]
        if not target.write_scanlines(top, top + len(row), 0, np.ascontiguousarray(pixels)):
            raise OSError(target.geterror())
    target.close()


def fields(layers: tuple[tuple[int, float], ...], seed: int) -> list[tuple[NDArray[np.float32], float]]:
    """Random grids and their strengths."""
    random = np.random.default_rng(seed)
    return [(random.standard_normal((cells + 1, cells + 1)).astype(np.float32), strength) for cells, strength in layers]


def stone(
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    layers: list[tuple[NDArray[np.float32], float]],
    bends: list[tuple[NDArray[np.float32], float]],
    grain: NDArray[np.float32],
) -> NDArray[np.float64]:
    """(rows, cols, 3) linear light of a mottled grey-green stone with dark red veins; row and col run from 0 to 1."""
    mottle = sum(strength * smooth(grid, row, col) for grid, strength in layers) + 0.1 * grain
    vein = np.exp(-((sum(strength * smooth(grid, row, col) for grid, strength in bends) / 0.05) ** 2))
    tone = 0.3 * np.exp(0.35 * mottle)
    ground = np.array([0.95, 1.05, 0.85])
    red = np.array([0.45, 0.16, 0.12])
    return np.asarray(tone[..., None] * (ground + vein[..., None] * (red - ground)))


def smooth(grid: NDArray[np.float32], row: NDArray[np.float64], col: NDArray[np.float64]) -> NDArray[np.float32]:
    """A grid interpolated smoothly at (row, col) from 0 to 1."""
    across = weights(col, grid.shape[1])
    down = weights(row, grid.shape[0])
    held = grid[down[0]] * down[1][:, None] + grid[down[0] + 1] * (1 - down[1][:, None])
    return np.asarray(held[:, across[0]] * across[1] + held[:, across[0] + 1] * (1 - across[1]), dtype=np.float32)


def weights(at: NDArray[np.float64], points: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Left neighbour of each place on a grid, and its share."""
    place = at * (points - 1)
    left = np.minimum(place.astype(np.int64), points - 2)
    t = place - left
    return left, (1 - t * t * (3 - 2 * t)).astype(np.float32)


if __name__ == "__main__":
    main()
