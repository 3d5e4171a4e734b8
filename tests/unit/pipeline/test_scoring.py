"""Scores of textures whose faults were put there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from tilefab.errors import ImageError
from tilefab.io.layers import Layer, write_layer
from tilefab.io.source_map_file import SourceMap, save_source_map
from tilefab.pipeline.scoring import Score, score_texture
from tilefab.types import SizePx

SIDE_PX = 96


class Quiet:
    """Nobody watches."""

    def stage(self, name: str, share: float) -> None:
        assert name
        assert 0 <= share <= 1


def stone(seed: int, rows: int = SIDE_PX, cols: int = SIDE_PX) -> NDArray[np.uint8]:
    """Grains with grit."""
    random = np.random.default_rng(seed)
    coarse = ndimage.gaussian_filter(random.normal(size=(rows + 40, cols + 40)), 2.5)[20:-20, 20:-20]
    light = 120 + 45 * np.tanh(4 * coarse / coarse.std()) + random.normal(0, 8, (rows, cols))
    return np.rint(np.clip(np.stack([light, 0.9 * light, 0.8 * light], axis=2), 0, 255)).astype(np.uint8)


def pieces(seed: int, rows: int, cols: int, side: int) -> NDArray[np.int32]:
    random = np.random.default_rng(seed)
    index = np.arange(SIDE_PX**2, dtype=np.int32).reshape(SIDE_PX, SIDE_PX)
    source = np.zeros((rows, cols), dtype=np.int32)
    for top in range(0, rows, side):
        for left in range(0, cols, side):
            r, c = random.integers(SIDE_PX - side + 1, size=2)
            there = source[top : top + side, left : left + side]
            there[...] = index[r : r + side, c : c + side][: there.shape[0], : there.shape[1]]
    return source


def written(path: Path, pixels: NDArray[np.uint8]) -> Path:
    Image.fromarray(pixels).save(path)
    return path


def scored(folder: Path, texture: NDArray[np.uint8], exemplar: NDArray[np.uint8]) -> Score:
    return score_texture(written(folder / "out.png", texture), written(folder / "exemplar.png", exemplar), Quiet())


def failed(score: Score) -> set[str]:
    return {gate.name for gate in score.gates if not gate.passed}


def test_the_exemplar_itself_is_perfect(tmp_path: Path) -> None:
    score = scored(tmp_path, stone(1), stone(1))
    assert score.passed
    assert score.map_estimated
    assert score.known_share == 1.0
    assert score.coverage == 1.0
    assert (score.portilla_simoncelli, score.radial_psd, score.seam_delta_e) == (0.0, 0.0, 0.0)
    assert score.gradient == pytest.approx(0, abs=1e-9)


def test_a_fresh_sample_passes_though_nothing_is_known_of_it(tmp_path: Path) -> None:
    score = scored(tmp_path, stone(2, 160, 200), stone(1))
    assert score.passed
    assert score.known_share < 0.1
    assert any("isn't made of copies" in note for note in score.notes)


def test_tiling_is_repetition(tmp_path: Path) -> None:
    assert "repetition" in failed(scored(tmp_path, np.tile(stone(1), (2, 3, 1)), stone(1)))


def test_one_piece_again_and_again_is_copies(tmp_path: Path) -> None:
    exemplar, texture = stone(1), stone(2, 192, 192)
    random = np.random.default_rng(3)
    for top in range(0, 192, 48):
        for left in range(0, 192, 48):
            down, right = random.integers(0, 12, 2)
            texture[top + down : top + down + 34, left + right : left + right + 34] = exemplar[20:54, 30:64]
    score = scored(tmp_path, texture, exemplar)
    (gate,) = (gate for gate in score.gates if gate.name == "copies")
    assert not gate.passed
    assert gate.value == pytest.approx(16 / 4)
    assert "comes back 16 times" in gate.meaning


def test_blur_and_noise_fail_their_gates(tmp_path: Path) -> None:
    fresh = stone(2, 128, 128)
    blurred = ndimage.gaussian_filter(fresh.astype(float), (1.2, 1.2, 0)).astype(np.uint8)
    assert "blur" in failed(scored(tmp_path, blurred, stone(1)))
    grain = np.random.default_rng(4).normal(0, 25, fresh.shape)
    assert "noise" in failed(scored(tmp_path, np.clip(fresh + grain, 0, 255).astype(np.uint8), stone(1)))


def test_hard_seams_fail_with_the_map_and_without(tmp_path: Path) -> None:
    exemplar, source = stone(1), pieces(5, 160, 192, 40)
    texture = exemplar.reshape(-1, 3)[source]
    without = scored(tmp_path, texture, exemplar)
    save_source_map(tmp_path / "map.npz", SourceMap(source, SizePx(SIDE_PX, SIDE_PX), "pieces", 5, False))
    kept = score_texture(tmp_path / "out.png", tmp_path / "exemplar.png", Quiet(), tmp_path / "map.npz")
    assert not kept.map_estimated
    assert kept.known_share == 1.0
    for score in (without, kept):
        assert {"hard seams", "straight edges"} <= failed(score)
    assert without.coverage == pytest.approx(kept.coverage, abs=0.02)
    assert without.seam_delta_e == pytest.approx(kept.seam_delta_e, rel=0.2)


def test_holes_are_left_out(tmp_path: Path) -> None:
    exemplar = np.dstack([stone(1), np.full((SIDE_PX, SIDE_PX), 255, np.uint8)])
    exemplar[:20, :, 3] = 0
    exemplar[:20, :, :3] = 0
    score = scored(tmp_path, stone(1)[20:], exemplar)
    assert score.coverage == 1.0
    assert any("76 pixels on a side" in note for note in score.notes)
    assert score.portilla_simoncelli < 0.15


def test_heights_are_scored_by_the_exemplars_range(tmp_path: Path) -> None:
    heights = stone(1)[:, :, :1].astype(np.float32) / 20 - 4
    heights[0, :2, 0] = -400, 400
    for name, pixels in (("exemplar.tif", heights), ("out.tif", heights[1:])):
        like = Layer(name, pixels, ("Y",))
        write_layer(tmp_path / name, pixels, like)
    score = score_texture(tmp_path / "out.tif", tmp_path / "exemplar.tif", Quiet())
    assert score.known_share == 1.0
    assert score.bidirectional_de76 < 0.1
    assert len(score.notes) == len(set(score.notes)) == 1


def test_gray_is_scored_as_gray(tmp_path: Path) -> None:
    score = scored(tmp_path, stone(1)[:, :, 0], stone(1)[:, :, 0])
    assert score.passed
    assert score.coverage == 1.0


@pytest.mark.parametrize(
    ("texture", "exemplar", "message"),
    [
        (stone(1, 39, 60), stone(1), "too few for a score"),
        (stone(1), stone(1, 16, 16), "too few for a score"),
        (stone(1)[:, :, 0], stone(1), "gray, the other in colour"),
        (
            np.dstack([stone(1), np.zeros((SIDE_PX, SIDE_PX), np.uint8) + np.eye(SIDE_PX, dtype=np.uint8) * 255]),
            stone(1),
            "transparent",
        ),
        (
            stone(1),
            np.dstack([stone(1), np.tile(np.array([255] * 30 + [0, 0], np.uint8), (SIDE_PX, 3))]),
            "without holes",
        ),
    ],
)
def test_what_cant_be_scored_is_said(tmp_path: Path, texture, exemplar, message: str) -> None:
    with pytest.raises(ImageError, match=message):
        scored(tmp_path, texture, exemplar)


def test_a_map_of_another_texture_is_refused(tmp_path: Path) -> None:
    save_source_map(tmp_path / "map.npz", SourceMap(pieces(1, 50, 60, 20), SizePx(SIDE_PX, SIDE_PX), "p", 1, False))
    texture, exemplar = (written(tmp_path / name, stone(1)) for name in ("a.png", "b.png"))
    with pytest.raises(ImageError, match="give the map that belongs"):
        score_texture(texture, exemplar, Quiet(), tmp_path / "map.npz")
