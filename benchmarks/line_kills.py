"""The line's daemon killed (SIGKILL) at every named step of a tile's way, and at any moment.

Usage: python benchmarks/line_kills.py [--each N] [--kills N] [--jobs N] [--steps STEP ...] [--seed SEED]

Each step has a simulated plant and a job of its own; an operator who starts and acknowledges at once stands beside.
After the kills of a step the job is finished, and the journal is held against what the plant saw with its own eyes: no
face may be lost, doubled, or silently skipped, none may pass in part or with other pixels than the job's. Ends with 1
if anything is wrong.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from figures import Figures
from machine import machine_name

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.line_campaigns import ANY, Kills, in_doubt, kill_block
from tilefab.pipeline.line.probe import CORRECTION_STEPS, STEPS

_AT_ONCE = 100


def _blocks(steps: list[str], each: int, kills: int) -> list[tuple[str, int, bool]]:
    """Steps, how often to kill at each, and whether over RTU."""
    blocks = [(step, each, False) for step in steps]
    left = kills - each * len(steps)
    while left > 0:
        blocks.append((ANY, min(_AT_ONCE, left), len(blocks) % 2 == 0))
        left -= _AT_ONCE
    return blocks


def main() -> int:
    """Kill daemons, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=100, help="kills at each step")
    parser.add_argument("--kills", type=int, default=3000, help="kills in all; those left over come at any moment")
    parser.add_argument("--jobs", type=int, default=2, help="plants at once")
    parser.add_argument("--steps", nargs="*", default=[*STEPS, *CORRECTION_STEPS], help="only these")
    parser.add_argument("--seed", type=int, default=1, help="of what is left to chance")
    arguments = parser.parse_args()
    figures = Figures()
    figures.title(f"Daemons killed\n{machine_name()}")
    begin = time.perf_counter()
    blocks = _blocks(arguments.steps, arguments.each, arguments.kills)
    columns = ("kills", "faces", "lost", "doubled", "wrong", "in doubt", "scrapped")
    print(f"{'step':<22}" + "".join(f"{column:>9}" for column in columns))
    rows: list[Kills] = []
    with (
        tempfile.TemporaryDirectory(prefix="tilefab-kills-") as folder,
        ProcessPoolExecutor(arguments.jobs, mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        futures = [
            pool.submit(kill_block, Path(folder) / str(number), step, kills, arguments.seed + number, rtu=rtu)
            for number, (step, kills, rtu) in enumerate(blocks)
        ]
        for future, (step, _, rtu) in zip(futures, blocks, strict=True):
            row = future.result()
            rows.append(row)
            scrapped = row.faces["diverted"] + row.faces["partial"]
            faces = sum(row.faces.values())
            values = (row.kills, faces, row.lost, row.doubled, len(row.wrong), in_doubt(row.faces), scrapped)
            print(f"{step + (', RTU' if rtu else ''):<22}" + "".join(f"{value:>9}" for value in values), flush=True)
            for text in row.wrong[:10]:
                print(f"    {text}", flush=True)
    kills, wrong = sum(row.kills for row in rows), sum(len(row.wrong) for row in rows)
    print()
    figures.check("kills", str(kills), kills >= arguments.kills, f"at least {arguments.kills}")
    figures.check("least at a step", str(min(row.kills for row in rows if row.step != ANY)), True, f"{arguments.each}")
    figures.check("faces lost, doubled, silently skipped, or passed wrong", str(wrong), wrong == 0, "0")
    figures.note("faces in doubt, told to the operator", str(sum(in_doubt(row.faces) for row in rows)))
    figures.note("took", f"{time.perf_counter() - begin:.0f} s")
    figures.end()
    return int(figures.reached < figures.judged)


if __name__ == "__main__":
    sys.exit(main())
