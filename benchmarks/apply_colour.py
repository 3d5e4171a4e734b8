"""How fast images go through colour tables on one core, against Little CMS in the same run, and how well both agree.

Usage: python benchmarks/apply_colour.py [--rows ROWS] [--cols COLS] [--threads THREADS]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import imagecodecs
import numpy as np
from machine import machine_name
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.colour.grid_bake import bake
from tilefab.colour.grid_float import apply_float
from tilefab.colour.grid_table import compile_table
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, lab_from_xyz, rgb_lin_from_srgb
from tilefab.colour.stages import ColourTable, Float64Array
from tilefab.io.icc import read_icc_profile
from tilefab.io.icc_tables import device_to_pcs, pcs_to_device
from tilefab.pipeline.plan import shipped_profiles

RUNS = 5
INTENT = 1  # relative, as Little CMS counts them
GRID_OF_LCMS = 33


def best_seconds(*works: Callable[[], object]) -> list[float]:
    """Shortest of several runs of each, in turn, after one that doesn't count: others share the machine."""
    times: list[list[float]] = [[] for _ in works]
    for _ in range(RUNS + 1):
        for work, spent in zip(works, times, strict=True):
            begin = time.perf_counter()
            work()
            spent.append(time.perf_counter() - begin)
    return [min(spent[1:]) for spent in times]


