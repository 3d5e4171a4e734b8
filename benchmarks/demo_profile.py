"""How near the demo profile comes to the simulated press it was made for, off its chart and without noise.

Usage: python benchmarks/demo_profile.py [--colours N]
"""

from __future__ import annotations

import argparse

import numpy as np
from machine import machine_name

from sim.press import CeramicPress
from tilefab.colour import delta_e_2000, relative_lab
from tilefab.io.icc import read_icc_profile
from tilefab.io.press_profile import press_transform
from tilefab.pipeline.plan import shipped_profiles

LIMIT = 2.8


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--colours", type=int, default=4000)
    count = parser.parse_args().colours
    profile = read_icc_profile(shipped_profiles() / "demo_ceramic.icc")
    press = CeramicPress()
    transform = press_transform(profile, "relative")
    random = np.random.default_rng(20261122)
    inks = random.random((4 * count, profile.channels))
    inks = inks[inks.sum(axis=1) <= LIMIT][:count]
    printed = press.lab(inks)
    white = press.lab(np.zeros((1, profile.channels)))[0]
    print(f"{profile.path.rpartition('/')[2]}, {len(inks)} random colours in gamut, on {machine_name()}")
    forward = transform.lab_from_inks(inks[None].astype(np.float32), intent="absolute")[0]
    report("inks to colour, profile against press", delta_e_2000(forward, printed))
    recipe = transform.inks_from_lab(relative_lab(printed, white)[None])[0]
    again = press.lab(recipe.astype(np.float64))
    report("wanted colour to inks to press", delta_e_2000(again, printed))
    print(f"largest total ink of a recipe: {100 * float(recipe.sum(axis=1).max()):.2f} %")


def report(what: str, delta_e: np.ndarray) -> None:
    """Print mean, 95th percentile and worst of some colour differences."""
    print(
        f"{what}: CIEDE2000 mean {delta_e.mean():.2f}, 95 % {np.percentile(delta_e, 95):.2f}, max {delta_e.max():.2f}"
    )


if __name__ == "__main__":
    main()
