"""Whether a texture repeats itself, as brickwork and cloth do, and where to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

REGULAR = 0.6
"""Likeness from which a shift counts as a repetition: near-regular textures reach .8, irregular ones stay below .3."""

_WORKING_SIDE_PX = 512
_LOCAL_SHARE = 1 / 16
_LEAST_OVERLAP = 0.2
_LEAN_SHARE = 0.06


class SelfLikeness:
    """Likeness of a texture to itself, shifted.

    Parameters
    ----------
    lightness
        (rows, cols) CIELAB lightness, any scale; at least 8 a side.

    Notes
    -----
    Normalised cross-correlation over the part that both cover, after what varies slower than a sixteenth of the side
    is removed; found by FFT at no more than some 512 pixels a side.
    """

    def __init__(self, lightness: NDArray[np.floating]) -> None:
        self.factor = max(1, -(-max(lightness.shape) // _WORKING_SIDE_PX))
        rows, cols = (side // self.factor for side in lightness.shape)
        blocks = np.asarray(lightness[: rows * self.factor, : cols * self.factor], dtype=np.float64)
        plane = blocks.reshape(rows, self.factor, cols, self.factor).mean(axis=(1, 3))
        plane = plane - ndimage.gaussian_filter(plane, max(plane.shape) * _LOCAL_SHARE, mode="nearest")
        size = tuple(fft.next_fast_len(2 * side, real=True) for side in plane.shape)
        values, squares, ones = (fft.rfft2(image, size) for image in (plane, plane**2, np.ones_like(plane)))

        def correlate(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> NDArray[np.float64]:
            return np.asarray(fft.irfft2(first * np.conj(second), size))

        area = correlate(ones, ones)
        energy = np.maximum(correlate(squares, ones) * correlate(ones, squares), 0)
        known = (area > _LEAST_OVERLAP * plane.size) & (energy > 1e-6 * float((plane**2).sum()) ** 2)
        likeness = np.where(known, correlate(values, values) / np.sqrt(np.where(known, energy, 1.0)), 0.0)
        # Rounding must not decide what is regular: four decimals are the same everywhere.
        self._likeness = np.round(likeness, 4)
        self._shape = plane.shape

    def at(self, down: NDArray[np.int64], right: NDArray[np.int64]) -> NDArray[np.float64]:
        """Likeness after shifts in pixels, -1 to 1; 0 where too little would overlap."""
        rows, cols = (
            np.rint(np.asarray(shift) / self.factor).astype(np.int64) for shift in np.broadcast_arrays(down, right)
        )
        outside = (np.abs(rows) >= self._shape[0]) | (np.abs(cols) >= self._shape[1])
        found = self._likeness[rows % self._likeness.shape[0], cols % self._likeness.shape[1]]
        return np.where(outside, 0.0, found)

    def repeats_at(self, pitch_px: int) -> float:
        """Likeness to itself a pitch down and a pitch to the right, the worse of both; it may lean a little."""
        reach = max(1, int(_LEAN_SHARE * pitch_px / self.factor)) * self.factor
        aside = np.arange(-reach, reach + 1)
        pitch = np.full_like(aside, pitch_px)
        return float(min(self.at(pitch, aside).max(), self.at(aside, pitch).max()))
