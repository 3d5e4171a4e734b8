"""Tiles are found to a fraction of a pixel, whole or not; images of no use are told apart."""

from __future__ import annotations

import dataclasses
import io

import numpy as np
import pytest
from PIL import Image

from sim.tile_photo import PhotoConditions, photo_conditions
from tests.imagined_stone import PX_PER_MM, ImaginedStone, to_xyz, true_corners
from tilefab.inspection.finding import FoundTile, find_tile
from tilefab.inspection.records import ImageProblem
from tilefab.types import SizeMm

SIZE = SizeMm(150.0, 150.0)
STONE = ImaginedStone(SIZE)
PLAIN = PhotoConditions()


def _found(xyz: np.ndarray, size: SizeMm = SIZE, px_per_mm: float | None = PX_PER_MM) -> FoundTile:
    tile = find_tile(xyz, size, px_per_mm=px_per_mm)
    assert isinstance(tile, FoundTile), tile
    return tile


@pytest.mark.parametrize("px_per_mm", [PX_PER_MM, None])
@pytest.mark.parametrize("seed", range(6))
def test_corners_of_a_whole_tile(seed: int, px_per_mm: float | None) -> None:
    conditions = photo_conditions(np.random.default_rng(seed), shift=0.04)
    photo = STONE.photo(seed, conditions)
    tile = _found(to_xyz(photo.image), px_per_mm=px_per_mm)
    truth = np.roll(true_corners(photo, SIZE), conditions.quarter_turns, axis=0)
    np.testing.assert_allclose(tile.corners_px, truth, atol=0.5)
    assert tile.sides_seen == (True, True, True, True)
    assert tile.measured
    assert tile.visible > 0.99
    assert abs(tile.px_per_mm / (PX_PER_MM * conditions.scale) - 1.0) < 0.003
    assert abs(tile.mask.sum() / (SIZE.width * SIZE.height * tile.px_per_mm**2) - 1.0) < 0.04


@pytest.mark.parametrize("turns", range(4))
def test_oblong_tile_says_how_it_lies(turns: int) -> None:
    size = SizeMm(200.0, 100.0)
    photo = ImaginedStone(size).photo(1, PhotoConditions(quarter_turns=turns, rotation_deg=-3.0))
    for px_per_mm in (PX_PER_MM, None):
        tile = _found(to_xyz(photo.image), size, px_per_mm)
        assert tile.across == bool(turns % 2)
        np.testing.assert_allclose(tile.corners_px, np.roll(true_corners(photo, size), turns, axis=0), atol=0.5)


def test_seen_from_aslant() -> None:
    photo = STONE.photo(1, PhotoConditions(rotation_deg=2.0, perspective=0.01))
    np.testing.assert_allclose(_found(to_xyz(photo.image)).corners_px, true_corners(photo, SIZE), atol=0.6)


@pytest.mark.parametrize("seed", range(12))
def test_broken_tile(seed: int) -> None:
    conditions = dataclasses.replace(
        photo_conditions(np.random.default_rng(seed), shift=0.02), broken=0.1 + 0.025 * seed, quarter_turns=0
    )
    photo = STONE.photo(seed, conditions, seed=seed)
    tile = _found(to_xyz(photo.image))
    assert abs(tile.visible - (1.0 - conditions.broken)) < 0.03
    # Without a pair of sides the camera's resolution counts, and the tile is up to 2 % off it.
    away = np.linalg.norm(tile.corners_px - true_corners(photo, SIZE), axis=1).max()
    assert away < (4.0 if tile.measured else 0.03 * SIZE.width * PX_PER_MM)


def test_scaled_keeps_the_sides_seen() -> None:
    tile = _found(to_xyz(STONE.photo(0, PLAIN).image))
    half = dataclasses.replace(tile, sides_seen=(False, False, True, True))
    larger = half.scaled(1.1)
    np.testing.assert_allclose(larger[3], tile.corners_px[3])
    np.testing.assert_allclose(larger[1] - larger[3], 1.1 * (tile.corners_px[1] - tile.corners_px[3]))


def test_tile_darker_than_the_belt() -> None:
    photo = STONE.photo(2, PhotoConditions(backing=0.8, rotation_deg=1.0))
    np.testing.assert_allclose(_found(to_xyz(photo.image)).corners_px, true_corners(photo, SIZE), atol=0.6)