def made_up_picture(rows: int, cols: int, channels: int) -> NDArray[np.uint16]:
    """Soft figure, hard veins and the grain of a scanner, in 16 bits."""
    random = np.random.default_rng(channels)
    picture = np.empty((rows, cols, channels), np.uint16)
    figure = ndimage.gaussian_filter(random.normal(0, 1, (rows // 10 + 1, cols // 10 + 1)), 20)
    veins = np.abs(figure) < 0.1 * figure.std()
    for channel in range(channels):
        own = ndimage.gaussian_filter(random.normal(0, 1, figure.shape), 30)
        coarse = 0.55 + 0.15 * figure / figure.std() + 0.05 * own / own.std() - 0.2 * veins
        wide = ndimage.zoom(coarse.astype(np.float32), 10, order=1)[:rows, :cols]
        wide += random.standard_normal((rows, cols), dtype=np.float32) * np.float32(0.02)
        picture[:, :, channel] = np.clip(wide, 0, 1) * 65535
    return picture


def ink_from_rgb(lab_to_ink: ColourTable) -> Callable[[Float64Array], Float64Array]:
    """A chain of sRGB, CIELAB and inks."""

    def convert(rgb: Float64Array) -> Float64Array:
        return lab_to_ink(lab_from_xyz(rgb_lin_from_srgb(rgb) @ XYZ_D50_FROM_RGB_LIN.T))

    return convert


def made_up_inks(count: int) -> Callable[[Float64Array], Float64Array]:
    """Smooth inks of no press: only their number counts."""
    weights = np.random.default_rng(count).normal(0, 2, (3, count))
    return lambda rgb: 1.0 / (1.0 + np.exp(rgb @ weights))


class Lcms:
    """Little CMS on one conversion between sRGB or a press and that press."""

    def __init__(self, profile: bytes, source: str) -> None:
        self.source = imagecodecs.cms_profile("srgb") if source == "rgb" else profile
        self.target, self.space = profile, source

    def __call__(self, image: NDArray[Any], out: NDArray[Any]) -> object:
        """Convert an image."""
        return imagecodecs.cms_transform(
            image, self.source, self.target, colorspace=self.space, outcolorspace="cmyk", intent=INTENT, out=out
        )

    def inks(self, values: Float64Array) -> Float64Array:
        """Its own floating point, where nothing is resampled: values (M, I) 0 to 1 to inks (M, 4)."""
        scale = 100.0 if self.space == "cmyk" else 1.0
        data = (scale * values[np.newaxis]).astype(np.float32)
        found = imagecodecs.cms_transform(
            data, self.source, self.target, colorspace=self.space, outcolorspace="cmyk", outdtype="f4", intent=INTENT
        )
        return np.clip(np.asarray(found[0], dtype=np.float64) / 100.0, 0.0, 1.0)


def measure(
    what: str, table: ColourTable, pictures: dict[str, NDArray[np.uint16]], lcms: Lcms | None, threads: int
) -> None:
    """Print million pixels a second of a table, and of Little CMS."""
    for dtype in (np.uint8, np.uint16):
        compiled = compile_table(table, dtype, dtype)
        for name, picture in pictures.items():
            image = (picture >> 8).astype(np.uint8) if dtype == np.uint8 else picture
            million = image.shape[0] * image.shape[1] / 1e6
            out = np.zeros((*image.shape[:2], compiled.outputs), dtype)
            works: list[Callable[[], object]] = [lambda c=compiled, i=image, o=out: c.apply(i, threads=threads, out=o)]
            if lcms is not None:
                theirs = np.zeros_like(out)
                works.append(lambda i=image, o=theirs: lcms(i, o))
            speeds = [million / seconds for seconds in best_seconds(*works)]
            ratio = "no peer" if lcms is None else f"lcms2 {speeds[1]:5.1f}, {speeds[0] / speeds[1]:.1f} times as fast"
            print(f"{what}, {8 * np.dtype(dtype).itemsize:2} bit, {name}: {speeds[0]:5.1f} Mpx/s ({ratio})")


def compare(what: str, table: ColourTable, lcms: Lcms, picture: NDArray[np.uint16]) -> None:
    """Print differences from Little CMS in counts."""
    parts = []
    for dtype in (np.uint8, np.uint16):
        image = (picture >> 8).astype(np.uint8) if dtype == np.uint8 else picture
        theirs = np.zeros((*image.shape[:2], 4), dtype)
        lcms(image, theirs)
        ours = compile_table(table, dtype, dtype).apply(image)
        exact = np.rint(table(image / np.iinfo(dtype).max) * np.iinfo(dtype).max)
        away = np.abs(ours.astype(np.int64) - theirs)
        own, peer = np.abs(exact - ours).max(), np.abs(exact - theirs).max()
        parts.append(
            f"{8 * np.dtype(dtype).itemsize} bit max {away.max()}, mean {away.mean():.3f} "
            f"(from the float table: ours max {own:.0f}, lcms2 {peer:.0f})"
        )
    print(f"{what}, difference from lcms2 in counts: {'; '.join(parts)}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=4000)
    parser.add_argument("--cols", type=int, default=6000)
    parser.add_argument("--threads", type=int, default=1, help="of tilefab; Little CMS always has one")
    arguments = parser.parse_args()
    shape, threads = (arguments.rows, arguments.cols), arguments.threads
    profile = read_icc_profile(shipped_profiles() / "demo_ceramic.icc")
    backward, forward = pcs_to_device(profile, "relative"), device_to_pcs(profile, "relative")
    print(f"{shape[1]} x {shape[0]} pixels, threads: {threads}, best of {RUNS} runs, on {machine_name()}")
    print(f"peer: {imagecodecs.cms_version()}")
    random = np.random.default_rng(0)
    rgb, cmyk = Lcms(profile.data, "rgb"), Lcms(profile.data, "cmyk")
    three = {"picture": made_up_picture(*shape, 3), "noise": random.integers(0, 65536, (*shape, 3), dtype=np.uint16)}
    four_inks = bake(ink_from_rgb(backward), "rgb", "ink", 3)
    measure("RGB to 4 inks", four_inks, three, rgb, threads)
    measure("RGB to 8 inks", bake(made_up_inks(8), "rgb", "ink", 3), three, None, threads)
    lab = (three["picture"][:1000] / 655.35 - [0.0, 50.0, 50.0]).astype(np.float32)
    seconds = best_seconds(lambda: apply_float(backward, lab, threads=threads))[0]
    print(f"Lab to 4 inks, floating point, picture: {lab.shape[0] * lab.shape[1] / 1e6 / seconds:.1f} Mpx/s")
    small = [picture[:300, :400] for picture in three.values()]
    del three
    four = {"picture": made_up_picture(*shape, 4), "noise": random.integers(0, 65536, (*shape, 4), dtype=np.uint16)}
    measure("4 inks to 4 inks", bake((forward, backward), "ink", "ink", 4), four, cmyk, threads)
    # Little CMS reads tables from CIELAB trilinearly, so chains through them differ already at the nodes.
    for name, picture in zip(four, small, strict=True):
        same = bake(rgb.inks, "rgb", "ink", 3, nodes=GRID_OF_LCMS)
        compare(f"RGB to 4 inks, nodes as lcms2 has them, {name}", same, rgb, picture)
        compare(f"RGB to 4 inks, nodes from the profile's tetrahedra, {name}", four_inks, rgb, picture)


if __name__ == "__main__":
    main()
