"""Pictures of the worst tiles of each run, kept for people."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tilefab.inspection.records import Grade, TileInspection
from tilefab.io.atomic import atomic_write_bytes
from tilefab.io.inspection_records import InspectionRecord, Pictures
from tilefab.pipeline.inspection.one_tile import TilePictures

MOST_KEPT = 10
"""Tiles of a run whose pictures are kept."""

_BY_GRADE = {Grade.FIRST: 0.0, Grade.SECOND: 1000.0, Grade.SCRAP: 2000.0}
_MOST_SAME_GRADE = 999.0
_PER_DELTA_E = 10.0


def badness(inspection: TileInspection) -> float:
    """How bad a tile is, for finding the worst: its grade first, then colour and defects."""
    off = 0.0 if inspection.colour is None else _PER_DELTA_E * inspection.colour.delta_e_mean
    worse = off + sum(defect.severity for defect in inspection.defects)
    return _BY_GRADE[inspection.grade] + min(worse, _MOST_SAME_GRADE)


class KeptPictures:
    """The folder of pictures.

    Parameters
    ----------
    folder
        Made when the first picture comes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def keep(self, run_id: int, name: str, bad: float, pictures: TilePictures) -> Pictures:
        """Write the pictures of a tile.

        Parameters
        ----------
        run_id
            Its run.
        name
            Its own, as that of its image.
        bad
            See `badness`.
        pictures
            What to write.

        Raises
        ------
        OutputError
            If they can't be written.
        """
        stem = f"run_{run_id}/{name}"
        kept = Pictures(bad, f"{stem}_predicted.png", f"{stem}_fired.png")
        atomic_write_bytes(self._folder / kept.predicted, _png(pictures.predicted))
        atomic_write_bytes(self._folder / kept.fired, _png(pictures.fired))
        return kept

    def remove(self, pictures: Sequence[Pictures]) -> None:
        """Remove pictures that are kept no longer; what can't be removed is let be."""
        for kept in pictures:
            for name in (kept.predicted, kept.fired):
                with suppress(OSError):
                    (self._folder / name).unlink()

    def tidy(self, known: Sequence[Pictures]) -> None:
        """Remove all pictures but those that are known, as of tiles that were being put down when the power failed."""
        names = {name for kept in known for name in (kept.predicted, kept.fired)}
        for path in self._folder.glob("run_*/*.png"):
            if f"{path.parent.name}/{path.name}" not in names:
                with suppress(OSError):
                    path.unlink()


def displaced(worst: Sequence[InspectionRecord], bad: float) -> tuple[bool, list[InspectionRecord]]:
    """Whether a tile is among the worst of its run, and which tiles then are no longer.

    Parameters
    ----------
    worst
        Those kept so far, the worst first.
    bad
        See `badness`.
    """
    if len(worst) < MOST_KEPT:
        return True, []
    last = worst[MOST_KEPT - 1].pictures
    if last is not None and bad <= last.badness:
        return False, []
    return True, list(worst[MOST_KEPT - 1 :])


def _png(pixels: NDArray[np.uint8]) -> bytes:
    out = BytesIO()
    Image.fromarray(pixels).save(out, "PNG", compress_level=3)
    return out.getvalue()
