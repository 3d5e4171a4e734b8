"""Where the pixels of an image came from in its exemplar, if nobody kept the source map.

What is found serves to judge images that others made: which share of the exemplar they show, which pieces of it they
repeat, and where they were put together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.texture.coverage_kernels import extend_pieces, match_patches
from tilefab.texture.matching import LAB_STEPS_PER_UNIT, matching_image, window_is_valid
from tilefab.types import Array, Mask

PATCH_PX = 7
"""Side of the patches that are looked up: of smaller ones, too many are alike."""
_ROUNDS = 6
_SAME_DE76 = 2
"""Root mean square colour difference up to which a patch, or a pixel, is a copy: JPEG files change it by as much."""


@dataclass(frozen=True)
class SourceEstimate:
    """A source map found by looking.

    Attributes
    ----------
    source
        (rows, cols) int32, flat index into the exemplar of each pixel.
    known
        (rows, cols), True where the image shows the same as the exemplar, so that the map isn't only the best guess.
    """

    source: NDArray[np.int32]
    known: Mask

    @property
    def known_share(self) -> float:
        """Share of pixels that were found, 0 to 1."""
        return float(self.known.mean())


def estimate_source(exemplar: Array, image: Array, valid: Mask | None = None) -> SourceEstimate:
    """Find for each pixel of an image the place in the exemplar that it shows, or looks most like.

    Parameters
    ----------
    exemplar
        (rows, cols, channels) CIELAB, or other channels scaled like it; at least 7 a side.
    image
        (rows, cols, channels) of the same channels and resolution, at least 7 a side.
    valid
        (exemplar rows, exemplar cols), True where the exemplar may have been used; all of it if None.

    Returns
    -------
    SourceEstimate
        The same for the same images, always. Of quilts and mosaics of five textures of 213 to 333 pixels whose maps
        were kept, 89 to 99 % of the pixels are known, 94 to 100 % of those as they were, the others at places that show
        the same; the share of the exemplar shown comes out within .022. A checkerboard is ambiguous: about 25 % of it
        come out as they were, and the share is off by up to .08.

    Raises
    ------
    ValueError
        If an image has the wrong shape or is too small, or no patch of the exemplar is valid.

    Notes
    -----
    Patches are looked up by PatchMatch. Those found with hardly a difference are taken for copies, and grow as long
    as the image goes on as the exemplar does: so seams come to lie where they are, not half a patch away.
    """
    for name, array in (("exemplar", exemplar), ("image", image)):
        if array.ndim != 3 or array.shape[2] != exemplar.shape[-1]:
            raise ValueError(f"exemplar {exemplar.shape} and image {image.shape} are not (rows, cols, same channels)")
        if min(array.shape[:2]) < PATCH_PX:
            raise ValueError(f"a search needs {PATCH_PX} x {PATCH_PX} pixels; {name} is {array.shape[:2]}")
    usable = np.ones(exemplar.shape[:2], dtype=bool) if valid is None else np.ascontiguousarray(valid, dtype=bool)
    if usable.shape != exemplar.shape[:2]:
        raise ValueError(f"the mask {usable.shape} and the exemplar {exemplar.shape[:2]} differ in shape")
    corners = window_is_valid(usable, PATCH_PX, PATCH_PX)
    if not corners.any():
        raise ValueError(f"the mask leaves no patch of {PATCH_PX} x {PATCH_PX} pixels of the exemplar")
    wanted, there = matching_image(image), matching_image(exemplar)
    places = np.empty((image.shape[0] - PATCH_PX + 1, image.shape[1] - PATCH_PX + 1), dtype=np.int32)
    squares = np.empty(places.shape, dtype=np.int64)
    listed = np.flatnonzero(corners).astype(np.int32)
    match_patches(wanted, there, corners, listed, PATCH_PX, _ROUNDS, places, squares)
    source = _of_pixels(places, corners.shape[1], (image.shape[0], image.shape[1]), exemplar.shape[1])
    most_square = (_SAME_DE76 * LAB_STEPS_PER_UNIT) ** 2
    known = np.zeros(source.shape, dtype=bool)
    half = PATCH_PX // 2
    known[half : half + places.shape[0], half : half + places.shape[1]] = squares <= most_square * PATCH_PX**2
    extend_pieces(wanted, there, usable, most_square, source, known)
    return SourceEstimate(source, known)


def _of_pixels(
    places: NDArray[np.int32], corner_cols: int, shape: tuple[int, int], exemplar_cols: int
) -> NDArray[np.int32]:
    """Places of patches' corners as those of the pixels in their middle; near the border, of the nearest patch."""
    half = PATCH_PX // 2
    rows, cols = (np.clip(np.arange(n) - half, 0, m - 1) for n, m in zip(shape, places.shape, strict=True))
    of_patch = places[np.ix_(rows, cols)]
    down, right = (np.arange(shape[0]) - rows)[:, None], (np.arange(shape[1]) - cols)[None, :]
    on_map = (of_patch // corner_cols + down) * exemplar_cols + of_patch % corner_cols + right
    return np.ascontiguousarray(on_map, dtype=np.int32)
