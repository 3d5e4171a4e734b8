"""Small value types shared by every room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatImage: TypeAlias = NDArray[np.float32]
"""A working image: float32, C-contiguous, (rows, cols, channels)."""

PrintImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
"""Print data: uint8 or uint16, (rows, cols, channels), 0 = no ink."""

Mask: TypeAlias = NDArray[np.bool_]
"""True = good, (rows, cols)."""

Array: TypeAlias = NDArray[Any]


@dataclass(frozen=True)
class SizePx:
    """A size in pixels."""

    rows: int
    cols: int


@dataclass(frozen=True)
class SizeMm:
    """A size in millimetres."""

    width: float
    height: float
