"""Whether 10,000 faces of one job all differ: downsampled hashes, and the share of equal pixels at the same place.

Usage: python benchmarks/distinct_faces.py [JOB] [--faces N]
"""

from __future__ import annotations

import argparse
import hashlib
import tempfile
import time
from pathlib import Path

import numpy as np
from machine import machine_name

from tilefab.config import load_job
from tilefab.pipeline.faces import face_region, render_face
from tilefab.pipeline.maps import job_maps
from tilefab.pipeline.plan import plan_job
from tilefab.pipeline.progress import Silent
from tilefab.sampling import render_points
from tilefab.texture.likeness import closest_signatures, most_shared, signature

PLACES = 512


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("job", nargs="?", default="jobs/demo.toml", type=Path)
    parser.add_argument("--faces", type=int, default=10_000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        plan = plan_job(load_job(arguments.job), Path(folder))
        maps = job_maps(plan, Silent())
    print(f"{arguments.job}: {arguments.faces} faces on {machine_name()}")
    press = maps.press
    pixels_of_base = press.base.shape[0] * press.base.shape[1]
    where = np.arange(pixels_of_base, dtype=np.int32).reshape(*press.base.shape[:2], 1)
    traced = press.with_base(where, space="place", channels=("place",))
    random = np.random.default_rng(1)
    region = face_region(plan, press, 0)
    rows, cols = random.integers(region.rows, size=PLACES), random.integers(region.cols, size=PLACES)
    hashes, signatures, samples, colours, buffer = set(), [], [], [], None
    begin = time.perf_counter()
    for index in range(arguments.faces):
        buffer = render_face(plan, press, index, out=buffer)
        hashes.add(hashlib.sha256(buffer.data).digest())
        signatures.append(signature(buffer))
        colours.append(buffer[rows, cols].copy().view(np.int32)[:, 0])
        place = face_region(plan, press, index)
        samples.append(render_points(traced, place.row + rows, place.col + cols, seed=plan.seed)[:, 0])
    seconds = time.perf_counter() - begin
    print(f"rendered and hashed in {seconds:.1f} s")
    print(f"different sha256: {len(hashes)} of {arguments.faces}")
    near = closest_signatures(np.array(signatures))
    print(f"closest downsampled hashes: faces {near.first} and {near.second} differ in {near.value:.0f} of 256 bits")
    shared = most_shared(np.array(samples))
    print(
        f"most shared: faces {shared.first} and {shared.second} show the same pixel of the stone at "
        f"{100 * shared.value:.1f} % of {PLACES} places"
    )
    equal = most_shared(np.array(colours))
    print(
        f"most equal in colour: faces {equal.first} and {equal.second} have the same inks at "
        f"{100 * equal.value:.1f} % of {PLACES} places"
    )


if __name__ == "__main__":
    main()
