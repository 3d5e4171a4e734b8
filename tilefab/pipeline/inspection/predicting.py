"""What any face of a job should look like, at the resolution that a camera sees it with.

The target of a tile is its face as the job's own conversion makes it on the press as it was profiled, whatever
correction the tile was printed with: corrections are there to reach it. What is learnt about the press comes from the
inks that lie on the tile, which are those of its correction.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import absolute_lab, xyz_from_lab
from tilefab.colour.encoding import decode_lab16
from tilefab.pipeline.faces import face_region, plan_face, render_strip
from tilefab.pipeline.maps import JobMaps
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.press_tables import fired_colours
from tilefab.sampling import CropMap, Region, TextureMap, render_points, render_reduced
from tilefab.types import Array, SizePx
from tilefab.units import MM_PER_INCH

Float32Array = NDArray[np.float32]

XYZ_SPACE = "xyz16"
_XYZ_UNIT = 32768.0
"""Counts of a white's Y: colours up to twice as bright have room."""
_OVERSAMPLING = 4
_BAND_ROWS = 256
_MAPS_KEPT = 4
"""Fired maps of corrections kept: tiles of three are in a kiln at once, beside the target."""


class PredictedFaces:
    """Faces of a job as they should look.

    Parameters
    ----------
    plan
        The job as its file says.
    maps
        Its maps, without a correction.
    threads
        For making what all faces share, and for rendering.
    """

    def __init__(self, plan: Plan, maps: JobMaps, threads: int = 1) -> None:
        self.plan, self.maps, self._threads = plan, maps, threads
        self._fired: OrderedDict[TextureMap, TextureMap] = OrderedDict()
        self._table: tuple[Callable[..., NDArray[np.uint16]], NDArray[np.float64]] | None = None

    @property
    def print_px_per_mm(self) -> float:
        """Resolution of the print."""
        return self.plan.job.tile.dpi / MM_PER_INCH

    def factor(self, px_per_mm: float) -> int:
        """How many print pixels to take together, along a side, for about a resolution; never coarser than it."""
        return max(1, math.floor(self.print_px_per_mm / px_per_mm + 1e-6))

    def px_per_mm(self, factor: int) -> float:
        """Resolution where so many print pixels are taken together."""
        return self.print_px_per_mm / factor

    def lightness(self, face: int, long_px: int) -> Float32Array:
        """L* of a face in the stone, without bleed: what fingerprints are made from.

        Parameters
        ----------
        face
            Its index.
        long_px
            Least number of pixels of its longer side.

        Returns
        -------
        ndarray
            (rows, cols) float32, 0 to 100; the longer side has ``long_px`` pixels up to twice as many, or those of the
            face where it has fewer.

        Notes
        -----
        From halved crops, not from the face at its full size: a few milliseconds, however large the tile.
        """
        texture = self.maps.texture
        whole = self._tile(face)
        if isinstance(texture, CropMap):
            level = _level(max(whole.rows, whole.cols), _OVERSAMPLING * long_px)
            pixels = self._reduced(texture, whole, level)
        else:
            pixels = self._sampled(texture, whole, _OVERSAMPLING * long_px)
        lightness = decode_lab16(pixels)[..., 0]
        factor = max(1, max(lightness.shape) // long_px)
        return _block_means(lightness[..., np.newaxis], factor)[..., 0]

    def _reduced(self, texture: CropMap, whole: Region, level: int) -> Array:
        top, left = round(whole.row / (1 << level)), round(whole.col / (1 << level))
        rows, cols = max(1, round(whole.rows / (1 << level))), max(1, round(whole.cols / (1 << level)))
        return render_reduced(texture, top, left, rows, cols, level=level, seed=self.plan.seed, threads=self._threads)

    def _sampled(self, texture: TextureMap, whole: Region, long_px: int) -> Array:
        """Pixels of the plane at even steps: other designs have no halved pieces."""
        step = max(1, max(whole.rows, whole.cols) // long_px)
        rows = np.arange(whole.row + step // 2, whole.row + whole.rows, step)
        cols = np.arange(whole.col + step // 2, whole.col + whole.cols, step)
        return render_points(texture, rows[:, np.newaxis], cols[np.newaxis, :], seed=self.plan.seed)

    def xyz(self, face: int, factor: int, press: TextureMap | None = None) -> Float32Array:
        """Colours that a face has after firing on the press as the job knows it.

        Parameters
        ----------
        face
            Its index.
        factor
            See `factor`.
        press
            Map in inks of a correction. ``None``: the job's own, whose colours are the target.

        Returns
        -------
        ndarray
            (rows, cols, 3) float32 XYZ under D50, Y = 1 for white; means in linear light over print pixels. A last
            row or column that isn't whole is left out.
        """
        fired = self._fired_map(self.maps.press if press is None else press)
        return self._means(fired, face, factor) * np.float32(1.0 / _XYZ_UNIT)

    def ink_frac(self, face: int, factor: int, press: TextureMap | None = None) -> Float32Array:
        """Inks of a face, (rows, cols, inks) float32, 0 to 1, from the job's press map or that of a correction."""
        chosen = self.maps.press if press is None else press
        return self._means(chosen, face, factor) * np.float32(1.0 / np.iinfo(chosen.base.dtype).max)

    def press_lab(self, ink_frac: NDArray[np.floating]) -> NDArray[np.float64]:
        """Absolute Lab (P, 3) that inks (P, N), 0 to 1, fire to on the press as the job knows it."""
        if self._table is None:
            self._table = fired_colours(self.plan, np.uint16)
        convert, white_lab = self._table
        counts = np.rint(np.clip(ink_frac, 0.0, 1.0) * 65535.0).astype(np.uint16)
        lab = decode_lab16(convert(np.ascontiguousarray(counts[np.newaxis]), threads=self._threads))[0]
        return absolute_lab(lab, white_lab)

    @cached_property
    def _colours(self) -> tuple[Callable[..., NDArray[np.uint16]], NDArray[np.float64]]:
        return fired_colours(self.plan, self.maps.press.base.dtype)

    def _fired_map(self, press: TextureMap) -> TextureMap:
        """A map in inks as it fires: linear light, so that means of pixels are what a camera sees of them."""
        if press in self._fired:
            self._fired.move_to_end(press)
            return self._fired[press]
        convert, white_lab = self._colours
        base = np.empty((*press.base.shape[:2], 3), dtype=np.uint16)
        for top in range(0, len(base), _BAND_ROWS):
            band = slice(top, top + _BAND_ROWS)
            lab = decode_lab16(convert(np.ascontiguousarray(press.base[band]), threads=self._threads))
            xyz = xyz_from_lab(absolute_lab(lab, white_lab))
            base[band] = np.rint(np.clip(xyz * _XYZ_UNIT, 0.0, 65535.0)).astype(np.uint16)
        fired = self._fired[press] = press.with_base(base, space=XYZ_SPACE, channels=("X", "Y", "Z"))
        while len(self._fired) > _MAPS_KEPT:
            self._fired.popitem(last=False)
        return fired

    def _tile(self, face: int) -> Region:
        whole, bleed = face_region(self.plan, self.maps.texture, face), self.plan.bleed_px
        return Region(whole.row + bleed, whole.col + bleed, whole.rows - 2 * bleed, whole.cols - 2 * bleed)

    def grid(self, factor: int) -> SizePx:
        """Size of a face where so many print pixels are taken together."""
        tile = self.plan.tile_px
        return SizePx(max(1, tile.rows // factor), max(1, tile.cols // factor))

    def _means(self, texture: TextureMap, face: int, factor: int) -> Float32Array:
        planned = plan_face(self.plan, texture, face, threads=self._threads, bleed=False)
        size = self.grid(factor)
        channels = texture.base.shape[2]
        out = np.empty((size.rows, size.cols, channels), dtype=np.float32)
        step = max(1, _BAND_ROWS // factor)
        for first in range(0, size.rows, step):
            rows = min(step, size.rows - first)
            band = np.empty(
                (min(rows * factor, planned.region.rows), planned.region.cols, channels), texture.base.dtype
            )
            render_strip(self.plan, texture, planned, first * factor, band, threads=self._threads)
            out[first : first + rows] = _block_means(band, factor)[:, : size.cols]
        return out


def _level(long_px: int, wanted_px: int) -> int:
    """Halvings after which a length still has a wanted number of pixels."""
    return max(0, math.floor(math.log2(max(1.0, long_px / wanted_px))))


def _block_means(image: Array, factor: int) -> Float32Array:
    """Means over squares of ``factor`` pixels a side; a last row or column that isn't whole is left out."""
    if factor == 1:
        return np.ascontiguousarray(image, dtype=np.float32)
    rows, cols = max(1, image.shape[0] // factor), max(1, image.shape[1] // factor)
    high, wide = min(factor, image.shape[0]), min(factor, image.shape[1])
    whole = image[: rows * high, : cols * wide]
    columns = np.add.reduceat(whole, np.arange(0, cols * wide, wide), axis=1, dtype=np.float32)
    total = np.add.reduceat(columns, np.arange(0, rows * high, high), axis=0)
    return np.ascontiguousarray(total / np.float32(high * wide), dtype=np.float32)
