"""A kiln that has drifted: how near a state fitted to 48 patches comes to profiling the press anew.

Usage: python benchmarks/drift.py [--seeds N] [--presses NAMES]

A simulated press is measured and modelled; then it drifts in a random direction by a mean ΔE of 3. 48 random recipes
are fired and read with noise of 0.3, and a drift state is fitted to them. Beside it the press is profiled anew from a
chart of the same size as at first. Printed is how far colours that the drifted press can make, separated by each model,
come out wrong on it, and how far each model's colours are from those of random recipes.
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np
from figures import Figures, mean_p95
from machine import machine_name
from press_data import Float64Array

from sim.kiln import Firing, drift_of_size, random_recipes
from sim.spectral_press import SpectralPress
from tilefab.chart.design import design_chart
from tilefab.colour.drift import drifted, no_drift, update_drift
from tilefab.colour.press_model import PressModel, fit_press_model
from tilefab.colour.separation import SeparationSettings, Separator

PATCHES = {"ceramic4": 800, "ceramic6": 1000}
SMALL_CHART = 48
NOISE = 0.3
UPDATE_NOISE = 0.4
DRIFT_DELTA_E = 3.0
LIMIT = 280.0
TESTS = 2000
ABOVE = 0.3


def fitted(press: SpectralPress, firing: Firing | None, random: np.random.Generator) -> PressModel:
    """A press model of a full chart, read with noise."""
    inks = len(press.ink_names)
    black = press.ink_names.index("Black")
    chart = design_chart(inks, PATCHES[press.name], total_limit_percent=LIMIT, black_channel=black, seed=31)
    recipes = chart.ink_percent / 100.0
    return fit_press_model(recipes, press.lab(recipes, firing) + random.normal(0.0, NOISE, (len(recipes), 3)))


def printed_wrong(press: SpectralPress, firing: Firing, model: PressModel, wanted: Float64Array) -> tuple[float, float]:
    """Colours through a model to inks, and these on the press as it fires now, against the colours."""
    settings = SeparationSettings(total_limit=LIMIT / 100.0, black_channel=press.ink_names.index("Black"))
    inks = Separator(model, settings, threads=os.cpu_count() or 1).separate(wanted)
    return mean_p95(press.lab(np.clip(inks, 0.0, 1.0), firing), wanted)


def one_press(figures: Figures, name: str, seeds: int) -> None:
    """All drifts of a press."""
    press = SpectralPress(name)
    inks = len(press.ink_names)
    figures.title(
        f"{name}: profiled from {PATCHES[name]} patches, drift of mean ΔE {DRIFT_DELTA_E:g}, {SMALL_CHART} patches\n"
        "mean / 95 %"
    )
    profiled = fitted(press, None, np.random.default_rng(40))
    above = []
    for seed in range(1, seeds + 1):
        random = np.random.default_rng(4000 + seed)
        firing = drift_of_size(press, random, DRIFT_DELTA_E)
        recipes = random_recipes(inks, SMALL_CHART, random, LIMIT / 100.0)
        recipes[0] = 0.0
        read = press.lab(recipes, firing) + random.normal(0.0, NOISE, (SMALL_CHART, 3))
        began = time.process_time()
        state = update_drift(profiled, no_drift(inks), recipes, read, UPDATE_NOISE)
        seconds = time.process_time() - began
        tests = random_recipes(inks, TESTS, random, LIMIT / 100.0)
        wanted = press.lab(tests, firing)
        models = {
            "as profiled": profiled,
            "drift state": drifted(profiled, state),
            "profiled anew": fitted(press, firing, random),
        }
        wrong = {}
        for what, model in models.items():
            wrong[what] = printed_wrong(press, firing, model, wanted)
            figures.row(f"seed {seed}, {what}: colours printed", wrong[what])
            figures.row(f"seed {seed}, {what}: device to Lab", mean_p95(model.lab(tests), wanted))
        more = wrong["drift state"][0] - wrong["profiled anew"][0]
        above.append(more)
        figures.row(f"seed {seed}, drift state above profiled anew", (more,), None, f"[{seconds:.1f} CPU s]")
    figures.row(f"{name}, drift state above profiled anew, mean of seeds", (float(np.mean(above)),), (ABOVE,))
    figures.row(f"{name}, the same, worst seed", (max(above),), (ABOVE,))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, help="drifts of each press")
    parser.add_argument("--presses", default="ceramic4,ceramic6", help="which, by commas")
    arguments = parser.parse_args()
    print(f"on {machine_name()}\ndifferences are CIEDE2000")
    figures = Figures()
    for name in arguments.presses.split(","):
        if name not in PATCHES:
            parser.error(f"no press is called {name}: choose of {', '.join(PATCHES)}")
        one_press(figures, name, arguments.seeds)
    figures.end()


if __name__ == "__main__":
    main()
