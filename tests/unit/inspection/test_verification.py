"""An image is compared with a face place by place: what lies on the tile isn't held against the face."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from sim.tile_photo import PhotoConditions
from tests.imagined_stone import ImaginedStone, to_xyz, true_corners
from tilefab.inspection.verification import compare, difference_of_faces, without_cover
from tilefab.inspection.views import Cells, matrix_of
from tilefab.types import SizeMm, SizePx

SIZE = SizeMm(150.0, 150.0)
STONE = ImaginedStone(SIZE)


def test_comparison_finds_the_exact_place() -> None:
    photo = STONE.photo(1, PhotoConditions(rotation_deg=1.0))
    xyz = to_xyz(photo.image)
    truth = matrix_of(true_corners(photo, SIZE), SizePx(1, 1))
    off = truth @ np.array([[1.01, 0.004, 0.006], [-0.003, 0.992, -0.008], [0.0, 0.0, 1.0]])
    light, mask = np.ascontiguousarray(xyz[..., 1]), np.ones(xyz.shape[:2], np.bool_)
    found = compare(light, mask, off, STONE(1, 128))
    square = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    np.testing.assert_allclose(square @ found.matrix.T, square @ truth.T, atol=0.6)
    assert found.differs < 0.01
    assert found.share > 0.9
    other = compare(light, mask, off, STONE(2, 128))
    assert other.differs > 0.5
    assert other.likeness < 0.4


def test_cover_is_not_held_against_a_face() -> None:
    covered = dataclasses.replace(PhotoConditions(), occluded=(0.2, 0.2, 0.5, 0.5))
    photo = STONE.photo(1, covered)
    xyz = to_xyz(photo.image)
    matrix = matrix_of(true_corners(photo, SIZE), SizePx(1, 1))
    found = compare(np.ascontiguousarray(xyz[..., 1]), np.ones(xyz.shape[:2], np.bool_), matrix, STONE(1, 128))
    assert found.differs < 0.05
    assert 0.4 < found.seen < 0.75
    assert not found.compared[45:70, 45:70].any()


def test_faces_differ_from_each_other_but_not_from_themselves() -> None:
    one, other = STONE(1, 128), STONE(2, 128)
    everywhere = np.ones((128, 128), dtype=np.bool_)
    assert difference_of_faces(one, one, 0, everywhere) < 0.001
    assert difference_of_faces(one, other, 0, everywhere) > 0.8
    for turns in range(4):
        # A face turned anticlockwise, then clockwise again.
        assert difference_of_faces(one, np.rot90(one, turns), turns, everywhere) < 0.001
    assert difference_of_faces(one, np.rot90(one), 0, everywhere) > 0.8
    mixed = one.copy()
    mixed[:, : one.shape[1] // 4] = other[:, : one.shape[1] // 4]
    assert 0.15 < difference_of_faces(one, mixed, 0, everywhere) < 0.35
    right = everywhere.copy()
    right[:, :50] = False
    assert difference_of_faces(one, mixed, 0, right) < 0.02


@pytest.mark.parametrize("with_face", [True, False])
def test_cover_stands_out_from_light_and_stone(with_face: bool) -> None:
    generator = np.random.default_rng(3)
    stone = (50.0 + 0.5 * generator.standard_normal((64, 64))).astype(np.float32)
    slope = np.linspace(-6.0, 6.0, 64, dtype=np.float32)[:, np.newaxis]
    shown = stone + slope + 0.1 * slope * slope
    shown[20:40, 10:50] = 70.0
    seen = np.ones((64, 64), dtype=np.bool_)
    seen[:, 60:] = False
    left = without_cover(Cells(shown, seen), Cells(stone, np.ones_like(seen)) if with_face else None).seen
    assert not left[20:40, 10:50].any()
    assert left[:16, :58].mean() > 0.98
    assert left[46:, :58].mean() > 0.98
    assert not left[:, 60:].any()


def test_nothing_is_covered_where_nothing_stands_out() -> None:
    face = Cells(STONE(3, 64), np.ones((75, 75), dtype=np.bool_))
    shown = Cells(face.lightness * np.float32(0.95) + np.float32(4.0), face.seen)
    assert without_cover(shown, face).seen.all()
    hardly = Cells(face.lightness, np.zeros_like(face.seen))
    assert without_cover(hardly, face) is hardly
