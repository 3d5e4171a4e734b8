"""CIELAB in 16 bits a channel, as texture maps keep it.

The encoding is that of ICC.1:2010, 10.10 (PCSLAB in 16 bits): L* 0 .. 100 as 0 .. 65535, a* and b* -128 .. 127 as
0 .. 65535. A step is 0.0015 in L* and 0.0039 in a* and b*, far below what a scanner resolves.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

LAB16_SPACE = "lab16"
LAB16_CHANNELS = ("L*", "a*", "b*")
_SCALE = np.array([655.35, 257.0, 257.0])
_OFFSET = np.array([0.0, 128.0, 128.0])
_STRIP_VALUES = 1 << 20


def encode_lab16(lab_d50: NDArray[np.floating]) -> NDArray[np.uint16]:
    """(rows, cols, 3) CIELAB (D50) to 16 bits, values outside the range clipped.

    >>> encode_lab16(np.array([[[100.0, 0.0, -128.0]]])).tolist()
    [[[65535, 32896, 0]]]
    """
    out = np.empty(lab_d50.shape, dtype=np.uint16)
    step = _strip_rows(lab_d50.shape)
    for top in range(0, len(lab_d50), step):
        strip = (lab_d50[top : top + step].astype(np.float64) + _OFFSET) * _SCALE
        out[top : top + step] = np.clip(np.rint(strip), 0, 65535)
    return out


def decode_lab16(counts: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Inverse of `encode_lab16`, (..., 3) float32."""
    out = np.empty(counts.shape, dtype=np.float32)
    step = _strip_rows(counts.shape)
    for top in range(0, len(counts), step):
        out[top : top + step] = counts[top : top + step] / _SCALE - _OFFSET
    return out


def _strip_rows(shape: tuple[int, ...]) -> int:
    return max(1, _STRIP_VALUES // max(1, math.prod(shape[1:])))
