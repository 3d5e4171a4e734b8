"""Unevenness of the light on a tile, taken out by what the tile itself should look like.

Fired over predicted colour is the light, times what the firing changed. The light is slow and the same in all
channels; what the firing changed goes with the colour. So both are fitted together, and only the light is taken out;
its mean is kept, and so is its cast, for they can't be told from drift and must not be hidden. A slow change of the
firing across a tile goes with the light.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.inspection.measurement_kernels import pair_sums
from tilefab.types import FloatImage, Mask

Float64Array = NDArray[np.float64]

_CELLS = 28
_LEAST_CELLS, _FINE = 60, 200
_LEAST_SHARE = 0.5
_EDGE_SHARE = 0.0075
_DARK = 0.01
_ROUNDS = 12
_BIWEIGHT, _MAD, _LEAST_SPREAD = 4.685, 1.4826, 1e-4
_LIGHT_SPREAD, _TONE_SPREAD = 0.3, 0.1
_DARKEST, _BRIGHTEST = 0.4, 2.5


@dataclass(frozen=True, eq=False)
class LightFit:
    """The light on a tile.

    Attributes
    ----------
    coefficients
        (5,) float64: of x, y, x^2, x y, y^2, which with 1 are the light up to a factor; x and y from -1 to 1 over the
        face.
    level
        That factor: what it is divided by, so that the mean over what was seen is 1.
    unevenness
        How much brighter the best lit place of the face is than the worst lit, share.
    cells
        Parts of the face it was fitted to; 0 if there were too few to fit anything, and it is 1 everywhere.
    """

    coefficients: Float64Array = field(repr=False)
    level: float
    unevenness: float
    cells: int

    def surface(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """The light (rows, cols) float32, mean about 1."""
        y = (2.0 * (np.arange(shape[0]) + 0.5) / shape[0] - 1.0)[:, np.newaxis]
        x = (2.0 * (np.arange(shape[1]) + 0.5) / shape[1] - 1.0)[np.newaxis, :]
        a, b, c, d, e = self.coefficients
        light = (1.0 + (a * x + c * x * x) + (b * y + e * y * y) + d * x * y).astype(np.float32)
        return np.asarray(np.clip(light, _DARKEST, _BRIGHTEST) / np.float32(self.level), dtype=np.float32)


def worn(valid: Mask, width_px: int) -> Mask:
    """A mask of a face less what lies within some pixels of the face's border or of what isn't valid."""
    if width_px < 1:
        return valid
    share = ndimage.uniform_filter(valid.astype(np.float32), 2 * width_px + 1, mode="constant")
    return np.asarray(share > 1.0 - 0.4 / (2 * width_px + 1) ** 2, dtype=np.bool_)


def even_light(predicted_xyz: FloatImage, fired_xyz: FloatImage, valid: Mask) -> tuple[FloatImage, LightFit]:
    """Take the light's unevenness out of a fired tile's colours.

    Parameters
    ----------
    predicted_xyz, fired_xyz
        (rows, cols, 3) float32: XYZ (D50, Y = 1 for the perfect white) on the face grid.
    valid
        (rows, cols) bool: where the tile is seen.

    Returns
    -------
    evened, fit
        (rows, cols, 3) float32, the fired colours over the light; and the light, a second-order surface of mean 1.

    Raises
    ------
    ValueError
        If shapes differ or the images aren't float32 of three channels.
    """
    check_pair(predicted_xyz, fired_xyz, valid)
    rows, cols = valid.shape
    whole = worn(valid, max(2, round(_EDGE_SHARE * min(rows, cols))))
    row_cuts = np.linspace(0, rows, min(_CELLS, rows) + 1).astype(np.int64)
    col_cuts = np.linspace(0, cols, min(_CELLS, cols) + 1).astype(np.int64)
    sums = np.empty((len(row_cuts) - 1, len(col_cuts) - 1, 16))
    pair_sums(predicted_xyz, fired_xyz, whole, row_cuts, col_cuts, sums)
    areas = np.outer(np.diff(row_cuts), np.diff(col_cuts))
    good = (sums[:, :, 0] >= _LEAST_SHARE * areas) & (sums[:, :, 1:7] > 0).all(axis=2)
    count = int(good.sum())
    if count < _LEAST_CELLS:
        return fired_xyz, LightFit(np.zeros(5), 1.0, 0.0, 0)
    middle_y = (row_cuts[:-1] + row_cuts[1:]) / rows - 1.0
    middle_x = (col_cuts[:-1] + col_cuts[1:]) / cols - 1.0
    y, x = (values[good] for values in np.meshgrid(middle_y, middle_x, indexing="ij"))
    predicted = sums[:, :, 1:4][good] / sums[:, :, :1][good]
    fired = sums[:, :, 4:7][good] / sums[:, :, :1][good]
    slow = np.column_stack([x, y, x * x, x * y, y * y])
    coefficients = _fitted(slow, predicted, fired)
    light = np.clip(1.0 + slow @ coefficients, _DARKEST, _BRIGHTEST)
    level = float(np.average(light, weights=sums[:, :, 0][good]))
    rough = LightFit(coefficients, level, 0.0, count)
    whole_face = rough.surface((_FINE, _FINE))
    fit = LightFit(coefficients, level, float(whole_face.max() / whole_face.min()) - 1.0, count)
    return np.asarray(fired_xyz / fit.surface((rows, cols))[:, :, np.newaxis], dtype=np.float32), fit


def check_pair(predicted_xyz: FloatImage, fired_xyz: FloatImage, valid: Mask) -> None:
    """Raise ValueError unless both are float32 (rows, cols, 3) on one grid with its mask."""
    for name, image in (("predicted_xyz", predicted_xyz), ("fired_xyz", fired_xyz)):
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.float32:
            raise ValueError(f"{name} must be float32 (rows, cols, 3), not {image.dtype} {image.shape}")
    if not predicted_xyz.shape[:2] == fired_xyz.shape[:2] == valid.shape:
        raise ValueError(f"shapes differ: {predicted_xyz.shape}, {fired_xyz.shape} and mask {valid.shape}")


def _fitted(slow: Float64Array, predicted: Float64Array, fired: Float64Array) -> Float64Array:
    """Coefficients (5,) of the light from means (C, 3) of cells, by iteratively reweighted least squares.

    Beside the light each channel has a level, and follows the predicted colour: its logarithm in each channel, and
    the square of that of Y.
    """
    tone = np.log(predicted)
    tone = np.column_stack([tone, tone[:, 1] ** 2])
    tone = tone - tone.mean(axis=0)
    ratio = np.log(fired / predicted)
    cells, tones = len(tone), tone.shape[1]
    unknowns = 5 + 3 * (1 + tones)
    columns = np.zeros((3, cells, unknowns))
    for channel in range(3):
        first = 5 + channel * (1 + tones)
        columns[channel, :, first] = 1.0
        columns[channel, :, first + 1 : first + 1 + tones] = tone
    prior = np.full(unknowns, 1.0 / _TONE_SPREAD)
    prior[:5] = 1.0 / _LIGHT_SPREAD
    prior[5 :: 1 + tones] = 0.0
    # The logarithm of a dark cell is the noisier.
    trust = (predicted[:, 1] / (predicted[:, 1] + _DARK)) ** 2
    weight, spread = trust.copy(), 0.02
    solution = np.zeros(unknowns)
    for _ in range(_ROUNDS):
        # The logarithm of the light is straightened where the last round left it.
        light = np.clip(1.0 + slow @ solution[:5], _DARKEST, _BRIGHTEST)
        columns[:, :, :5] = slow / light[:, np.newaxis]
        wanted = ratio - (np.log(light) - slow @ solution[:5] / light)[:, np.newaxis]
        normal = np.einsum("kcu,c,kcv->uv", columns, weight, columns, optimize=True)
        normal += np.diag((spread * prior) ** 2)
        solution = np.linalg.solve(normal, np.einsum("kcu,c,ck->u", columns, weight, wanted, optimize=True))
        away = np.sqrt(((wanted - (columns @ solution).T) ** 2).mean(axis=1))
        spread = max(_MAD * float(np.median(away)), _LEAST_SPREAD)
        weight = trust * np.clip(1.0 - (away / (_BIWEIGHT * spread)) ** 2, 0.0, None) ** 2
    return solution[:5]
