"""The quality panel: how near a synthesised image is to its exemplar, and whether it got there honestly.

Four measures of likeness, and three gates for what the measures can be fooled by: copies repeated at a fixed shift
please every one of them, blurred detail hardly moves those that look at coarse scales, and straight seams are a
handful of pixels among many. Coverage of the exemplar needs the synthesis's coordinates, and is measured elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from tilefab.texture.bidirectional import bidirectional_similarity
from tilefab.texture.gradients import check_labs, gradient_distance
from tilefab.texture.portilla_simoncelli import MIN_SIDE_PX, portilla_simoncelli_distance
from tilefab.texture.spectrum import radial_psd_distance
from tilefab.types import Array

Plane: TypeAlias = NDArray[np.float64]

MAX_REPETITION = 0.2
"""Largest excess of the autocorrelation peak that passes: see `repetition_excess`."""
SHARPNESS_RANGE = (0.75, 1.35)
"""Fine-scale contrast over the exemplar's that passes: see `sharpness_ratio`."""
MAX_SEAMS = 0.1
"""Largest excess of aligned edges that passes: see `seam_excess`."""

_LEAST_CHANNEL_SHARE = 0.1
_LEAST_CONTRAST_DE76 = 0.1
_FINE_SIGMA_PX = 1.0
_DETAIL_SIGMA_PX = 3.0
_NEAR_SHARE = 0.125


@dataclass(frozen=True)
class Panel:
    """How near an image is to its exemplar; of the first four, less is better.

    Attributes
    ----------
    portilla_simoncelli
        Relative distance of joint wavelet statistics; 0.1 to 0.3 between samples of one texture.
    radial_psd
        Root mean square difference of the radial log power spectra, natural logarithms.
    bidirectional_de76
        Mean colour difference per pixel between patches and their nearest ones in the other image, both ways.
    gradient
        Earth mover's distance between gradient magnitudes, relative to the exemplar's mean.
    sharpness_ratio
        Fine-scale contrast over the exemplar's; 1 is right.
    repetition
        Excess of the detail's autocorrelation peak over the exemplar's, 0 to 1; 0 is right.
    seams
        Excess of straight aligned edges over the exemplar's, in mean gradients; 0 is right.
    """

    portilla_simoncelli: float
    radial_psd: float
    bidirectional_de76: float
    gradient: float
    sharpness_ratio: float
    repetition: float
    seams: float

    @property
    def failed_gates(self) -> tuple[str, ...]:
        """Which of ``repetition``, ``blur``, ``noise`` (sharper than the exemplar) and ``seams`` the image fails."""
        failed = {
            "repetition": self.repetition > MAX_REPETITION,
            "blur": self.sharpness_ratio < SHARPNESS_RANGE[0],
            "noise": self.sharpness_ratio > SHARPNESS_RANGE[1],
            "seams": self.seams > MAX_SEAMS,
        }
        return tuple(name for name, fails in failed.items() if fails)

    @property
    def gates_passed(self) -> bool:
        """Whether the image passes every gate, so that the first four measures may be believed."""
        return not self.failed_gates


