"""A picture of one inspected tile: as it should be, as it is, and where they differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from tilefab.colour import delta_e_2000, lab_from_xyz
from tilefab.inspection.records import Defect, Grade
from tilefab.io.faces import write_preview
from tilefab.pipeline.inspection.one_tile import InspectedTile
from tilefab.pipeline.inspection.pictures import RgbImage, picture_of
from tilefab.units import MM_PER_INCH

_SIDE_PX = 700
_GAP_PX = 12
_BACKGROUND = 245
_MARKS = {Grade.FIRST: (90, 90, 90), Grade.SECOND: (230, 140, 0), Grade.SCRAP: (200, 0, 0)}
_DIFFERENCES = np.array(
    [[255, 255, 255], [255, 237, 160], [254, 178, 76], [240, 59, 32], [128, 0, 38]], dtype=np.float64
)
_STEP_DELTA_E = 2.0
"""Difference from one colour of the map of differences to the next."""


def tile_sheet(tile: InspectedTile) -> RgbImage | None:
    """Target, tile and map of differences side by side, defects outlined; ``None`` of a tile that wasn't measured.

    In the map white is no difference, and each of the following colours (yellow, orange, red, dark red) ΔE00 2 more.
    """
    if tile.xyz is None or tile.target_xyz is None:
        return None
    panels = [picture_of(tile.target_xyz, _SIDE_PX), picture_of(tile.xyz, _SIDE_PX)]
    step = tile.xyz.shape[0] / panels[0].shape[0]
    panels.append(_differences(tile.target_xyz, tile.xyz, panels[0].shape[:2]))
    scale = tile.px_per_mm / step
    marked = [panels[0], *(_with_marks(panel, tile.inspection.defects, scale) for panel in panels[1:])]
    rows, cols = panels[0].shape[:2]
    sheet = np.full((rows + 2 * _GAP_PX, 3 * cols + 4 * _GAP_PX, 3), _BACKGROUND, dtype=np.uint8)
    for place, panel in enumerate(marked):
        left = _GAP_PX + place * (cols + _GAP_PX)
        sheet[_GAP_PX : _GAP_PX + rows, left : left + cols] = panel
    return sheet


def write_tile_sheet(path: Path, tile: InspectedTile) -> bool:
    """Write the sheet of a tile, if it was measured.

    Raises
    ------
    OutputError
        If it can't be written.
    """
    sheet = tile_sheet(tile)
    if sheet is None:
        return False
    shown = tile.px_per_mm * (sheet.shape[0] - 2 * _GAP_PX) / (0 if tile.xyz is None else tile.xyz.shape[0])
    write_preview(path, sheet, shown * MM_PER_INCH)
    return True


def _differences(target: NDArray[np.float32], fired: NDArray[np.float32], shape: tuple[int, ...]) -> RgbImage:
    rows, cols = shape
    high, wide = max(1, target.shape[0] // rows), max(1, target.shape[1] // cols)

    def small(xyz: NDArray[np.float32]) -> NDArray[np.float64]:
        part = xyz[: rows * high, : cols * wide].reshape(rows, high, cols, wide, 3)
        return lab_from_xyz(part.mean(axis=(1, 3)))

    level = np.clip(np.asarray(delta_e_2000(small(target), small(fired))) / _STEP_DELTA_E, 0.0, len(_DIFFERENCES) - 1.0)
    lower = np.minimum(level.astype(int), len(_DIFFERENCES) - 2)
    share = (level - lower)[..., np.newaxis]
    shown: RgbImage = np.rint(_DIFFERENCES[lower] * (1.0 - share) + _DIFFERENCES[lower + 1] * share).astype(np.uint8)
    return shown


def _with_marks(panel: RgbImage, defects: tuple[Defect, ...], px_per_mm: float) -> RgbImage:
    image = Image.fromarray(panel)
    draw = ImageDraw.Draw(image)
    for defect in defects:
        wide = max(4.0, 0.5 * defect.width_mm * px_per_mm + 3.0)
        high = max(4.0, 0.5 * defect.height_mm * px_per_mm + 3.0)
        x, y = defect.x_mm * px_per_mm, defect.y_mm * px_per_mm
        draw.rectangle((x - wide, y - high, x + wide, y + high), outline=_MARKS[defect.grade], width=2)
    return np.asarray(image, dtype=np.uint8)
