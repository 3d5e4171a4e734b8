"""What the faces themselves keep to: the ink limit, the bleed, and one another."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray


def faces(out: Path) -> list[NDArray[Any]]:
    return [tifffile.imread(path) for path in sorted((out / "faces").iterdir())]


@pytest.mark.parametrize("intent", ["perceptual", "relative", "absolute", "saturation"])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("limit", ["260", "180.5", "100", "33.3"])
def test_no_pixel_of_any_face_has_more_ink_than_allowed(
    workshop: Any, finished_once: Any, limit: str, bits: int, intent: str
) -> None:
    job = workshop.job(
        ("ink_limit_percent = 260", f'ink_limit_percent = {limit}\nintent = "{intent}"'),
        ("[output]", f"[output]\nbits = {bits}\nproofs = false"),
        ("count = 8", "count = 4"),
    )
    # The map of the stone is the same for all of these jobs.
    (texture,) = finished_once.out.glob("maps/*.texture.tfmap")
    (workshop.out / "maps").mkdir(parents=True)
    shutil.copy(texture, workshop.out / "maps")
    done = workshop.cli("run", job)
    assert done.code == 0, done.err
    assert "Growing the tile" not in done.err
    most = 0
    for face in faces(workshop.out):
        assert face.dtype == (np.uint8 if bits == 8 else np.uint16)
        most = max(most, int(face.sum(axis=2, dtype=np.int64).max()))
    full = 2**bits - 1
    allowed = Fraction(limit) * full / 100
    assert most <= allowed
    # The limit is used, so this test could fail: some pixel comes within a count an ink of it.
    if Fraction(limit) <= 200:
        assert most > allowed - 4


@pytest.fixture(scope="module")
def wall_run(tmp_path_factory: pytest.TempPathFactory, new_workshop: Any) -> Any:
    workshop = new_workshop(tmp_path_factory.mktemp("wall") / "work")
    job = workshop.job(("bleed_mm = 1", 'bleed_mm = 3\nlayout = "continuous"\ncolumns = 3'), ("count = 8", "count = 9"))
    done = workshop.cli("run", job)
    assert done.code == 0, done.err
    return workshop


def test_neighbours_of_a_wall_join(wall_run: Any) -> None:
    made = faces(wall_run.out)
    bleed = 7
    rows, cols = made[0].shape[0] - 2 * bleed, made[0].shape[1] - 2 * bleed
    assert (rows, cols) == (57, 47)
    plane = np.zeros((3 * rows + 2 * bleed, 3 * cols + 2 * bleed, 4), dtype=np.uint8)
    for index, face in enumerate(made):
        row, col = index // 3 * rows, index % 3 * cols
        plane[row : row + face.shape[0], col : col + face.shape[1]] = face
    for index, face in enumerate(made):
        # Every face, bleed and all, lies unchanged in the plane that all were laid into.
        row, col = index // 3 * rows, index % 3 * cols
        np.testing.assert_array_equal(plane[row : row + face.shape[0], col : col + face.shape[1]], face)
    right, left = made[0][:, cols:], made[1][:, : 2 * bleed]
    np.testing.assert_array_equal(right, left)
    np.testing.assert_array_equal(made[1][rows:], made[4][: 2 * bleed])
    assert len({face.tobytes() for face in made}) == 9


def test_faces_of_a_wall_lie_in_reading_order(wall_run: Any) -> None:
    assert [line["origin"] for line in wall_run.lines()] == [
        [row * 57 - 7, col * 47 - 7] for row in range(3) for col in range(3)
    ]


def test_bleed_adds_a_margin_and_moves_nothing(wall_run: Any, workshop: Any) -> None:
    job = workshop.job(("bleed_mm = 1", 'bleed_mm = 0\nlayout = "continuous"\ncolumns = 3'), ("count = 8", "count = 9"))
    assert workshop.cli("run", job).code == 0
    for bare, with_bleed in zip(faces(workshop.out), faces(wall_run.out), strict=True):
        np.testing.assert_array_equal(with_bleed[7:-7, 7:-7], bare)


def test_scattered_faces_share_no_piece_of_the_plane(finished_once: Any) -> None:
    boxes = [(*line["origin"], line["rows"], line["cols"]) for line in finished_once.lines()]
    for index, (row, col, rows, cols) in enumerate(boxes):
        for other_row, other_col, other_rows, other_cols in boxes[:index]:
            apart = row >= other_row + other_rows or other_row >= row + rows
            assert apart or col >= other_col + other_cols or other_col >= col + cols


@pytest.fixture
def prepared(workshop: Any) -> Callable[..., tuple[str, list[str]]]:
    """Build the map of a job; what its preparation says, and its warnings."""
    from tilefab.io import load_texture_map

    def build(*changes: tuple[str, str]) -> tuple[str, list[str]]:
        done = workshop.cli("map", "build", workshop.job(*changes), "--json")
        assert done.code == 0, done.err
        return load_texture_map(done.json["file"]).provenance["preparation"], done.json["warnings"]

    return build


def test_a_gray_scan_works_and_is_said_to_be_gray(workshop: Any, prepared: Any, made_stone: Any, scanner: Any) -> None:
    scanner(workshop.folder / "slab.tif", made_stone(100, 110)[..., 0].copy(), photometric="minisblack")
    assert "slab.tif is grayscale: it is used as a neutral grey stone" in prepared()[0]
    done = workshop.cli("run", workshop.folder / "job.toml", "--faces", "0:2")
    assert done.code == 0, done.err
    assert len(workshop.hashes()) == 2


def test_a_scan_with_alpha_works_and_its_transparent_part_is_not_used(
    workshop: Any, prepared: Any, made_stone: Any, scanner: Any
) -> None:
    from tilefab.io import load_texture_map

    pixels = np.dstack([made_stone(100, 110), np.full((100, 110), 255, np.uint8)])
    pixels[:, 80:] = 0, 255, 0, 0
    scanner(workshop.folder / "slab.tif", pixels, extrasamples=["unassalpha"])
    preparation, _ = prepared()
    assert "slab.tif has an alpha channel: 27.3 % of it is transparent and not used" in preparation
    done = workshop.cli("run", workshop.folder / "job.toml", "--faces", "0:2")
    assert done.code == 0, done.err
    (path,) = workshop.out.glob("maps/*.texture.tfmap")
    texture = load_texture_map(path)
    assert texture.crop_col.max() + texture.crop_px <= 80


def test_a_masked_part_is_not_used(workshop: Any, prepared: Any) -> None:
    from tilefab.io import load_texture_map

    mask = np.zeros((100, 110), np.uint8)
    mask[:25] = 255
    tifffile.imwrite(workshop.folder / "mask.png.tif", mask)
    preparation, _ = prepared(("square = false", 'square = false\nmasks = ["mask.png.tif"]'))
    assert "slab.tif: 25.0 % not used" in preparation
    (path,) = workshop.out.glob("maps/*.texture.tfmap")
    texture = load_texture_map(path)
    assert texture.crop_row.min() >= 25


def test_a_tile_doesn_t_use_a_masked_part_either(workshop: Any, prepared: Any, tile_design: tuple[str, str]) -> None:
    from tilefab.io import load_texture_map

    mask = np.zeros((100, 110), np.uint8)
    mask[:25] = 255
    tifffile.imwrite(workshop.folder / "mask.png.tif", mask)
    prepared(("square = false", 'square = false\nmasks = ["mask.png.tif"]'), tile_design)
    (path,) = workshop.out.glob("maps/*.texture.tfmap")
    texture = load_texture_map(path)
    assert (texture.tile_source // texture.base.shape[1]).min() >= 25
    assert texture.patches.base_row.min() >= 25


def test_several_scans_are_joined_and_can_be_told_apart(workshop: Any, made_stone: Any, scanner: Any) -> None:
    from tilefab.io import load_texture_map

    scanner(workshop.folder / "second.tif", made_stone(90, 80, 2).astype(np.uint16) * 257)
    job = workshop.job(('["slab.tif"]', '["slab.tif", "second.tif"]'))
    done = workshop.cli("run", job, "--faces", "0:2")
    assert done.code == 0, done.err
    (path,) = workshop.out.glob("maps/*.texture.tfmap")
    assert [slab.name for slab in load_texture_map(path).slabs] == ["slab.tif", "second.tif"]


def test_a_stone_much_smaller_than_a_tile_gives_a_warning(prepared: Any) -> None:
    _, warnings = prepared(("[20, 24]", "[200, 240]"))
    assert any("times as large as a tile" in warning for warning in warnings)
