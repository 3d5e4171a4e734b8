"""How fast the sampler is, against a plain NumPy copy of the same bytes in the same run.

Usage: python benchmarks/sampler.py [--slab PIXELS] [--design crops|tile]
"""

from __future__ import annotations

import argparse
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from machine import machine_name
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.config import load_job
from tilefab.pipeline.maps import job_maps
from tilefab.pipeline.plan import plan_job
from tilefab.pipeline.progress import Silent
from tilefab.sampling import (
    CropMap,
    CropOptions,
    TextureMap,
    build_crop_map,
    plan_region,
    render,
    render_plan,
    render_points,
    render_reduced,
)

RUNS = 5
FACE_PX = 9449  # 600 mm at 400 dpi
INKS = ("Cyan", "Magenta", "Yellow", "Black")
POINTS = 1_000_000
LONELY_POINTS = 1000
WALL_MM = (10_000, 3_000)
DPI = 400
FACES_OF_GROWTH = (1, 10, 100, 1000, 10_000, 100_000)
GROWTH_FACE_PX = 256
WALL_LEVEL = 6


def median_seconds(work: Callable[[int], object]) -> float:
    """Median of several runs after one that doesn't count; each is given its number."""
    times = []
    for run in range(RUNS + 1):
        begin = time.perf_counter()
        work(run)
        times.append(time.perf_counter() - begin)
    return statistics.median(times[1:])


