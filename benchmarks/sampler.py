"""How fast the sampler is, against a plain NumPy copy of the same bytes in the same run.

Usage: python benchmarks/sampler.py [--side PIXELS]
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from machine import machine_name

from tilefab.config import load_job
from tilefab.pipeline.maps import job_maps
from tilefab.pipeline.plan import plan_job
from tilefab.pipeline.progress import Silent
from tilefab.sampling import render, render_points

RUNS = 5
POINTS = 200_000


def median_seconds(work: Callable[[], object]) -> float:
    """Median of several runs after one that doesn't count."""
    times = []
    for _ in range(RUNS + 1):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times[1:])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=4096)
    side = parser.parse_args().side
    with tempfile.TemporaryDirectory() as folder:
        plan = plan_job(load_job(Path("jobs/demo.toml")), Path(folder))
        begin = time.perf_counter()
        press = job_maps(plan, Silent()).press
        prepared = time.perf_counter() - begin
    print(f"{side} x {side} pixels, {press.base.shape[2]} inks, {press.base.dtype}, on {machine_name()}")
    print(f"map of {press.base.shape[1]} x {press.base.shape[0]} pixels prepared and converted in {prepared:.1f} s")
    out = np.empty((side, side, press.base.shape[2]), dtype=press.base.dtype)
    source = np.ones_like(out)
    copy = median_seconds(lambda: np.copyto(out, source))
    for threads in (1, 2):
        seconds = median_seconds(
            lambda threads=threads: render(press, 0, 0, side, side, seed=1, out=out, threads=threads)
        )
        print(
            f"render, {threads} thread(s): {side * side / seconds / 1e6:.0f} Mpx/s, {copy / seconds:.2f} of a plain "
            f"one-thread copy ({side * side / copy / 1e6:.0f} Mpx/s)"
        )
    random = np.random.default_rng(1)
    rows, cols = random.integers(-(2**40), 2**40, (2, POINTS))
    seconds = median_seconds(lambda: render_points(press, rows, cols, seed=1))
    print(f"random points far apart: {seconds / POINTS * 1e6:.2f} microseconds each")


if __name__ == "__main__":
    main()
