"""A whole line struck by faults of every kind: of messages, of devices, of the plant, over TCP and RTU.

Usage: python benchmarks/line_faults.py [--faults N] [--jobs N] [--seed SEED]

Campaigns of some fifty faults each strike a running line at random moments; hands mend what doesn't mend itself, and an
operator acknowledges and resumes. At the end of each the job is finished, and the journal is held against what the
plant saw with its own eyes. Faces that nobody can know of must be marked in doubt, and are counted; beyond that none
may be lost, doubled, silently skipped, or passed wrong. Ends with 1 if anything is wrong.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from figures import Figures
from machine import machine_name

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.line_campaigns import workplace
from tests.line_faults import MESSAGE_FAULTS, PLANT_FAULTS, Struck, strike_often

_AT_ONCE = 50


def campaign(folder: Path, names: list[str], seed: int, rtu: bool) -> Struck:
    """Strike a line of its own."""
    faults = PLANT_FAULTS | MESSAGE_FAULTS
    with workplace(folder, rate=10.0 if rtu else 20.0, rtu=rtu, seed=seed, count=60) as (plant, place):
        return strike_often(plant, place, [(name, faults[name]) for name in names], seed=seed)[0]


def _names(faults: int, seed: int) -> list[str]:
    """So many kinds in random order, each as often as the others."""
    kinds, chance = [*PLANT_FAULTS, *MESSAGE_FAULTS], random.Random(seed)
    names: list[str] = []
    while len(names) < faults:
        names += chance.sample(kinds, len(kinds))
    return names[:faults]


def main() -> int:
    """Strike, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faults", type=int, default=2000, help="faults in all")
    parser.add_argument("--jobs", type=int, default=2, help="plants at once")
    parser.add_argument("--seed", type=int, default=1, help="of what is left to chance")
    arguments = parser.parse_args()
    figures = Figures()
    figures.title(f"Faults of a whole line\n{machine_name()}")
    begin = time.perf_counter()
    names = _names(arguments.faults, arguments.seed)
    parts = [names[first : first + _AT_ONCE] for first in range(0, len(names), _AT_ONCE)]
    faults: Counter[str] = Counter()
    faces: Counter[str] = Counter()
    wrong = 0
    with (
        tempfile.TemporaryDirectory(prefix="tilefab-faults-") as folder,
        ProcessPoolExecutor(arguments.jobs, mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        futures = [
            pool.submit(campaign, Path(folder) / str(number), part, arguments.seed + number, number % 2 == 1)
            for number, part in enumerate(parts)
        ]
        for number, future in enumerate(futures):
            found = future.result()
            faults += found.faults
            faces += found.faces
            wrong += len(found.wrong)
            for text in found.wrong[:10]:
                print(f"campaign {number}: {text}", flush=True)
    for kind, struck in sorted(faults.items()):
        figures.note(kind, str(struck))
    print()
    figures.check("faults", str(faults.total()), faults.total() >= arguments.faults, f"at least {arguments.faults}")
    figures.check("faces lost, doubled, silently skipped, or passed wrong", str(wrong), wrong == 0, "0")
    figures.note("faces printed and passed", str(faces["passed"]))
    for state in ("diverted", "partial", "in_doubt"):
        figures.note(f"faces told of as {state}", str(faces[state]))
    figures.note("took", f"{time.perf_counter() - begin:.0f} s")
    figures.end()
    return int(figures.reached < figures.judged)


if __name__ == "__main__":
    sys.exit(main())
