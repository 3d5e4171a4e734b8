"""How smoothly a profile's inks change along straight lines in Lab: tilefab's against Argyll's, from the same data.

Usage: python benchmarks/smoothness.py [--lines N]

Lines lie within the gamut: no point of them is far from a colour that the press prints within the ink limit. Inks are
looked up by Little CMS in floating point, every half unit of Lab, so what bends is the tables.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from figures import Figures
from machine import machine_name
from outside import inks_of, judges
from press_data import (
    Float64Array,
    NotBuiltError,
    TruePress,
    argyll_profile,
    load_patches,
    tilefab_profile,
    true_press,
    workshop,
    write_ti3,
)
from scipy.spatial import cKDTree

LIMIT = 330.0
STEP = 0.5
POINTS = 41
REACH = 1.5  # a colour this near to a printed one is in gamut: as fine as the cloud of printed colours is
CLOUD = 150_000
JUMP_PERCENT = 2.0


def lines_in_gamut(press: TruePress, count: int, random: np.random.Generator) -> Float64Array:
    """Straight lines (count, POINTS, 3) of Lab with points `STEP` apart, all within the gamut."""
    recipes = random.random((CLOUD, 4)) ** random.choice([0.5, 1.0, 2.0], (CLOUD, 1))
    recipes[random.random((CLOUD, 4)) < 0.25] = 0.0
    recipes *= np.minimum(1.0, LIMIT / 100.0 / np.maximum(recipes.sum(axis=1, keepdims=True), 1e-9))
    cloud = press(recipes)
    tree = cKDTree(cloud)
    kept: list[Float64Array] = []
    found = 0
    while found < count:
        # Evenly in Lab, not where recipes crowd.
        start = random.uniform(cloud.min(axis=0), cloud.max(axis=0), (4 * count, 3))
        start = start[tree.query(start)[0] < REACH]
        way = random.normal(size=(len(start), 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        places = STEP * np.arange(POINTS)
        lines = start[:, np.newaxis] + places[:, np.newaxis] * way[:, np.newaxis]
        near = tree.query(lines.reshape(-1, 3), distance_upper_bound=REACH)[0].reshape(len(start), POINTS)
        kept.append(lines[np.isfinite(near).all(axis=1)])
        found += len(kept[-1])
    return np.concatenate(kept)[:count]


def report(figures: Figures, maker: str, profile: Path, lines: Float64Array) -> dict[str, float]:
    """Print how inks change along lines; the figures that are compared."""
    inks = 100.0 * inks_of(profile, lines.reshape(-1, 3)).reshape(*lines.shape[:2], -1)
    steps = np.abs(np.diff(inks, axis=1))
    bends = np.abs(np.diff(inks, n=2, axis=1))
    found = {
        "mean second difference": float(bends.mean()),
        "99 % of second differences": float(np.percentile(bends, 99)),
        "largest second difference": float(bends.max()),
        "largest step": float(steps.max()),
        f"steps above {JUMP_PERCENT:g} % ink, per thousand": float(1000.0 * (steps > JUMP_PERCENT).mean()),
    }
    for what, value in found.items():
        figures.note(f"{maker}, {what}", f"{value:.4f}")
    for name, channel in zip("CMYK", range(inks.shape[2]), strict=True):
        worst = f"bend {bends[..., channel].max():.3f}, step {steps[..., channel].max():.3f}"
        figures.note(f"{maker}, {name}", f"mean bend {bends[..., channel].mean():.4f}, largest {worst}")
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lines", type=int, default=10_000)
    arguments = parser.parse_args()
    patches = load_patches("FOGRA39L")
    if patches is None:
        return
    print(f"on {machine_name()}\njudged by {judges()}")
    press = true_press(patches)
    lines = lines_in_gamut(press, arguments.lines, np.random.default_rng(31))
    figures = Figures()
    figures.title(
        f"inks in percent along {len(lines)} lines in Lab, every {STEP:g}, FOGRA39L, limit {LIMIT:g} %, absolute"
    )
    found: dict[str, dict[str, float]] = {}
    with workshop() as folder:
        ti3 = write_ti3(folder / "FOGRA39L.ti3", patches, "FOGRA39L")
        for maker in ("Argyll -qm", "tilefab"):
            profile = folder / f"{maker.split()[0]}.icc"
            try:
                if maker == "tilefab":
                    tilefab_profile(ti3, profile, LIMIT)
                else:
                    argyll_profile(ti3, profile, "-qm", f"-l{LIMIT:g}")
                found[maker] = report(figures, maker, profile, lines)
            except NotBuiltError as error:
                figures.note(maker, f"not measured: {error}")
    if len(found) == 2:
        for what, ours in found["tilefab"].items():
            theirs = found["Argyll -qm"][what]
            figures.check(f"tilefab against Argyll, {what}", f"{ours:.4f}", ours <= theirs, f"{theirs:.4f}")
    figures.end()


if __name__ == "__main__":
    main()
