"""Faces of a job as a line takes them: planned ahead, rendered strip by strip, never whole."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tilefab.errors import OutputError
from tilefab.io.manifest import locked_folder
from tilefab.pipeline.faces import PlannedFace, plan_face, render_strip
from tilefab.pipeline.maps import JobMaps, check_owner, job_maps
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.progress import Progress
from tilefab.pipeline.run import claim_folder
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
    """Faces of one job.

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

    def strips(self, planned: PlannedFace, first: int = 0) -> Iterator[Strip]:
        """Strips of a face from row ``first`` on, each overwriting the one before."""
        for row in range(first, self.size.rows, self.strip_rows):
            out = self._buffer[: min(self.strip_rows, self.size.rows - row)]
            yield Strip(row, render_strip(self.plan, self.maps.press, planned, row, out, threads=1))

    def checksum(self, face: int) -> int:
        """CRC-32 of all rows of a face in order, as the printer computes it over what it received."""
        crc = 0
        for strip in self.strips(self.prepare(face)):
            crc = zlib.crc32(strip.pixels.data, crc)
        return crc


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
