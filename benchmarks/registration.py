"""How exactly an image of a fired tile is laid over its face, and what is then measured.

Usage: python benchmarks/registration.py [--tiles N] [--stones NAMES] [--pictures FILE ...] [--grid PX]

Faces of 150 mm are cut out of photographs of stone, fired with another tone and cast, and photographed at 4 pixels a
millimetre: turned, scaled by up to 2 %, lit unevenly by up to 15 %, blurred and noisy; whole, covered by up to 30 %, or
broken by up to 40 %; also with a tenth of the stone's contrast. Registration starts from corners that are off by up to
2.5 % of the side together and 1 % each. Errors are root mean squares in image pixels over what is seen of the face.
Beside them: errors of regions' colours, of the sides' lengths, and processor time of one thread.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from figures import Figures
from machine import machine_name
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from sim.tile_photo import PhotoConditions, PhotoOfTile, photo_conditions, photo_of
from tilefab.chart.finding import project
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, delta_e_2000, lab_from_xyz, rgb_lin_from_srgb
from tilefab.inspection.dimensions import measure_dimensions
from tilefab.inspection.finding import FoundTile, find_tile
from tilefab.inspection.light import even_light
from tilefab.inspection.measurement import colour_figures, difference_maps, region_colours
from tilefab.inspection.registration import register, start_matrix, warp_mask_to_face, warp_to_face
from tilefab.types import FloatImage, Mask, SizeMm

SIDE_MM, FACE_PX_PER_MM, CAMERA_PX_PER_MM = 150.0, 5.0, 4.0
STONES = ("gravel", "grass", "brick")
CASES: dict[str, dict[str, float]] = {"whole": {}, "covered": {"occluded": 0.3}, "broken": {"broken": 0.4}}
MOST_RMS_PX = 0.1
MOST_SECONDS = 1.5
EXPONENT, CAST = 1.04, (1.05, 1.0, 0.94)
Float64Array = NDArray[np.float64]


def stones(names: list[str], files: list[Path]) -> dict[str, FloatImage]:
    """Linear light of stones, by name."""
    from skimage import data

    out = {}
    for name in names:
        grey = rgb_lin_from_srgb(getattr(data, name)() / 255.0)
        out[name] = np.repeat(grey[:, :, np.newaxis], 3, axis=2).astype(np.float32)
    for path in files:
        pixels = np.asarray(Image.open(path).convert("RGB"))
        out[f"{path.parent.name}/{path.stem}"] = rgb_lin_from_srgb(pixels / 255.0).astype(np.float32)
    return out


def a_face(stone: FloatImage, random: np.random.Generator, contrast: float) -> FloatImage:
    """A part of the stone, mirrored on where it ends, as large as a tile."""
    side = round(SIDE_MM * FACE_PX_PER_MM)
    picked = []
    for length in stone.shape[:2]:
        there = np.concatenate([np.arange(length), np.arange(length)[::-1]])
        picked.append(np.resize(np.roll(there, -int(random.integers(2 * length))), side))
    face = stone[np.ix_(picked[0], picked[1])]
    mean = face.mean(axis=(0, 1))
    return np.ascontiguousarray(np.clip(0.04 + 0.7 * (mean + contrast * (face - mean)), 0.0, 1.0), dtype=np.float32)


def xyz_of(rgb_lin: NDArray[np.floating]) -> FloatImage:
    """XYZ of linear sRGB."""
    return np.ascontiguousarray(rgb_lin @ XYZ_D50_FROM_RGB_LIN.T, dtype=np.float32)


def seen_places(photo: PhotoOfTile, conditions: PhotoConditions, mask: Mask, side: int) -> Float64Array:
    """Places of the face, in its pixels, that the image shows."""
    x, y = np.meshgrid(np.linspace(0.02, 0.98, 13), np.linspace(0.02, 0.98, 13))
    shares = np.stack([x, y], axis=-1).reshape(-1, 2)
    if conditions.occluded is not None:
        left, top, wide, high = conditions.occluded
        hidden = (shares[:, 0] > left) & (shares[:, 0] < left + wide)
        shares = shares[~(hidden & (shares[:, 1] > top) & (shares[:, 1] < top + high))]
    places = shares * side
    col, row = np.floor(project(photo.matrix, places)).astype(int).T
    rows, cols = mask.shape
    shown = mask[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)]
    return np.asarray(places[shown], dtype=np.float64)


class Tally:
    """What tiles of one kind gave."""

    def __init__(self) -> None:
        self.rms: list[float] = []
        self.seconds: list[float] = []
        self.colour: list[float] = []
        self.sides_mm: list[float] = []
        self.lost = self.unmeasured = 0

    def tile(self, stone: FloatImage, contrast: float, case: str, random: np.random.Generator) -> None:
        """Make, photograph, find, register and measure a tile."""
        limits = CASES[case]
        face = a_face(stone, random, contrast)
        side = face.shape[0]
        fired = np.asarray(face**EXPONENT * np.array(CAST), dtype=np.float32)
        conditions = photo_conditions(
            random, shift=0.03, gain=0.0, occluded=limits.get("occluded", 0.0), broken=limits.get("broken", 0.0)
        )
        photo = photo_of(fired, FACE_PX_PER_MM, conditions, random, px_per_mm=CAMERA_PX_PER_MM)
        xyz = xyz_of(rgb_lin_from_srgb(photo.image / 255.0))
        found = find_tile(xyz, SizeMm(SIDE_MM, SIDE_MM), px_per_mm=CAMERA_PX_PER_MM)
        if not isinstance(found, FoundTile):
            self.lost += 1
            return
        true = project(photo.matrix, np.array([[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]]))
        reach = SIDE_MM * CAMERA_PX_PER_MM
        corners = true + 0.025 * reach * random.uniform(-1, 1, 2) + 0.01 * reach * random.uniform(-1, 1, (4, 2))
        predicted, lightness = xyz_of(face), lab_from_xyz(xyz)[:, :, 0].astype(np.float32)
        predicted_l = lab_from_xyz(predicted)[:, :, 0].astype(np.float32)
        began = time.thread_time()
        got = register(predicted_l, lightness, start_matrix(corners, (side, side)), valid=found.mask)
        self.seconds.append(time.thread_time() - began)
        places = seen_places(photo, conditions, found.mask, side)
        away = project(got.matrix, places) - project(photo.matrix, places)
        self.rms.append(float(np.sqrt((away**2).sum(axis=1).mean())) if got.converged else np.inf)
        if limits:
            return
        warped, inside = warp_to_face(xyz, got.matrix, (side, side))
        valid = inside & warp_mask_to_face(found.mask, got.matrix, (side, side))
        evened, _ = even_light(predicted, warped, valid)
        inks = np.zeros((side, side, 1), dtype=np.float32)
        regions = region_colours(predicted, evened, inks, valid, FACE_PX_PER_MM)
        wanted = region_colours(predicted, xyz_of(fired), inks, valid, FACE_PX_PER_MM)
        # The light's mean can't be told from the tile's; it counts as drift, and isn't an error of regions.
        level = float(np.median(light_of(regions.fired_lab) / light_of(wanted.fired_lab)))
        even = region_colours(predicted, evened / np.float32(level), inks, valid, FACE_PX_PER_MM)
        self.colour.append(float(delta_e_2000(even.fired_lab, wanted.fired_lab).mean()))
        turned = np.roll(found.corners_px, -conditions.quarter_turns, axis=0)
        size = SizeMm(SIDE_MM, SIDE_MM)
        dimensions = measure_dimensions(xyz, turned, found.mask, size, CAMERA_PX_PER_MM * conditions.scale)
        if dimensions is None:
            self.unmeasured += 1
        else:
            self.sides_mm.extend(abs(side_mm - SIDE_MM) for side_mm in dimensions.sides_mm)


def light_of(lab: Float64Array) -> Float64Array:
    """Y of Lab colours (M, 3)."""
    return np.asarray(((lab[:, 0] + 16.0) / 116.0) ** 3, dtype=np.float64)


def one_stone(figures: Figures, name: str, stone: FloatImage, tiles: int) -> None:
    """All cases of a stone."""
    figures.title(f"{name}: {tiles} tiles a case\nroot mean square error, image pixels: median / 99 % / worst")
    for contrast in (1.0, 0.1):
        for case in CASES:
            random = np.random.default_rng([sum(name.encode()), list(CASES).index(case), round(10 * contrast)])
            tally = Tally()
            for _ in range(tiles):
                tally.tile(stone, contrast, case, random)
            what = f"{case}, contrast x {contrast:g}"
            rms = np.array(tally.rms)
            shown = (float(np.median(rms)), float(np.percentile(rms, 99)), float(rms.max()))
            note = f"[{1000 * np.mean(tally.seconds):.0f} ms{f', {tally.lost} not found' if tally.lost else ''}]"
            figures.row(what, shown, (MOST_RMS_PX,) * 3, note)
            if tally.colour:
                figures.note("  regions' colours off, mean CIEDE2000", f"{np.mean(tally.colour):.3f}")
            if tally.sides_mm:
                sides = np.array(tally.sides_mm)
                shown_mm = f"{sides.mean():.3f} / {sides.max():.3f}, not measured: {tally.unmeasured}"
                figures.note("  sides off, mm: mean / worst", shown_mm)


def whole_tile(figures: Figures, grid: int) -> None:
    """Processor time of measuring one large face."""
    random = np.random.default_rng(5)
    grain = ndimage.gaussian_filter(random.standard_normal((grid, grid)), 3)
    face = np.repeat((0.4 + 0.1 * grain / grain.std())[:, :, np.newaxis], 3, axis=2).clip(0.02, 1).astype(np.float32)
    photo = photo_of(face, 10.0, PhotoConditions(rotation_deg=1.0, light=0.1), random, px_per_mm=10.0)
    xyz, predicted = xyz_of(rgb_lin_from_srgb(photo.image / 255.0)), xyz_of(face)
    inks = random.random((grid, grid, 4), dtype=np.float32)
    valid = np.ones((grid, grid), dtype=np.bool_)
    seconds = []
    for _ in range(3):
        began = time.thread_time()
        fired, inside = warp_to_face(xyz, photo.matrix, (grid, grid))
        evened, _ = even_light(predicted, fired, valid & inside)
        regions = region_colours(predicted, evened, inks, valid & inside, 10.0)
        colour_figures(regions)
        difference_maps(regions)
        seconds.append(time.thread_time() - began)
    figures.title(f"One face of {grid} x {grid} pixels")
    figures.row(f"measuring {len(regions)} regions, s", (min(seconds),), (MOST_SECONDS,))


def main() -> None:
    """Measure and print; ends with 1 if a figure is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiles", type=int, default=100, help="tiles of each case")
    parser.add_argument("--stones", default=",".join(STONES), help="which of scikit-image's pictures, by commas")
    parser.add_argument("--pictures", type=Path, nargs="*", default=[], help="further pictures of stone")
    parser.add_argument("--grid", type=int, default=1500, help="side of the face that is timed, pixels")
    arguments = parser.parse_args()
    print(f"on {machine_name()}")
    figures = Figures()
    for name, stone in stones([name for name in arguments.stones.split(",") if name], arguments.pictures).items():
        one_stone(figures, name, stone, arguments.tiles)
    whole_tile(figures, arguments.grid)
    figures.end()
    raise SystemExit(figures.reached < figures.judged)


if __name__ == "__main__":
    main()
