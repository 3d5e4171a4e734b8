"""How long growing a texture takes, whether threads change it, and where the time goes.

From 213 x 213 pixels of scikit-image's gravel (CC0) to 1024 x 1024, after a small run that compiles.

Usage: python benchmarks/synthesis_speed.py [--methods NAME ...] [--side PX] [--exemplar PX]
"""

from __future__ import annotations

import argparse
import cProfile
import hashlib
import os
import pstats
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from machine import machine_name
from skimage import data

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.synthesis import METHODS, SynthesisRequest
from tilefab.types import SizePx

LIMIT_S = {"self-tuning": (20.0, 5.0)}
THREADS = (1, 2, 4)
STEPS = {
    "patch_kernels.py:search": "PatchMatch search",
    "patch_field.py:vote": "votes",
    "patch_field.py:chosen": "last choice of pixels, seams settled",
    "patch_field.py:shown_at": "from scale to scale",
    "usage.py:prices": "prices of use",
    "usage.py:shifts": "shifts that repeat",
    "pyramid.py:scales": "the exemplar's scales",
    "guidance.py:guidance_channel": "guidance channel",
    "lattice.py:find_lattice": "lattice",
    "layout.py:initial_field": "beginning",
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", choices=sorted(METHODS), default=list(METHODS), metavar="NAME")
    parser.add_argument("--side", type=int, default=1024, help="of the result, pixels")
    parser.add_argument("--exemplar", type=int, default=213, help="side of the exemplar, pixels")
    options = parser.parse_args()
    gray = np.ascontiguousarray(data.gravel()[: options.exemplar, : options.exemplar])
    lab = lab_from_xyz(scan_to_xyz(np.repeat(gray[..., np.newaxis], 3, axis=2), None)).astype(np.float32)
    request = SynthesisRequest(lab, np.ones(lab.shape[:2], dtype=bool), SizePx(options.side, options.side), seed=1)
    print(f"{options.exemplar} px to {options.side} x {options.side}, repeating, on {machine_name()}")
    cores = len(os.sched_getaffinity(0))
    for method in options.methods:
        METHODS[method](replace(request, size=SizePx(64, 64)))
        for fast in (False, True):
            begin, busy = time.perf_counter(), time.process_time()
            METHODS[method](replace(request, fast=fast, threads=cores))
            seconds, cpu = time.perf_counter() - begin, time.process_time() - busy
            verdict = ""
            if method in LIMIT_S:
                limit = LIMIT_S[method][fast]
                verdict = f"at most {limit:g} s: {'reached' if seconds <= limit else 'NOT reached'}"
            name = f"{method}, fast" if fast else method
            print(f"{name:20}{seconds:7.1f} s on {cores} cores, {cpu:6.1f} CPU s  {verdict}", flush=True)
        digests = {
            hashlib.sha256(METHODS[method](replace(request, fast=True, threads=threads)).source.tobytes()).hexdigest()
            for threads in (*THREADS, THREADS[0])
        }
        same = "the same bits" if len(digests) == 1 else "DIFFERENT bits"
        print(f"{'':20}fast, with 1, 2, 4 threads and again: {same}", flush=True)
    if "self-tuning" in options.methods:
        shares(request)


def shares(request: SynthesisRequest) -> None:
    """Where the time of self-tuning goes, on one thread."""
    profile = cProfile.Profile()
    begin = time.process_time()
    profile.runcall(METHODS["self-tuning"], replace(request, threads=1))
    total = time.process_time() - begin
    spent = {f"{Path(path).name}:{name}": facts[3] for (path, _, name), facts in pstats.Stats(profile).stats.items()}
    print(f"\nself-tuning by step, one thread, {total:.1f} CPU s")
    for key, label in STEPS.items():
        print(f"  {label:40}{100 * spent.get(key, 0.0) / total:5.1f} %")


if __name__ == "__main__":
    main()
