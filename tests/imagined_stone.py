"""Faces of an imagined stone, and photographs of them as the core sees them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sim.tile_photo import PhotoConditions, PhotoOfTile, photo_of
from tilefab.colour import scan_to_xyz
from tilefab.types import SizeMm

PX_PER_MM = 2.0


class ImaginedStone:
    """Faces of smooth noise, each its own."""

    def __init__(self, size_mm: SizeMm, seed: int = 0, contrast_l: float = 8.0, grain_mm: float = 4.0) -> None:
        self.size_mm, self.seed, self.contrast_l, self.grain_mm = size_mm, seed, contrast_l, grain_mm

    def lightness(self, face: int) -> NDArray[np.float32]:
        """L* (rows, cols) at 2 px/mm."""
        shape = (round(PX_PER_MM * self.size_mm.height), round(PX_PER_MM * self.size_mm.width))
        noise = np.random.default_rng([self.seed, face]).standard_normal(shape)
        field = ndimage.gaussian_filter(noise, PX_PER_MM * self.grain_mm, mode="wrap")
        return np.asarray(55.0 + self.contrast_l * field / field.std(), dtype=np.float32)

    def __call__(self, face: int, long_px: int) -> NDArray[np.float32]:
        """A small rendering, as `FaceView` asks for."""
        whole = self.lightness(face)
        rows, cols = whole.shape
        step = max(step for step in range(1, max(rows, cols) // long_px + 1) if rows % step == cols % step == 0)
        return whole.reshape(rows // step, step, cols // step, step).mean(axis=(1, 3))

    def photo(self, face: int, conditions: PhotoConditions, seed: int = 1, px_per_mm: float = PX_PER_MM) -> PhotoOfTile:
        """The fired face under the camera."""
        grey = np.clip(((self.lightness(face) + 16.0) / 116.0) ** 3, 0.0, 1.0).astype(np.float32)
        rgb = np.ascontiguousarray(np.repeat(grey[..., np.newaxis], 3, axis=2))
        return photo_of(rgb, PX_PER_MM, conditions, np.random.default_rng(seed), px_per_mm=px_per_mm)


def to_xyz(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """An image as the core gets it."""
    return np.ascontiguousarray(np.maximum(scan_to_xyz(image, None), 0.0), dtype=np.float32)


def true_corners(photo: PhotoOfTile, size_mm: SizeMm) -> NDArray[np.float64]:
    """Where the face's corners lie in the image, from its own upper left one."""
    wide, high = PX_PER_MM * size_mm.width, PX_PER_MM * size_mm.height
    corners = np.array([[0, 0, 1], [wide, 0, 1], [wide, high, 1], [0, high, 1]]) @ photo.matrix.T
    return np.asarray(corners[:, :2] / corners[:, 2:])
