"""Some hundred faults on each wire; `benchmarks/line_wire.py` puts a hundred thousand on them."""

from __future__ import annotations

import pytest

from tests.unit.devices.wire_faults import KINDS, run


@pytest.mark.parametrize("wire", ["tcp", "rtu", "printer"])
def test_no_wrong_value_is_acted_on(wire):
    tally = run(wire, 150, seed=3)
    assert tally.wrong == 0
    assert set(tally.faults) == set(KINDS)
    assert tally.answered > 50, "what is sound gets through"


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_the_judge_finds_the_wrong_values_of_the_plain_client(wire, caplog):
    caplog.set_level("CRITICAL")
    assert run(wire, 100, seed=3, plain=True).wrong > 0
