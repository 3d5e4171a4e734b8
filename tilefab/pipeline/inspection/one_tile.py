"""One fired tile: recognised, laid over its own face, measured, judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import lab_from_xyz
from tilefab.inspection.defects import find_defects
from tilefab.inspection.dimensions import measure_dimensions
from tilefab.inspection.finding import FoundTile, find_tile
from tilefab.inspection.fingerprint import FingerprintIndex
from tilefab.inspection.grading import Tolerances, grade_tile
from tilefab.inspection.light import even_light
from tilefab.inspection.measurement import RegionColours, colour_figures, region_colours
from tilefab.inspection.recognition import recognise
from tilefab.inspection.records import Grade, ImageProblem, Recognition, TileDimensions, TileInspection
from tilefab.inspection.registration import Registration, register, start_matrix, warp_mask_to_face, warp_to_face
from tilefab.pipeline.inspection.images import CameraImage
from tilefab.pipeline.inspection.pictures import RgbImage, picture_of
from tilefab.pipeline.inspection.predicting import PredictedFaces
from tilefab.sampling import TextureMap

Float32Array = NDArray[np.float32]

_PICTURE_PX = 360
_LEAST_PX_PER_MM = 1.0
_LEAST_LIKENESS = 0.2
"""Correlation of a tile with its own face at full size, below which it can't be measured."""


@dataclass(frozen=True, eq=False)
class TilePictures:
    """What a tile looks like beside what it should, uint8 sRGB (rows, cols, 3), of one size.

    Attributes
    ----------
    predicted, fired
        The face as it should look, and the tile laid over it, its light evened.
    """

    predicted: RgbImage
    fired: RgbImage


@dataclass(frozen=True, eq=False)
class InspectedTile:
    """A tile, and what was measured on it.

    Attributes
    ----------
    inspection
        What was found out.
    correction
        Number of the correction that it was printed with.
    regions
        Its regions' colours against its target; ``None`` if it couldn't be measured.
    printed
        The same against what its own inks fire to on the press as profiled: what the drift is learnt from.
    pictures
        For people; ``None`` if there are none.
    xyz
        (rows, cols, 3) the tile on the face grid, evened.
    target_xyz
        What it should be.
    px_per_mm
        Resolution of both.
    """

    inspection: TileInspection
    correction: int = 0
    regions: RegionColours | None = None
    printed: RegionColours | None = None
    pictures: TilePictures | None = None
    xyz: Float32Array | None = field(default=None, repr=False)
    target_xyz: Float32Array | None = field(default=None, repr=False)
    px_per_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class PrintedWith:
    """How a face was printed.

    Attributes
    ----------
    number
        Of the correction; 0: as the job says.
    press
        Its map in inks; ``None``: the job's own.
    """

    number: int = 0
    press: TextureMap | None = None


AS_THE_JOB_SAYS = PrintedWith()


