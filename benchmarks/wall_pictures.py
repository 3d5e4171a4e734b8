"""Pictures of walls in both designs of map, to look at: left the first seed's tile with patches, right crops.

The textures aren't part of this repository; without them the script says so and ends.

Usage: python benchmarks/wall_pictures.py [--textures FOLDER] [--out FOLDER]
"""

from __future__ import annotations

import argparse
import io
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tilefab.colour import lab_from_xyz, reduce_srgb, scan_to_xyz
from tilefab.sampling import (
    CropMap,
    CropOptions,
    TextureMap,
    TileMap,
    TileOptions,
    build_crop_map,
    build_tile_map,
    render,
)
from tilefab.synthesis import METHODS, SynthesisRequest
from tilefab.types import SizePx

ROOT = Path(__file__).resolve().parents[1]
DEFAULT_TEXTURES = ROOT.parent / "shared" / "textures"
DEFAULT_OUT = ROOT / "docs" / "images" / "walls"
TEXTURES = ("blades", "checkerboard", "greenmarble", "grid", "noise", "pebbles", "rough")
TILES = 10
PATCHES = 200
SEED = 1
WALL_PX = 700
GAP_PX = 12
GAP_GREY = 255
LARGEST_BYTES = 300_000
QUALITIES = range(80, 30, -5)


def main() -> None:
    """Draw and print what was written."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--textures", default=DEFAULT_TEXTURES, type=Path)
    parser.add_argument("--out", default=DEFAULT_OUT, type=Path)
    arguments = parser.parse_args()
    missing = [name for name in TEXTURES if not (arguments.textures / name / "exemplar.png").is_file()]
    if missing:
        print(f"skipped: {arguments.textures} has no {', '.join(missing)}; --textures names the folder that has them")
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in TEXTURES:
        begin = time.perf_counter()
        with Image.open(arguments.textures / name / "exemplar.png") as image:
            exemplar = np.ascontiguousarray(image.convert("RGB"))
        left = wall(tile_map(exemplar), exemplar.shape)
        try:
            crops = crop_map(exemplar)
        except ValueError as error:
            print(f"{name}: no map of crops, so the right wall is left grey: {error}")
            right, sizes = np.full_like(left, 128), "no crops"
        else:
            right = wall(crops, exemplar.shape)
            sizes = f"{len(crops.crop_row)} crops of {crops.crop_px} px, a pitch of {crops.pitch_px} px"
        gap = np.full((left.shape[0], GAP_PX, 3), GAP_GREY, dtype=np.uint8)
        data = jpeg(np.concatenate([left, gap, right], axis=1))
        (arguments.out / f"{name}.jpg").write_bytes(data)
        seconds = time.perf_counter() - begin
        print(f"{name}.jpg: {len(data) / 1e3:.0f} kB, tile of {exemplar.shape[0]} px, {sizes}, {seconds:.0f} s")


def tile_map(exemplar: NDArray[np.uint8]) -> TileMap:
    """The first seed's design: a quilted tile as large as the exemplar, and patches."""
    lab, valid = lab_of(exemplar)
    tile = METHODS["quilting"](SynthesisRequest(lab, valid, SizePx(*valid.shape), SEED))
    return build_tile_map(
        lab,
        valid,
        tile.source,
        TileOptions(patches=PATCHES, seed=SEED),
        stored=exemplar,
        space="srgb8",
        channels=("R", "G", "B"),
        dpi=25.4,
    )


def crop_map(exemplar: NDArray[np.uint8]) -> CropMap:
    """Crops of the exemplar, with the sizes that are taken where a job says nothing."""
    lab, valid = lab_of(exemplar)
    return build_crop_map(
        lab, valid, CropOptions(seed=SEED), stored=exemplar, space="srgb8", channels=("R", "G", "B"), dpi=25.4
    )


def lab_of(exemplar: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """CIELAB of an sRGB image, all of which may be used."""
    lab = np.asarray(lab_from_xyz(scan_to_xyz(exemplar, None)), dtype=np.float32)
    return lab, np.ones(lab.shape[:2], dtype=bool)


def wall(texture_map: TextureMap, tile_shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """The wall, reduced by the whole number that brings it closest to the width wanted."""
    rows, cols = TILES * tile_shape[0], TILES * tile_shape[1]
    return reduce_srgb(render(texture_map, 0, 0, rows, cols, seed=SEED), max(1, round(cols / WALL_PX)))


def jpeg(picture: NDArray[np.uint8]) -> bytes:
    """The picture as JPEG, of quality 80 if it is then small enough to keep."""
    for quality in QUALITIES:
        file = io.BytesIO()
        Image.fromarray(picture).save(file, "JPEG", quality=quality, optimize=True)
        if file.tell() <= LARGEST_BYTES:
            break
    return file.getvalue()


if __name__ == "__main__":
    main()
