"""Whether an image shows a face: brought to lie on it exactly, and compared with it place by place.

What lies on a tile (a label, a glove) isn't in the face. Where the image differs from the face it matters how: a place
that is flat where the face isn't, or lighter or darker than any of it, is covered and says nothing; a place that shows
stone, but another, says that this is another face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.inspection.views import Cells, Plane, Window, cells_of_image, cells_of_view, detail
from tilefab.types import Mask, SizePx

Float64Array = NDArray[np.float64]

COMPARED_PX = 128
_ALIGNED_PX = (32, 64)
_STEPS = 4
_STILL_CELLS = 0.05
_AROUND = 3.0
_MOST_MOVED = 0.04
_HOPELESS = 0.2
_WINDOW_CELLS = 3.5
_CLOSE_CELLS = 1.2
_SELDOM = 0.01
_SMOOTHED_CELLS = (2.0, 1.0)
_KEPT_ENERGY = 0.5
_DETAIL_CELLS = 6.0
_ALIKE = 0.75
_NOISE_L = 0.15
_LEAST_CONTRAST_L = 0.15
_FLAT = 0.15
_BEYOND_L, _BEYOND_MEAN_L = 1.5, 4.0
_BEYOND_SHARE = 0.1
_BEYOND_SPREADS = 4.0
_LEAST_FITTED = 64
_FITTED_SIDE = 24
_FITS = 5
_COVER_MARGIN = 7
_LEAST_COVER = 0.004


@dataclass(frozen=True, eq=False)
class Comparison:
    """How an image of a tile compares with a face.

    Attributes
    ----------
    matrix
        (3, 3) from (x, y, 1), shares of the face's width and height from its upper left corner, to image pixels.
    alike
        bool (rows, cols) on a grid over the face: where they are alike.
    compared
        bool: where they could be compared: seen, not covered, and the face not plain.
    seen
        Share of the face that is seen and not covered, 0 to 1.
    likeness
        Correlation over all that could be compared, -1 to 1; 0 if nothing could be.
    """

    matrix: Float64Array
    alike: Mask
    compared: Mask
    seen: float
    likeness: float

    @property
    def differs(self) -> float:
        """Share of what could be compared that differs, 0 to 1; 1 if nothing could be."""
        count = int(self.compared.sum())
        return 1.0 - float((self.alike & self.compared).sum()) / count if count else 1.0

    @property
    def agrees(self) -> float:
        """Share of the face where it was found alike."""
        return float((self.alike & self.compared).mean())

    @property
    def share(self) -> float:
        """Share of the face that could be compared."""
        return float(self.compared.mean())


def compare(light: Plane, mask: Mask, matrix: Float64Array, view: Plane, *, lies_there: bool = False) -> Comparison:
    """Compare an image of a tile with a face.

    Parameters
    ----------
    light
        float32 (rows, cols) Y, linear.
    mask
        bool (rows, cols): pixels that show the tile.
    matrix
        (3, 3): where the face lies in the image to about 1 %, see `Comparison`.
    view
        The face, (rows, cols) L*, its longer side at least `COMPARED_PX`.
    lies_there
        Whether the matrix is exact already, so that nothing is looked for.
    """
    lies = matrix
    for long_px in () if lies_there else _ALIGNED_PX:
        lies, correlation = _aligned(light, mask, lies, cells_of_view(view, _grid(view, long_px)))
        if correlation < _HOPELESS:
            break
    if _moved(matrix, lies) > _MOST_MOVED:
        lies = matrix
    grid = _grid(view, COMPARED_PX)
    return _compared(cells_of_image(light, mask, lies @ _shares(grid), grid), cells_of_view(view, grid), lies)


def difference_of_faces(one: Plane, other: Plane, quarter_turns: int, where: Mask) -> float:
    """In which share of some places (rows, cols) a face and another, turned clockwise, differ.

    Measured as an image of the one would be compared with the other.
    """
    grid = SizePx(*where.shape)
    first, second = cells_of_view(one, grid), cells_of_view(np.rot90(other, -quarter_turns), grid)
    found = _compared(Cells(first.lightness, where), second, np.eye(3))
    return found.differs


def _grid(view: Plane, long_px: int) -> SizePx:
    longest = max(view.shape)
    return SizePx(max(1, round(view.shape[0] * long_px / longest)), max(1, round(view.shape[1] * long_px / longest)))


def _shares(grid: SizePx) -> Float64Array:
    """From cells of a grid to shares of the face."""
    return np.diag([1.0 / grid.cols, 1.0 / grid.rows, 1.0])


def _moved(one: Float64Array, other: Float64Array) -> float:
    """Farthest that a corner of the face lies from where it was, share of the face's longer side."""
    square = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    places = [points[:, :2] / points[:, 2:] for points in (square @ one.T, square @ other.T)]
    side = float(np.linalg.norm(places[0] - np.roll(places[0], 1, axis=0), axis=1).max())
    return float(np.linalg.norm(places[0] - places[1], axis=1).max()) / max(side, 1e-9)


