"""Defects of a whole print: an ink that isn't there, an ink out of register, the face printed twice.

They change a tile everywhere, so they are sought on a small copy, and with the press's own colours of inks: what the
tile would look like without an ink, or with one moved, is known and only has to be recognised.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import delta_e_2000
from tilefab.inspection.defect_classes import GradeLimits
from tilefab.inspection.defect_colour_kernels import place_terms
from tilefab.inspection.defect_kernels import means_of
from tilefab.inspection.records import Defect, DefectKind
from tilefab.types import FloatImage, Mask

Float64Array = NDArray[np.float64]
PressColours = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""CIELAB colours (P, 3) of ink fractions (P, N), as predicted faces have them."""

_PX_PER_MM = 2.0
_SAMPLES = 6000
_ROUNDS = 5
_HUBER = 2.0
_MAD = 1.4826
_LOOSE_SHARE = 0.5


@dataclass(frozen=True)
class PrintLimits:
    """What counts as a defect of the whole print.

    Attributes
    ----------
    missing_share
        Share of an ink's effect on colour that must be gone.
    missing_contrast
        Least mean effect that an ink must have on the face, CIELAB units, to be missed.
    missing_explained, missing_alone_contrast
        Where an ink's effect can't be told from the others': share of the whole difference that it must explain, and
        its least mean effect, above any drift's.
    shift_mm
        Least shift of an ink against the others.
    shift_gain
        Share of the residual's variance that this shift must explain.
    ghost_share
        Least strength of a second print, as a share of the face's own contrast.
    ghost_sigmas
        How far it must stand out of the other places where one could lie, standard deviations.
    ghost_reach_mm
        How far off a second print is sought.
    """

    missing_share: float = 0.75
    missing_contrast: float = 1.5
    missing_explained: float = 0.8
    missing_alone_contrast: float = 5.0
    shift_mm: float = 0.12
    shift_gain: float = 0.15
    ghost_share: float = 0.06
    ghost_sigmas: float = 14.0
    ghost_reach_mm: float = 12.0


@dataclass(frozen=True, eq=False)
class _Small:
    """A tile at some two pixels a millimetre, with the places where it is judged."""

    predicted: Float64Array
    expected: Float64Array
    fired: Float64Array
    inks: Float64Array | None
    good: Mask
    px_per_mm: float


def print_defects(
    predicted_lab: FloatImage,
    expected_lab: FloatImage,
    fired_lab: FloatImage,
    judged: Mask,
    px_per_mm: float,
    inks: FloatImage | None,
    press: PressColours | None,
    limits: PrintLimits,
    grades: GradeLimits,
) -> tuple[Defect, ...]:
    """Defects of the whole print.

    Parameters
    ----------
    predicted_lab, expected_lab, fired_lab
        (rows, cols, 3) the face as predicted, the same with this firing's colours, and the tile.
    judged
        (rows, cols), True where the tile is seen.
    px_per_mm
        Resolution.
    inks, press
        (rows, cols, N) ink fractions, and their colours: without them only a second print is sought.
    limits, grades
        What counts, and how it is graded.
    """
    small = _small(predicted_lab, expected_lab, fired_lab, judged, px_per_mm, inks)
    if small.good.sum() < 200:
        return ()
    high_mm, wide_mm = (side / px_per_mm for side in judged.shape)

    def everywhere(kind: DefectKind, delta_e: float, severity: float, size: float) -> Defect:
        return Defect(
            kind,
            wide_mm / 2.0,
            high_mm / 2.0,
            wide_mm,
            high_mm,
            wide_mm * high_mm,
            delta_e,
            max(severity, 1.0),
            grades.of(kind, size=size),
        )

    if small.inks is not None and press is not None:
        missing = _missing_ink(small, small.inks, press, limits)
        if missing is not None:
            return (everywhere(DefectKind.MISSING_INK, missing[1], missing[1] / limits.missing_contrast, 1.0),)
    ghost = _second_print(small, limits)
    if ghost is not None:
        share, delta_e = ghost
        return (everywhere(DefectKind.DOUBLE_PRINT, delta_e, share / limits.ghost_share, 1.0),)
    if small.inks is not None and press is not None:
        moved = _moved_ink(small, small.inks, press, limits)
        if moved is not None:
            shift_mm, delta_e = moved
            return (everywhere(DefectKind.MISREGISTRATION, delta_e, shift_mm / limits.shift_mm, shift_mm),)
    return ()


