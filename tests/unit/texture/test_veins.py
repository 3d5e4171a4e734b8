"""Veins: found at their length, not found where there are none, and shorter where a wall breaks them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.texture import veins
from tilefab.texture.veins import VeinContinuity, vein_continuity, vein_lengths, vein_thresholds


def grey(lightness: NDArray[np.float64]) -> NDArray[np.float32]:
    lab = np.zeros((*lightness.shape, 3), dtype=np.float32)
    lab[..., 0] = lightness
    return lab


def veined(rows: int, cols: int, contrast: float = 20.0, channel: int = 0) -> NDArray[np.float32]:
    """Veins 5 px wide and 24 px apart that run across the picture in waves, on a faintly noisy ground."""
    row, col = np.indices((rows, cols))
    phase = (row + 6 * np.sin(col / 15)) % 24 - 12
    lab = np.random.default_rng(3).normal(0, 0.3, (rows, cols, 3)).astype(np.float32)
    lab[..., 0] += 60
    lab[..., channel] += (contrast * np.exp(-(phase**2) / (2 * 2.0**2))).astype(np.float32)
    return lab


def chopped(picture: NDArray[np.float32], side: int, seed: int) -> NDArray[np.float32]:
    """Squares from anywhere in the picture, side by side."""
    random = np.random.default_rng(seed)
    out = np.zeros_like(picture)
    for r in range(0, picture.shape[0], side):
        for c in range(0, picture.shape[1], side):
            there = out[r : r + side, c : c + side]
            row, col = (random.integers(n - side) for n in picture.shape[:2])
            there[:] = picture[row : row + side, col : col + side][: there.shape[0], : there.shape[1]]
    return out


def test_a_vein_is_as_long_as_drawn() -> None:
    row, col = np.indices((80, 90))
    straight = grey(50 - 30 * np.exp(-((row - 40.0) ** 2) / 8))
    # Eight pixels at either border are left out.
    assert vein_lengths(straight, vein_thresholds(straight, low_share=0.005, high_share=0.002))[0] == 90 - 2 * 8 - 1
    ring = grey(50 + 30 * np.exp(-((np.hypot(row - 40, col - 45) - 20) ** 2) / 8))
    length = vein_lengths(ring, vein_thresholds(ring, low_share=0.012, high_share=0.01))[0]
    # Of steps to eight neighbours, a circle is 8 (sqrt(2) - 1) r long rather than 2 pi r.
    assert length == pytest.approx(8 * (math.sqrt(2) - 1) * 2 * 20, rel=0.06)


@pytest.mark.parametrize(("channel", "contrast"), [(0, 20.0), (0, -20.0), (1, 20.0), (2, -20.0)])
def test_unbroken_veins_run_on_and_chopped_ones_do_not(channel: int, contrast: float) -> None:
    exemplar, wall = veined(110, 120, contrast, channel), veined(330, 361, contrast, channel)
    unbroken = vein_continuity(exemplar, wall)
    assert unbroken.exemplar_median_px > 80
    assert unbroken.median_ratio == pytest.approx(1.0, abs=0.1)
    assert unbroken.p90_ratio == pytest.approx(1.0, abs=0.1)
    assert unbroken.density_ratio == pytest.approx(1.0, abs=0.15)
    broken = vein_continuity(exemplar, chopped(wall, 25, 1))
    assert broken.median_ratio < 0.6
    assert broken.p90_ratio < 0.8


def test_the_smaller_the_pieces_the_shorter_the_veins() -> None:
    exemplar, wall = veined(110, 120), veined(220, 240)
    ratios = [vein_continuity(exemplar, chopped(wall, side, 2)).median_ratio for side in (60, 30, 15)]
    assert all(longer > 1.2 * shorter for longer, shorter in pairwise(ratios))


def test_the_exemplar_is_as_continuous_as_itself() -> None:
    exemplar = veined(70, 64)
    result = vein_continuity(exemplar, exemplar)
    assert result == VeinContinuity(1.0, 1.0, 1.0, 1.0, 1.0, result.exemplar_median_px)


def test_faded_veins_are_missing() -> None:
    exemplar = veined(90, 90)
    faded = vein_continuity(exemplar, veined(90, 90, contrast=0.5))
    assert faded.density_ratio < 0.1
    flat = vein_continuity(exemplar, grey(np.full((200, 100), 60.0)))
    assert (flat.median_ratio, flat.p90_ratio, flat.plain_median_ratio, flat.density_ratio) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("shape", [(60, 60), (16, 200), (3, 4), (1, 1)])
def test_a_flat_or_tiny_exemplar_has_no_veins_to_keep(shape: tuple[int, int]) -> None:
    flat = grey(np.full(shape, 41.3))
    assert vein_thresholds(flat).low == math.inf
    assert vein_lengths(flat, vein_thresholds(flat)).size == 0
    assert vein_continuity(flat, veined(200, 200)) == VeinContinuity(1.0, 1.0, 1.0, 1.0, 1.0, 0.0)


def test_spots_and_ramps_are_no_veins() -> None:
    row, col = np.indices((100, 100))
    limits = vein_thresholds(veined(100, 100))
    assert vein_lengths(grey(0.8 * row + 0.1 * col), limits).size == 0
    spots = grey(50 + 20 * np.exp(-((row % 20 - 10.0) ** 2 + (col % 20 - 10.0) ** 2) / 8))
    assert vein_lengths(spots, limits).max(initial=0.0) < 12


def test_windows_lie_side_by_side_and_reach_both_ends() -> None:
    assert veins._starts(100, 100) == [0]
    assert veins._starts(199, 100) == [0]
    assert veins._starts(320, 100) == [0, 110, 220]
    assert veins._starts(400, 100) == [0, 100, 200, 300]


def test_quantiles_weighted_by_length() -> None:
    lengths = np.array([1.0] * 10 + [10.0, 30.0])
    assert [veins._weighted_quantile(lengths, share) for share in (0.1, 0.3, 0.5, 0.9, 1.0)] == [1, 10, 30, 30, 30]
    assert veins._plain_quantile(lengths, 0.5) == 1.0


def crests_by_scipy(
    strength: NDArray[np.float64], angle: NDArray[np.float64], margin: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Crests as `_crests` should find them, and where rounding may decide, a neighbour being just as strong."""
    row, col = np.indices(strength.shape)
    ahead, behind = (
        ndimage.map_coordinates(strength, [row + sign * np.cos(angle), col + sign * np.sin(angle)], order=1)
        for sign in (1, -1)
    )
    crest = np.where((strength > behind) & (strength >= ahead) & (strength > 0), strength, 0.0)
    inner = np.zeros(strength.shape, dtype=bool)
    inner[margin:-margin, margin:-margin] = True
    doubtful = np.minimum(abs(strength - ahead), abs(strength - behind)) < 1e-9
    return np.where(inner, crest, 0.0), doubtful & inner


