"""How near profiles come to presses, judged from outside: profile files, through their own tables, by other tools.

Usage: python benchmarks/press_profiles.py [--parts NAMES] [--argyll-high] [--argyll-seeds N]

held-out   500 noisy patches of published data, A2B against the other patches
simulated  500 and 1,000 noisy patches of two simulated presses, A2B against other recipes
round-trip the full FOGRA39L set: colours in gamut to inks by B2A, and these inks on the press
many-inks  the same for simulated presses of 6 and 8 inks, 1,000 noisy patches

Argyll's colprof builds from the same files in the same run. Rows say which tool looked the colours up.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from figures import Figures, mean_p95
from machine import machine_name
from outside import inks_of, judges, lab_of, largest_total_percent, tools_for
from press_data import (
    Float64Array,
    NotBuiltError,
    Patches,
    TruePress,
    argyll_profile,
    load_patches,
    tilefab_profile,
    true_press,
    workshop,
    write_ti3,
)

from sim.kiln import random_recipes
from sim.spectral_press import SpectralPress
from tilefab.chart.design import design_chart

NOISE = 0.3
SEEDS = (11, 12, 13)
LIMIT_A2B = 280.0  # of profiles whose B2A is not looked at; random training patches reach it
LIMIT = 330.0
MOST_CPU_SECONDS = 60.0
MANY_LIMIT = 300.0
MOST_INK_BITS = (("8 bit", "u1"), ("16 bit", "u2"))

Build = Callable[[Path, Path], float]


def report_a2b(
    figures: Figures, case: str, train: Patches, test: Patches, to_reach: tuple[float, float], argyll: bool
) -> None:
    """Build profiles from patches, and print how far their A2B tables are from others."""
    builders: list[tuple[str, Build]] = [("tilefab", partial(_tilefab, limit=LIMIT_A2B))]
    if argyll:
        builders.append(("Argyll -qm", partial(_argyll, options=("-qm", "-bn"))))
    with workshop() as folder:
        ti3 = write_ti3(folder / "train.ti3", train, case)
        for maker, build in builders:
            profile = folder / f"{maker.split()[0]}.icc"
            try:
                seconds = build(ti3, profile)
            except NotBuiltError as error:
                figures.note(f"{case}, {maker}", f"not measured: {error}")
                continue
            for tool in tools_for(profile):
                values = mean_p95(lab_of(profile, test.ink_frac, tool=tool), test.lab_d50)
                wanted = to_reach if maker == "tilefab" else None
                figures.row(f"{case}, {maker} ({tool})", values, wanted, f"[{seconds:.0f} CPU s]")


def _tilefab(ti3: Path, out: Path, *, limit: float, more: tuple[str, ...] = ()) -> float:
    return tilefab_profile(ti3, out, limit, *more)


def _argyll(ti3: Path, out: Path, *, options: tuple[str, ...]) -> float:
    return argyll_profile(ti3, out, *options)


def held_out(figures: Figures, argyll_seeds: int) -> None:
    """500 noisy patches of published data against the rest."""
    figures.title(
        "device to Lab, held-out patches of published data, 500 training patches with noise of 0.3\nmean / 95 %"
    )
    for name in ("FOGRA39L", "TR006"):
        patches = load_patches(name)
        if patches is None:
            continue
        bare = int(np.flatnonzero(patches.ink_frac.sum(axis=1) == 0.0)[0])
        for index, seed in enumerate(SEEDS):
            random = np.random.default_rng(seed)
            order = random.permutation(len(patches))
            order = np.concatenate([[bare], order[order != bare]])  # every chart has a bare patch
            train = patches.part(order[:500]).noisy(NOISE, random)
            case = f"{name}, seed {seed}"
            report_a2b(figures, case, train, patches.part(order[500:]), (0.20, 0.55), index < argyll_seeds)


def simulated(figures: Figures, argyll_seeds: int) -> None:
    """Noisy patches of simulated presses against other recipes."""
    figures.title("device to Lab, simulated press, random recipes up to 300 %, noise of 0.3, 3,000 others\nmean / 95 %")
    for name in ("offset4", "ceramic4"):
        press = SpectralPress(name)
        for index, seed in enumerate(SEEDS):
            random = np.random.default_rng(1000 + seed)
            tests = random_recipes(4, 3000, random)
            test = Patches(tests, press.lab(tests), press.ink_names)
            for count, to_reach in ((500, (0.35, 1.2)), (1000, (0.28, 0.9))):
                recipes = random_recipes(4, count, random)
                recipes[0] = 0.0
                train = Patches(recipes, press.lab(recipes), press.ink_names).noisy(NOISE, random)
                case = f"{name}, {count} patches, seed {seed}"
                report_a2b(figures, case, train, test, to_reach, index < argyll_seeds)


def round_trip(figures: Figures, argyll_high: bool) -> None:
    """Colours in gamut to inks to the press, from all of FOGRA39L."""
    patches = load_patches("FOGRA39L")
    if patches is None:
        return
    press, second = true_press(patches), true_press(patches, "thin_plate_spline")
    figures.title(f"Lab in gamut to inks to press, full FOGRA39L, ink limit {LIMIT:g} %\nmean / 95 %")
    within = patches.part(patches.ink_frac.sum(axis=1) <= LIMIT / 100.0)
    recipes = random_recipes(4, 5000, np.random.default_rng(7), LIMIT / 100.0)
    sets = {"random recipes": press(recipes), "patches": within.lab_d50}
    values = mean_p95(second(recipes), press(recipes))
    figures.row("the press, against another through the same patches", values, None, "how sure the judge is")
    builders: list[tuple[str, Build]] = [
        ("tilefab", partial(_tilefab, limit=LIMIT)),
        ("Argyll -qm", partial(_argyll, options=("-qm", f"-l{LIMIT:g}"))),
    ]
    if argyll_high:
        builders.append(("Argyll -qh", partial(_argyll, options=("-qh", f"-l{LIMIT:g}"))))
    with workshop() as folder:
        ti3 = write_ti3(folder / "FOGRA39L.ti3", patches, "FOGRA39L")
        for maker, build in builders:
            profile = folder / f"{maker.replace(' ', '')}.icc"
            try:
                seconds = build(ti3, profile)
            except NotBuiltError as error:
                figures.note(maker, f"not measured: {error}")
                continue
            ours = maker == "tilefab"
            _report_round_trip(figures, maker, profile, press, sets, (0.20, 0.50) if ours else None)
            _report_limit(figures, maker, profile, ours)
            if ours:
                figures.check(f"{maker}, build", f"{seconds:.1f} CPU s", seconds <= MOST_CPU_SECONDS, "60 CPU s")
            else:
                figures.note(f"{maker}, build", f"{seconds:.1f} CPU s")


def _report_round_trip(
    figures: Figures,
    maker: str,
    profile: Path,
    press: TruePress,
    sets: dict[str, Float64Array],
    to_reach: tuple[float, float] | None,
) -> None:
    for tool in tools_for(profile):
        printed = {name: press(inks_of(profile, lab, tool=tool)) for name, lab in sets.items()}
        for name, lab in sets.items():
            figures.row(f"{maker}, {name} ({tool})", mean_p95(printed[name], lab))
        every, wanted = np.concatenate(list(printed.values())), np.concatenate(list(sets.values()))
        figures.row(f"{maker}, all colours ({tool})", mean_p95(every, wanted), to_reach)


def _report_limit(figures: Figures, maker: str, profile: Path, ours: bool) -> None:
    for name, dtype in MOST_INK_BITS:
        most = largest_total_percent(profile, dtype)
        what, shown = f"{maker}, largest total ink, {name} (lcms2)", f"{most:.3f} %"
        if ours:
            figures.check(what, shown, most <= LIMIT, f"{LIMIT:g} % at most")
        else:
            figures.note(what, shown)


def many_inks(figures: Figures) -> None:
    """Colours in gamut to inks to simulated presses of 6 and 8 inks."""
    figures.title(
        f"Lab in gamut to inks to press, 1,000 patches with noise of 0.3, ink limit {MANY_LIMIT:g} %; no peer can"
        "\nmean / 95 %"
    )
    for name in ("ceramic6", "ceramic8"):
        press = SpectralPress(name)
        inks = len(press.ink_names)
        black = press.ink_names.index("Black")
        design = design_chart(inks, 1000, total_limit_percent=MANY_LIMIT, black_channel=black, seed=21)
        recipes = design.ink_percent / 100.0
        train = Patches(recipes, press.lab(recipes), press.ink_names).noisy(NOISE, np.random.default_rng(22))
        tests = _mixed_recipes(inks, 3000, np.random.default_rng(23))
        with workshop() as folder:
            profile = folder / "press.icc"
            try:
                ti3 = write_ti3(folder / "train.ti3", train, name)
                seconds = _tilefab(ti3, profile, limit=MANY_LIMIT, more=("--version", "2"))
                for what, recipes in tests.items():
                    wanted = press.lab(recipes)
                    printed = press.lab(inks_of(profile, wanted))
                    what = f"{name}, {what} (icclu)"
                    figures.row(what, mean_p95(printed, wanted), (0.5, 1.2), f"[{seconds:.0f} CPU s]")
                every = np.concatenate(list(tests.values()))
                values = mean_p95(lab_of(profile, every), press.lab(every))
                figures.row(f"{name}, device to Lab, the same recipes (icclu)", values)
            except (NotBuiltError, RuntimeError) as error:
                figures.note(name, f"not measured: {error}")


def _mixed_recipes(inks: int, count: int, random: np.random.Generator) -> dict[str, Float64Array]:
    """Recipes that use the inks: mixtures of all, and of one to four, as separations have them."""
    few = random.random((count, inks))
    ranks = random.random((count, inks)).argsort(axis=1).argsort(axis=1)
    few[ranks >= random.integers(1, 5, (count, 1))] = 0.0
    few *= np.minimum(1.0, MANY_LIMIT / 100.0 / few.sum(axis=1, keepdims=True))
    return {
        "mixtures of all inks": random_recipes(inks, count, random, MANY_LIMIT / 100.0),
        "mixtures of 1 to 4 inks": few,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="held-out,simulated,round-trip,many-inks", help="which, by commas")
    parser.add_argument("--argyll-high", action="store_true", help="round-trip: colprof -qh too, which takes minutes")
    parser.add_argument("--argyll-seeds", type=int, default=1, help="for how many seeds Argyll builds too")
    arguments = parser.parse_args()
    print(f"on {machine_name()}\njudged by {judges()}; differences are CIEDE2000")
    figures = Figures()
    parts: dict[str, Callable[[], None]] = {
        "held-out": lambda: held_out(figures, arguments.argyll_seeds),
        "simulated": lambda: simulated(figures, arguments.argyll_seeds),
        "round-trip": lambda: round_trip(figures, arguments.argyll_high),
        "many-inks": lambda: many_inks(figures),
    }
    chosen = arguments.parts.split(",")
    unknown = [name for name in chosen if name not in parts]
    if unknown:
        parser.error(f"no part is called {', '.join(unknown)}: choose of {', '.join(parts)}")
    for name in chosen:
        parts[name]()
    figures.end()


if __name__ == "__main__":
    main()