def _aligned(light: Plane, mask: Mask, matrix: Float64Array, face: Cells) -> tuple[Float64Array, float]:
    """Matrix moved by affine steps until the image lies on the face, and how far they then correlate.

    Cells that differ much count little. Gauss-Newton, inverse compositional (Baker and Matthews 2004, "Lucas-Kanade 20
    years on", section 3.2).
    """
    grid = SizePx(*face.seen.shape)
    x = (np.arange(grid.cols) + 0.5) / grid.cols
    y = (np.arange(grid.rows)[:, np.newaxis] + 0.5) / grid.rows
    correlation = 0.0
    for _ in range(_STEPS):
        cells = cells_of_image(light, mask, matrix @ _shares(grid), grid)
        cells = without_cover(cells, face)
        if not cells.seen.any():
            return matrix, 0.0
        seen = Cells(face.lightness, cells.seen)
        wanted, shown = detail(seen, _AROUND).astype(np.float64), detail(cells, _AROUND).astype(np.float64)
        down, across = np.gradient(wanted)
        down, across = down * grid.rows, across * grid.cols
        norm = float(np.sqrt((shown * shown).sum() * (wanted * wanted).sum()))
        correlation = float((shown * wanted).sum()) / norm if norm > 0.0 else 0.0
        # Next to what isn't seen the gradient is that of the gap.
        weight = ndimage.binary_erosion(cells.seen, border_value=1).astype(np.float64)
        spread = float(np.sqrt((weight * wanted * wanted).sum() / max(weight.sum(), 1.0))) + 1e-6
        weight /= 1.0 + ((shown - wanted) / spread) ** 2
        one = np.ones_like(wanted)
        slopes = np.stack([across * x, across * y, across * one, down * x, down * y, down * one, wanted], axis=-1)
        design = slopes.reshape(-1, 7)
        normal = design.T @ (weight.reshape(-1, 1) * design)
        normal += (1e-6 * np.trace(normal) / 7.0 + 1e-9) * np.eye(7)
        found = np.linalg.solve(normal, design.T @ (weight * (shown - wanted)).ravel())
        a, b, c, d, e, f, _ = (float(value) for value in found)
        step = np.array([[1.0 + a, b, c], [d, 1.0 + e, f], [0.0, 0.0, 1.0]])
        if abs(float(np.linalg.det(step)) - 1.0) > 0.2:
            return matrix, correlation
        matrix = matrix @ np.linalg.inv(step)
        if float(np.abs(found[:6]).max()) < _STILL_CELLS / max(grid.rows, grid.cols):
            break
    return matrix, correlation


