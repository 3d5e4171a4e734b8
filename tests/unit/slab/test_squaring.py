"""Squaring: corners found to a fraction of a pixel, and stone never taken for the scanner's bed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from tilefab.slab.squaring import SquaringOptions, homography, square_slab

ROWS, COLS = 340, 420
BEDS = {"black": (0.010, 0.0105, 0.009), "white": (0.82, 0.85, 0.70), "grey": (0.19, 0.20, 0.16)}


def stone(rows: int, cols: int, seed: int = 0, level: float = 0.4) -> np.ndarray:
    """Mottled stone with a few dark veins."""
    rng = np.random.default_rng(seed)
    mottle = ndimage.gaussian_filter(rng.standard_normal((rows, cols)), 3.0)
    ridge = ndimage.gaussian_filter(rng.standard_normal((rows, cols)), 14.0)
    log_y = 0.15 * mottle / mottle.std() - 0.8 * np.exp(-((ridge / ridge.std() / 0.08) ** 2))
    return (np.array([0.95, 1.0, 0.7]) * level * np.exp(log_y)[..., None]).astype(np.float32)


def quadrilateral(height: float, width: float, angle_deg: float, seed: int = 0) -> np.ndarray:
    """Corners of a turned, slightly trapezoidal slab in the middle of the scan."""
    angle = np.radians(angle_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    half = np.array([(-height, -width), (-height, width), (height, width), (height, -width)]) / 2
    jitter = np.random.default_rng(seed).uniform(-1.5, 1.5, (4, 2)) if angle_deg else 0.0
    return half @ turn.T + np.array([ROWS / 2 + 1.3, COLS / 2 - 2.6]) + jitter


def scan(
    slab: np.ndarray,
    corners: np.ndarray,
    bed: str,
    *,
    chips: int = 0,
    noise: float = 0.003,
    vignette: float = 0.1,
) -> np.ndarray:
    """Scan of a slab on a bed, 3 x 3 samples a pixel, with chipped edges, vignetting and noise."""
    rng = np.random.default_rng(99)
    height, width = slab.shape[:2]
    rectangle = np.array([(0, 0), (0, width), (height, width), (height, 0)], np.float64)
    matrix = homography(corners, rectangle)
    whole = np.ones((height, width), np.bool_)
    down, across = np.ogrid[:height, :width]
    for _ in range(chips):
        side, t = rng.integers(4), rng.uniform(0.1, 0.9)
        row, col = [(0, t * width), (t * height, width), (height, t * width), (t * height, 0)][side]
        whole &= (down - row) ** 2 + (across - col) ** 2 > rng.uniform(5, 9) ** 2
    y, x = np.meshgrid(np.arange(ROWS) + 0.5, np.arange(COLS) + 0.5, indexing="ij")
    light = np.zeros((ROWS, COLS, 3))
    for dy in (-1 / 3, 0.0, 1 / 3):
        for dx in (-1 / 3, 0.0, 1 / 3):
            at = np.tensordot(matrix, np.stack([y + dy, x + dx, np.ones_like(y)]), axes=1)
            row = np.floor(at[0] / at[2]).astype(int)
            col = np.floor(at[1] / at[2]).astype(int)
            on_slab = (row >= 0) & (row < height) & (col >= 0) & (col < width)
            row, col = row.clip(0, height - 1), col.clip(0, width - 1)
            on_slab &= whole[row, col]
            light += np.where(on_slab[..., None], slab[row, col], BEDS[bed]) / 9
    fall = ((y / ROWS - 0.5) ** 2 + (x / COLS - 0.5) ** 2) * 2
    light *= (1.0 - vignette * fall)[..., None]
    return (light + noise * rng.standard_normal(light.shape)).clip(0.0).astype(np.float32)


def all_valid(image: np.ndarray) -> np.ndarray:
    return np.ones(image.shape[:2], np.bool_)


def test_homography_takes_points_where_it_should() -> None:
    source = np.array([(0, 0), (0, 10), (8, 10), (8, 0)], np.float64)
    target = np.array([(1, 2), (2, 12), (11, 11), (9, 1)], np.float64)
    mapped = np.c_[source, np.ones(4)] @ homography(source, target).T
    assert_allclose(mapped[:, :2] / mapped[:, 2:], target, atol=1e-9)


@pytest.mark.parametrize("bed", list(BEDS))
@pytest.mark.parametrize("angle_deg", [0.0, 1.4, -9.0])
def test_corners_are_found_to_a_fraction_of_a_pixel(bed: str, angle_deg: float) -> None:
    level = 0.4 if bed != "white" else 0.25
    slab, corners = stone(220, 300, level=level), quadrilateral(220, 300, angle_deg, seed=4)
    image = scan(slab, corners, bed, chips=4)
    out, valid, record = square_slab(image, all_valid(image), SquaringOptions(trim_px=3))
    assert record.squared, record.summary
    assert np.abs(np.array(record.corners_px) - corners).max() < 0.35
    assert record.angle_deg == pytest.approx(angle_deg, abs=0.5)
    assert abs(out.shape[0] - 214) <= 2
    assert abs(out.shape[1] - 294) <= 2
    assert out.shape[:2] == valid.shape == (record.size_after.rows, record.size_after.cols)
    assert valid.mean() > 0.9
    assert "slab found" in record.summary


def test_the_squared_slab_is_the_slab() -> None:
    slab, corners = stone(220, 300), quadrilateral(220, 300, 3.0)
    corners = corners - quadrilateral(220, 300, 3.0).mean(axis=0) + (ROWS / 2, COLS / 2)
    image = scan(slab, corners, "black", noise=0.0, vignette=0.0)
    out, valid, _ = square_slab(image, all_valid(image))
    rows, cols = min(out.shape[0], 220), min(out.shape[1], 300)
    inner = np.s_[10 : rows - 10, 10 : cols - 10]
    assert valid[inner].all()
    smooth = [ndimage.gaussian_filter(x[..., 1], 1.0)[inner] for x in (out, slab)]
    assert np.corrcoef(smooth[0].ravel(), smooth[1].ravel())[0, 1] > 0.97


def test_an_upright_slab_is_cut_out_bit_for_bit() -> None:
    image = np.full((ROWS, COLS, 3), 0.01, np.float32)
    slab = stone(240, 300)
    image[50:290, 70:370] = slab
    out, valid, record = square_slab(image, all_valid(image), SquaringOptions(trim_px=7))
    assert_array_equal(out, slab[7:-7, 7:-7])
    assert valid.all()
    assert record.trim_px == 7
    assert "cut out where it lay" in record.summary


def test_chips_of_the_edge_become_invalid() -> None:
    image = np.full((ROWS, COLS, 3), 0.01, np.float32)
    image[50:290, 70:370] = stone(240, 300)
    image[50:66, 200:225] = 0.01
    _, valid, record = square_slab(image, all_valid(image))
    assert record.squared
    assert not valid[:15, 131:154].any()
    assert valid[25:, :].all()
    assert 0.004 < record.chipped_frac < 0.02


def test_masks_are_warped_along() -> None:
    slab, corners = stone(220, 300), quadrilateral(220, 300, 2.0)
    image = scan(slab, corners, "black")
    valid = all_valid(image)
    valid[160:170, 200:210] = False
    _, out_valid, record = square_slab(image, valid)
    assert record.squared
    assert 100 <= int((~out_valid[20:-20, 20:-20]).sum()) <= 260


def stones_that_fill_the_scan() -> dict[str, np.ndarray]:
    flat = stone(ROWS, COLS, 1) * 0 + np.float32(0.4)
    flat *= np.exp(0.01 * np.random.default_rng(0).standard_normal((ROWS, COLS, 1))).astype(np.float32)
    veined = stone(ROWS, COLS, 2)
    scans = {"uniform": flat, "veined": veined}
    for name, base in (("uniform", flat), ("veined", veined)):
        image = base.copy()
        image[:, :18] *= 0.15
        scans[f"{name}, dark vein along one side"] = image
        image = image.copy()
        image[:16] *= 0.15
        image[-16:] *= 0.15
        scans[f"{name}, dark vein along three sides"] = image
    width = 22 + 9 * np.sin(np.arange(ROWS) / 25)
    depth = 22 + 9 * np.sin(np.arange(COLS) / 19)
    col, row = np.arange(COLS)[None, :], np.arange(ROWS)[:, None]
    frame = (col < width[:, None]) | (COLS - col < width[:, None]) | (row < depth) | (ROWS - row < depth)
    image = flat.copy()
    image[frame] *= 0.15
    scans["wavy dark vein all round"] = image
    y, x = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLS), indexing="ij")
    for name, blob in (("ellipse", np.hypot(x, y) < 0.9), ("diamond", abs(x) + abs(y) < 0.97)):
        image = flat.copy()
        image[blob] *= 0.2
        scans[f"dark {name} in the middle"] = image
    return scans


@pytest.mark.parametrize("name", list(stones_that_fill_the_scan()))
def test_stone_is_never_taken_for_the_bed(name: str) -> None:
    image = stones_that_fill_the_scan()[name]
    out, _, record = square_slab(image, all_valid(image), SquaringOptions(trim_px=2))
    assert not record.squared
    assert record.corners_px is None
    assert record.summary.startswith("trimmed by 2 px, not squared, because")
    assert_array_equal(out, image[2:-2, 2:-2])


def test_a_stone_of_the_colour_of_the_bed_is_left_alone() -> None:
    slab = stone(220, 300, level=1.0) / np.array([0.95, 1.0, 0.7]) * np.array(BEDS["white"])
    image = scan(slab, quadrilateral(220, 300, 2.0), "white")
    out, _, record = square_slab(image, all_valid(image))
    assert not record.squared
    assert_array_equal(out, image)


@pytest.mark.parametrize(
    ("height", "width", "angle_deg", "words"),
    [(140, 200, 1.0, "% of the scan"), (215, 270, 19.0, "askew")],
)
def test_doubtful_outlines_are_left_alone(height: int, width: int, angle_deg: float, words: str) -> None:
    image = scan(stone(height, width), quadrilateral(height, width, angle_deg), "black")
    _, _, record = square_slab(image, all_valid(image), SquaringOptions(min_area_frac=0.35))
    assert not record.squared
    assert words in record.summary


def test_a_slab_touching_the_edge_of_the_scan_is_left_alone() -> None:
    image = np.full((ROWS, COLS, 3), 0.01, np.float32)
    image[40:-40, :-50] = stone(ROWS - 80, COLS - 50)
    out, _, record = square_slab(image, all_valid(image))
    assert not record.squared
    assert_array_equal(out, image)
    assert record.summary.startswith("nothing, because only")


@pytest.mark.parametrize("size", [1, 5, 23, 40])
def test_tiny_scans_pass_through(size: int) -> None:
    image = np.random.default_rng(0).random((size, size, 3), np.float32)
    out, valid, record = square_slab(image, all_valid(image))
    assert_array_equal(out, image)
    assert valid.all()
    assert not record.squared


def test_black_scans_and_masked_borders_pass_through() -> None:
    image = np.zeros((60, 60, 3), np.float32)
    valid = all_valid(image)
    assert "uniform surface" in square_slab(image, valid)[2].summary
    valid[:5] = valid[-5:] = valid[:, :5] = valid[:, -5:] = False
    assert "border is valid" in square_slab(image, valid)[2].summary


def test_large_scans_are_found_on_a_reduced_copy() -> None:
    image = np.full((1500, 2200, 3), 0.012, np.float32)
    image[151:1360, 203:2010] = np.tile(stone(403, 602), (3, 4, 1))[:1209, :1807]
    out, _, record = square_slab(image, all_valid(image))
    wanted = np.array([(151, 203), (151, 2010), (1360, 2010), (1360, 203)])
    assert np.abs(np.array(record.corners_px) - wanted).max() < 0.2
    assert_array_equal(out, image[151:1360, 203:2010])


def test_refuses_misuse() -> None:
    image = np.full((20, 30, 3), 0.4, np.float32)
    with pytest.raises(ValueError, match="negative"):
        square_slab(image, all_valid(image), SquaringOptions(trim_px=-1))
    with pytest.raises(ValueError, match="leaves nothing"):
        square_slab(image, all_valid(image), SquaringOptions(trim_px=10))
    with pytest.raises(ValueError, match="no pixel"):
        square_slab(image, ~all_valid(image))