def made_up_slab(side: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """CIELAB and four inks of a made-up stone with coarse figure and fine grain."""
    random = np.random.default_rng(0)
    figure = ndimage.gaussian_filter(random.normal(0, 1, (side, side)).astype(np.float32), side / 100)
    grain = ndimage.gaussian_filter(random.normal(0, 6, (side, side)).astype(np.float32), 1)
    lightness = 55 + 12 * figure / figure.std() + grain
    lab = np.stack([lightness, 0.1 * lightness, 0.2 * lightness], axis=2).astype(np.float32)
    return lab, random.integers(0, 100, (side, side, len(INKS)), dtype=np.uint8)


def measure_crops(side: int) -> None:
    """Print every figure of the crop design."""
    lab, inks = made_up_slab(side)
    begin = time.perf_counter()
    options = CropOptions()
    press = build_crop_map(
        lab, np.ones((side, side), dtype=bool), options, stored=inks, space="ink8", channels=INKS, dpi=DPI
    )
    print(
        f"slab of {side} x {side} px; map built in {time.perf_counter() - begin:.1f} s: {len(press.price)} crops, "
        f"cells of {press.pitch_px} px, overlap {press.overlap_px} px"
    )
    copy = measure_face(press)
    measure_points(press)
    measure_wall(press)
    measure_large_faces(press, copy)
    measure_growth(press)


def measure_face(press: CropMap) -> float:
    """One face of 600 x 600 mm; returns the seconds of the plain copy."""
    out = np.empty((FACE_PX, FACE_PX, len(INKS)), dtype=np.uint8)
    source = np.ones_like(out)
    megapixels = FACE_PX**2 / 1e6
    plan = plan_region(press, 123_456, -7_891_011, FACE_PX, FACE_PX, seed=1)
    copy = median_seconds(lambda _: np.copyto(out, source))
    print(f"plain copy of {FACE_PX} x {FACE_PX} x 4 bytes, 1 thread: {megapixels / copy:.0f} Mpx/s")
    warm = median_seconds(lambda _: render_plan(press, plan, out=out, threads=1))
    print(f"render, warm, 1 thread: {megapixels / warm:.0f} Mpx/s, {copy / warm:.2f} of the copy")
    for threads in (1, 2):
        cold = median_seconds(
            lambda run, threads=threads: render(
                press, 10**6 * run, -(10**7) * run, FACE_PX, FACE_PX, seed=1, out=out, threads=threads
            )
        )
        print(
            f"render, cold (crops chosen and seams found on the way), {threads} thread(s): "
            f"{megapixels / cold:.0f} Mpx/s, {copy / cold:.2f} of the copy"
        )
    return copy


def measure_points(press: TextureMap) -> None:
    """A million random points, over larger and larger parts of the plane."""
    random = np.random.default_rng(1)
    for points, side in ((POINTS, FACE_PX), (POINTS, 10 * FACE_PX), (LONELY_POINTS, 1 << 40)):
        rows, cols = random.integers(0, side, (2, points))
        begin = time.perf_counter()
        render_points(press, rows, cols, seed=1)
        each = (time.perf_counter() - begin) / points
        print(f"random points, {points:,} over {side:,} x {side:,} px: {each * 1e6:.2f} microseconds each")


def measure_wall(press: CropMap) -> None:
    """A wall of 10 m x 3 m, reduced."""
    cols, rows = (round(side / 25.4 * DPI) >> WALL_LEVEL for side in WALL_MM)
    press.base_level(press.coarsest_level)
    seconds = median_seconds(lambda run: render_reduced(press, 0, 0, rows, cols, level=WALL_LEVEL, seed=run))
    print(f"wall of 10 m x 3 m at {cols} x {rows} px: {seconds:.2f} s")


def measure_large_faces(press: CropMap, copy: float) -> None:
    """Faces of 600 x 1200 mm, all cores."""
    out = np.empty((2 * FACE_PX, FACE_PX, len(INKS)), dtype=np.uint8)
    seconds = median_seconds(
        lambda run: render(press, 3 * 10**6 * run, 10**5 * run, 2 * FACE_PX, FACE_PX, seed=1, out=out)
    )
    print(
        f"faces of 600 x 1200 mm, 4 inks, cold, all cores: {60 / seconds:.0f} a minute "
        f"({2 * copy / seconds:.2f} of a one-thread copy)"
    )


def measure_growth(press: CropMap) -> None:
    """Time and memory as more faces are made."""
    out = np.empty((GROWTH_FACE_PX, GROWTH_FACE_PX, len(INKS)), dtype=np.uint8)
    for faces in FACES_OF_GROWTH:
        begin = time.perf_counter()
        for face in range(faces):
            render(press, 5000 * face, 777, GROWTH_FACE_PX, GROWTH_FACE_PX, seed=2, out=out, threads=1)
        each = (time.perf_counter() - begin) / faces
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{faces} faces of {GROWTH_FACE_PX} px: {each * 1e3:.2f} ms each, peak memory {peak:.0f} MB")


def measure_tile() -> None:
    """The thesis's design, on the demo's stone."""
    with tempfile.TemporaryDirectory() as folder:
        plan = plan_job(load_job(Path("jobs/tile.toml")), Path(folder))
        press = job_maps(plan, Silent()).press
    out = np.empty((4096, 4096, press.base.shape[2]), dtype=press.base.dtype)
    source = np.ones_like(out)
    copy = median_seconds(lambda _: np.copyto(out, source))
    seconds = median_seconds(lambda _: render(press, 0, 0, 4096, 4096, seed=1, out=out, threads=1))
    print(f"render, 1 thread: {4096**2 / seconds / 1e6:.0f} Mpx/s, {copy / seconds:.2f} of a plain copy")
    rows, cols = np.random.default_rng(1).integers(0, FACE_PX, (2, POINTS))
    seconds = median_seconds(lambda _: render_points(press, rows, cols, seed=1))
    print(
        f"random points, {POINTS:,} over {FACE_PX:,} x {FACE_PX:,} px: {seconds / POINTS * 1e6:.2f} microseconds each"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slab", type=int, default=4096, help="side of the made-up slab in pixels")
    parser.add_argument("--design", choices=("crops", "tile"), default="crops")
    arguments = parser.parse_args()
    print(f"on {machine_name()}; medians of {RUNS} runs")
    if arguments.design == "crops":
        measure_crops(arguments.slab)
    else:
        measure_tile()


if __name__ == "__main__":
    main()
