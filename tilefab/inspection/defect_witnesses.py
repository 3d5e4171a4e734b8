"""Other places of a tile as witnesses: what all pixels of a recipe show is the firing's doing, and no defect.

A firing changes some colours otherwise than any smooth function of them. On stone whose patches recur, such a colour
stands out wherever it lies; a defect stands out in one place, and others of its recipe look as they should.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.inspection.defect_colour_kernels import distance_squared
from tilefab.inspection.defect_residual import Residual, halved, halved_values
from tilefab.types import FloatImage, Mask

Float64Array = NDArray[np.float64]

_INK_UNIT = 100.0
_ALIKE = 3.0
_WITNESSES = 60
_AWAY_MM = 1.0


class Witnesses:
    """Asks the rest of a tile about the colours of a patch.

    Parameters
    ----------
    rest
        The tile's residual.
    inks
        (rows, cols, N) ink fractions, or None: then colours alone tell what is alike.
    px_per_mm
        Resolution.
    """

    def __init__(self, rest: Residual, inks: FloatImage | None, px_per_mm: float) -> None:
        self._expected, self._inks = rest.expected, inks
        self._away = round(_AWAY_MM * px_per_mm)
        features = halved(rest.expected)
        if inks is not None:
            features = np.concatenate([features, np.float32(_INK_UNIT) * halved(inks)], axis=-1)
        self._features = np.ascontiguousarray(features)
        self._values, self._weight = halved_values(rest.fine, rest.weight), halved(rest.weight)

    def share_shown(self, core: Mask, top: int, left: int, mean: Float64Array) -> float:
        """How much of a patch's difference its likes elsewhere show: 0 for nothing, 1 for all of it.

        Parameters
        ----------
        core
            (h, w) bool, the patch's pixels.
        top, left
            Where its upper left pixel lies.
        mean
            (3,) its mean residual.
        """
        high, wide = core.shape
        part = (slice(top, top + high), slice(left, left + wide))
        middle = self._expected[part][core].mean(axis=0, dtype=np.float64)
        if self._inks is not None:
            middle = np.concatenate([middle, _INK_UNIT * self._inks[part][core].mean(axis=0, dtype=np.float64)])
        far = distance_squared(self._features, middle, np.eye(len(middle)))
        other = self._weight > 0.99
        near = (
            slice(max(top - self._away, 0) // 2, (top + high + self._away) // 2 + 1),
            slice(max(left - self._away, 0) // 2, (left + wide + self._away) // 2 + 1),
        )
        other[near] = False
        places = np.flatnonzero(other)
        if len(places) < _WITNESSES:
            return 0.0
        distance = far.reshape(-1)[places]
        chosen = np.argpartition(distance, _WITNESSES - 1)[:_WITNESSES]
        size = float(mean @ mean)
        shown = self._values.reshape(-1, 3)[places[chosen]] @ mean / max(size, 1e-9)
        # One that is marked itself, by another defect, isn't to speak for all.
        counts = 1.0 / (distance[chosen].astype(np.float64) + _ALIKE**2)
        return float(np.average(np.clip(shown, -1.0, 1.0), weights=counts))