def measure_panel(exemplar_lab: Array, image_lab: Array) -> Panel:
    """Measure a synthesised image against its exemplar.

    Parameters
    ----------
    exemplar_lab
        (rows, cols, 3) CIELAB, at least 40 pixels a side; finite.
    image_lab
        (rows, cols, 3) CIELAB at the same resolution, at least 40 pixels a side. Any size, but the repetition of
        copies further apart than two thirds of it can't be seen.

    Returns
    -------
    Panel
        Finite numbers, whatever the images.

    Raises
    ------
    ValueError
        If an image has the wrong shape, is too small or isn't finite.

    Notes
    -----
    The statistics and spectra are of the exemplar's principal colour channels, those with a tenth or more of its
    variance, and are averaged by variance; gates look at the first.
    """
    check_labs(exemplar_lab, image_lab, MIN_SIDE_PX, "the panel")
    axes, shares = principal_axes(exemplar_lab)
    exemplar, image = exemplar_lab @ axes, image_lab @ axes
    channels = range(shares.size)
    statistics = [portilla_simoncelli_distance(exemplar[:, :, k], image[:, :, k]) for k in channels]
    spectra = [radial_psd_distance(exemplar[:, :, k], image[:, :, k]) for k in channels]
    return Panel(
        portilla_simoncelli=float(shares @ np.array(statistics)),
        radial_psd=float(shares @ np.array(spectra)),
        bidirectional_de76=bidirectional_similarity(exemplar_lab, image_lab).distance_de76,
        gradient=gradient_distance(exemplar_lab, image_lab),
        sharpness_ratio=sharpness_ratio(exemplar[:, :, 0], image[:, :, 0]),
        repetition=repetition_excess(exemplar[:, :, 0], image[:, :, 0]),
        seams=seam_excess(exemplar[:, :, 0], image[:, :, 0]),
    )


def principal_axes(lab: Array) -> tuple[Plane, Plane]:
    """The colour directions in which an image varies most.

    Parameters
    ----------
    lab
        (rows, cols, 3) CIELAB.

    Returns
    -------
    axes
        (3, n) orthonormal, from the greatest variance down; those with a tenth of all variance or more, at least one.
        For an image without any, lightness.
    shares
        (n,) their variances, scaled to add up to 1.
    """
    if float(lab.reshape(-1, 3).std(axis=0).max()) < _LEAST_CONTRAST_DE76:
        return np.array([[1.0], [0.0], [0.0]]), np.ones(1)
    variances, directions = np.linalg.eigh(np.cov(lab.reshape(-1, 3).astype(np.float64), rowvar=False))
    variances, directions = variances[::-1], directions[:, ::-1]
    used = variances >= _LEAST_CHANNEL_SHARE * variances.sum()
    # An axis has no sign of its own; light is taken as positive so that the choice is the same everywhere.
    signs = np.where(directions[0, used] < 0, -1.0, 1.0)
    return directions[:, used] * signs, variances[used] / variances[used].sum()


def sharpness_ratio(exemplar: Array, image: Array) -> float:
    """Fine-scale contrast of an image over that of its exemplar.

    Parameters
    ----------
    exemplar, image
        (rows, cols) of one channel, in CIELAB units.

    Returns
    -------
    float
        Root mean square of what a Gaussian of one pixel removes, image over exemplar. The published results that
        people find sharp have 0.82 to 1.19, the blurred ones 0.2 to 0.41, and a photograph blurred by a Gaussian of
        0.7 pixels has 0.43 to 0.65 of what it had. Pieces of an exemplar laid edge to edge reach 1.9.
    """
    return _fine_contrast(image) / _fine_contrast(exemplar)


def _fine_contrast(plane: Array) -> float:
    values = plane.astype(np.float64)
    fine = values - ndimage.gaussian_filter(values, _FINE_SIGMA_PX, mode="mirror")
    # Eight-bit rounding alone makes about as much.
    return math.hypot(float(np.sqrt(np.mean(fine**2))), _LEAST_CONTRAST_DE76)


def repetition_excess(exemplar: Array, image: Array) -> float:
    """By how much more an image repeats itself at some shift than its exemplar does at any.

    Parameters
    ----------
    exemplar, image
        (rows, cols) of one channel, in CIELAB units.

    Returns
    -------
    float
        0 to 1: highest autocorrelation of the image's detail (what a Gaussian of three pixels removes) away from
        zero, less the exemplar's, or 0. About the share of the image that is a copy of what stands at the shift. A
        near-regular exemplar repeats itself, so an image that repeats as much has no excess. Chance gives up to 0.05,
        published results have 0.18 or less, and exemplars tiled edge to edge 0.9 (0.2 to 0.3 if near-regular).

    Notes
    -----
    Shifts are those of an eighth of the exemplar's shorter side or more and up to half the exemplar's, or two thirds
    of the image's, sides; each is normalised by the contrast of the parts that overlap. Fine detail is used since
    the coarse structure of any texture correlates with itself by chance.
    """
    near_px = _NEAR_SHARE * min(exemplar.shape)
    own = _highest_autocorrelation(exemplar, near_px, 1 / 2)
    return max(0.0, _highest_autocorrelation(image, near_px, 2 / 3) - own)