def _compared(image: Cells, face: Cells, matrix: Float64Array) -> Comparison:
    image = without_cover(image, face)
    seen = image.seen
    weights = seen.astype(np.float32)
    shown, wanted = detail(image, _DETAIL_CELLS), detail(Cells(face.lightness, seen), _DETAIL_CELLS)
    shown, wanted = _without_noise(shown, wanted, weights)
    around, close_by = Window(weights, _WINDOW_CELLS), Window(weights, _CLOSE_CELLS)
    both = around.mean(shown * wanted)
    of_shown = around.mean(shown * shown)
    of_wanted = around.mean(wanted * wanted)
    # What noise leaves of a correlation of 1.
    attainable = np.sqrt(of_wanted / (of_wanted + np.float32(_NOISE_L**2)))
    alike = both > np.float32(_ALIKE) * attainable * np.sqrt(of_shown * of_wanted)
    busy = seen & (of_wanted > np.float32(_LEAST_CONTRAST_L**2))
    good = alike & busy
    gain = float(np.median(of_shown[good] / of_wanted[good])) if good.any() else 1.0
    flat = busy & (of_shown < np.float32(_FLAT * gain) * of_wanted)
    # Something narrow is flat only close around each cell. So is a smooth stone here and there.
    close = _roughness(face.lightness, close_by)
    rough = around.mean(close)
    fine = busy & (rough > np.float32(_LEAST_CONTRAST_L**2))
    if float((close[fine] < np.float32(_FLAT) * rough[fine]).sum()) < _SELDOM * max(1, int(fine.sum())):
        flat |= fine & (_roughness(image.lightness, close_by) < np.float32(_FLAT * gain) * rough)
    # Of means over a window a face has less of a range than of cells.
    level = around.mean(image.lightness - face.lightness)
    offset = float(np.median(level[good])) if good.any() else 0.0
    smooth = Window(np.ones_like(weights), _WINDOW_CELLS).mean(face.lightness)
    own = around.mean(image.lightness) - offset
    beyond = (own < smooth.min() - _BEYOND_MEAN_L) | (own > smooth.max() + _BEYOND_MEAN_L)
    covered = seen & ~alike & (flat | beyond)
    if covered.mean() > _LEAST_COVER:
        covered = ndimage.maximum_filter(covered, size=2 * _COVER_MARGIN + 1)
    compared = busy & ~covered
    keep = compared.astype(np.float32)
    norm = float(np.sqrt((shown * shown * keep).sum() * (wanted * wanted * keep).sum()))
    likeness = float((shown * wanted * keep).sum()) / norm if norm > 0.0 else 0.0
    return Comparison(matrix, alike, compared, float((seen & ~covered).mean()), likeness)


def _roughness(lightness: Plane, close_by: Window) -> Plane:
    """Variance of the lightness close around each cell."""
    level = lightness - np.float32(lightness.mean())
    mean = close_by.mean(level)
    return np.asarray(close_by.mean(level * level) - mean * mean, dtype=np.float32)


def without_cover(image: Cells, face: Cells | None = None) -> Cells:
    """The image less cells much lighter or darker than any of the face: something lies there.

    Light, camera and firing may differ by a smooth surface (of degree 2, fitted robustly). Without a face the image's
    own spread about such a surface stands for it.
    """
    rows, cols = image.seen.shape
    if int(image.seen.sum()) < _LEAST_FITTED:
        return image
    x, y = np.linspace(-1.0, 1.0, cols), np.linspace(-1.0, 1.0, rows)[:, np.newaxis]
    one = np.ones((rows, cols))
    basis = np.stack([one, one * x, one * y, one * x * x, x * y, one * y * y], axis=-1)
    change = image.lightness if face is None else image.lightness - face.lightness
    # Every few cells are enough to fit six numbers.
    step = max(1, min(rows, cols) // _FITTED_SIDE)
    some = image.seen[::step, ::step]
    design, values = basis[::step, ::step][some], change[::step, ::step][some].astype(np.float64)
    fitted = np.full(len(values), float(np.median(values)))
    for _ in range(_FITS):
        away = np.abs(values - fitted)
        spread = max(1.4826 * float(np.median(away)), 1e-3)
        weight = 1.0 / (1.0 + (away / spread) ** 2)
        normal = design.T @ (weight[:, np.newaxis] * design) + 1e-6 * len(values) * np.eye(6)
        coefficients = np.linalg.solve(normal, design.T @ (weight * values))
        fitted = design @ coefficients
    own = image.lightness - (basis @ coefficients).astype(np.float32)
    if face is None:
        reach = _BEYOND_SPREADS * spread + _BEYOND_L
        beyond = np.abs(own) > reach
    else:
        low, high = float(face.lightness.min()), float(face.lightness.max())
        slack = _BEYOND_L + _BEYOND_SHARE * (high - low)
        beyond = (own < low - slack) | (own > high + slack)
    if not (beyond & image.seen).any():
        return image
    hidden = ndimage.maximum_filter(beyond, size=2 * max(1, max(rows, cols) // 64) + 1)
    return Cells(image.lightness, image.seen & ~hidden)


def _without_noise(shown: Plane, wanted: Plane, weights: Plane) -> tuple[Plane, Plane]:
    """Both smoothed as far as the face keeps most of its contrast: what is finer is the camera's noise."""
    energy = float((wanted * wanted).sum())
    for sigma in _SMOOTHED_CELLS:
        around = Window(weights, sigma)
        smooth = around.mean(wanted) * weights
        if float((smooth * smooth).sum()) >= _KEPT_ENERGY * energy:
            return np.asarray(around.mean(shown) * weights, dtype=np.float32), smooth
    return shown, wanted
