"""Loss of power under the line's journal: un-synced writes are dropped at each sync, and between.

Usage: python benchmarks/line_power.py [--cases N] [--seed SEED]

Every case opens what is left, checks the database, and holds it against what was promised; the first that breaks a
promise ends it with the exception.
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

from tests.power_loss import WAYS, Unreachable
from tests.system.test_journal_power_loss import prove

CALLS = 40


def main() -> None:
    """Prove it, and print what was gone through."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000, help="losses of power")
    parser.add_argument("--seed", type=int, default=1, help="of calls and of what is left")
    arguments = parser.parse_args()
    figures = Figures()
    figures.title(f"Loss of power under the journal, SQLite\n{machine_name()}")
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="tilefab-power-") as folder:
        try:
            tally = prove(Path(folder), arguments.cases, seed=arguments.seed, calls=CALLS)
        except Unreachable as reason:
            figures.note("skipped", str(reason))
            return
    wanted = min(arguments.cases, 500)
    figures.check("losses of power", str(tally.cases), tally.cases >= wanted, f"at least {wanted}")
    figures.note("of these with something un-synced", str(tally.at_risk))
    for way in WAYS:
        figures.note(f"of what was un-synced there was left: {way}", str(tally.kinds[way]))
    for kind in ("kept what was promised", "also kept what was begun"):
        figures.note(kind, str(tally.kinds[kind]))
    # Any would have ended it.
    figures.check("promises broken, half-done calls seen, numbers given twice", "0", True, "0")
    figures.note("took", f"{time.perf_counter() - begin:.1f} s")
    figures.end()


if __name__ == "__main__":
    main()
