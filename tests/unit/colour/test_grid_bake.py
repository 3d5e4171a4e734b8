"""Sampled chains, and tables in floating point."""

import numpy as np
import pytest

from tilefab.colour.grid_bake import bake, neutral_curve
from tilefab.colour.grid_float import apply_float
from tilefab.colour.grid_table import compile_table
from tilefab.colour.stages import ColourTable, Curves, Grid, Matrix, lab_from_unit, lab_to_unit


def test_neutral_falls_on_a_node_and_steps_there_are_half() -> None:
    curve = neutral_curve()
    assert curve[0] == 0.0
    assert curve[128] == 0.5
    assert curve[-1] == 1.0
    assert (np.diff(curve) > 0).all()
    assert np.allclose(np.diff(curve)[[127, 128]] * 255, 2.0, rtol=0.03)


def test_nodes_are_exact_in_all_spaces() -> None:
    def mix(lab: np.ndarray) -> np.ndarray:
        return np.stack([lab[:, 0] / 100, (lab[:, 1] / 128) ** 2, np.abs(lab[:, 2]) / 128], axis=1)

    table = bake(mix, "lab", "rgb", 3, nodes=9)
    grey = np.stack([np.linspace(0, 100, 9), np.zeros(9), np.zeros(9)], axis=1)
    assert np.allclose(table(grey), mix(grey), atol=1e-12)
    back = bake(lambda rgb: np.array([100.0, 40.0, -60.0]) * rgb, "rgb", "lab", 3, nodes=3)
    rgb = np.random.default_rng(0).random((50, 3))
    assert np.allclose(back(rgb), np.array([100.0, 40.0, -60.0]) * rgb)
    xyz = bake([np.sqrt, np.square], "xyz", "xyz", 3, nodes=5)
    points = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]) * 65535 / 32768 / 2
    assert np.allclose(xyz(points), points)


def test_a_chain_is_applied_in_turn() -> None:
    first = ColourTable("ink", "lab", (Grid(np.random.default_rng(1).random((3, 3, 3, 3, 3))), lab_from_unit(4)))
    second = ColourTable("lab", "ink", (lab_to_unit(4), Grid(np.random.default_rng(2).random((2, 2, 2, 4)))))
    table = bake((first, second), "ink", "ink", 4, nodes=5)
    corners = np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    assert np.allclose(table(corners), second(first(corners)), atol=1e-12)


def test_curves_crowd_nodes_where_they_are_steep() -> None:
    def root(value: np.ndarray) -> np.ndarray:
        return np.sqrt(value)

    place = np.linspace(0, 1, 1001)[:, np.newaxis]
    plain = bake(root, "gray", "ink", 1, nodes=9)
    steep = bake(root, "gray", "ink", 1, nodes=9, curves=[np.sqrt(np.linspace(0, 1, 4096))])
    assert np.abs(steep(place) - root(place)).max() < np.abs(plain(place) - root(place)).max() / 5


def test_more_inputs_still_fit() -> None:
    def mean(ink: np.ndarray) -> np.ndarray:
        return ink.mean(axis=1, keepdims=True)

    table = bake(mean, "ink", "ink", 8, nodes=3)
    image = np.random.default_rng(3).integers(0, 256, (7, 9, 8)).astype(np.uint8)
    found = compile_table(table, np.uint8, np.uint8).apply(image)
    assert np.abs(found[..., 0] - image.mean(axis=2)).max() < 0.52


def test_bad_requests_are_refused() -> None:
    with pytest.raises(ValueError, match="1 to 8"):
        bake(np.sqrt, "ink", "ink", 9)
    with pytest.raises(ValueError, match="2 to 255"):
        bake(np.sqrt, "ink", "ink", 3, nodes=1)
    with pytest.raises(ValueError, match="rising"):
        bake(np.sqrt, "ink", "ink", 1, nodes=3, curves=[np.array([0.0, 0.5, 0.5, 1.0])])
    with pytest.raises(ValueError, match="3 channels"):
        bake(np.sqrt, "lab", "ink", 4, nodes=3, curves=[np.array([0.0, 1.0])] * 4)


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (3, 4), (3, 8), (4, 3), (8, 5)])
def test_floating_point_is_the_table(inputs: int, outputs: int) -> None:
    random = np.random.default_rng(inputs)
    stages = (
        Curves(tuple(np.sort(random.random(5 + channel)) for channel in range(inputs))),
        Grid(random.random((*random.integers(2, 5, inputs), outputs))),
        Matrix(random.normal(0, 1, (outputs, outputs)), random.normal(0, 0.1, outputs)),
        Curves(tuple(random.random(3) for _ in range(outputs))),
    )
    table = ColourTable("ink", "ink", stages)
    image = random.uniform(-0.1, 1.1, (30, 20, inputs)).astype(np.float32)
    image[0] = 0.0
    image[1] = 1.0
    found = apply_float(table, image)
    assert found.dtype == np.float32
    assert np.abs(found - table(image)).max() < 3e-6


def test_floating_point_bears_threads_layout_and_what_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    table = ColourTable("lab", "ink", (lab_to_unit(2), Grid(np.random.default_rng(4).random((5, 5, 5, 4)))))
    lab = np.random.default_rng(5).normal([50, 0, 0], [20, 40, 40], (300, 70, 3)).astype(np.float32)
    whole = apply_float(table, lab)
    monkeypatch.setattr("tilefab.colour.grid_layout._STRIP_PIXELS", 500)
    monkeypatch.setattr("tilefab.colour.grid_float.BLOCK_PIXELS", 33)
    assert np.array_equal(apply_float(table, lab, threads=2), whole)
    assert np.array_equal(apply_float(table, lab[:, ::-1]), whole[:, ::-1])
    assert apply_float(table, lab[:0]).shape == (0, 70, 4)
    lab[0, 0] = [np.nan, np.inf, -np.inf]
    zero = apply_float(ColourTable("lab", "ink", table.stages[1:]), lab[:1, :1])
    assert np.array_equal(zero[0, 0], np.float32(table.stages[1](np.array([[0.0, 1.0, 0.0]]))[0]))


def test_floating_point_misuse_is_refused() -> None:
    table = ColourTable("rgb", "ink", (Grid(np.zeros((2, 2, 2, 4))),))
    with pytest.raises(ValueError, match="float32"):
        apply_float(table, np.zeros((2, 2, 3)))
    with pytest.raises(ValueError, match="threads"):
        apply_float(table, np.zeros((2, 2, 3), np.float32), threads=0)
    with pytest.raises(ValueError, match="without stages"):
        apply_float(ColourTable("rgb", "ink", ()), np.zeros((2, 2, 3), np.float32))