def _highest_autocorrelation(plane: Array, near_px: float, reach: float) -> float:
    values = plane.astype(np.float64)
    detail = values - ndimage.gaussian_filter(values, _DETAIL_SIGMA_PX, mode="mirror")
    detail -= detail.mean()
    rows, cols = detail.shape
    down, right = int(reach * rows), int(reach * cols)
    size = (fft.next_fast_len(rows + down, real=True), fft.next_fast_len(cols + right, real=True))
    spectrum = fft.rfft2(detail, size)
    energy, inside = fft.rfft2(detail**2, size), fft.rfft2(np.ones_like(detail), size)
    products = fft.irfft2(np.abs(spectrum) ** 2, size)
    here = fft.irfft2(np.conj(energy) * inside, size)
    there = fft.irfft2(np.conj(inside) * energy, size)
    lags_down = np.arange(down + 1)
    lags_right = np.arange(-right, right + 1)
    lags = np.ix_(lags_down, lags_right)
    # Eight-bit rounding isn't detail: without the floor, a flat image would correlate with itself at random.
    floor = _LEAST_CONTRAST_DE76**2 * (rows - lags_down)[:, None] * (cols - np.abs(lags_right))[None, :]
    scale = np.sqrt(np.maximum(here[lags], 0) * np.maximum(there[lags], 0)) + floor
    correlation = products[lags] / scale
    away = np.hypot(lags_down[:, None], lags_right[None, :]) >= near_px
    return float(np.clip(correlation[away].max(initial=0), 0, 1))


def seam_excess(exemplar: Array, image: Array) -> float:
    """By how much more an image's sharp edges line up in single rows or columns than its exemplar's do.

    Parameters
    ----------
    exemplar, image
        (rows, cols) of one channel, in CIELAB units.

    Returns
    -------
    float
        >= 0, in mean absolute differences between the exemplar's neighbouring pixels: the greatest mean step across a
        straight line as long as the exemplar's shorter side, beyond the steps on either side of the line; less the
        same along any quarter as long in the exemplar, or 0. Of 49 published results on seven textures, 48 have 0 and
        one, with stacked straight cuts, 2; pieces of the exemplars laid edge to edge have 0.14 (of sparse strokes) to
        10.

    Notes
    -----
    The measure of block edges in compressed images, Wang, Bovik and Evans 2000, "Blind measurement of blocking
    artifacts in images", without their assumption of where the blocks lie. Texture has steps of one size on either
    side of a line, so only a seam stands out. The exemplar is read along shorter lines since the threads of a weave
    or the sides of grains line up by chance, and a larger image has more chances.
    """
    side = min(exemplar.shape)
    excesses = []
    for axis in (0, 1):
        own, typical = _aligned_steps(exemplar, axis, side // 4)
        found, _ = _aligned_steps(image, axis, side)
        excesses.append((found - own) / max(typical, _LEAST_CONTRAST_DE76))
    return max(0.0, *excesses)


def _aligned_steps(plane: Array, axis: int, run_px: int) -> tuple[float, float]:
    """Greatest mean step across one line along so many pixels, beyond its neighbours', and the mean step anywhere."""
    steps = np.abs(np.diff(plane.astype(np.float64), axis=axis))
    lines = steps if axis == 0 else steps.T
    beyond = lines[1:-1] - (lines[:-2] + lines[2:]) / 2
    run = min(run_px, beyond.shape[1])
    sums = np.cumsum(np.pad(beyond, ((0, 0), (1, 0))), axis=1)
    return float((sums[:, run:] - sums[:, :-run]).max()) / run, float(steps.mean())
