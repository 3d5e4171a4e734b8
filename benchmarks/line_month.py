"""Thirty days of the plant's time: the real daemon against the real simulator, with random faults of every kind.

Usage: python benchmarks/line_month.py [--days N | --hours N] [--rate R] [--seed S] [--fault-every SECONDS] [--folder F]

The belt is slow in the plant's time, so that at rate 1000 a tile still takes 430 ms of the wall's clock from eye to
head and 330 ms from there to the diverter: the daemon's deadlines are on the wall's clock. Jobs come in bursts, with
pauses between. A kiln's set-points climb in wall time too, so recipes are luke-warm: a hot kiln that forgot its
set-points would need days of the plant's time. Memory and descriptors are sampled each hour of the plant's time. Exit
code 1 if memory grows by more than 5 % + 10 MB after the warm-up (the first day, or the first quarter of less), if
descriptors grow by more than 3, or if an invariant breaks.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from figures import Figures
from machine import machine_name

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.line_month import Month, Sample, Terms, live

MOST_SHARE, MOST_BYTES = 0.05, 10e6
MOST_FILES = 3
"""Connections are there or just being made anew; a leak of one a day would be far above."""

DAY_H = 24.0


def main() -> None:
    """Run it and print the figures; exit code 1 if one isn't reached."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--days", type=float, default=30.0, help="days of the plant's time")
    parser.add_argument("--hours", type=float, help="hours of it, instead of days")
    parser.add_argument("--rate", type=float, default=1000.0, help="plant seconds a wall second, at most 1000")
    parser.add_argument("--lot", type=int, default=120, help="faces of a job")
    parser.add_argument("--fault-every", type=float, default=3.0, help="mean wall seconds between two faults")
    parser.add_argument("--seed", type=int, default=1, help="of faults and operator")
    parser.add_argument("--folder", type=Path, help="where journal, log and truth are left; default: nowhere")
    arguments = parser.parse_args()
    hours = arguments.hours or arguments.days * DAY_H
    samples = None if hours > 2 * DAY_H else 48
    terms = Terms(hours, arguments.rate, arguments.lot, arguments.fault_every, arguments.seed, samples)
    with tempfile.TemporaryDirectory(prefix="tilefab-month-") as name:
        folder = arguments.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        month = live(folder, terms, lambda line: print(line, flush=True))
    figures = Figures()
    figures.title(f"{hours:g} hours of a line at rate {arguments.rate:g}, seed {arguments.seed}\n{machine_name()}")
    show(figures, month, hours)
    figures.end()
    raise SystemExit(figures.reached != figures.judged)


def show(figures: Figures, month: Month, hours: float) -> None:
    """Print what there was and what came of it."""
    seen, summary = month.told["seen"], month.summary
    figures.note("took", f"{month.wall_s / 60:.1f} minutes")
    figures.note("tiles", ", ".join(f"{summary[name]} {name}" for name in ("tiles", "passed", "diverted", "removed")))
    figures.note("out of the kiln", f"{summary['fired']} fired, {summary['broken']} broken")
    figures.note("prints", f"{summary['prints_complete']} whole, {summary['prints_partial']} in part")
    figures.note("faces", ", ".join(f"{many} {state}" for state, many in sorted(month.faces.items())))
    figures.note("faces rendered again to compare what was printed", str(month.checksums))
    figures.note("tiles without a face while running", str(month.told["blank"]))
    figures.note("arming p50 / p99.9", " / ".join(f"{ms:.1f}" for ms in month.told["arming_ms"]) + " ms")
    figures.note("faults set", str(sum(month.struck.values())))
    figures.note("  by kind", ", ".join(f"{kind} {many}" for kind, many in sorted(month.struck.items())))
    figures.note("  messages struck", str(month.messages_struck))
    for state in ("holding", "e_stopped", "faulted", "stopped", "running"):
        figures.note(f"times that the line came to be {state}", str(seen.get(state, 0)))
    figures.note("jobs taken up", str(seen.get("jobs taken up", 0)))
    alarms = {name.removeprefix("alarm "): many for name, many in seen.items() if name.startswith("alarm ")}
    figures.note("alarms", ", ".join(f"{code} {many}" for code, many in sorted(alarms.items())))
    figures.note(
        "operator", ", ".join(f"{name} {seen.get(name, 0)}" for name in ("ack", "resume", "start", "hold", "stop"))
    )
    _memory(figures, month.samples, hours)
    figures.check("hours lived through", f"{month.hours:.1f}", month.hours >= hours, f"{hours:g}")
    figures.check("faces settled", str(sum(month.faces.values())), bool(month.faces), "some")
    figures.check("invariants that broke", str(len(month.wrong)), not month.wrong, "0")
    for what in month.wrong:
        print(f"  {what}")


def _memory(figures: Figures, samples: list[Sample], hours: float) -> None:
    """Memory and descriptors, after the warm-up against the end."""
    part = DAY_H if hours >= 3 * DAY_H else hours / 4
    first = [sample for sample in samples if part <= sample.hour < 2 * part]
    last = [sample for sample in samples if sample.hour >= hours - part]
    warm = [sample for sample in samples if sample.hour >= part]
    if not first or not last:
        figures.check("samples of memory", str(len(samples)), False, "enough")
        return
    for name in samples[0].resident:
        before, after = (float(np.median([sample.resident[name] for sample in some])) for some in (first, last))
        days = [sample.hour / DAY_H for sample in warm]
        slope = np.polyfit(days, [sample.resident[name] for sample in warm], 1)[0] if len(warm) > 1 else 0.0
        most = MOST_SHARE * before + MOST_BYTES
        figures.check(
            f"resident memory of the {name}: first / last",
            f"{before / 1e6:.1f} / {after / 1e6:.1f} MB, {slope / 1e3:+.1f} kB a day",
            after - before <= most,
            f"at most {most / 1e6:.1f} MB more",
        )
        files = [int(np.median([sample.descriptors[name] for sample in some])) for some in (first, last)]
        shown = f"{files[0]} / {files[1]}"
        figures.check(
            f"open descriptors of the {name}", shown, files[1] - files[0] <= MOST_FILES, f"at most {MOST_FILES} more"
        )


if __name__ == "__main__":
    main()
