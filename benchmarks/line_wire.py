"""Faults on the wires of the line: garbled, truncated, noisy, late, doubled and reordered answers.

Usage: python benchmarks/line_wire.py [--faults N] [--seed SEED]

Scripted devices on loopback sockets and ptys tell something else at each answer, and remember it, so that every value
that a session hands on can be held against what its device sent for this very request. A value counts as wrong if it
isn't that one; so does a command that is told to be done and isn't, and an arm that the printer acted on twice. The
plain client of pymodbus runs against the same devices for comparison.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from pathlib import Path

from figures import Figures
from machine import machine_name

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.unit.devices.wire_faults import KINDS, Tally, Wire, run

CONNECTIONS = 24
PLAIN_SHARE = 20
NAMES: dict[Wire, str] = {"tcp": "Modbus TCP", "rtu": "Modbus RTU", "printer": "printer, TFP 1"}


def said(tally: Tally, begin: float) -> str:
    """What came of a run, in a line."""
    kinds = ", ".join(f"{tally.faults[kind]} {kind}" for kind in KINDS)
    return (
        f"{tally.faults.total()} faults ({kinds}) in {tally.calls} calls, {tally.answered} of them answered; "
        f"{time.perf_counter() - begin:.0f} s"
    )


def main() -> int:
    """Run; the exit code tells whether what was to reach was reached."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    # What the plain client thinks of these faults would fill the screen.
    for name in ("pymodbus.logging", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    figures = Figures()
    print(machine_name())
    figures.title("Wrong values acted on")
    total = wrong = 0
    for wire, name in NAMES.items():
        begin = time.perf_counter()
        share = options.faults // len(NAMES) + (options.faults % len(NAMES) if wire == "tcp" else 0)
        tally = run(wire, share, seed=options.seed, connections=CONNECTIONS)
        total, wrong = total + tally.faults.total(), wrong + tally.wrong
        figures.note(name, f"{tally.wrong} wrong, {said(tally, begin)}")
    figures.check(f"all wires, {total} faults", f"{wrong} wrong", wrong == 0 and total >= options.faults, "0 wrong")
    figures.title("For comparison")
    few = max(options.faults // PLAIN_SHARE, 100)
    for wire in ("tcp", "rtu"):
        begin = time.perf_counter()
        tally = run(wire, few, seed=options.seed, connections=CONNECTIONS, plain=True)
        figures.note(f"{NAMES[wire]}, plain pymodbus", f"{tally.wrong} wrong, {said(tally, begin)}")
        begin = time.perf_counter()
        tally = run(wire, few, seed=options.seed, connections=CONNECTIONS, sums=False)
        figures.note(f"{NAMES[wire]}, controller without check words", f"{tally.wrong} wrong, {said(tally, begin)}")
    return 0 if figures.reached == figures.judged else 1


if __name__ == "__main__":
    sys.exit(main())