@pytest.mark.parametrize("seed", range(5))
def test_crests_are_those_of_interpolated_neighbours(seed: int) -> None:
    random = np.random.default_rng(seed)
    strength = np.maximum(ndimage.gaussian_filter(random.normal(size=(40, 50)), 1.5), 0.0)
    angle = random.uniform(-math.pi, math.pi, strength.shape)
    expected, doubtful = crests_by_scipy(strength, angle, 3)
    found = veins._crests(strength, np.cos(angle), np.sin(angle), 3)
    assert np.count_nonzero(expected) > 100
    assert_array_equal(found[~doubtful], expected[~doubtful])


def test_of_two_equal_rows_one_is_the_crest() -> None:
    strength = np.zeros((12, 12))
    strength[5:7] = 1.0
    crest = veins._crests(strength, np.ones((12, 12)), np.zeros((12, 12)), 2)
    assert_array_equal(np.flatnonzero(crest.any(axis=1)), [5])


def follow(points: dict[tuple[int, int], tuple[float, float]], low: float = 0.5) -> list[float]:
    """Lengths of curves through points of strength and direction, an angle in degrees from the row axis to across."""
    strength, angle = np.zeros((30, 30)), np.zeros((30, 30))
    for place, (value, degrees) in points.items():
        strength[place], angle[place] = value, math.radians(degrees)
    seeds = np.flatnonzero(strength >= 1)
    seeds = seeds[np.argsort(-strength.ravel()[seeds], kind="stable")]
    lengths = veins._follow(strength, np.cos(angle), np.sin(angle), seeds, low, veins._CURVE_COSINE, veins._GAP_COSINE)
    return sorted(lengths[lengths > 0].tolist())


def test_curves_followed_by_hand() -> None:
    level = {(10, c): (1.0, 0.0) for c in range(5, 21)}
    assert follow(level) == [15.0]
    assert follow({(k, k): (1.0, 135.0) for k in range(5, 16)}) == [pytest.approx(10 * math.sqrt(2))]
    # The direction across a ridge has no sign.
    assert follow(level | {(10, c): (1.0, 180.0) for c in range(8, 14)}) == [15.0]
    # Steps of one row down every three columns.
    assert follow({(10 + c // 3, c): (1.0, -18.0) for c in range(5, 17)}) == [pytest.approx(7 + 4 * math.sqrt(2))]


def test_one_missing_point_is_bridged_and_two_are_not() -> None:
    level = {(10, c): (1.0, 0.0) for c in range(5, 21)}
    assert follow({place: value for place, value in level.items() if place[1] != 11}) == [15.0]
    assert follow({place: value for place, value in level.items() if place[1] not in (11, 12)}) == [5.0, 7.0]


def test_a_curve_goes_on_above_low_only() -> None:
    level = {(10, c): (0.7, 0.0) for c in range(5, 21)} | {(10, 12): (1.0, 0.0)}
    assert follow(level) == [15.0]
    assert follow(level | {(10, c): (0.3, 0.0) for c in range(16, 21)}) == [10.0]
    assert follow(level | {(10, 12): (0.9, 0.0)}) == []


def test_a_sharp_corner_ends_a_curve() -> None:
    level = {(10, c): (1.0, 0.0) for c in range(5, 16)}
    upright = {(r, 15): (1.0, 90.0) for r in range(11, 19)}
    assert follow(level | upright) == [7.0, 10.0]


def test_curves_cross() -> None:
    level = {(10, c): (2.0, 0.0) for c in range(5, 21)}
    upright = {(r, 12): (1.0, 90.0) for r in range(4, 17)}
    assert follow(upright | level) == [12.0, 15.0]


def test_a_ridge_two_pixels_wide_is_one_curve() -> None:
    wide = {(r, c): (2.0 if r == 10 else 1.5, 0.0) for r in (10, 11) for c in range(5, 21)}
    assert follow(wide) == [15.0]


def test_misuse_is_refused() -> None:
    picture = veined(40, 40)
    with pytest.raises(ValueError, match="smaller"):
        vein_continuity(picture, picture[:39])
    with pytest.raises(ValueError, match="CIELAB"):
        vein_thresholds(picture[..., 0])
    with pytest.raises(ValueError, match="scales"):
        vein_thresholds(picture, sigmas_px=())
    with pytest.raises(ValueError, match="scales"):
        vein_thresholds(picture, sigmas_px=(1.0, 0.0))
    with pytest.raises(ValueError, match="shares"):
        vein_thresholds(picture, low_share=0.01, high_share=0.02)
