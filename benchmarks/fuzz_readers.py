"""Damaged ICC profiles and measurement files through their readers: an error that explains, or a sound result.

Usage: python benchmarks/fuzz_readers.py [--count N] [--seed SEED]

A crash, an error of another kind or an unsound result ends it with the exception.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

from machine import machine_name

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.unit.io.test_cgats_kinds import fuzz as damage_and_read_cgats
from tests.unit.io.test_icc_fuzz import damage_and_read as damage_and_read_icc

MOST_MEGABYTES = 500.0


def peak_megabytes() -> float:
    """Most memory that this process ever held."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def report(what: str, work: Callable[[], str]) -> None:
    """Run one fuzz, and print what came of it."""
    before, begin = peak_megabytes(), time.perf_counter()
    said = work()
    grown = peak_megabytes() - before
    verdict = "reached" if grown < MOST_MEGABYTES else "NOT reached"
    print(
        f"{what}: {said}; {time.perf_counter() - begin:.1f} s, {grown:.1f} MB above the {before:.1f} MB before "
        f"(to reach: below {MOST_MEGABYTES:g} MB: {verdict})",
        flush=True,
    )


def main() -> None:
    """Damage, read and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    count, seed = arguments.count, arguments.seed
    print(f"on {machine_name()}")

    def icc() -> str:
        sound = damage_and_read_icc(count, seed)
        return f"{count} damaged profiles, {sound} of their tables sound, the rest refused"

    def cgats() -> str:
        accepted, refused = damage_and_read_cgats(count, seed)
        if accepted + refused != count:
            raise AssertionError(f"{count - accepted - refused} files gave an unsound result or an unclear message")
        return f"{count} damaged measurement files, {accepted} read and sound, {refused} refused in a line"

    report("ICC profiles", icc)
    report("CGATS and .ti3", cgats)


if __name__ == "__main__":
    main()
