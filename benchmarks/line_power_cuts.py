"""A whole line that loses its power again and again: un-synced writes of the journal are dropped, devices restart.

Usage: python benchmarks/line_power_cuts.py [--cases N] [--seed SEED]

Real daemons against the real simulator; the plant's own truth judges what the journal says at the end.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from figures import Figures
from machine import machine_name

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.line_power import lose_power
from tests.line_workshop import Workplace, judge, plant_process, wait_or_kill, write_job, write_line, write_slab

FACES_A_CASE = 45
RATE = 20


def main() -> None:
    """Go through it and print the table; ends with 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=600, help="losses of power")
    parser.add_argument("--seed", type=int, default=1, help="of moments and remains")
    arguments = parser.parse_args()
    figures = Figures()
    figures.title(f"Loss of power under a whole line\n{machine_name()}")
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="tilefab-cuts-") as name:
        folder = Path(name)
        write_slab(folder)
        job = write_job(folder, count=FACES_A_CASE * arguments.cases)
        with plant_process(folder, rate=RATE) as plant:
            place = Workplace.open(job, write_line(folder, plant.endpoints))
            cycles = lose_power(plant, place, arguments.cases, seed=arguments.seed)
            # One more daemon settles what the last one left; it needn't print what is left of the job.
            wait_or_kill(place.fork(lambda _step: None), 3.0)
            found = judge(plant, place, finished=False, check_pixels=50)
            summary = plant.do("truth", summary=True)["summary"]
    figures.check("losses of power", str(cycles.cases), cycles.cases >= arguments.cases, f"{arguments.cases}")
    figures.note("with something un-synced at that moment", str(cycles.at_risk))
    figures.note("what was left of it", ", ".join(f"{way} {count}" for way, count in sorted(cycles.ways.items())))
    figures.note("in which the plant lost its power, too", str(cycles.plant_cuts))
    figures.note("faces printed whole / in part", f"{summary['prints_complete']} / {summary['prints_partial']}")
    figures.check("faces on two tiles", str(summary["faces_twice"]), not summary["faces_twice"], "0")
    figures.check("lost, skipped or wrongly recorded", str(len(found.wrong)), not found.wrong, "0")
    for what in found.wrong[:20]:
        figures.note("", what)
    figures.note("wall time", f"{time.perf_counter() - began:.0f} s")
    raise SystemExit(bool(found.wrong) or cycles.cases < arguments.cases)


if __name__ == "__main__":
    main()
