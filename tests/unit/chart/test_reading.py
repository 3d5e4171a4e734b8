"""Charts through a made-up press and scanner, and back: where tiles lie, their colours, and what is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.chart import ChartLayout, design_chart, lay_out_chart, render_tile
from tilefab.chart.finding import find_tiles, fit_homography, project
from tilefab.chart.reading import TileReading, grey_of, read_tiles
from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, srgb_from_rgb_lin
from tilefab.errors import ProfileError
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


@pytest.fixture(scope="module")
def chart() -> ChartLayout:
    return small_chart()


def read(pixels: Array, layout: ChartLayout, *, even_light: bool = True) -> TileReading:
    (reading,) = read_tiles(pixels, layout, lambda part: scan_to_xyz(part, None), even_light=even_light)
    return reading


def errors(reading: TileReading, layout: ChartLayout) -> NDArray[np.float64]:
    """CIE76 of each patch, apart from the scan's exposure, which no reader can know."""
    true = true_xyz(layout)[reading.patches]
    xyz = reading.xyz_d50 / np.median(reading.xyz_d50[:, 1] / true[:, 1])
    return np.linalg.norm(lab_from_xyz(xyz) - lab_from_xyz(true), axis=1)


def test_a_homography_is_found_again() -> None:
    true = np.array([[1.1, 0.2, 30.0], [-0.15, 0.9, 12.0], [1e-4, -2e-4, 1.0]])
    points = np.random.default_rng(1).random((9, 2)) * 900.0
    np.testing.assert_allclose(fit_homography(points, project(true, points)), true, rtol=1e-8, atol=1e-11)


def test_a_plain_scan_is_read_exactly(chart: ChartLayout) -> None:
    reading = read(Scanner().scan(chart), chart)
    assert errors(reading, chart).max() < 0.02
    assert reading.pose.marks == 4
    assert reading.pose.residual_px < 0.05
    assert reading.pose.scale == pytest.approx(1.0, abs=1e-3)
    assert not reading.defect.any()
    assert not reading.left_out.any()
    np.testing.assert_array_equal(np.sort(reading.patches), np.arange(120))


@pytest.mark.parametrize("quarter", [0, 90, 180, 270])
def test_all_turns_with_tilt_light_and_noise(chart: ChartLayout, quarter: int) -> None:
    scanner = Scanner(turn_degrees=quarter + 4, scale=0.85, perspective=0.04, light=0.12, noise=0.003)
    reading = read(scanner.scan(chart), chart)
    away = errors(reading, chart)
    assert away.mean() < 0.15
    assert away.max() < 1.5
    assert reading.pose.residual_px < 0.1
    turned = (reading.pose.turn_degrees - quarter - 4 + 180) % 360 - 180
    assert abs(turned) < 2.0
    assert reading.defect.sum() <= 1


@pytest.mark.parametrize(
    "scanner",
    [
        Scanner(turn_degrees=-8, scale=1.2, perspective=-0.05, light=0.2, noise=0.003, bits=8),
        Scanner(turn_degrees=30, lid=0.95),
        Scanner(turn_degrees=45, scale=0.8, lid=0.5),
        Scanner(scale=0.5),
        Scanner(scale=2.0, turn_degrees=93),
        Scanner(border_px=2, turn_degrees=1),
    ],
)
def test_other_scanners(chart: ChartLayout, scanner: Scanner) -> None:
    reading = read(scanner.scan(chart), chart)
    assert errors(reading, chart).mean() < 0.15
    assert reading.pose.residual_px < 0.2


def test_uneven_light_is_taken_out_and_can_be_left(chart: ChartLayout) -> None:
    pixels = Scanner(light=0.3).scan(chart)
    evened, left = read(pixels, chart), read(pixels, chart, even_light=False)
    assert errors(evened, chart).mean() < 0.1
    assert errors(left, chart).mean() > 1.0
    assert evened.lighting_percent == pytest.approx(22.0, abs=8.0)
    assert left.lighting_percent is None


def test_a_scratch_is_reported_and_left_out(chart: ChartLayout) -> None:
    scratched = (17, 60)
    reading = read(Scanner(noise=0.002, turn_degrees=2).scan(chart, scratch=scratched), chart)
    assert set(reading.patches[reading.defect]) == set(scratched)
    places = np.isin(reading.patches, scratched)
    assert (reading.left_out[places] > 0.1).all()
    assert errors(reading, chart)[places].max() < 0.5
    assert reading.spread_delta_e[places].min() > 4 * np.median(reading.spread_delta_e)


