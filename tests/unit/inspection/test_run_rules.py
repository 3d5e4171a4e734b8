"""Each of Nelson's rules by a pattern that just fulfils it and one that just doesn't, and by how often chance does."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.inspection.run_rules import LONGEST, RULES, chance_rates, count_findings, nelson_rules, newest_rules


def found(values: list[float], rule: int) -> list[int]:
    return [int(place) for place in nelson_rules(values, 0.0, 1.0)[rule - 1]]


def zigzag(count: int) -> list[float]:
    return [0.3 + 0.01 * place if place % 2 else -0.3 - 0.01 * place for place in range(count)]


@pytest.mark.parametrize(
    ("rule", "values", "expected"),
    [
        (1, [0.0, 3.01, -3.01, 3.0], [1, 2]),
        (2, [0.1] * 9, [8]),
        (2, [-0.1] * 11, [8, 9, 10]),
        (2, [0.1] * 8 + [0.0] + [0.1] * 8, []),
        (3, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [5]),
        (3, [0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0], [5, 6]),
        (3, [0.1, 0.2, 0.3, 0.3, 0.4, 0.5, 0.6], []),
        (4, zigzag(14), [13]),
        (4, zigzag(13), []),
        (5, [2.1, 0.0, 2.1], [2]),
        (5, [2.1, 2.1, 0.0], [1]),
        (5, [2.1, 0.0, 0.0, 2.1], []),
        (5, [2.1, -2.1, 0.0], []),
        (6, [1.1, 1.1, 0.0, 1.1, 1.1], [4]),
        (6, [-1.1, -1.1, -1.1, -1.1, 0.0], [3]),
        (6, [1.1, 1.1, -1.1, 0.0, 1.1], []),
        (7, [0.9, -0.9] * 7 + [0.9], [14]),
        (7, [0.9, -0.9] * 6 + [1.1, 0.9, -0.9], []),
        (8, [1.1, -1.1, 2.0, -2.0] * 2, [7]),
        (8, [1.1, -1.1, 2.0, 0.9, -2.0, 1.1, 1.1, -1.1], []),
    ],
)
def test_each_rule(rule: int, values: list[float], expected: list[int]) -> None:
    assert found(values, rule) == expected


def test_centre_and_sigma_are_used() -> None:
    values = 10.0 + 0.2 * np.array([0.0, 3.5, 0.0])
    assert nelson_rules(values, 10.0, 0.2)[0].tolist() == [1]


@given(st.lists(st.floats(-5.0, 5.0), max_size=60))
def test_rules_know_no_side_and_no_scale(values: list[float]) -> None:
    one = nelson_rules(values, 0.0, 1.0)
    assert len(one) == len(RULES) == 8
    for mirrored in (
        nelson_rules([-value for value in values], 0.0, 1.0),
        nelson_rules([4.0 * v for v in values], 0.0, 4.0),
    ):
        assert [rule.tolist() for rule in one] == [rule.tolist() for rule in mirrored]
    for rule in one:
        assert rule.dtype == np.int64
        assert (np.diff(rule) > 0).all()


@given(st.lists(st.floats(-4.0, 4.0), min_size=1, max_size=40))
def test_the_newest_points_suffice(values: list[float]) -> None:
    everything = nelson_rules(values, 0.0, 1.0)
    last = tuple(rule for rule, points in enumerate(everything, 1) if len(values) - 1 in points)
    assert newest_rules(values[-LONGEST:]) == last


@pytest.mark.parametrize(("values", "sigma"), [([math.nan], 1.0), ([[1.0]], 1.0), ([1.0], 0.0), ([1.0], math.nan)])
def test_refuses_what_is_no_series(values: list[float], sigma: float) -> None:
    with pytest.raises(ValueError, match="must be finite"):
        nelson_rules(values, 0.0, sigma)


def test_nothing_gives_nothing() -> None:
    assert [rule.size for rule in nelson_rules([], 0.0, 1.0)] == [0] * 8
    assert newest_rules([]) == ()
    assert [finding.points for finding in count_findings([])] == [0] * 8


def test_chance_is_as_counted() -> None:
    # 600 000 values: each rate's standard error is below 6 % of it but for the rarest, which clusters most.
    values = np.random.default_rng(12).standard_normal(600_000)
    for finding in count_findings(values):
        assert finding.points == pytest.approx(finding.by_chance, rel=0.5 if finding.rule == 8 else 0.12)


def test_chance_of_zigzags_by_trying_all_orders() -> None:
    # Rule 4's rate is 2 E / n!; here the same count for 7 points, by hand: E7 = 272.
    ups = sum(
        all((after > before) == (place % 2 == 0) for place, (before, after) in enumerate(itertools.pairwise(order)))
        for order in itertools.permutations(range(7))
    )
    assert ups == 272
    assert chance_rates()[3] == pytest.approx(2 * 199_360_981 / math.factorial(14))
