"""Stones to search for defects: printed with a spectral press, predicted by its profile, photographed."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from drift import LIMIT, fitted
from numpy.typing import NDArray
from PIL import Image
from press_data import shared_folder
from scipy import ndimage

from sim.inks import xyz_from_reflectance
from sim.kiln import Firing, drift_of_size
from sim.spectral_press import SpectralPress
from sim.tile_photo import photo_conditions, photo_of
from tilefab.colour.press_model import PressModel
from tilefab.colour.separation import SeparationSettings, Separator
from tilefab.colour.spaces import RGB_LIN_FROM_XYZ_D50, XYZ_D50_FROM_RGB_LIN, lab_from_xyz
from tilefab.inspection.registration import register, warp_to_face
from tilefab.sampling import CropMap, CropOptions, build_crop_map, render
from tilefab.types import FloatImage, Mask

PRESS = "ceramic4"
EXEMPLARS = {"greenmarble": 3, "pebbles": 3, "rough": 3, "blades": 3}
"""Shared textures, and how many pixels each of theirs becomes."""
PHOTOGRAPHS = {"gravel": 1, "gravel, coarse": 2, "grass": 2, "brick": 2}
"""Photographs of scikit-image."""
_TINTS = {"gravel": (1.0, 0.93, 0.84), "grass": (0.95, 0.97, 0.8), "brick": (1.0, 0.85, 0.75)}
_LIGHTEST, _DARKEST = 92.0, 22.0
_STEP = 4
_LINEAR = np.where(
    np.arange(256) <= 10, np.arange(256) / 255.0 / 12.92, ((np.arange(256) / 255.0 + 0.055) / 1.055) ** 2.4
).astype(np.float32)


@lru_cache(maxsize=1)
def press() -> SpectralPress:
    """The press that prints and fires."""
    return SpectralPress(PRESS)


@lru_cache(maxsize=1)
def profile() -> PressModel:
    """What is known of it: fitted to a chart read with noise."""
    return fitted(press(), None, np.random.default_rng(40))


def press_rgb(ink_frac: NDArray[np.floating], firing: Firing | None) -> FloatImage:
    """Linear sRGB (P, 3) of recipes (P, N) after a firing."""
    rgb = xyz_from_reflectance(press().reflectance(ink_frac, firing)) @ RGB_LIN_FROM_XYZ_D50.T
    return np.clip(rgb, 0.0, 1.0).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Stone:
    """A stone as a press prints it.

    Attributes
    ----------
    name
        Its name.
    counts
        (U, N) uint8 print data of its colours.
    texture
        Faces, as numbers of colours.
    """

    name: str
    counts: NDArray[np.uint8]
    texture: CropMap

    def face(self, number: int, px: int) -> NDArray[np.uint16]:
        """(px, px) numbers of colours of a face."""
        return np.asarray(render(self.texture, 5000 * number, 0, px, px, seed=7, threads=1)[..., 0], dtype=np.uint16)

    def predicted_lab(self) -> NDArray[np.float64]:
        """(U, 3) CIELAB of its colours, by the profile."""
        return profile().lab(self.counts / 255.0)

    def fired_rgb(self, firing: Firing | None) -> FloatImage:
        """(U, 3) linear sRGB of its colours as fired."""
        return press_rgb(self.counts / 255.0, firing)


def stones() -> list[str]:
    """Names of the stones that can be had here."""
    names = list(PHOTOGRAPHS)
    folder = shared_folder("TILEFAB_TEXTURES", "textures")
    if folder is not None:
        names += [name for name in EXEMPLARS if (folder / name / "exemplar.png").is_file()]
    return names


def stone_of(name: str) -> Stone:
    """A stone by its name."""
    rgb, zoom = _picture(name)
    rgb = np.clip(ndimage.zoom(rgb, (zoom, zoom, 1), order=3), 0.0, 255.0) if zoom > 1 else rgb
    # Few enough colours that each is separated by itself.
    levels = np.rint(rgb / _STEP).astype(np.int64)
    packed = (levels[..., 0] * 256 + levels[..., 1]) * 256 + levels[..., 2]
    _, first, place = np.unique(packed.ravel(), return_index=True, return_inverse=True)
    colours = np.minimum(_STEP * levels.reshape(-1, 3)[first], 255)
    lab = lab_from_xyz(_LINEAR[colours].astype(np.float64) @ XYZ_D50_FROM_RGB_LIN.T)
    lab[:, 0] = _DARKEST + (_LIGHTEST - _DARKEST) / 100.0 * lab[:, 0]
    settings = SeparationSettings(total_limit=LIMIT / 100.0, black_channel=press().ink_names.index("Black"))
    inks = np.clip(Separator(profile(), settings).separate(lab), 0.0, 1.0)
    numbers = place.reshape(packed.shape).astype(np.uint16)
    texture = build_crop_map(
        lab[numbers].astype(np.float32),
        np.ones(numbers.shape, dtype=bool),
        CropOptions(crops=256, candidates=64, sweeps=1, threads=1),
        stored=numbers[..., np.newaxis].copy(),
        space="numbers of colours",
        channels=("number",),
        dpi=254.0,
    )
    return Stone(name, np.rint(255.0 * inks).astype(np.uint8), texture)


def _picture(name: str) -> tuple[NDArray[np.float64], int]:
    """A stone's picture (rows, cols, 3), 0 to 255, and how often to enlarge it."""
    if name in PHOTOGRAPHS:
        from skimage import data

        kind = name.partition(",")[0]
        grey = getattr(data, kind)().astype(np.float64)
        return grey[..., np.newaxis] * np.array(_TINTS[kind]), PHOTOGRAPHS[name]
    folder = shared_folder("TILEFAB_TEXTURES", "textures")
    if folder is None:
        raise ValueError(f"no texture {name} here")
    with Image.open(folder / name / "exemplar.png") as image:
        return np.asarray(image.convert("RGB"), dtype=np.float64), EXEMPLARS[name]


def random_firing(random: np.random.Generator, most: float) -> Firing:
    """A firing drifted in any direction by a mean CIEDE2000 of up to ``most``."""
    return drift_of_size(press(), random, float(random.uniform(0.1, 1.0) * most))


def photographed(
    fired: FloatImage, predicted_lab: FloatImage, random: np.random.Generator, px_per_mm: float
) -> tuple[FloatImage, Mask]:
    """CIELAB of a fired tile on its face's grid, photographed in any position and registered, and where it is seen."""
    rows, cols = fired.shape[:2]
    size_mm = (cols / px_per_mm, rows / px_per_mm)
    conditions = photo_conditions(random, rotation_deg=4.0, light=0.1, gain=0.04, size_mm=size_mm)
    photo = photo_of(fired, px_per_mm, conditions, random, px_per_mm=px_per_mm)
    light = _LINEAR[photo.image]
    # A recognised tile's corners are known to some pixels.
    off = np.eye(3)
    off[:2, 2] = random.uniform(-2.0, 2.0, 2)
    lightness = np.ascontiguousarray(_lab(light)[..., 0])
    laid = register(np.ascontiguousarray(predicted_lab[..., 0]), lightness, photo.matrix @ off)
    seen, inside = warp_to_face(light, laid.matrix, (rows, cols))
    return _lab(seen), inside


def _lab(rgb_lin: FloatImage) -> FloatImage:
    return lab_from_xyz(rgb_lin @ XYZ_D50_FROM_RGB_LIN.T).astype(np.float32)
