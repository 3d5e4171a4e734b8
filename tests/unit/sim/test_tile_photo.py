"""Photographs of fired tiles lie where they say, and show what was asked for."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from sim.scanner import scan_of
from sim.spectral_press import SpectralPress
from sim.tile_photo import PhotoConditions, fired_rgb, photo_conditions, photo_of

PLAIN = PhotoConditions(blur_px=0.0, noise=0.0)


def _spotted(rows: int, cols: int, places: list[tuple[float, float]], radius: float = 6.0) -> np.ndarray:
    y, x = np.mgrid[:rows, :cols] + 0.5
    tile = np.full((rows, cols, 3), 0.5, dtype=np.float32)
    for column, row in places:
        tile[(x - column) ** 2 + (y - row) ** 2 < radius**2] = 0.0
    return tile


def _linear(image: np.ndarray) -> np.ndarray:
    value = image / 255.0
    return np.asarray(np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4))


def _middle_of_dark(image: np.ndarray, near: np.ndarray, reach: float) -> np.ndarray:
    y, x = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    weight = np.clip(0.5 - _linear(image)[..., 1], 0.0, None) * ((x - near[0]) ** 2 + (y - near[1]) ** 2 < reach**2)
    return np.array([(weight * x).sum() / weight.sum(), (weight * y).sum() / weight.sum()])


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("px_per_mm", [1.7, 4.0, 6.1])
def test_matrix_says_where_everything_lies(turns: int, px_per_mm: float) -> None:
    places = [(50.0, 60.0), (150.0, 40.0), (120.0, 100.0)]
    tile = _spotted(140, 200, places)
    conditions = PhotoConditions(turns, 3.0, (2.0, -1.5), 1.02, blur_px=0.4, noise=0.0, perspective=0.02)
    photo = photo_of(tile, 4.0, conditions, np.random.default_rng(turns), px_per_mm=px_per_mm)
    for place in places:
        expected = photo.matrix @ np.array([*place, 1.0])
        expected = expected[:2] / expected[2]
        found = _middle_of_dark(photo.image, expected, 10.0 * px_per_mm / 4.0)
        np.testing.assert_allclose(found, expected, atol=0.15)


def test_quarter_turns_are_clockwise() -> None:
    tile = np.full((40, 40, 3), 0.5, dtype=np.float32)
    tile[:20, :20] = 0.9  # upper left
    photo = photo_of(tile, 1.0, dataclasses.replace(PLAIN, quarter_turns=1), np.random.default_rng(1), px_per_mm=1.0)
    rows, cols = photo.image.shape[:2]
    assert photo.image[rows // 2 - 10, cols // 2 + 10, 0] > photo.image[rows // 2 - 10, cols // 2 - 10, 0]
    assert photo.image[rows // 2 + 10, cols // 2 + 10, 0] == photo.image[rows // 2 + 10, cols // 2 - 10, 0]


def test_size_and_backing() -> None:
    tile = np.full((100, 200, 3), 0.5, dtype=np.float32)
    photo = photo_of(tile, 2.0, PLAIN, np.random.default_rng(1), px_per_mm=2.0, margin_mm=8.0)
    assert photo.image.shape == (132, 232, 3)
    linear = _linear(photo.image)
    assert np.abs(linear[:15] - 0.03).max() < 0.002
    assert np.abs(linear[20:110, 20:210] - 0.5).max() < 0.005


@pytest.mark.parametrize("broken", [0.1, 0.4])
def test_broken_off_share(broken: float) -> None:
    tile = np.full((200, 200, 3), 0.8, dtype=np.float32)
    for seed in range(4):
        conditions = dataclasses.replace(PLAIN, broken=broken)
        photo = photo_of(tile, 1.0, conditions, np.random.default_rng(seed), px_per_mm=1.0)
        assert abs((photo.image[..., 0] > 128).sum() / 200**2 - (1.0 - broken)) < 0.02


def test_occluded_part_lies_on_the_face() -> None:
    tile = np.full((100, 200, 3), 0.9, dtype=np.float32)
    conditions = dataclasses.replace(PLAIN, quarter_turns=2, occluded=(0.0, 0.0, 0.25, 0.5))
    photo = photo_of(tile, 1.0, conditions, np.random.default_rng(3), px_per_mm=1.0)
    linear = _linear(photo.image)
    covered = linear[8 + 52 : 8 + 98, 8 + 152 : 8 + 198]  # upper left of the face: lower right of the image
    assert covered.max() < 0.65
    assert linear[8 + 2 : 8 + 48, 8 + 2 : 8 + 198].min() > 0.85


def test_light_gain_and_noise() -> None:
    tile = np.full((200, 200, 3), 0.5, dtype=np.float32)
    lit = dataclasses.replace(PLAIN, light=0.2, gain_rgb=(1.1, 1.0, 0.9))
    linear = _linear(photo_of(tile, 1.0, lit, np.random.default_rng(1), px_per_mm=1.0).image)[10:-10, 10:-10]
    assert linear[..., 1].max() / linear[..., 1].min() > 1.2
    np.testing.assert_allclose(linear.mean(axis=(0, 1)) / linear[..., 1].mean(), [1.1, 1.0, 0.9], atol=0.01)
    noisy = dataclasses.replace(PLAIN, noise=0.02)
    linear = _linear(photo_of(tile, 1.0, noisy, np.random.default_rng(1), px_per_mm=1.0).image)[10:-10, 10:-10]
    assert abs(linear.std() - 0.02 * np.sqrt(0.52)) < 0.001


def test_repeatable_and_drawn_within_limits() -> None:
    tile = _spotted(60, 60, [(30.0, 30.0)])
    conditions = photo_conditions(np.random.default_rng(5), occluded=0.3, broken=0.4)
    one, two = (photo_of(tile, 1.0, conditions, np.random.default_rng(6), px_per_mm=2.0) for _ in range(2))
    np.testing.assert_array_equal(one.image, two.image)
    source = np.random.default_rng(7)
    drawn = [photo_conditions(source, occluded=0.3, broken=0.4, size_mm=(200.0, 100.0)) for _ in range(300)]
    assert {c.quarter_turns for c in drawn} == {0, 1, 2, 3}
    assert all(abs(c.rotation_deg) <= 4.0 and abs(c.scale - 1.0) <= 0.02 and 0 <= c.broken <= 0.4 for c in drawn)
    assert all(max(np.abs(c.shift_mm)) <= 6.0 for c in drawn)
    for c in drawn:
        assert c.occluded is not None
        x, y, wide, high = c.occluded
        assert 0.0 <= x <= x + wide <= 1.0 + 1e-9
        assert 0.0 <= y <= y + high <= 1.0 + 1e-9
        assert wide * high <= 0.3 + 1e-9
    assert photo_conditions(source).occluded is None


def test_fired_colours_are_the_scanners() -> None:
    press = SpectralPress("ceramic4")
    pixels = np.zeros((40, 40, 4), dtype=np.uint8)
    pixels[:, 20:, 0] = 200
    colours = fired_rgb(pixels, press)
    assert colours.shape == (40, 40, 3)
    assert colours.dtype == np.float32
    assert (colours[:, :20] > colours[:, 20:]).all()
    scan = scan_of(pixels, press, np.random.default_rng(1), blur_px=0.01, unevenness=0.0, noise=0.0)
    middle = scan.shape[0] // 2
    np.testing.assert_allclose(_linear(scan[middle, middle - 10]), colours[20, 10], atol=0.005)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"scale": 0.0}, "scale"), ({"broken": 1.0}, "broken"), ({"perspective": -0.1}, "perspective")],
)
def test_senseless_conditions(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(PLAIN, **change)


def test_senseless_tiles() -> None:
    generator = np.random.default_rng(1)
    with pytest.raises(ValueError, match="rows, cols, 3"):
        photo_of(np.zeros((4, 4), np.float32), 1.0, PLAIN, generator, px_per_mm=1.0)
    with pytest.raises(ValueError, match="more than 0"):
        photo_of(np.zeros((4, 4, 3), np.float32), 1.0, PLAIN, generator, px_per_mm=0.0)
    with pytest.raises(ValueError, match="print data"):
        fired_rgb(np.zeros((4, 4, 3), np.uint8), SpectralPress("ceramic4"))
