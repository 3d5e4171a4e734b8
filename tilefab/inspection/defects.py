"""Defects of a fired tile: found as difference from its own predicted face, classed, located, graded.

What firing, light and small shifts explain is taken away first (`tilefab.inspection.defect_residual`). What is left is
searched for lines along a column (nozzles), bands of rows, thin lines in any direction, and blobs of any size; a find
must stand out of the tile's own noise and be strong enough to be seen. Defects of the whole print (an ink missing or
out of register, a second print) are searched for by `tilefab.inspection.defect_print`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from tilefab.colour import delta_e_2000
from tilefab.inspection.defect_classes import GradeLimits, ShapeLimits, chips_of, classed, core_of
from tilefab.inspection.defect_kernels import binomial
from tilefab.inspection.defect_print import PressColours, PrintLimits, print_defects
from tilefab.inspection.defect_profiles import ProfileSettings, Stripe, stripes_of
from tilefab.inspection.defect_residual import (
    Residual,
    contrast_of,
    halved,
    halved_values,
    residual_over,
    whitened_by_noise,
)
from tilefab.inspection.defect_search_kernels import line_strengths
from tilefab.inspection.defect_witnesses import Witnesses
from tilefab.inspection.records import Defect, DefectKind, Grade
from tilefab.types import FloatImage, Mask

_INNER, _OUTER = 2, 5
_LINE_REACH_MM, _LINE_WAYS = 1.0, 20
_LINE_CANDIDATE, _CLIP = 2.5, 4.0
_LINE_SAMPLE = 1500
_JOIN_MM, _STRIPE_BLUR_MM = 0.3, 0.4
_LEAST_VALID, _LEAST_ITSELF = 0.02, 0.4
_ECHO_MM, _ECHO_SHARE = 4.0, 0.25
_LINE_TYPICAL = 3.0
_ORDER = {Grade.FIRST: 0, Grade.SECOND: 1, Grade.SCRAP: 2}


@dataclass(frozen=True)
class DefectSettings:
    """What counts as a defect.

    Attributes
    ----------
    margin_mm
        Strip along the face's edges that is searched for chips only: there, tile and belt mix.
    least_contrast
        Smallest contrast of a blob to its surroundings, CIELAB units, as camera and search blur it; `shapes` says what
        it must be besides.
    rare_colours
        How much more contrast is asked for, as a share, where the face has colours that are found hardly anywhere else
        on the tile, so that what the firing does to them isn't known.
    most_witnessed
        Share of its difference that a patch's likes elsewhere on the tile may show: if they show more, it is the
        firing's doing.
    blob_sigmas, line_sigmas
        How far a blob's middle, or a piece of a line, must stand out of the tile's noise, standard deviations.
    largest_px_mm
        Blobs are sought at all scales up to pixels so large.
    profiles
        For lines and bands over the whole tile.
    prints
        For defects of the whole print.
    shapes, grades
        How patches are told apart; from sizes and strengths to grades.
    """

    margin_mm: float = 0.5
    least_contrast: float = 2.0
    rare_colours: float = 2.0
    most_witnessed: float = 0.2
    blob_sigmas: float = 6.0
    line_sigmas: float = 9.0
    largest_px_mm: float = 1.6
    profiles: ProfileSettings = field(default_factory=ProfileSettings)
    prints: PrintLimits = field(default_factory=PrintLimits)
    shapes: ShapeLimits = field(default_factory=ShapeLimits)
    grades: GradeLimits = field(default_factory=GradeLimits)


DEFAULTS = DefectSettings()


def find_defects(
    predicted_lab: FloatImage,
    fired_lab: FloatImage,
    valid: Mask,
    px_per_mm: float,
    *,
    tile_mask: Mask | None = None,
    inks: FloatImage | None = None,
    press: PressColours | None = None,
    settings: DefectSettings = DEFAULTS,
) -> tuple[Defect, ...]:
    """Defects of a fired tile, the worst first.

    Parameters
    ----------
    predicted_lab, fired_lab
        (rows, cols, 3) float32 CIELAB on the face grid, the tile registered to some tenths of a pixel.
    valid
        (rows, cols), True where the image shows the tile.
    px_per_mm
        Resolution of the grid.
    tile_mask
        (rows, cols), True where there is tile at all: elsewhere it is chipped. None: the whole face.
    inks
        (rows, cols, N) ink fractions 0 to 1 that the face was printed with. A firing changes colours by their inks:
        without them, faults of the firing may be taken for defects.
    press
        Colours (P, 3), as the prediction has them, of ink fractions (P, N). Without it, an ink that is missing or out
        of register isn't told.
    settings
        What counts as a defect.

    Returns
    -------
    tuple
        Empty if there are none.

    Raises
    ------
    ValueError
        If the shapes differ, or hardly any of the tile is valid.
    """
    rows, cols = valid.shape
    if not predicted_lab.shape == fired_lab.shape == (rows, cols, 3):
        raise ValueError(f"images {predicted_lab.shape} and {fired_lab.shape} must fit the mask {valid.shape}")
    margin = max(round(settings.margin_mm * px_per_mm), 1)
    judged = np.zeros_like(valid)
    judged[margin:-margin, margin:-margin] = True
    judged &= ndimage.minimum_filter(valid, 2 * min(margin, 3) + 1)
    if tile_mask is not None:
        judged &= ndimage.minimum_filter(tile_mask, 2 * margin + 1)
    if judged.mean() < _LEAST_VALID:
        raise ValueError(f"only {100 * judged.mean():.1f} % of the face is seen: too little to look for defects on")
    rest = residual_over(predicted_lab, fired_lab, judged, px_per_mm, inks)
    found = list(
        print_defects(
            predicted_lab, rest.expected, rest.fired, judged, px_per_mm, inks, press, settings.prints, settings.grades
        )
    )
    if not found:
        # On a print that is wrong all over, nothing else can be told.
        stripes = _stripes(rest, px_per_mm, inks, settings)
        found = _without_echoes(stripes + _patches(rest, stripes, px_per_mm, inks, settings))
    if tile_mask is not None:
        found += chips_of(tile_mask, px_per_mm, settings.margin_mm, settings.shapes, settings.grades)
    return tuple(sorted(found, key=lambda defect: (-_ORDER[defect.grade], -defect.severity)))


def _without_echoes(found: list[Defect]) -> list[Defect]:
    """Leave out what a nozzle line makes beside itself: fainter lines where its surround is taken off, pieces of it."""
    lines = [defect for defect in found if defect.kind is DefectKind.NOZZLE_LINE]

    def is_echo(defect: Defect) -> bool:
        if defect.kind not in (DefectKind.NOZZLE_LINE, DefectKind.SCRATCH, DefectKind.CRACK):
            return False
        beside = [line for line in lines if line is not defect and abs(line.x_mm - defect.x_mm) <= _ECHO_MM]
        if defect.kind is DefectKind.NOZZLE_LINE:
            return any(defect.delta_e < _ECHO_SHARE * line.delta_e for line in beside)
        return defect.width_mm <= _ECHO_MM and any(abs(line.x_mm - defect.x_mm) <= line.width_mm for line in beside)

    return [defect for defect in found if not is_echo(defect)]


def _stripes(rest: Residual, px_per_mm: float, inks: FloatImage | None, settings: DefectSettings) -> list[Defect]:
    """Nozzle lines and bands."""
    limits = settings.profiles
    whitened, lengths = whitened_by_noise(rest.values, rest.weight, rest.likes)
    # Outliers are cut down, so that a spot or a crack doesn't make a column.
    share = rest.weight * _cut_down(lengths)
    lines = stripes_of(
        rest.values,
        whitened,
        rest.weight,
        share,
        _in_pixels(limits.line_widths_mm, px_per_mm),
        limits.line_sigmas,
        limits.least_line_contrast,
        limits.least_share,
        inks,
    )
    bands = stripes_of(
        rest.values.transpose(1, 0, 2),
        whitened.transpose(1, 0, 2),
        rest.weight.T,
        share.T,
        _in_pixels(limits.band_widths_mm, px_per_mm),
        limits.band_sigmas,
        limits.least_band_contrast,
        limits.least_share,
        rare=False,
    )
    found = []
    for line in lines:
        part = (slice(None), slice(max(line.first, 0), line.first + line.width))
        found.append(_stripe(rest, part, DefectKind.NOZZLE_LINE, line, limits.line_sigmas, px_per_mm, settings))
    if bands:
        # However many bands a tile has, they are one fault.
        each = []
        for band in bands:
            part = (slice(max(band.first, 0), band.first + band.width), slice(None))
            each.append(_stripe(rest, part, DefectKind.BANDING, band, limits.band_sigmas, px_per_mm, settings))
        found.append(_together(each))
    return found


def _together(bands: list[Defect]) -> Defect:
    """Bands as one defect: as strong as the strongest, in the box around all."""
    worst = max(bands, key=lambda band: band.delta_e)
    top = min(band.y_mm - band.height_mm / 2.0 for band in bands)
    bottom = max(band.y_mm + band.height_mm / 2.0 for band in bands)
    return replace(
        worst,
        y_mm=(top + bottom) / 2.0,
        height_mm=bottom - top,
        area_mm2=sum(band.area_mm2 for band in bands),
        severity=max(band.severity for band in bands),
    )


def _in_pixels(widths_mm: tuple[float, ...], px_per_mm: float) -> tuple[int, ...]:
    return tuple(sorted({max(round(width * px_per_mm), 1) for width in widths_mm}))


def _stripe(
    rest: Residual,
    part: tuple[slice, slice],
    kind: DefectKind,
    stripe: Stripe,
    sigmas: float,
    px_per_mm: float,
    settings: DefectSettings,
) -> Defect:
    """A line or a band as a defect: as strong as where it shows best."""
    values = rest.values[part][rest.weight[part] > 0.0].astype(np.float64)
    direction = np.array(stripe.contrast) / np.linalg.norm(stripe.contrast)
    colours = rest.expected[part][rest.weight[part] > 0.0].astype(np.float64)
    moved = np.abs(values @ direction).mean() * direction
    difference = float(delta_e_2000(colours.mean(axis=0), colours.mean(axis=0) + moved))
    bounds = [piece.indices(side) for piece, side in zip(part, rest.weight.shape, strict=True)]
    (top, bottom, _), (left, right, _) = bounds
    high, wide = bottom - top, right - left
    least = (
        settings.profiles.least_line_contrast
        if kind is DefectKind.NOZZLE_LINE
        else settings.profiles.least_band_contrast
    )
    contrast = float(np.linalg.norm(stripe.contrast))
    return Defect(
        kind,
        (left + wide / 2.0) / px_per_mm,
        (top + high / 2.0) / px_per_mm,
        wide / px_per_mm,
        high / px_per_mm,
        wide * high / px_per_mm**2,
        difference,
        max(min(stripe.sigmas / sigmas, contrast / least), 1.0),
        settings.grades.of(kind, size=difference),
    )


def _patches(
    rest: Residual, stripes: list[Defect], px_per_mm: float, inks: FloatImage | None, settings: DefectSettings
) -> list[Defect]:
    """Blobs and thin lines, but for what is found as a stripe."""
    rows, cols = rest.weight.shape
    level, weight, likes = rest.fine, rest.weight, rest.likes
    if any(stripe.kind is DefectKind.BANDING for stripe in stripes):
        level = _less_rows(level, weight)
    strength = np.zeros((rows, cols), dtype=np.float32)
    size = 1
    while size / px_per_mm <= settings.largest_px_mm and min(weight.shape) > 4 * _OUTER:
        contrast, whitened, sigmas, seen = contrast_of(level, weight, likes, _INNER, _OUTER)
        height = np.sqrt(np.einsum("rck,rck->rc", contrast, contrast))
        least = settings.least_contrast * (1.0 + settings.rare_colours * likes[..., 2])
        share = np.minimum(sigmas / settings.blob_sigmas, height / least)
        if size == 1:
            share = np.maximum(share, _lines(whitened, seen, sigmas, px_per_mm, settings))
        if (share >= 1.0).any():
            # What only lies beside something strong, and differs from that, is as it should be.
            itself = np.einsum("rck,rck->rc", binomial(level), contrast)
            share = np.where(itself >= np.float32(_LEAST_ITSELF) * height * height, share, np.float32(0.0))
            stands = _connected(share)
            spread = np.kron(np.where(stands, share, 0.0), np.ones((size, size), dtype=np.float32))
            high, wide = (min(a, b) for a, b in zip(spread.shape, strength.shape, strict=True))
            np.maximum(strength[:high, :wide], spread[:high, :wide], out=strength[:high, :wide])
        level, weight = halved_values(level, weight), halved(weight)
        likes = halved(likes)
        size *= 2
    for stripe in stripes:
        if stripe.kind is DefectKind.NOZZLE_LINE:
            reach_mm = stripe.width_mm / 2.0 + _STRIPE_BLUR_MM
            left, right = (round((stripe.x_mm + side * reach_mm) * px_per_mm) for side in (-1, 1))
            strength[:, max(left, 0) : right + 1] = 0.0
    return _as_defects(strength, rest, inks, px_per_mm, settings)


def _less_rows(values: FloatImage, weight: FloatImage) -> FloatImage:
    """A residual less the mean of each row."""
    counts = np.maximum(weight.sum(axis=1), 1.0)
    means = np.einsum("rck,rc->rk", values, weight) / counts[:, np.newaxis]
    return np.asarray((values - means[:, np.newaxis]) * weight[..., np.newaxis], dtype=np.float32)


def _connected(share: FloatImage) -> Mask:
    """Pixels of at least half the limit that hang together with one that reaches it."""
    warm = share >= 0.5
    labels, count = ndimage.label(warm, np.ones((3, 3)))
    if count == 0:
        return np.zeros(share.shape, dtype=bool)
    reached = np.zeros(count + 1, dtype=bool)
    reached[np.unique(labels[share >= 1.0])] = True
    reached[0] = False
    return np.asarray(reached[labels], dtype=bool)


def _lines(
    whitened: FloatImage, seen: FloatImage, sigmas: FloatImage, px_per_mm: float, settings: DefectSettings
) -> FloatImage:
    """How strong a thin line through each pixel is, over the least that counts."""
    reach = max(round(_LINE_REACH_MM * px_per_mm), 3)
    # A spot isn't to make a star of lines.
    bounded = whitened * _cut_down(sigmas)[..., np.newaxis]
    used = np.argwhere(seen > 0.0)
    sample = used[:: max(len(used) // _LINE_SAMPLE, 1)]
    out = np.zeros(seen.shape, dtype=np.float32)
    if not len(sample):
        return out
    usual, _ = line_strengths(bounded, seen, sample[:, 0].copy(), sample[:, 1].copy(), reach, _LINE_WAYS)
    # The best of many directions of plain noise, whose neighbouring pixels are alike, has a median of its own.
    typical = float(np.median(usual)) / _LINE_TYPICAL
    row, col = np.nonzero((sigmas > _LINE_CANDIDATE) & (seen > 0.0))
    found, _ = line_strengths(bounded, seen, row, col, reach, _LINE_WAYS)
    out[row, col] = found / np.float32(max(typical, 0.5) * settings.line_sigmas)
    return out


def _cut_down(lengths: FloatImage) -> FloatImage:
    """Factors that cut vectors of these lengths down to a few standard deviations."""
    return np.asarray(np.minimum(np.float32(1.0), np.float32(_CLIP) / np.maximum(lengths, np.float32(1e-6))))


def _as_defects(
    strength: FloatImage, rest: Residual, inks: FloatImage | None, px_per_mm: float, settings: DefectSettings
) -> list[Defect]:
    """Patches, with those close to each other joined, as defects."""
    marked = strength > 0.0
    if not marked.any():
        return []
    joined = ndimage.binary_dilation(marked, _disc(max(round(_JOIN_MM * px_per_mm), 1)))
    labels, count = ndimage.label(joined, np.ones((3, 3)))
    pad = max(round(_JOIN_MM * px_per_mm), 1) + 1
    found: list[Defect] = []
    witnesses: Witnesses | None = None
    for number, box in enumerate(ndimage.find_objects(labels, max_label=count), 1):
        patch = labels[box] == number
        patch &= rest.weight[box] > 0.0
        if not (patch & (strength[box] > 0.0)).any():
            continue
        core, mean = core_of(patch, rest.fine[box], strength[box])
        if not core.any():
            continue
        top, left = box[0].start, box[1].start
        defect = classed(
            core,
            mean,
            top,
            left,
            rest.expected[box],
            px_per_mm,
            _at_edge(box, patch & (strength[box] > 0.0), rest.weight, pad),
            float(strength[box][patch].max()),
            settings.shapes,
            settings.grades,
        )
        if defect is None:
            continue
        witnesses = witnesses or Witnesses(rest, inks, px_per_mm)
        if witnesses.share_shown(core, top, left, mean) < settings.most_witnessed:
            found.append(defect)
    return found


def _at_edge(box: tuple[slice, ...], marked: Mask, weight: FloatImage, pad: int) -> bool:
    """Whether marked pixels of a box lie within some pixels of what isn't judged."""
    wider = tuple(slice(max(part.start - pad, 0), part.stop + pad) for part in box)
    inner = tuple(slice(part.start - wide.start, part.stop - wide.start) for part, wide in zip(box, wider, strict=True))
    near = ndimage.binary_dilation(weight[wider] <= 0.0, iterations=pad)
    return bool((near[inner] & marked).any())


def _disc(radius: int) -> Mask:
    across = np.arange(-radius, radius + 1)
    return np.asarray(across**2 + across[:, np.newaxis] ** 2 <= radius * radius + 1, dtype=bool)