def _small(
    predicted: FloatImage,
    expected: FloatImage,
    fired: FloatImage,
    judged: Mask,
    px_per_mm: float,
    inks: FloatImage | None,
) -> _Small:
    step = max(round(px_per_mm / _PX_PER_MM), 1)

    def means(image: FloatImage) -> Float64Array:
        return means_of(image, step).astype(np.float64)

    good = means(judged[..., np.newaxis].astype(np.float32))[..., 0] > 0.999
    laid = None if inks is None else means(inks)
    return _Small(means(predicted), means(expected), means(fired), laid, good, px_per_mm / step)


def _chosen(good: Mask) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of at most some thousand pixels spread over the tile, none at its border."""
    inner = good.copy()
    inner[[0, -1]] = False
    inner[:, [0, -1]] = False
    row, col = np.nonzero(inner)
    # A step that shares no factor with the rows' length, so that columns take turns.
    thin = max(len(row) // _SAMPLES, 1)
    while thin > 1 and math.gcd(thin, good.shape[1]) > 1:
        thin += 1
    return row[::thin], col[::thin]


def _fitted(design: Float64Array, wanted: Float64Array, prior: Float64Array) -> Float64Array:
    """Factors (K,) by robust least squares of ``wanted`` (P, 3) on a ``design`` (P, 3, K).

    ``prior`` (K,): inverse variances of the factors about 0.
    """
    weights = np.ones(len(wanted))
    found = np.zeros(design.shape[2])
    for _ in range(_ROUNDS):
        rest = wanted - design @ found
        size = np.maximum(_MAD * np.median(np.abs(rest), axis=0), 0.1)
        off = np.sqrt(((rest / size) ** 2).mean(axis=1))
        weights = np.minimum(1.0, _HUBER / np.maximum(off, 1e-9))
        scaled = design * (weights[:, np.newaxis] / size**2)[..., np.newaxis]
        normal = np.einsum("pck,pcl->kl", scaled, design) + np.diag(prior)
        found = np.linalg.solve(normal, np.einsum("pck,pc->k", scaled, wanted))
    return found


def _missing_ink(
    small: _Small, inks: Float64Array, press: PressColours, limits: PrintLimits
) -> tuple[float, float] | None:
    """Share of the difference that a missing ink explains, and mean CIEDE2000 that it makes; None if all are there.

    All inks' strengths are fitted at once, so that a firing that fades several isn't taken for one that is missing.
    """
    row, col = _chosen(small.good)
    laid = inks[row, col]
    predicted, difference = small.predicted[row, col], small.fired[row, col] - small.predicted[row, col]
    effects = []
    printed = press(laid)
    for ink in range(laid.shape[1]):
        without = laid.copy()
        without[:, ink] = 0.0
        effects.append(press(without) - printed)
    count = len(effects)
    bright = (predicted[:, :1] + 16.0) / 100.0
    places = bright * place_terms(*small.good.shape)[row, col]
    design = np.zeros((len(row), 3, count + 3 + places.shape[1]))
    for ink, effect in enumerate(effects):
        design[:, :, ink] = effect
    design[:, range(3), range(count, count + 3)] = 1.0
    design[:, 0, count + 3 :] = places
    prior = np.r_[np.full(count, 1.0 / _LOOSE_SHARE**2), np.full(3, 1.0 / 3.0**2), np.full(places.shape[1], 1e-2)]
    shares = _fitted(design, difference, prior)
    best: tuple[float, float] | None = None
    power = (difference**2).sum()
    for ink, effect in enumerate(effects):
        size = float(np.sqrt((effect**2).sum(axis=1)).mean())
        if size < limits.missing_contrast:
            continue
        # On a stone of one hue all inks go together, and only the whole difference tells which is missing.
        explained = 1.0 - float(((difference - effect) ** 2).sum() / max(power, 1e-9))
        alone = explained >= limits.missing_explained and size >= limits.missing_alone_contrast
        apart = shares[ink] >= limits.missing_share and explained > 0.0
        if (alone or apart) and (best is None or explained > best[0]):
            best = explained, float(delta_e_2000(predicted, predicted + effect).mean())
    return best


def _moved_ink(
    small: _Small, inks: Float64Array, press: PressColours, limits: PrintLimits
) -> tuple[float, float] | None:
    """How far (mm) one ink lies off the others, and mean CIEDE2000 that it makes; None if none does."""
    row, col = _chosen(small.good)
    laid = inks[row, col]
    rest = small.fired[row, col] - small.expected[row, col]

    def slope(images: Float64Array, down: int, right: int) -> Float64Array:
        return np.asarray(0.5 * (images[row - down, col - right] - images[row + down, col + right]), dtype=np.float64)

    common = np.stack([slope(small.expected, 0, 1), slope(small.expected, 1, 0)], axis=2)
    sides = [small.expected[row + down, col + right] for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0))]
    curve = np.sum(sides, axis=0) - 4.0 * small.expected[row, col]
    base = np.concatenate([common, curve[..., np.newaxis]], axis=2)
    prior = np.full(3, 1e-3)
    _, without = _sum_of_squares(base, rest, prior)
    best: tuple[float, float, float] | None = None
    for ink in range(laid.shape[1]):
        slopes = []
        for down, right in ((0, 1), (1, 0)):
            moved = []
            for sign in (1, -1):
                other = laid.copy()
                other[:, ink] = inks[row - sign * down, col - sign * right, ink]
                moved.append(press(other))
            slopes.append(0.5 * (moved[0] - moved[1]))
        design = np.concatenate([base, np.stack(slopes, axis=2)], axis=2)
        found, cost = _sum_of_squares(design, rest, np.r_[prior, 1e-3, 1e-3])
        shift_mm = float(np.hypot(found[3], found[4])) / small.px_per_mm
        gain = 1.0 - cost / max(without, 1e-9)
        if shift_mm >= limits.shift_mm and gain >= limits.shift_gain and (best is None or gain > best[0]):
            change = design[:, :, 3:] @ found[3:]
            expected = small.expected[row, col]
            best = gain, shift_mm, float(delta_e_2000(expected, expected + change).mean())
    return None if best is None else best[1:]


def _sum_of_squares(design: Float64Array, rest: Float64Array, prior: Float64Array) -> tuple[Float64Array, float]:
    """Factors of a least-squares fit, and what it leaves: outliers cut to three times the usual size."""
    size = np.maximum(_MAD * np.median(np.abs(rest), axis=0), 0.05)
    cut = np.clip(rest, -3.0 * size, 3.0 * size) / size
    scaled = design / size[:, np.newaxis]
    normal = np.einsum("pck,pcl->kl", scaled, scaled) + np.diag(prior)
    found = np.linalg.solve(normal, np.einsum("pck,pc->k", scaled, cut))
    return found, float(((cut - scaled @ found) ** 2).sum())


def _second_print(small: _Small, limits: PrintLimits) -> tuple[float, float] | None:
    """Strength of a second print and the mean CIEDE2000 that it makes; None if there is none.

    What the residual answers to the prediction at each shift, by deconvolution with a floor (Wiener): a stone that is
    like itself at some shift has no peak there.
    """
    taper = np.outer(*(np.hanning(side + 2)[1:-1] for side in small.good.shape)) * small.good
    total = taper.sum()

    def freed(image: Float64Array) -> Float64Array:
        return np.asarray((image - (image * taper).sum() / total) * taper, dtype=np.float64)

    face, rest = freed(small.expected[..., 0]), freed(small.fired[..., 0] - small.expected[..., 0])
    shape = tuple(2 * side for side in face.shape)
    of_face, of_rest = np.fft.rfft2(face, shape), np.fft.rfft2(rest, shape)
    power = np.abs(of_face) ** 2
    answer = np.fft.irfft2(np.conj(of_face) * of_rest / (power + 0.05 * power.mean()), shape)
    reach = min(round(limits.ghost_reach_mm * small.px_per_mm), min(face.shape) // 2)
    near = np.roll(answer, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    down, right = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    # At no shift it is blur, misregistration and contrast.
    away = np.hypot(down, right) >= 1.0 * small.px_per_mm
    spread = max(_MAD * float(np.median(np.abs(near[away]))), 1e-6)
    peak = float(near[away].max())
    if peak < limits.ghost_sigmas * spread or peak < limits.ghost_share:
        return None
    change = np.abs(small.fired - small.expected)[small.good].mean(axis=0)
    middle = small.expected[small.good].mean(axis=0)
    return peak, float(delta_e_2000(middle, middle + change))
