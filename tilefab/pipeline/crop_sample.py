"""What a map of crops does, measured on a sample of its plane: how well crops join, and how evenly they are used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.sampling import CropMap, plan_region
from tilefab.sampling.crop_choice import choose_crops
from tilefab.sampling.crop_map import BARRED
from tilefab.sampling.crop_prices import crop_usage
from tilefab.sampling.joins import Joins, measure_joins
from tilefab.sampling.tracing import trace_plan_points

JOINED_CELLS = 24
_USED_CELLS = 96
_USAGE_PX = 256
_TRACED_CELLS = 40
_TRACED_POINTS = 300_000
_COVERAGE_BINS = 80


@dataclass(frozen=True, eq=False)
class CropSample:
    """Measurements of a map of crops.

    Attributes
    ----------
    joins
        Every join of a window of cells.
    uses
        (crops,) how often each is shown in a larger window.
    usage
        How often each place of the slab is shown, as a multiple of the mean; the slab is reduced.
    can_show
        Where in ``usage`` a cell's middle can lie.
    coverage
        Share of the usable slab that is shown at all.
    """

    joins: Joins
    uses: NDArray[np.int64]
    usage: NDArray[np.float64]
    can_show: NDArray[np.bool_]
    coverage: float

    @property
    def most_used(self) -> float:
        """How often the most used place is shown, as a multiple of the mean."""
        return float(self.usage.max(initial=0.0))

    def join_costs(self, crops: int) -> NDArray[np.float64]:
        """(crops,) mean CIE76 of the joins of each crop in the sample; NaN for those not in it."""
        total, count = np.zeros(crops), np.zeros(crops)
        for which in (self.joins.first, self.joins.second):
            np.add.at(total, which, self.joins.delta_e)
            np.add.at(count, which, 1)
        mean: NDArray[np.float64] = np.divide(total, count, out=np.full(crops, np.nan), where=count > 0)
        return mean


def shown_crops(crop_map: CropMap) -> NDArray[np.bool_]:
    """(crops,) True where the job lets a crop be shown."""
    shown: NDArray[np.bool_] = crop_map.price < BARRED
    return shown


def sample_crops(crop_map: CropMap, seed: int, threads: int = 1, joined_cells: int = JOINED_CELLS) -> CropSample:
    """Measure a map of crops on the plane of a job seed; joins are measured in a square of ``joined_cells``."""
    crops = len(crop_map.crop_row)
    joins = measure_joins(crop_map, 0, 0, joined_cells, joined_cells, seed=seed, threads=threads)
    window = choose_crops(crop_map, rng.stream_key(seed, "crops"), 0, 0, _USED_CELLS, _USED_CELLS)
    uses = np.bincount(window.ravel(), minlength=crops)
    factor = max(1, -(-max(crop_map.base.shape[:2]) // _USAGE_PX))
    can_show = crop_usage(crop_map, shown_crops(crop_map).astype(np.int64), factor) > 0.5
    usage = np.where(can_show, crop_usage(crop_map, uses, factor), 0.0)
    usage /= max(float(usage[can_show].mean()) if can_show.any() else 0.0, 1e-12)
    return CropSample(joins, uses.astype(np.int64), usage, can_show, _coverage(crop_map, seed, threads))


def _coverage(crop_map: CropMap, seed: int, threads: int) -> float:
    level = crop_map.coarsest_level
    side = _TRACED_CELLS * (crop_map.pitch_px >> level)
    plan = plan_region(crop_map, 0, 0, side, side, seed=seed, level=level, threads=threads)
    random = rng.generator(seed, "coverage")
    rows, cols = random.integers(side, size=(2, _TRACED_POINTS))
    at = trace_plan_points(crop_map, plan, rows, cols) << level
    largest = max(crop_map.base.shape[:2])
    bins = at * _COVERAGE_BINS // largest
    shown = len(np.unique(bins[:, 0] * _COVERAGE_BINS + bins[:, 1]))
    slabs_px = sum(slab.rows * slab.cols for slab in crop_map.slabs) or crop_map.base.shape[0] * crop_map.base.shape[1]
    usable = int(crop_map.provenance.get("usable_px", slabs_px))
    return float(min(1.0, shown * (largest / _COVERAGE_BINS) ** 2 / max(usable, 1)))
