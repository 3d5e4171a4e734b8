"""Building a crop map from a slab: the dictionary of crops, what joining them costs, and what each may be used."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.sampling.candidates import largest_valid_square
from tilefab.sampling.crop_map import BARRED, CONTINUING_COST, RATION_PERIOD, CropMap, continuations, halved_guide
from tilefab.sampling.crop_prices import fair_prices
from tilefab.sampling.crop_tables import JoiningCosts, joining_costs
from tilefab.sampling.texture_map import SlabArea
from tilefab.texture.matching import reduced_mask, window_is_valid
from tilefab.texture.regularity import REGULAR, SelfLikeness
from tilefab.types import Array, Mask

PITCH_PER_FEATURE = 0.88
DEFAULT_FEATURE_SHARE = 0.25
_OVERLAP_PER_PITCH = 1 / 3
_COARSEST_OVERLAP_PX = 8
_LARGEST_GUIDE_PX = 1 << 26
_SMALLEST_TABLE_PITCH_PX = 24
_STRIP_ROWS = 512
_LARGEST_PITCH_PX = (1 << 14) - 1
# Roberts 2018, "The unreasonable effectiveness of quasirandom sequences": fractions of the plastic number.
_STEP_ROW = 0.7548776662466927
_STEP_COL = 0.5698402909980532
# Share of the crops at each side of the slab: pixels at its rim lie in few others.
_RIM_SHARE = 0.06
_PHASES_PER_CROP = 64
_REGULAR_PITCHES = (0.5, 1.1)


@dataclass(frozen=True)
class Feature:
    """A place of the slab that would be recognised if it recurred.

    Attributes
    ----------
    row, col
        Its middle, in pixels of the base.
    radius_px
        Its size.
    """

    row: int
    col: int
    radius_px: int


@dataclass(frozen=True)
class CropOptions:
    """How a crop map is built.

    Attributes
    ----------
    feature_px
        Size of the largest thing that should stay whole; ``None``: a quarter of the largest square of the slab.
    crops
        How many crops to choose from. More make better seams; the tables grow with its square.
    candidates
        How many of them each choice tries.
    sweeps
        How many times choices are gone over again.
    seed
        Job seed.
    threads
        For the tables; doesn't change the result. ``None``: one per processor.
    drop, keep
        Crops never to show, or, if ``keep`` isn't empty, the only ones to show.
    """

    feature_px: int | None = None
    crops: int = 1024
    candidates: int = 512
    sweeps: int = 2
    seed: int = 0
    threads: int | None = None
    drop: tuple[int, ...] = ()
    keep: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.crops < 1 or self.candidates < 1 or not 0 <= self.sweeps <= 8:
            raise ValueError(f"{self.crops} crops, {self.candidates} candidates, {self.sweeps} sweeps: not possible")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"threads must be at least 1, not {self.threads}")
        if self.feature_px is not None and self.feature_px < 1:
            raise ValueError(f"features of {self.feature_px} px: must be at least 1")


@dataclass(frozen=True)
class Geometry:
    """Sizes of a crop map, see `CropMap`."""

    pitch_px: int
    overlap_px: int
    guide_shift: int
    seam_levels: int
    regular: bool = False


def crop_geometry(
    shape: tuple[int, int], largest_square_px: int, feature_px: int | None, likeness: SelfLikeness | None = None
) -> Geometry:
    """Sizes that suit a slab.

    Parameters
    ----------
    shape
        Rows and columns of the base.
    largest_square_px
        Side of the largest square of it that is all valid.
    feature_px
        See `CropOptions`.
    likeness
        The slab's likeness to itself: if it repeats at a pitch that would do, that is taken, so that crops fall in
        with each other.

    Raises
    ------
    ValueError
        If the slab is too small for any crop.
    """
    feature = feature_px if feature_px is not None else DEFAULT_FEATURE_SHARE * largest_square_px
    # Crops half as large as the slab leave no choice of where to take them from.
    wanted = min(PITCH_PER_FEATURE * feature, 0.5 * largest_square_px / (1 + _OVERLAP_PER_PITCH), _LARGEST_PITCH_PX)
    overlap = _OVERLAP_PER_PITCH * wanted
    halvings = max(0, int(np.floor(np.log2(max(overlap, 1) / _COARSEST_OVERLAP_PX))))
    guide_shift = 0
    while (shape[0] >> guide_shift) * (shape[1] >> guide_shift) > _LARGEST_GUIDE_PX and guide_shift < halvings:
        guide_shift += 1
    regular = _regular_pitch(likeness, wanted, guide_shift, halvings) if likeness is not None else None
    if regular is not None:
        pitch_px, halvings = regular
        quantum = 2 << halvings
    else:
        quantum = 2 << halvings
        pitch_px = max(int(wanted / quantum), 1) * quantum
    overlap_px = min(max(int(_OVERLAP_PER_PITCH * pitch_px / quantum + 0.5), 1) * quantum, pitch_px)
    if pitch_px + overlap_px > largest_square_px:
        raise ValueError(f"a usable piece of {largest_square_px} px is too small to take crops from")
    return Geometry(pitch_px, overlap_px, guide_shift, halvings - guide_shift, regular is not None)


def _regular_pitch(likeness: SelfLikeness, wanted_px: float, guide_shift: int, halvings: int) -> tuple[int, int] | None:
    """Pitch at which a slab repeats itself and how often it can be halved, or ``None``.

    A coarser quantum is given up where only a finer one has such a pitch.
    """
    low, high = (share * wanted_px for share in _REGULAR_PITCHES)
    for fewer in range(halvings, guide_shift - 1, -1):
        quantum = 2 << fewer
        pitches = range(max(int(np.ceil(low / quantum)), 1) * quantum, int(high) + 1, quantum)
        found = [(likeness.repeats_at(pitch), pitch) for pitch in pitches]
        if found and max(found)[0] >= REGULAR:
            return max(found)[1], fewer
    return None


def build_crop_map(
    base_lab_d50: NDArray[np.float32],
    valid: Mask,
    options: CropOptions,
    *,
    stored: Array,
    space: str,
    channels: tuple[str, ...],
    dpi: float,
    slabs: tuple[SlabArea, ...] = (),
    provenance: dict[str, str] | None = None,
    weights: NDArray[np.uint8] | None = None,
    features: Sequence[Feature] = (),
    costs: JoiningCosts | None = None,
    progress: Callable[[float], None] | None = None,
) -> CropMap:
    """Build a crop map.

    Parameters
    ----------
    base_lab_d50
        (rows, cols, 3) float32 CIELAB (D50) of the slab: what seams are judged by.
    valid
        (rows, cols), True where the slab may be used.
    options
        How to build.
    stored
        (rows, cols, channels): the image the map keeps and renders from, in ``space``.
    space, channels, dpi, slabs, provenance
        See `TextureMap`.
    weights
        (rows, cols) uint8: where seams should not pass. 0: as they like; 255: at 17 times the cost.
    features
        What should not recur close by: crops that show one take turns.
    costs
        Joining costs of an earlier build from the same slab with the same sizes and number of crops; a new list of
        crops to drop needs no others.
    progress
        Called with the share done, 0 to 1.

    Returns
    -------
    CropMap

    Raises
    ------
    ValueError
        If the images or the mask differ in size, the slab is too small, or no crop is left to show.
    """
    if not base_lab_d50.shape[:2] == valid.shape == stored.shape[:2]:
        raise ValueError(f"base {base_lab_d50.shape}, valid {valid.shape} and stored {stored.shape} differ in size")
    if weights is not None and weights.shape != valid.shape:
        raise ValueError(f"weights {weights.shape} and valid {valid.shape} differ in size")
    report = progress or (lambda _share: None)
    threads = options.threads or os.cpu_count() or 1
    likeness = SelfLikeness(np.where(valid, base_lab_d50[..., 0], base_lab_d50[..., 0][valid].mean()))
    geometry = crop_geometry(valid.shape, largest_valid_square(valid), options.feature_px, likeness)
    guide = guide_image(base_lab_d50, weights, geometry.guide_shift)
    report(0.05)
    row, col = spread_places(valid, geometry, options.crops, likeness)
    if costs is None:
        level, table_level = guide, 0
        while geometry.pitch_px >> (geometry.guide_shift + table_level + 1) >= _SMALLEST_TABLE_PITCH_PX and (
            table_level < geometry.seam_levels
        ):
            level, table_level = halved_guide(level), table_level + 1
        shift = geometry.guide_shift + table_level
        costs = joining_costs(
            level,
            row >> shift,
            col >> shift,
            geometry.pitch_px >> shift,
            geometry.overlap_px >> shift,
            threads,
            lambda share: report(0.05 + 0.75 * share),
        )
    elif len(costs.side) != len(row):
        raise ValueError(f"costs of {len(costs.side)} crops don't fit {len(row)}")
    barred = barred_crops(len(row), options)
    follows = continuations(row.astype(np.int32), col.astype(np.int32), geometry.pitch_px)
    costs = costs._replace(side=costs.side.copy(), below=costs.below.copy())  # a caller's may be read-only
    for table, direction in ((costs.side, 0), (costs.below, 2)):
        continued = np.flatnonzero(follows[:, direction] >= 0)
        table[continued, follows[continued, direction]] = CONTINUING_COST
    crop_map = CropMap(
        base=np.ascontiguousarray(stored),
        space=space,
        channels=channels,
        dpi=dpi,
        slabs=slabs,
        provenance=dict(provenance or {}),
        guide=guide,
        guide_shift=geometry.guide_shift,
        crop_row=row.astype(np.int32),
        crop_col=col.astype(np.int32),
        pitch_px=geometry.pitch_px,
        overlap_px=geometry.overlap_px,
        seam_levels=geometry.seam_levels,
        side_cost=costs.side,
        below_cost=costs.below,
        price=np.where(barred, BARRED, 0).astype(np.int32),
        ration=rations(row, col, geometry, features),
        candidates=min(options.candidates, len(row)),
        sweeps=options.sweeps,
    )
    priced = fair_prices(crop_map, barred, options.seed, lambda share: report(0.8 + 0.2 * share))
    report(1.0)
    return priced


def barred_crops(crops: int, options: CropOptions) -> Mask:
    """(crops,) True where a crop must not be shown.

    Raises
    ------
    ValueError
        If there is no such crop, or none would be left.
    """
    wrong = [k for k in (*options.drop, *options.keep) if not 0 <= k < crops]
    if wrong:
        raise ValueError(f"there is no crop {wrong[0]}; the map has crops 0 to {crops - 1}")
    barred = np.full(crops, bool(options.keep))
    barred[list(options.keep)] = False
    barred[list(options.drop)] = True
    if barred.all():
        raise ValueError("every crop is dropped; keep some")
    return barred


def guide_image(lab_d50: NDArray[np.float32], weights: NDArray[np.uint8] | None, guide_shift: int) -> NDArray[np.uint8]:
    """The slab as seams see it; see `CropMap.guide`. Sides are rounded up: the last pixels are repeated."""
    factor = 1 << guide_shift
    rows, cols = (-(-side // factor) for side in lab_d50.shape[:2])
    out = np.empty((rows, cols, 3 if weights is None else 4), dtype=np.uint8)
    offset = np.array([0.0, 64.0, 64.0], dtype=np.float32)
    step = max(_STRIP_ROWS // factor, 1)
    for top in range(0, rows, step):
        part = lab_d50[top * factor : (top + step) * factor]
        pad = [(0, -part.shape[0] % factor), (0, -part.shape[1] % factor), (0, 0)]
        if factor > 1:
            part = np.pad(part, pad, mode="edge")
            part = part.reshape(part.shape[0] // factor, factor, cols, factor, 3).mean(axis=(1, 3), dtype=np.float32)
        out[top : top + step, :, :3] = np.clip(np.rint(2 * (part + offset)), 0, 255)
        if weights is not None:
            # What must not be cut stays so however small it is.
            held = np.pad(weights[top * factor : (top + step) * factor], pad[:2], mode="edge")
            out[top : top + step, :, 3] = held.reshape(-1, factor, cols, factor).max(axis=(1, 3))
    return out


def spread_places(
    valid: Mask, geometry: Geometry, crops: int, likeness: SelfLikeness | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of up to ``crops`` different crops, evenly spread over the valid part of a slab.

    Most come with the crops that continue them, a pitch away. Any run of successive crops is evenly spread as well,
    so that a hashed part of the dictionary is a fair one. Of a slab that repeats itself, only crops of one phase are
    taken (``likeness`` tells which).
    """
    quantum = 1 << geometry.guide_shift
    side = geometry.pitch_px + geometry.overlap_px
    # Whole quanta are checked, so a crop is valid if its quanta are.
    fits = window_is_valid(reduced_mask(valid, quantum), side // quantum, side // quantum)
    if not fits.any():
        raise ValueError(f"no square of {side} px is usable: the mask leaves nothing to take crops from")
    if geometry.regular and likeness is not None:
        fits = _of_one_phase(fits, likeness, quantum)
    # On the grid of the coarsest level, if it has places enough, reduced pictures show crops where they are.
    while 2 * quantum <= 1 << (geometry.guide_shift + geometry.seam_levels) and (
        np.count_nonzero(fits[::2, ::2]) >= 2 * crops
    ):
        fits, quantum = fits[::2, ::2], 2 * quantum
    if np.count_nonzero(fits) <= crops:
        at = np.argwhere(fits)
        at = at[_spread_order(len(at))]
        return at[:, 0] * quantum, at[:, 1] * quantum
    pitch = geometry.pitch_px // quantum
    found: dict[tuple[int, int], None] = {}
    everywhere = np.argwhere(fits)
    for number in range(_PHASES_PER_CROP * crops):
        row, col = (
            _phase((0.5 + step * number) % 1, places, pitch)
            for step, places in zip((_STEP_ROW, _STEP_COL), fits.shape, strict=True)
        )
        for r, c in np.argwhere(fits[row::pitch, col::pitch]):
            found[row + int(r) * pitch, col + int(c) * pitch] = None
        if len(found) >= crops:
            break
    # Places few and far between, as of a slab that repeats itself, may lie at phases that weren't drawn.
    for r, c in everywhere[_spread_order(len(everywhere))] if len(found) < crops else ():
        found[int(r), int(c)] = None
    at = np.array(list(found)[:crops], dtype=np.int64)
    return at[:, 0] * quantum, at[:, 1] * quantum


def _phase(share: float, places: int, pitch: int) -> int:
    """Place within a pitch, 0 .. pitch - 1, for a number from 0 to 1; the slab's own ends more often than others."""
    if share < _RIM_SHARE:
        return 0
    if share > 1 - _RIM_SHARE:
        return (places - 1) % pitch
    return int((share - _RIM_SHARE) / (1 - 2 * _RIM_SHARE) * pitch)


def _of_one_phase(fits: Mask, likeness: SelfLikeness, quantum: int) -> Mask:
    """Of the places that fit, those where the slab looks as it does at the one nearest the middle of them all."""
    at = np.argwhere(fits)
    middle = at[np.abs(at - at.mean(axis=0)).sum(axis=1).argmin()]
    row, col = np.ogrid[: fits.shape[0], : fits.shape[1]]
    return fits & (likeness.at((row - middle[0]) * quantum, (col - middle[1]) * quantum) >= REGULAR)


def _spread_order(count: int) -> NDArray[np.int64]:
    """All of 0 .. count - 1, successive ones far apart."""
    return np.argsort((np.arange(count) * _STEP_ROW) % 1, kind="stable").astype(np.int64)


def rations(
    row: NDArray[np.int64], col: NDArray[np.int64], geometry: Geometry, features: Sequence[Feature]
) -> NDArray[np.int8]:
    """(crops,) whose turn a crop that shows a feature has, or -1."""
    ration = np.full(len(row), -1, dtype=np.int8)
    margin = geometry.overlap_px // 2
    for number, feature in enumerate(features):
        inside_row = (feature.row >= row + margin) & (feature.row < row + margin + geometry.pitch_px)
        inside_col = (feature.col >= col + margin) & (feature.col < col + margin + geometry.pitch_px)
        ration[inside_row & inside_col] = number % RATION_PERIOD
    return ration
