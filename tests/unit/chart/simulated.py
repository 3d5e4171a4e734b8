"""A press and a scanner for tests: smooth made-up colours of ink mixtures, and a scan of what was printed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.chart import ChartLayout, design_chart, lay_out_chart, render_tile
from tilefab.chart.finding import project
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, srgb_from_rgb_lin
from tilefab.types import Array, SizeMm

ABSORB = np.array(
    [
        [0.95, 0.35, 0.05],
        [0.10, 0.85, 0.40],
        [0.02, 0.08, 0.85],
        [0.92, 0.93, 0.94],
        [0.30, 0.60, 0.75],
        [0.60, 0.20, 0.55],
        [0.20, 0.75, 0.10],
        [0.45, 0.50, 0.20],
    ]
)
WHITE_RGB = np.array([0.88, 0.86, 0.82])


def rgb_of_ink(ink_frac: NDArray[np.floating]) -> NDArray[np.float64]:
    """Linear RGB, (..., 3), of recipes (..., N): every ink lets a share of the light through."""
    rgb = np.broadcast_to(WHITE_RGB, (*ink_frac.shape[:-1], 3)).copy()
    for ink in range(ink_frac.shape[-1]):
        cover = ink_frac[..., ink, np.newaxis]
        rgb *= 1.0 - ABSORB[ink] * (cover + 0.25 * cover * (1.0 - cover))
    return rgb


def true_xyz(layout: ChartLayout) -> NDArray[np.float64]:
    return rgb_of_ink(layout.ink_counts / 255.0) @ XYZ_D50_FROM_RGB_LIN.T


def small_chart(
    patches: int = 120, *, inks: int = 4, tile_mm: float = 130.0, dpi: float = 120.0, seed: int = 1
) -> ChartLayout:
    black = 3 if inks >= 4 else None
    design = design_chart(inks, patches, total_limit_percent=min(100.0 * inks, 300.0), black_channel=black, seed=seed)
    return lay_out_chart(design, tile_mm=SizeMm(tile_mm, tile_mm), dpi=dpi, patch_mm=7.0, gap_mm=1.2, seed=seed)


@dataclass(frozen=True)
class Scanner:
    """How a tile lies and is seen."""

    turn_degrees: float = 0.0
    scale: float = 1.0
    perspective: float = 0.0
    light: float = 0.0
    noise: float = 0.0
    blur_px: float = 0.7
    lid: float = 0.02
    border_px: int = 40
    bits: int = 16
    seed: int = 3

    def scan(self, layout: ChartLayout, tile: int = 0, scratch: tuple[int, ...] = ()) -> Array:
        """sRGB pixels of a tile of the chart; a bright line crosses each patch of ``scratch``."""
        print_rgb = rgb_of_ink(render_tile(layout, tile) / 255.0)
        for patch in scratch:
            top, left = layout.cell_corner(*(int(v) for v in layout.places[patch, 1:]))
            middle = top + layout.patch_px // 2
            print_rgb[middle - 2 : middle + 2, left : left + layout.patch_px] = 0.95
        rows, cols = print_rgb.shape[:2]
        angle = np.radians(self.turn_degrees)
        turn = self.scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        forward = np.eye(3)
        forward[:2, :2] = turn
        forward[2, :2] = self.perspective / max(rows, cols) * np.array([1.0, -0.6])
        corners = project(forward, np.array([[0.0, 0.0], [cols, 0.0], [cols, rows], [0.0, rows]]))
        shift = np.eye(3)
        shift[:2, 2] = self.border_px - corners.min(axis=0)
        forward = shift @ forward
        size = np.ceil(corners.max(axis=0) - corners.min(axis=0)).astype(int) + 2 * self.border_px
        x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
        source = project(np.linalg.inv(forward), np.stack([x, y], axis=-1))
        places = [source[..., 1] - 0.5, source[..., 0] - 0.5]
        rgb = np.stack(
            [
                ndimage.map_coordinates(
                    ndimage.gaussian_filter(print_rgb[..., c], self.blur_px),
                    places,
                    order=1,
                    mode="constant",
                    cval=self.lid,
                )
                for c in range(3)
            ],
            axis=-1,
        )
        u, v = x / size[0] - 0.5, y / size[1] - 0.5
        rgb *= (1.0 + self.light * (0.7 * u - 0.5 * v - 1.2 * u * u))[..., np.newaxis]
        rgb += self.noise * np.random.default_rng(self.seed).standard_normal(rgb.shape)
        full = 2**self.bits - 1
        encoded = np.rint(full * srgb_from_rgb_lin(np.clip(rgb, 0.0, 1.0)))
        return encoded.astype(np.uint16 if self.bits == 16 else np.uint8)
