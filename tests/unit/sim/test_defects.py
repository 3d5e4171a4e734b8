"""Seeded defects change what they say, and nothing else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sim import defects

PX_PER_MM = 10.0


def generator() -> np.random.Generator:
    return np.random.default_rng(3)


def print_data() -> np.ndarray:
    return np.random.default_rng(1).integers(20, 200, (300, 260, 4)).astype(np.uint8)


def fired() -> np.ndarray:
    return np.full((300, 260, 3), 0.5, dtype=np.float32)


def box_of(changed: np.ndarray, truth: defects.SeededDefect) -> None:
    rows, cols = np.nonzero(changed)
    low, high = np.array([cols.min(), rows.min()]) / PX_PER_MM, (np.array([cols.max(), rows.max()]) + 1) / PX_PER_MM
    assert (low + high) / 2 == pytest.approx([truth.x_mm, truth.y_mm], abs=0.15)
    assert high - low == pytest.approx([truth.width_mm, truth.height_mm], abs=0.35)


def test_nozzle_line() -> None:
    data = print_data()
    out, truth = defects.nozzle_line(data, 2, generator(), px_per_mm=PX_PER_MM)
    changed = (out != data).any(axis=2)
    assert changed.any(axis=0).sum() == 2
    assert changed.all(axis=0).sum() == 2
    assert (out[..., [0, 1, 3]] == data[..., [0, 1, 3]]).all()
    assert out[..., 2][changed].max() == 0
    box_of(changed, truth)


def test_missing_ink() -> None:
    data = print_data()
    out, truth = defects.missing_ink(data, 1, px_per_mm=PX_PER_MM)
    assert not out[..., 1].any()
    assert (out[..., [0, 2, 3]] == data[..., [0, 2, 3]]).all()
    assert (truth.width_mm, truth.height_mm) == (26.0, 30.0)


def test_misregistration_moves_one_ink() -> None:
    data = print_data()
    out, _ = defects.misregistered(data, 3, (0.3, -0.2), px_per_mm=PX_PER_MM)
    assert (out[..., :3] == data[..., :3]).all()
    assert (out[:-2, 3:, 3] == data[2:, :-3, 3]).all()


def test_double_print_adds_ink() -> None:
    data = print_data()
    out, _ = defects.double_print(data, (1.0, 0.0), 0.5, px_per_mm=PX_PER_MM)
    assert (out >= data).all()
    wanted = np.minimum(data[:, 10:].astype(float) + 0.5 * data[:, :-10], 255)
    assert np.abs(out[:, 10:] - wanted).max() <= 0.5


def test_banding_swings_along_rows() -> None:
    data = np.full((300, 260, 4), 100, dtype=np.uint16)
    out, _ = defects.banding(data, 0.2, generator(), px_per_mm=PX_PER_MM, pitch_mm=10.0, ink=0)
    assert (out[..., 1:] == 100).all()
    assert (out[..., 0] == out[:, :1, 0]).all()
    assert out[..., 0].min() == 80
    assert out[..., 0].max() == 120
    assert (out[100:, 0, 0] == out[:-100, 0, 0]).all()


@pytest.mark.parametrize(
    ("make", "kind", "area_mm2"),
    [
        (defects.spot, "spot", np.pi * 0.25**2),
        (defects.pinhole, "pinhole", np.pi * 0.15**2),
        (defects.crack, "crack", 10.0 * 0.2),
        (defects.scratch, "scratch", 12.0 * 0.3),
    ],
)
def test_marks_have_their_size(
    make: Callable[..., tuple[np.ndarray, defects.SeededDefect]], kind: str, area_mm2: float
) -> None:
    options = {"length_mm": 12.0} if kind == "scratch" else {}
    out, truth = make(fired(), generator(), px_per_mm=PX_PER_MM, **options)
    assert truth.kind == kind
    changed = np.abs(out - fired())[..., 0]
    assert changed.sum() / changed.max() / PX_PER_MM**2 == pytest.approx(area_mm2, rel=0.25)
    box_of(changed > 0.3 * changed.max(), truth)


@pytest.mark.parametrize("corner", [True, False])
def test_chips_lie_at_the_edge(corner: bool) -> None:
    out, truth = defects.chip(fired(), generator(), px_per_mm=PX_PER_MM, corner=corner)
    changed = np.abs(out - fired()).max(axis=2) > 0.01
    edges = [changed[0].any(), changed[-1].any(), changed[:, 0].any(), changed[:, -1].any()]
    assert sum(edges) == (2 if corner else 1)
    box_of(changed, truth)


def test_the_same_generator_makes_the_same() -> None:
    one, other = (defects.crack(fired(), generator(), px_per_mm=PX_PER_MM)[0] for _ in range(2))
    assert (one == other).all()
    assert (fired() == 0.5).all()


def test_too_small_a_tile() -> None:
    with pytest.raises(ValueError, match="too small for a defect of 10 mm"):
        defects.crack(np.full((100, 100, 3), 0.5, dtype=np.float32), generator(), px_per_mm=PX_PER_MM)
