"""The line's state machine under arbitrary events: a sequence that breaks a rule ends it with the shortest one.

Usage: python benchmarks/line_machine.py [--sequences N] [--steps N] [--seed SEED]

The rules stand in tests/line_rules.py.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path
from typing import ClassVar, get_args

from figures import Figures
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.stateful import run_state_machine_as_test
from machine import machine_name

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.line_rules import LineRules
from tests.unit.control.test_line_machine_exhaustive import places
from tilefab.control.line_machine import Event, LineState

TO_REACH = 10_000
_ROUND = 1000


class Counted(LineRules):
    """Counts what the sequences came through."""

    sequences = 0
    steps = 0
    met: ClassVar[Counter[tuple[LineState, str]]] = Counter()
    reached: ClassVar[Counter[LineState]] = Counter()

    def __init__(self) -> None:
        super().__init__()
        self.states: set[LineState] = set()

    def happens(self, event: Event) -> None:
        """Count a step and take it."""
        before = self.line.state
        super().happens(event)
        Counted.steps += 1
        Counted.met[before, type(event).__name__] += 1
        self.states |= {before, self.line.state}

    def teardown(self) -> None:
        """Count a sequence."""
        if self.states:
            Counted.sequences += 1
            Counted.reached.update(self.states)


def main() -> None:
    """Run as many sequences as asked for, in rounds: hypothesis keeps what a round found until its end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=TO_REACH)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(machine_name())
    begin, rounds = time.perf_counter(), 0
    while Counted.sequences < options.sequences:
        wanted = settings(
            max_examples=min(_ROUND, options.sequences - Counted.sequences),
            stateful_step_count=options.steps,
            deadline=None,
            database=None,
            derandomize=False,
            phases=(Phase.generate, Phase.shrink),
            suppress_health_check=list(HealthCheck),
        )
        run_state_machine_as_test(seed(options.seed * 1_000_000 + rounds)(Counted), settings=wanted)
        rounds += 1
    figures = Figures()
    figures.title("The line's state machine, stateful testing")
    figures.check(
        "sequences without a broken rule", f"{Counted.sequences:,}", Counted.sequences >= TO_REACH, f"{TO_REACH:,}"
    )
    figures.note("steps", f"{Counted.steps:,} in {time.perf_counter() - begin:.0f} s")
    for state in LineState:
        figures.note(f"sequences that came to {state.name}", f"{Counted.reached[state]:,}")
    pairs = len(LineState) * len(get_args(Event))
    met = len(Counted.met)
    figures.check("pairs of state and event that were met", f"{met} of {pairs}", met == pairs, "all")
    figures.title("The same, exhaustively")
    begin = time.perf_counter()
    lines, steps = places()
    figures.note("lines that can come about", f"{len(lines):,}")
    figures.note("steps from them, all within the rules", f"{steps:,} in {time.perf_counter() - begin:.0f} s")
    figures.end()


if __name__ == "__main__":
    main()