class TileInspector:
    """Inspects tiles of a job.

    Parameters
    ----------
    faces
        What its faces should look like.
    tolerances
        What first choice may show.
    region_mm
        Side of the regions that colours are compared in.
    """

    def __init__(self, faces: PredictedFaces, tolerances: Tolerances, region_mm: float) -> None:
        self.faces, self._tolerances, self._region_mm = faces, tolerances, region_mm

    def inspect(
        self,
        image: CameraImage,
        index: FingerprintIndex,
        printed_with: Callable[[int], PrintedWith] | Mapping[int, PrintedWith] | None = None,
    ) -> InspectedTile:
        """Find out all about a tile.

        Parameters
        ----------
        image
            The tile, anyhow it lies in it.
        index
            Faces that it may show.
        printed_with
            Says of a face how it was printed, if any was corrected.
        """
        size = self.faces.plan.tile_mm
        found = find_tile(image.xyz, size, px_per_mm=image.px_per_mm)
        recognition = recognise(image.xyz, index, self.faces.lightness, size, px_per_mm=image.px_per_mm, found=found)
        if recognition.face is None or isinstance(found, ImageProblem):
            return InspectedTile(_not_ours(recognition))
        outline = _outline(found, recognition)
        dimensions = measure_dimensions(image.xyz, outline, found.mask, size, image.px_per_mm)
        if printed_with is None:
            how = AS_THE_JOB_SAYS
        elif callable(printed_with):
            how = printed_with(recognition.face)
        else:
            how = printed_with.get(recognition.face, AS_THE_JOB_SAYS)
        return self._measured(image, found, recognition, outline, dimensions, how)

    def _measured(
        self,
        image: CameraImage,
        found: FoundTile,
        recognition: Recognition,
        outline: NDArray[np.float64],
        dimensions: TileDimensions | None,
        how: PrintedWith,
    ) -> InspectedTile:
        face = recognition.face
        if face is None:
            raise ValueError("only a tile that was recognised can be measured")
        camera_px_per_mm = image.px_per_mm or _px_per_mm(recognition, self.faces)
        factor = self.faces.factor(camera_px_per_mm)
        px_per_mm = self.faces.px_per_mm(factor)
        target = self.faces.xyz(face, factor)
        printed = target if how.press is None else self.faces.xyz(face, factor, how.press)
        inks = self.faces.ink_frac(face, factor, how.press)
        shape = target.shape[:2]
        laid = self._laid(image, found, recognition, printed)
        if laid.likeness < _LEAST_LIKENESS:
            reason = f"the tile could not be laid over face {face} (likeness {laid.likeness:.2f}): it is not measured"
            return InspectedTile(TileInspection(recognition, None, dimensions, (), Grade.SCRAP, (reason,)), how.number)
        seen, inside = warp_to_face(image.xyz, laid.matrix, shape)
        there, _ = warp_to_face(found.mask.astype(np.float32)[..., np.newaxis], laid.matrix, shape)
        valid = inside & warp_mask_to_face(found.mask, laid.matrix, shape)
        fired, _ = even_light(printed, seen, valid)
        regions = region_colours(target, fired, inks, valid, px_per_mm, region_mm=self._region_mm)
        of_print = regions
        if how.press is not None:
            of_print = region_colours(printed, fired, inks, valid, px_per_mm, region_mm=self._region_mm)
        colour = None if image.grey else colour_figures(regions)
        defects = find_defects(
            _lab(printed),
            _lab(fired),
            valid,
            px_per_mm,
            tile_mask=there[..., 0] > 0.5,
            inks=inks,
            press=self.faces.press_lab,
        )
        shift_mm, turn_deg = _lie(outline, laid.matrix, shape, px_per_mm)
        grade, reasons = grade_tile(colour, dimensions, defects, shift_mm, self._tolerances)
        if image.grey:
            reasons = (*reasons, "the image is grey: colour was not measured")
        if camera_px_per_mm < _LEAST_PX_PER_MM:
            reasons = (
                *reasons,
                f"the image has {camera_px_per_mm:.1f} pixels a millimetre: too few to see small defects",
            )
        inspection = TileInspection(recognition, colour, dimensions, defects, grade, reasons, shift_mm, turn_deg)
        pictures = TilePictures(picture_of(target, _PICTURE_PX), picture_of(fired, _PICTURE_PX))
        if image.grey:
            return InspectedTile(inspection, how.number, None, None, pictures, fired, target, px_per_mm)
        return InspectedTile(inspection, how.number, regions, of_print, pictures, fired, target, px_per_mm)

    def _laid(
        self, image: CameraImage, found: FoundTile, recognition: Recognition, printed: Float32Array
    ) -> Registration:
        corners = np.asarray(recognition.corners_px, dtype=np.float64)
        start = start_matrix(corners, printed.shape[:2])
        return register(_lightness(printed), _lightness(image.xyz), start, valid=found.mask)


def _not_ours(recognition: Recognition) -> TileInspection:
    return TileInspection(recognition, None, None, (), Grade.SCRAP, (recognition.reason,))


def _px_per_mm(recognition: Recognition, faces: PredictedFaces) -> float:
    """Resolution of an image by the size of its tile."""
    corners = np.asarray(recognition.corners_px, dtype=np.float64)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    size = faces.plan.tile_mm
    return float(sides.sum() / (2.0 * (size.width + size.height)))


def _outline(found: FoundTile, recognition: Recognition) -> NDArray[np.float64]:
    """Corners (4, 2) of the tile itself, in the order of the face's."""
    face = np.asarray(recognition.corners_px, dtype=np.float64)
    turned = [np.roll(found.corners_px, -turns, axis=0) for turns in range(4)]
    return min(turned, key=lambda corners: float(np.linalg.norm(corners - face)))


def _lie(
    outline: NDArray[np.float64], matrix: NDArray[np.float64], shape: tuple[int, ...], px_per_mm: float
) -> tuple[tuple[float, float], float]:
    """How far the print lies off the tile's middle (mm), and how far it is turned (degrees, clockwise)."""
    corners = np.column_stack([outline, np.ones(4)])
    back = corners @ np.linalg.inv(matrix).T
    tile = back[:, :2] / back[:, 2:]
    rows, cols = shape[:2]
    middle = np.array([cols, rows]) / 2.0
    shift = (middle - tile.mean(axis=0)) / px_per_mm
    upper, lower = tile[1] - tile[0], tile[2] - tile[3]
    turn = -math.degrees(math.atan2(*(upper + lower)[::-1]))
    return (float(shift[0]), float(shift[1])), turn


def _lab(xyz: Float32Array) -> Float32Array:
    return lab_from_xyz(xyz).astype(np.float32)


def _lightness(xyz: Float32Array) -> Float32Array:
    """L* of XYZ colours."""
    y = np.maximum(xyz[..., 1], 0.0)
    return np.where(y > 216.0 / 24389.0, 116.0 * np.cbrt(y) - 16.0, y * np.float32(24389.0 / 27.0)).astype(np.float32)
