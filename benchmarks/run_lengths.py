"""Average run lengths of the control charts: published ones, by the integral equation, and by simulation.

Usage: python benchmarks/run_lengths.py [--runs N] [--seed SEED]

Also how often the eight Nelson rules and the charts of the watch signal when nothing is wrong. Ends with 1 if a figure
is more than 2 % off the published one.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from figures import Figures
from machine import machine_name

from tilefab.inspection.run_lengths import Chart, average_run_length, simulate_run_lengths
from tilefab.inspection.run_rules import count_findings, nelson_rules
from tilefab.inspection.spc import CusumChart, EwmaChart, ShewhartChart

_MOST_OFF_PERCENT = 2.0

# Montgomery, "Introduction to Statistical Quality Control", chapters 5 (single values) and 9 (CUSUM); Lucas and
# Saccucci, Technometrics 32 (1990) (EWMA).
_PUBLISHED: tuple[tuple[str, Chart, float, float], ...] = (
    ("single values, 3 sigma", ShewhartChart(3.0), 0.0, 370.4),
    ("CUSUM, k 0.5, h 5", CusumChart(0.5, 5.0), 0.0, 465.0),
    ("EWMA, weight 0.2, limit 2.962", EwmaChart(0.2, 2.962), 0.0, 500.0),
)
_SHIFTED: tuple[tuple[str, Chart, float, float], ...] = (
    ("single values, 3 sigma", ShewhartChart(3.0), 1.0, 43.9),
    ("CUSUM, k 0.5, h 5", CusumChart(0.5, 5.0), 1.0, 10.4),
    ("EWMA, weight 0.2, limit 2.962", EwmaChart(0.2, 2.962), 1.0, 10.5),
)


def _off_percent(found: float, published: float) -> float:
    return 100.0 * (found / published - 1.0)


def _first_rule(generator: np.random.Generator, runs: int) -> float:
    """Mean number of values until any of the eight rules first finds something."""
    lengths = []
    for _ in range(runs):
        length, z = 0, generator.standard_normal(0)
        while length == 0:
            z = np.concatenate((z, generator.standard_normal(400)))
            points = [int(rule[0]) for rule in nelson_rules(z, 0.0, 1.0) if rule.size]
            length = min(points) + 1 if points else 0
        lengths.append(length)
    return float(np.mean(lengths))


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200_000, help="simulated runs of each chart")
    parser.add_argument("--seed", type=int, default=1, help="of the simulation")
    arguments = parser.parse_args()
    figures = Figures()
    for name, rows in (("Nothing wrong", _PUBLISHED), ("Mean shifted by one standard deviation", _SHIFTED)):
        figures.title(f"{name}: average run length, {arguments.runs} simulated runs\n{machine_name()}")
        for what, chart, shift, published in rows:
            begun = time.perf_counter()
            found = simulate_run_lengths(chart, arguments.runs, shift=shift, seed=arguments.seed)
            took = time.perf_counter() - begun
            solved = average_run_length(chart, shift)
            for way, value, note in (
                ("simulated", found.mean, f"± {found.standard_error:.2f}, {took:.1f} s"),
                ("by equation", solved, ""),
            ):
                off = _off_percent(value, published)
                figures.check(
                    f"{what}, {way} (published {published:g})",
                    f"{value:.2f} {note}, off {off:+.2f} %".replace(" ,", ","),
                    abs(off) <= _MOST_OFF_PERCENT,
                    f"within {_MOST_OFF_PERCENT:g} %",
                )
    figures.title("The eight Nelson rules when nothing is wrong: share of points, %")
    values = np.random.default_rng(arguments.seed).standard_normal(20 * arguments.runs)
    for rule in count_findings(values):
        shares = f"{100 * rule.points / values.size:.3f}, by counting {100 * rule.by_chance / values.size:.3f}"
        figures.note(f"{rule.rule}: {rule.text}", shares)
    mean = _first_rule(np.random.default_rng(arguments.seed), max(arguments.runs // 100, 100))
    figures.note("values until any of the eight first finds something, mean", f"{mean:.1f}")
    figures.end()
    return int(figures.reached < figures.judged)


if __name__ == "__main__":
    sys.exit(main())
