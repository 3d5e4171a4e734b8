"""Several slabs brought to one mean colour and one spread, so that their faces belong together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.slab.bands import over_bands
from tilefab.slab.checks import check_pair
from tilefab.types import FloatImage, Mask

Triple = tuple[float, float, float]

CONSTANT_SPREAD = 0.02
"""A channel with a smaller standard deviation (CIELAB units) counts as constant, with no spread to scale."""

_BAND_PX = 1 << 20
_SCALED_PX = 1 << 17


@dataclass(frozen=True)
class SlabColour:
    """Colour of a slab in CIELAB D50.

    Attributes
    ----------
    mean
        Mean L*, a*, b* of the valid pixels.
    spread
        Standard deviation of each. None, in a target, leaves the spread to the slabs.
    """

    mean: Triple
    spread: Triple | None = None


@dataclass(frozen=True)
class MatchOptions:
    """How far matching may go.

    Attributes
    ----------
    strength
        0 leaves the slabs as they are, 1 brings mean and spread wholly to the target.
    min_gain, max_gain
        Limits of the factor on each channel's spread.
    """

    strength: float = 1.0
    min_gain: float = 0.5
    max_gain: float = 2.0


@dataclass(frozen=True)
class MatchRecord:
    """What matching did to one slab.

    Attributes
    ----------
    before, after
        Colour of the slab before and after; ``after`` leaves out the (rare) clipping of L*.
    target
        What the slab was brought towards.
    gains
        Factor on the spread of each channel.
    limited
        Whether a gain met its limit.
    shift_de
        Distance (CIE76) between the means before and after.
    summary
        One sentence for the report.
    """

    before: SlabColour
    after: SlabColour
    target: SlabColour
    gains: Triple
    limited: bool
    shift_de: float
    summary: str


def slab_colour(lab: FloatImage, valid: Mask) -> SlabColour:
    """Mean and standard deviation of the valid pixels, in float64, band by band.

    Parameters
    ----------
    lab
        float32, (rows, cols, 3), CIELAB D50.
    valid
        bool, (rows, cols), at least one True.

    Raises
    ------
    ValueError
        If image or mask break the conventions.
    """
    check_pair(lab, valid)
    count = 0
    mean = np.zeros(3)
    squares = np.zeros(3)
    rows = max(1, _BAND_PX // lab.shape[1])
    for top in range(0, lab.shape[0], rows):
        pixels = lab[top : top + rows][valid[top : top + rows]].astype(np.float64)
        if len(pixels) == 0:
            continue
        band_mean = pixels.mean(axis=0)
        delta = band_mean - mean
        total = count + len(pixels)
        squares += ((pixels - band_mean) ** 2).sum(axis=0) + delta**2 * (count * len(pixels) / total)
        mean += delta * (len(pixels) / total)
        count = total
    return SlabColour(_triple(mean), _triple(np.sqrt(squares / count)))


def match_slabs(
    labs: Sequence[FloatImage],
    valids: Sequence[Mask],
    target: SlabColour | None = None,
    options: MatchOptions | None = None,
    *,
    in_place: bool = False,
    threads: int = 1,
) -> tuple[list[FloatImage], list[MatchRecord]]:
    """Bring slabs to a common colour: per channel, (value - mean) * gain + new mean.

    After Reinhard, Ashikhmin, Gooch and Shirley (2001), "Color transfer between images", IEEE CG&A 21(5),
    in CIELAB and with limited gains. L* is kept within 0 to 100 (or the pixel's old value, where that was
    already outside).

    Parameters
    ----------
    labs
        One or more float32 images (rows, cols, 3), CIELAB D50; sizes may differ.
    valids
        Their masks. Invalid pixels are changed along with the rest but do not count.
    target
        Mean, and if given spread, to reach. By default the mean of the slabs' means and spreads, each slab
        counting once; for one slab without a target nothing is to do.
    options
        Strength and limits; whole strength and gains of 0.5 to 2 by default.
    in_place
        Whether to overwrite the images given.
    threads
        Never changes the result.

    Returns
    -------
    labs, records
        In the order given; a slab that needs no change is returned as it was given.

    Raises
    ------
    ValueError
        If the counts differ or are zero, an image breaks the conventions, or an option is out of range.
    """
    options = MatchOptions() if options is None else options
    if len(labs) != len(valids) or not labs:
        raise ValueError(f"{len(labs)} images with {len(valids)} masks: wanted one mask an image, at least one")
    if not 0.0 <= options.strength <= 1.0:
        raise ValueError(f"strength {options.strength} is outside 0 .. 1")
    if not 0.0 < options.min_gain <= 1.0 <= options.max_gain < math.inf:
        raise ValueError(f"gain limits {options.min_gain} .. {options.max_gain} do not enclose 1")
    colours = [slab_colour(lab, valid) for lab, valid in zip(labs, valids, strict=True)]
    aim = _resolved_target(colours, target)
    out: list[FloatImage] = []
    records: list[MatchRecord] = []
    for lab, colour in zip(labs, colours, strict=True):
        matched, record = _match_one(lab, colour, aim, options, lab if in_place else None, threads)
        out.append(matched)
        records.append(record)
    return out, records


def _resolved_target(colours: Sequence[SlabColour], target: SlabColour | None) -> SlabColour:
    means = np.array([colour.mean for colour in colours])
    spreads = np.array([_spread(colour) for colour in colours])
    mean = _triple(means.mean(axis=0)) if target is None else target.mean
    given = None if target is None else target.spread
    spread = _triple(spreads.mean(axis=0)) if given is None else given
    if not np.isfinite([*mean, *spread]).all() or min(spread) < 0.0:
        raise ValueError(f"target mean {mean} or spread {spread} is not finite, or a spread is negative")
    return SlabColour(mean, spread)


def _match_one(
    lab: FloatImage,
    colour: SlabColour,
    target: SlabColour,
    options: MatchOptions,
    out: FloatImage | None,
    threads: int,
) -> tuple[FloatImage, MatchRecord]:
    before, spread = np.array(colour.mean), np.array(_spread(colour))
    wanted = np.ones(3)
    varies = spread >= CONSTANT_SPREAD
    wanted[varies] = np.array(_spread(target))[varies] / spread[varies]
    allowed = np.clip(wanted, options.min_gain, options.max_gain)
    gains = 1.0 + options.strength * (allowed - 1.0)
    after = before + options.strength * (np.array(target.mean) - before)
    limited = bool((allowed != wanted).any())
    shift_de = float(np.linalg.norm(after - before))
    if shift_de == 0.0 and (gains == 1.0).all():
        out = lab
        summary = "nothing, because the slab already has the target's colour"
        if options.strength == 0.0:
            summary = "nothing, because the strength is 0"
    else:
        out = np.empty_like(lab) if out is None else out
        _scale(lab, before, gains, after, out, threads)
        summary = (
            f"mean moved by {shift_de:.1f} dE to L* {after[0]:.1f} a* {after[1]:.1f} b* {after[2]:.1f}, "
            f"spread times {gains[0]:.2f}, {gains[1]:.2f} and {gains[2]:.2f}"
            + (" (held at the limit)" if limited else "")
        )
    record = MatchRecord(
        before=colour,
        after=SlabColour(_triple(after), _triple(spread * gains)),
        target=target,
        gains=_triple(gains),
        limited=limited,
        shift_de=shift_de,
        summary=summary,
    )
    return out, record


def _scale(
    lab: FloatImage,
    before: NDArray[np.float64],
    gains: NDArray[np.float64],
    after: NDArray[np.float64],
    out: FloatImage,
    threads: int,
) -> None:
    def one_band(band: slice) -> None:
        old = lab[band].astype(np.float64)
        new = (old - before) * gains + after
        new[..., 0] = np.clip(new[..., 0], np.minimum(old[..., 0], 0.0), np.maximum(old[..., 0], 100.0))
        out[band] = new

    over_bands(one_band, lab.shape[0], max(1, _SCALED_PX // lab.shape[1]), threads)


def _spread(colour: SlabColour) -> Triple:
    return (0.0, 0.0, 0.0) if colour.spread is None else colour.spread


def _triple(values: NDArray[np.float64]) -> Triple:
    return (float(values[0]), float(values[1]), float(values[2]))