def test_halftone_dots_are_averaged_in_linear_light(chart: ChartLayout) -> None:
    """Patches made of full and no ink dots read as the mean of the light they send back."""
    dots = np.random.default_rng(4)

    def halftoned(layout: ChartLayout) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        ink = render_tile(layout, 0) / 255.0
        fine = np.kron(ink, np.ones((4, 4, 1)))
        rgb = rgb_of_ink((dots.random(fine.shape) < fine).astype(np.float64))
        rgb = rgb.reshape(ink.shape[0], 4, ink.shape[1], 4, 3).mean(axis=(1, 3))
        true = []
        for patch in range(len(layout.ink_counts)):
            top, left = layout.cell_corner(*(int(v) for v in layout.places[patch, 1:]))
            true.append(
                rgb[top + 4 : top + layout.patch_px - 4, left + 4 : left + layout.patch_px - 4].mean(axis=(0, 1))
            )
        return rgb, np.array(true)

    rgb, true = halftoned(chart)
    pixels = np.pad(rgb, ((9, 9), (9, 9), (0, 0)), constant_values=0.9).astype(np.float32)
    reading = read(pixels, chart)
    away = np.linalg.norm(
        lab_from_xyz(reading.xyz_d50) - lab_from_xyz(true[reading.patches] @ XYZ_D50_FROM_RGB_LIN.T), axis=1
    )
    assert np.median(away) < 0.8
    assert reading.defect.mean() < 0.05


def test_three_marks_are_enough_and_two_are_not(chart: ChartLayout) -> None:
    pixels = Scanner(noise=0.001).scan(chart)
    for corner in (2, 0):
        top, left = chart.mark_corner(corner)
        pixels[40 + top : 40 + top + chart.mark_px, 40 + left : 40 + left + chart.mark_px] = pixels[48, 400]
        if corner == 2:
            reading = read(pixels, chart)
            assert reading.pose.marks == 3
            assert errors(reading, chart).mean() < 0.1
    with pytest.raises(ProfileError, match=r"2 of a tile's 4 corner marks are found, and 3 are needed"):
        read(pixels, chart)


def test_scans_that_can_t_be_read(chart: ChartLayout) -> None:
    blank = np.full((300, 400, 3), 40000, np.uint16)
    with pytest.raises(ProfileError, match="0 of a tile's 4 corner marks"):
        read(blank, chart)
    noise = np.random.default_rng(1).integers(0, 256, (300, 400, 3)).astype(np.uint8)
    with pytest.raises(ProfileError, match="corner marks"):
        read(noise, chart)
    with pytest.raises(ProfileError, match="another chart"):
        read(Scanner().scan(small_chart(seed=2)), chart)


def test_a_tile_that_is_cut_off_is_refused() -> None:
    chart = small_chart(170)
    pixels = Scanner(turn_degrees=45).scan(chart)
    with pytest.raises(ProfileError, match="the tile is cut off"):
        read(pixels[: round(0.84 * len(pixels))], chart)


def test_two_tiles_in_one_scan() -> None:
    chart = small_chart(260)
    assert chart.tiles == 2
    both = np.concatenate([Scanner(turn_degrees=90, border_px=20).scan(chart, tile) for tile in (1, 0)], axis=1)
    readings = read_tiles(both, chart, lambda part: scan_to_xyz(part, None))
    assert [reading.pose.tile for reading in readings] == [0, 1]
    for reading in readings:
        assert errors(reading, chart).mean() < 0.05


def test_eight_inks_and_one() -> None:
    for inks in (1, 8):
        chart = small_chart(60, inks=inks, tile_mm=100.0)
        reading = read(Scanner(turn_degrees=183, noise=0.002).scan(chart), chart)
        assert errors(reading, chart).mean() < 0.15


def test_brightness_is_in_the_range_of_its_type() -> None:
    assert grey_of(np.full((2, 3, 3), 255, np.uint8)) == pytest.approx(1.0)
    assert grey_of(np.full((2, 3), 65535, np.uint16)) == pytest.approx(1.0)
    assert grey_of(np.full((2, 3, 3), 0.25, np.float32)) == pytest.approx(0.25)


def test_a_mirrored_scan_is_no_tile(chart: ChartLayout) -> None:
    with pytest.raises(ProfileError, match="corner marks"):
        find_tiles(grey_of(Scanner().scan(chart)[:, ::-1]), chart)
