"""Faces of a job as a line takes them: planned ahead, rendered strip by strip, never whole."""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from tilefab.errors import OutputError
from tilefab.io.manifest import locked_folder
from tilefab.pipeline.faces import PlannedFace, plan_face, render_strip
from tilefab.pipeline.maps import JobMaps, check_owner, job_maps
from tilefab.pipeline.plan import MAPS_FOLDER, Plan
from tilefab.pipeline.progress import Progress
from tilefab.pipeline.run import claim_folder
from tilefab.sampling import TextureMap
from tilefab.types import Array, SizePx
from tilefab.units import MM_PER_INCH


@dataclass(frozen=True, eq=False)
class Strip:
    """Rows of a face.

    Attributes
    ----------
    first
        The first of them.
    pixels
        (rows, cols, channels) of the press map's type; valid until the next strip is asked for.
    """

    first: int
    pixels: Array


class FaceSource:
    """Faces of one job: as its file says, and as corrected since.

    Which part of the stone a face shows is the same for every correction; only its inks are others. Maps are looked up
    when a face begins, so that one may be put beside the others, or taken away, between any two faces.

    Parameters
    ----------
    plan
        The job.
    maps
        Its maps.
    strip_rows
        Rows rendered at once.
    """

    def __init__(self, plan: Plan, maps: JobMaps, strip_rows: int) -> None:
        self.plan, self.maps, self.strip_rows = plan, maps, strip_rows
        press = maps.press
        self._corrected: Mapping[int, TextureMap] = {}
        layout = plan.layout(press)
        region = layout.face(0)
        self.size = SizePx(region.rows, region.cols)
        self.channels = int(press.base.shape[2])
        self.dtype = press.base.dtype
        self.bits = self.dtype.itemsize * 8
        self._buffer = np.empty((strip_rows, region.cols, self.channels), dtype=self.dtype)

    @property
    def row_pitch_mm(self) -> float:
        """Distance of two rows."""
        return MM_PER_INCH / self.plan.job.tile.dpi

    @property
    def face_bytes(self) -> int:
        """Size of a whole face."""
        return self.size.rows * self.size.cols * self.channels * self.dtype.itemsize

    def prepare(self, face: int) -> PlannedFace:
        """Find out what a face shows: the part of rendering that can be done ahead, of some kilobytes a face."""
        return plan_face(self.plan, self.maps.press, face, threads=1)

    def strips(self, planned: PlannedFace, first: int = 0, correction: int = 0) -> Iterator[Strip]:
        """Strips of a face from row ``first`` on, each overwriting the one before.

        Raises
        ------
        OutputError
            If the correction's map isn't there.
        """
        press = self._press(correction)
        for row in range(first, self.size.rows, self.strip_rows):
            out = self._buffer[: min(self.strip_rows, self.size.rows - row)]
            yield Strip(row, render_strip(self.plan, press, planned, row, out, threads=1))

    def checksum(self, face: int, correction: int = 0) -> int:
        """CRC-32 of all rows of a face in order, as the printer computes it over what it received."""
        crc = 0
        for strip in self.strips(self.prepare(face), correction=correction):
            crc = zlib.crc32(strip.pixels.data, crc)
        return crc

    @property
    def corrections(self) -> frozenset[int]:
        """Corrections that faces can be rendered with, besides 0: as the job's file says."""
        return frozenset(self._corrected)

    def put(self, correction: int, press: TextureMap) -> None:
        """Let faces be rendered with a correction from now on.

        Raises
        ------
        OutputError
            As `check`.
        """
        self.check(press)
        self._corrected = {**self._corrected, correction: press}

    def check(self, press: TextureMap) -> None:
        """Make sure that a corrected map can be one of this job.

        Raises
        ------
        OutputError
            If it has another size, other inks, or is of another texture map.
        """
        own = self.maps.press
        if (press.base.shape, press.base.dtype, press.cell_shape) != (own.base.shape, own.base.dtype, own.cell_shape):
            raise OutputError(
                f"{self.plan.name}: its corrected map has other inks or another size than its own: remove it from "
                f"{self.plan.output / MAPS_FOLDER}"
            )

    def keep_only(self, corrections: Collection[int]) -> None:
        """Let go of the maps of all corrections but some; a face that is being rendered keeps its own to its end."""
        if not self._corrected.keys() <= set(corrections):
            self._corrected = {number: press for number, press in self._corrected.items() if number in corrections}

    def _press(self, correction: int) -> TextureMap:
        press = self._corrected.get(correction) if correction else self.maps.press
        if press is None:
            raise OutputError(f"{self.plan.name}: the map of correction {correction} isn't open: this is a defect")
        return press


def open_source(plan: Plan, progress: Progress, strip_rows: int) -> FaceSource:
    """Claim a job's folder, make or load its maps, and open its faces.

    Raises
    ------
    OutputError
        If the folder is another job's, or can't be written to.
    ImageError, ProfileError, SynthesisError
        If the maps can't be made.
    """
    with locked_folder(plan.output):
        check_owner(plan)
        maps = job_maps(plan, progress, must_keep=True)
        claim_folder(plan)
    source = FaceSource(plan, maps, strip_rows)
    if source.channels > 8:
        raise OutputError(f"{plan.name}: {source.channels} inks, printers of this line take 8 at most")
    return source
