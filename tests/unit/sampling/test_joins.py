"""Costs of joins: those of the seams that are cut, each in its place."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tilefab.rng import stream_key
from tilefab.sampling import CropMap, plan_region
from tilefab.sampling.crop_choice import choose_crops
from tilefab.sampling.joins import measure_joins
from tilefab.sampling.tracing import trace_plan_points
from tilefab.texture.seam_cost import seam_cost


def test_every_pair_of_cells_is_measured_once(crop_map: CropMap) -> None:
    joins = measure_joins(crop_map, -3, 5, 6, 8, seed=3)
    assert len(joins.delta_e) == 6 * 7 + 5 * 8
    crops = choose_crops(crop_map, stream_key(3, "crops"), -3, 5, 6, 8)
    assert_array_equal(joins.crops, crops)
    for k in range(len(joins.delta_e)):
        row, col = joins.row[k] + 3, joins.col[k] - 5
        before = (row - 1, col) if joins.below[k] else (row, col - 1)
        assert (joins.first[k], joins.second[k]) == (crops[before], crops[row, col])
    cells = {(int(r), int(c), bool(b)) for r, c, b in zip(joins.row, joins.col, joins.below, strict=True)}
    assert len(cells) == len(joins.delta_e)


def test_costs_are_those_of_the_seams_shown(crop_map: CropMap) -> None:
    """Against the costs of all pixel pairs along the seams of the same window, found from where each pixel is from."""
    shift = crop_map.guide_shift
    pitch = crop_map.pitch_px >> shift
    joins = measure_joins(crop_map, 0, 0, 12, 12, seed=8)
    plan = plan_region(crop_map, 0, 0, 12 * pitch, 12 * pitch, seed=8, level=shift)
    row, col = np.meshgrid(np.arange(12 * pitch), np.arange(12 * pitch), indexing="ij")
    at = trace_plan_points(crop_map, plan, row.ravel(), col.ravel())
    lab = crop_map.guide[..., :3].astype(np.float64) / 2
    source = (at[:, 0] * lab.shape[1] + at[:, 1]).reshape(row.shape).astype(np.int32)
    # A slanting seam has more pairs than rows, and corners belong to three crops: near, not the same.
    assert joins.delta_e.mean() == pytest.approx(seam_cost(source, lab).mean_delta_e, rel=0.25)


def test_a_crop_joins_its_own_continuation_without_cost(crop_map: CropMap) -> None:
    joins = measure_joins(crop_map, 0, 0, 14, 14, seed=1)
    step = np.where(joins.below, crop_map.crop_row[joins.second] - crop_map.crop_row[joins.first], 0)
    side = np.where(joins.below, 0, crop_map.crop_col[joins.second] - crop_map.crop_col[joins.first])
    across = np.where(joins.below, crop_map.crop_col[joins.second] - crop_map.crop_col[joins.first], 0)
    along = np.where(joins.below, 0, crop_map.crop_row[joins.second] - crop_map.crop_row[joins.first])
    runs_on = (step + side == crop_map.pitch_px) & (across == 0) & (along == 0)
    assert (joins.delta_e[runs_on] == 0).all()
    assert (joins.delta_e >= 0).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 4), (4, 1)])
def test_windows_of_one_row_or_column(crop_map: CropMap, size: tuple[int, int]) -> None:
    rows, cols = size
    assert len(measure_joins(crop_map, 0, 0, rows, cols, seed=1).delta_e) == rows * (cols - 1) + (rows - 1) * cols