@pytest.mark.parametrize(
    ("value", "problem"), [(0, ImageProblem.BLACK), (255, ImageProblem.BLOWN_OUT), (120, ImageProblem.NO_TILE)]
)
def test_images_of_one_value(value: int, problem: ImageProblem) -> None:
    image = np.full((200, 200, 3), value, dtype=np.uint8)
    assert find_tile(to_xyz(image), SIZE, px_per_mm=PX_PER_MM) is problem


def test_noisy_black_and_empty_belt() -> None:
    generator = np.random.default_rng(1)
    black = generator.integers(0, 8, (300, 300, 3), dtype=np.uint8)
    assert find_tile(to_xyz(black), SIZE) is ImageProblem.BLACK
    belt = generator.integers(44, 54, (300, 300, 3), dtype=np.uint8)
    assert find_tile(to_xyz(belt), SIZE) is ImageProblem.NO_TILE
    assert find_tile(to_xyz(belt[:30, :30]), SIZE) is ImageProblem.NO_TILE


def test_torn_images() -> None:
    image = STONE.photo(1, PLAIN).image
    for fill in (0, 128):
        torn = image.copy()
        torn[200:] = fill
        assert find_tile(to_xyz(torn), SIZE, px_per_mm=PX_PER_MM) is ImageProblem.TORN
    stuck = image.copy()
    stuck[100:140] = stuck[100]
    assert find_tile(to_xyz(stuck), SIZE) is ImageProblem.TORN
    columns = image.copy()
    columns[:, 100:130] = 90
    assert find_tile(to_xyz(columns), SIZE) is ImageProblem.TORN


@pytest.mark.parametrize("quality", [50, 75, 90])
def test_compressed_and_enlarged_images_are_not_torn(quality: int) -> None:
    image = Image.fromarray(STONE.photo(1, PhotoConditions(rotation_deg=1.0)).image)
    file = io.BytesIO()
    image.save(file, "JPEG", quality=quality)
    _found(to_xyz(np.asarray(Image.open(file))))
    larger = image.resize((2 * image.width, 2 * image.height), Image.Resampling.BICUBIC)
    _found(to_xyz(np.asarray(larger)), px_per_mm=2.0 * PX_PER_MM)


def test_without_noise_an_even_belt_is_not_torn() -> None:
    photo = STONE.photo(1, PhotoConditions(noise=0.0, rotation_deg=1.0))
    np.testing.assert_allclose(_found(to_xyz(photo.image)).corners_px, true_corners(photo, SIZE), atol=0.5)


@pytest.mark.parametrize("px_per_mm", [PX_PER_MM, None])
def test_two_tiles(px_per_mm: float | None) -> None:
    one, two = (STONE.photo(face, PhotoConditions(rotation_deg=1.0 * face)).image for face in (1, 2))
    rows = min(len(one), len(two))
    both = np.concatenate([one[:rows], two[:rows]], axis=1)
    assert find_tile(to_xyz(both), SIZE, px_per_mm=px_per_mm) is ImageProblem.TWO_TILES


def test_wrong_size() -> None:
    photo = STONE.photo(1, PhotoConditions(rotation_deg=1.0))
    xyz = to_xyz(photo.image)
    assert find_tile(xyz, SizeMm(160.0, 160.0), px_per_mm=PX_PER_MM) is ImageProblem.WRONG_SIZE
    assert find_tile(xyz, SizeMm(140.0, 140.0), px_per_mm=PX_PER_MM) is ImageProblem.WRONG_SIZE
    assert find_tile(xyz, SizeMm(150.0, 140.0)) is ImageProblem.WRONG_SIZE
    assert isinstance(find_tile(xyz, SizeMm(600.0, 600.0)), FoundTile)


def test_misuse() -> None:
    xyz = np.zeros((100, 100, 3), dtype=np.float32)
    with pytest.raises(ValueError, match="rows, cols, 3"):
        find_tile(xyz[..., 0], SIZE)
    with pytest.raises(ValueError, match="sizes"):
        find_tile(xyz, SizeMm(0.0, 10.0))
    with pytest.raises(ValueError, match="px_per_mm"):
        find_tile(xyz, SIZE, px_per_mm=-1.0)
