"""Every face its own: two hundred faces of one job, no two alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tilefab.sampling import PlaneLayout, render

FACES = 200
FACE_ROWS, FACE_COLS = 192, 240


@pytest.fixture(scope="module")
def faces(
    maps: dict[str, Any], index_base: Callable[[int, int], NDArray[np.int32]]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """For each face, which pixel of the stone each pixel shows, and its lightness."""
    texture_map = maps["job"].map
    layout = PlaneLayout("scatter", 2024, FACE_ROWS, FACE_COLS, 0, *texture_map.tile_shape)
    index_map = texture_map.with_base(index_base(*texture_map.base.shape[:2]), "index", ("i",))
    regions = [layout.face(k) for k in range(FACES)]
    where = np.stack([render(index_map, r.row, r.col, r.rows, r.cols, seed=2024)[..., 0] for r in regions])
    return where, texture_map.base.reshape(-1, 3)[where, 0]


def test_no_two_faces_show_the_same_stone_at_the_same_place(
    faces: tuple[NDArray[np.int32], NDArray[np.float32]],
) -> None:
    where = faces[0].reshape(FACES, -1)
    shares = np.array([(where[i] == where[j]).mean() for i in range(FACES) for j in range(i)])
    assert shares.max() < 0.05
    assert shares.mean() < 5e-4


def test_no_two_faces_show_the_same_stone_even_when_shifted(
    maps: dict[str, Any], faces: tuple[NDArray[np.int32], NDArray[np.float32]]
) -> None:
    """Moved so that the repeatable tile lies in register, which is when two faces have most in common."""
    tile_rows, tile_cols = maps["job"].map.tile_shape
    layout = PlaneLayout("scatter", 2024, FACE_ROWS, FACE_COLS, 0, tile_rows, tile_cols)
    regions = [layout.face(k) for k in range(FACES)]
    shares = []
    for i, one in enumerate(regions):
        for j, other in enumerate(regions[:i]):
            down = (other.row - one.row + tile_rows // 2) % tile_rows - tile_rows // 2
            right = (other.col - one.col + tile_cols // 2) % tile_cols - tile_cols // 2
            here = faces[0][i][max(0, down) : FACE_ROWS + min(0, down), max(0, right) : FACE_COLS + min(0, right)]
            there = faces[0][j][max(0, -down) : FACE_ROWS - max(0, down), max(0, -right) : FACE_COLS - max(0, right)]
            shares.append((here == there).mean())
    # The repeatable tile shows through where no patch lies: on this small map in some three fifths of both.
    assert max(shares) < 0.87
    assert np.mean(shares) < 0.65
    assert min(shares) > 0.05  # or this test would compare nothing


def test_no_two_faces_look_alike_from_afar(faces: tuple[NDArray[np.int32], NDArray[np.float32]]) -> None:
    """Means over 16 x 16 blocks, against their median: a hash of 12 x 15 bits, far apart for any two faces."""
    small = faces[1].reshape(FACES, FACE_ROWS // 16, 16, FACE_COLS // 16, 16).mean(axis=(2, 4)).reshape(FACES, -1)
    bits = small > np.median(small, axis=1, keepdims=True)
    assert len(np.unique(bits, axis=0)) == FACES
    apart = np.array([np.count_nonzero(bits[i] != bits[j]) for i in range(FACES) for j in range(i)])
    assert apart.min() > 24


def test_all_faces_are_of_one_shade(faces: tuple[NDArray[np.int32], NDArray[np.float32]]) -> None:
    """Different, but of one run: mean lightness differs by little, and hardly a part of the stone is unused."""
    means = faces[1].mean(axis=(1, 2), dtype=np.float64)
    assert means.max() - means.min() < 0.8
    assert len(np.unique(faces[0])) > 0.6 * 150 * 140


def test_the_same_face_comes_back_alone(
    maps: dict[str, Any],
    index_base: Callable[[int, int], NDArray[np.int32]],
    faces: tuple[NDArray[np.int32], NDArray[np.float32]],
) -> None:
    texture_map = maps["job"].map
    layout = PlaneLayout("scatter", 2024, FACE_ROWS, FACE_COLS, 0, *texture_map.tile_shape)
    for index in (199, 0, 77):
        region = layout.face(index)
        face = render(texture_map, region.row, region.col, region.rows, region.cols, seed=2024, threads=3)
        assert (face[..., 0] == faces[1][index]).all()
