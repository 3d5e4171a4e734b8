"""The line under hypothesis' stateful testing; `benchmarks/line_machine.py` runs far more sequences of the same."""

from __future__ import annotations

from hypothesis import settings
from hypothesis.stateful import run_state_machine_as_test

from tests.line_rules import LineRules


def test_whatever_happens_the_rules_hold() -> None:
    run_state_machine_as_test(
        LineRules, settings=settings(max_examples=400, stateful_step_count=50, deadline=None, database=None)
    )
