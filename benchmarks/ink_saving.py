"""Ink that device links save on pictures of stone, and what it costs in colour: tilefab's link against Argyll's.

Usage: python benchmarks/ink_saving.py [--collink-quality l|m|h]

Pictures become CMYK through a profile's own separation, sRGB to relative colorimetric, in 16 bit; then they go through
a link from that profile to itself. Little CMS does both. Colours before and after are those of a press that prints
the published patches exactly (FOGRA39L), and shares no code with either maker's.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from figures import Figures, mean_p95
from machine import machine_name
from numpy.typing import NDArray
from outside import judges, link_library, linked, printed_counts
from PIL import Image
from press_data import (
    Float64Array,
    NotBuiltError,
    TruePress,
    argyll_missing,
    argyll_profile,
    load_patches,
    run,
    shared_folder,
    tilefab,
    tilefab_profile,
    true_press,
    workshop,
    write_ti3,
)

LIMIT = 330.0
TO_SAVE_PERCENT = {"greenmarble": 34.0, "rough": 9.0}
MOST_DELTA_E = (0.5, 1.0)
TOP = 65535
OWNERS: dict[str, tuple[str, ...] | None] = {
    "tilefab (its default separation)": None,
    "Argyll -qm (its default, ramped black)": ("-qm",),
    "Argyll -qm -kz (least black)": ("-qm", "-kz"),
}
"""Who separates, with the options of colprof: what is left to save depends on how much black is there already."""
LINES, POINTS, STEP = 10_000, 41, 0.005


class Picture:
    """A picture's colours, each once, and how often."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB")).reshape(-1, 3)
        self.srgb, self.which = np.unique(pixels, axis=0, return_inverse=True)
        self.which = self.which.reshape(-1)

    def mean_total_percent(self, inks: NDArray[np.uint16]) -> float:
        """Mean total ink of the picture, from inks of its colours."""
        return float(100.0 / TOP * inks.sum(axis=1, dtype=np.int64)[self.which].mean())


def load_pictures() -> dict[str, Picture]:
    """The exemplars, or none, having said so."""
    folder = shared_folder("TILEFAB_TEXTURES", "textures")
    paths = {name: (folder or Path()) / name / "exemplar.png" for name in TO_SAVE_PERCENT}
    if folder is None or not all(path.is_file() for path in paths.values()):
        print("SKIPPED: no textures: let TILEFAB_TEXTURES name the folder that holds greenmarble and rough")
        return {}
    return {name: Picture(path) for name, path in paths.items()}


def report_saving(
    figures: Figures,
    maker: str,
    profile: Path,
    link: Path,
    pictures: dict[str, Picture],
    press: TruePress,
    judged: bool,
) -> None:
    """Print what a link saves on pictures that a profile separated, and the colour differences."""
    for name, picture in pictures.items():
        before = printed_counts(profile, picture.srgb, "u2", "relative")
        after = linked(link, before)
        inks = picture.mean_total_percent(before), picture.mean_total_percent(after)
        saved = 100.0 * (1.0 - inks[1] / inks[0])
        wanted, printed = (press(counts / TOP)[picture.which] for counts in (before, after))
        mean, p95 = mean_p95(printed, wanted)
        what = f"{maker} on {name}"
        shown = f"{saved:5.2f} % saved ({inks[0]:.1f} to {inks[1]:.1f} % ink), CIEDE2000 {mean:.3f} / {p95:.3f}"
        if judged:
            least = TO_SAVE_PERCENT[name]
            good = saved >= least and mean <= MOST_DELTA_E[0] and p95 <= MOST_DELTA_E[1]
            figures.check(what, shown, good, f"{least:g} % at {MOST_DELTA_E[0]:g} / {MOST_DELTA_E[1]:g}")
        else:
            figures.note(what, shown)
        most = 100.0 / TOP * int(after.sum(axis=1, dtype=np.int64).max())
        if most > LIMIT:
            figures.note(what, f"largest total ink {most:.2f} % is ABOVE the limit of {LIMIT:g} %")


def ink_lines(random: np.random.Generator) -> NDArray[np.float32]:
    """Straight lines (LINES, POINTS, 4) of inks in percent within the limit, in any direction."""
    kept: list[Float64Array] = []
    while sum(map(len, kept)) < LINES:
        start = random.random((4 * LINES, 4)) ** 2
        way = random.normal(size=start.shape)
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        lines = start[:, np.newaxis] + STEP * np.arange(POINTS)[:, np.newaxis] * way[:, np.newaxis]
        inside = ((lines >= 0.0) & (lines <= 1.0)).all(axis=(1, 2)) & (lines.sum(axis=2) <= LIMIT / 100.0).all(axis=1)
        kept.append(lines[inside])
    return np.asarray(100.0 * np.concatenate(kept)[:LINES], dtype=np.float32)


def report_smoothness(figures: Figures, maker: str, link: Path, lines: NDArray[np.float32]) -> None:
    """Print how inks change through a link along straight lines of inks."""
    out = linked(link, lines.reshape(-1, 4)).reshape(lines.shape).astype(np.float64)
    steps, bends = np.abs(np.diff(out, axis=1)), np.abs(np.diff(out, n=2, axis=1))
    figures.note(
        f"{maker}, along lines of inks, every {100 * STEP:g} % ink",
        f"second differences mean {bends.mean():.4f}, 99 % {np.percentile(bends, 99):.3f}, max {bends.max():.3f}; "
        f"largest step {steps.max():.3f} % ink",
    )


def make_link(maker: str, profile: Path, link: Path, quality: str, picture: Path | None) -> float:
    """A link from a profile to itself, tilefab's for a picture if one is given; CPU seconds."""
    if maker == "tilefab":
        for_picture = () if picture is None else ("--image", picture)
        return tilefab("profile", "link", "--from", profile, "--to", profile, *for_picture, "-o", link)
    if argyll_missing():
        raise NotBuiltError(argyll_missing())
    return run(["collink", f"-q{quality}", "-G", "-ir", "-kx", f"-l{LIMIT:g}", profile, profile, link])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--collink-quality", choices=("l", "m", "h"), default="h")
    quality = parser.parse_args().collink_quality
    patches, pictures = load_patches("FOGRA39L"), load_pictures()
    if patches is None or not pictures:
        return
    if link_library() is None:
        print("SKIPPED: liblcms2 is not installed: without it nobody else applies links")
        return
    print(f"on {machine_name()}\njudged by {judges()}; links in 16 bit by the system's liblcms2")
    press, lines, figures = true_press(patches), ink_lines(np.random.default_rng(41)), Figures()
    makers = ("tilefab", f"Argyll collink -q{quality} -G -kx")
    with workshop() as folder:
        ti3 = write_ti3(folder / "FOGRA39L.ti3", patches, "FOGRA39L")
        for owner, options in OWNERS.items():
            figures.title(f"from the profile of {owner} of FOGRA39L to itself, ink limit {LIMIT:g} %")
            profile = folder / f"{owner.split()[0]}.icc"
            try:
                if options is None:
                    tilefab_profile(ti3, profile, LIMIT, "--version", "2")
                else:
                    argyll_profile(ti3, profile, *options, f"-l{LIMIT:g}")
            except NotBuiltError as error:
                figures.note(owner, f"not measured: {error}")
                continue
            # A link of tilefab's is made for a slab; without one, for the whole gamut.
            tasks: list[tuple[str, str, dict[str, Picture]]] = [
                ("tilefab", name, {name: pictures[name]}) for name in pictures
            ]
            tasks += [("tilefab", "", pictures), (makers[1], "", pictures)]
            for maker, name, shown in tasks:
                link = folder / "link.icc"
                title = f"{maker} for any picture" if maker == "tilefab" and not name else maker
                try:
                    seconds = make_link(maker, profile, link, quality, pictures[name].path if name else None)
                except NotBuiltError as error:
                    figures.note(title, f"not measured: {error}")
                    continue
                report_saving(figures, title, profile, link, shown, press, bool(name))
                report_smoothness(figures, title, link, lines)
                figures.note(f"{title}, making the link", f"{seconds:.1f} CPU s")
    figures.end()


if __name__ == "__main__":
    main()
