"""Compiled tables: the kernels against plain twins, counts against the float table, and invariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.colour.encoding import decode_lab16, encode_lab16
from tilefab.colour.grid_kernels import apply_grid, shape_plain, shape_words, simplex_plain
from tilefab.colour.grid_layout import unit_stage
from tilefab.colour.grid_table import CompiledTable, compile_table
from tilefab.colour.stages import ColourTable, Curves, Grid, Matrix, Stage, lab_from_unit, lab_to_unit

TOPS = {np.uint8: 255, np.uint16: 65535}


def random_table(inputs: int, outputs: int, seed: int, *, nodes: int = 3) -> ColourTable:
    random = np.random.default_rng(seed)
    axes = tuple(random.integers(2, nodes + 1, inputs))
    return ColourTable("ink", "ink", (Grid(random.random((*axes, outputs))),))


def random_counts(shape: tuple[int, ...], dtype: type, seed: int) -> np.ndarray:
    """Random counts, with many at both ends and many equal ones."""
    random = np.random.default_rng(seed)
    top = TOPS[dtype]
    counts = random.integers(0, top + 1, shape)
    counts[: shape[0] // 4] = random.choice([0, 1, top // 2, top - 1, top], counts[: shape[0] // 4].shape)
    equal = counts[shape[0] // 4 : shape[0] // 3]
    equal[...] = equal[..., :1]
    return counts.astype(dtype)


def worst_counts(table: ColourTable, image: np.ndarray, found: np.ndarray) -> int:
    """Largest difference from the float table, rounded, in counts."""
    source = image / np.iinfo(image.dtype).max
    if table.source == "lab":
        source = source * [100.0, 255.0, 255.0] - [0.0, 128.0, 128.0]
    exact = unit_stage(table.target, found.shape[2])(table(source).reshape(-1, found.shape[2])).reshape(found.shape)
    rounded = np.rint(np.clip(exact, 0.0, 1.0) * np.iinfo(found.dtype).max)
    return int(np.abs(rounded - found).max())


@pytest.mark.parametrize("outputs", range(1, 9))
@pytest.mark.parametrize("inputs", range(1, 9))
def test_all_channels_in_8_bits_are_within_a_count_and_are_the_twin(inputs: int, outputs: int) -> None:
    table = random_table(inputs, outputs, 10 * inputs + outputs, nodes=5 if inputs < 5 else 3)
    compiled = compile_table(table, np.uint8, np.uint8)
    image = random_counts((12, 11, inputs), np.uint8, outputs)
    found = compiled.apply(image)
    assert found.shape == (12, 11, outputs)
    assert worst_counts(table, image, found) <= 1
    twin = simplex_plain(
        image.reshape(-1, inputs), compiled._positions, compiled._strides, compiled._nodes, outputs, np.dtype(np.uint8)
    )
    assert np.array_equal(found.reshape(-1, outputs), twin)


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (3, 3), (3, 8), (4, 4), (5, 7), (8, 2)])
@pytest.mark.parametrize(("into", "to"), [(np.uint8, np.uint16), (np.uint16, np.uint8), (np.uint16, np.uint16)])
def test_16_bits_are_within_a_count_and_are_the_twin(inputs: int, outputs: int, into: type, to: type) -> None:
    table = random_table(inputs, outputs, inputs, nodes=17 if inputs < 4 else 3)
    compiled = compile_table(table, into, to)
    image = random_counts((20, 15, inputs), into, outputs)
    found = compiled.apply(image)
    assert found.dtype == to
    assert worst_counts(table, image, found) <= 1
    part = image[:6].reshape(-1, inputs)
    twin = simplex_plain(part, compiled._positions, compiled._strides, compiled._nodes, outputs, np.dtype(to))
    assert np.array_equal(found[:6].reshape(-1, outputs), twin)


def test_16_bits_are_almost_always_the_rounded_float() -> None:
    table = random_table(3, 4, 0, nodes=33)
    image = random_counts((200, 200, 3), np.uint16, 1)
    found = compile_table(table, np.uint16, np.uint16).apply(image)
    rounded = np.rint(65535.0 * table(image / 65535.0))
    assert np.mean(rounded != found) < 2e-3


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_nodes_are_exact_and_ends_too(dtype: type) -> None:
    top = TOPS[dtype]
    random = np.random.default_rng(2)
    counts = random.integers(0, top + 1, (4, 4, 4, 5))
    counts[0, 0, 0] = 0
    counts[3, 3, 3] = top
    table = ColourTable("rgb", "ink", (Grid(counts / top),))
    steps = np.linspace(0, top, 4).round().astype(dtype)
    image = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(1, -1, 3)
    found = compile_table(table, dtype, dtype).apply(image)
    assert np.array_equal(found.reshape(counts.shape), counts)


def shaped_stages(seed: int, outputs: int) -> tuple[Stage, ...]:
    random = np.random.default_rng(seed)
    before = Curves(tuple(np.sort(np.r_[0.0, random.random(9), 1.0]) for _ in range(3)))
    after = Curves(tuple(np.linspace(0.0, 1.0, 40 + channel) ** (0.5 + 0.3 * channel) for channel in range(outputs)))
    return before, Grid(random.random((7, 6, 5, outputs))), after


@pytest.mark.parametrize(("into", "to"), [(np.uint8, np.uint8), (np.uint16, np.uint16), (np.uint8, np.uint16)])
@pytest.mark.parametrize("outputs", [3, 5])
def test_curves_before_and_behind(into: type, to: type, outputs: int) -> None:
    table = ColourTable("rgb", "ink", shaped_stages(4, outputs))
    image = random_counts((130, 90, 3), into, 5)
    assert worst_counts(table, image, compile_table(table, into, to).apply(image)) <= 1


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_straight_curves_and_scalings_cost_nothing(dtype: type) -> None:
    nodes = np.random.default_rng(6).random((5, 5, 5, 4))
    straight = Curves((np.linspace(0.1, 0.9, 9),) * 4)
    scale = Matrix(np.diag([0.5, 1.0, 0.2, 0.9]), np.array([0.5, 0.0, 0.1, 0.05]))
    table = ColourTable("rgb", "ink", (Grid(nodes), straight, scale))
    compiled = compile_table(table, dtype, dtype)
    assert compiled._bytes is None
    assert compiled._words is None
    image = random_counts((30, 30, 3), dtype, 7)
    assert worst_counts(table, image, compiled.apply(image)) <= 1


@pytest.mark.parametrize("to", [np.uint8, np.uint16])
@pytest.mark.parametrize("curved", [False, True])
def test_nodes_outside_are_clipped_after_interpolation(to: type, curved: bool) -> None:
    nodes = np.random.default_rng(8).uniform(-0.5, 1.6, (4, 4, 4, 3))
    after = (Curves((np.linspace(0.0, 1.0, 33) ** 2,) * 3),) if curved else ()
    table = ColourTable("rgb", "rgb", (Grid(nodes), *after))
    image = random_counts((60, 60, 3), np.uint16, 9)
    assert worst_counts(table, image, compile_table(table, np.uint16, to).apply(image)) <= 1


@pytest.mark.parametrize("version", [2, 4])
def test_lab16_in_and_out(version: int) -> None:
    random = np.random.default_rng(10)
    number = 2 if version == 2 else 4
    image = random_counts((40, 40, 3), np.uint16, 11)
    into = ColourTable("lab", "ink", (lab_to_unit(number), Grid(random.random((9, 9, 9, 4)))))
    found = compile_table(into, np.uint16, np.uint16).apply(image)
    assert worst_counts(into, image, found) <= 1
    plain = 65535.0 * into(decode_lab16(image))
    assert np.abs(plain - found).max() < 1.6
    back = ColourTable("ink", "lab", (Grid(random.random((5, 5, 5, 5, 3))), lab_from_unit(number)))
    inks = random_counts((40, 40, 4), np.uint8, 12)
    lab = compile_table(back, np.uint8, np.uint16).apply(inks)
    assert np.abs(encode_lab16(back(inks / 255.0)).astype(int) - lab).max() <= 1


def test_words_are_shaped_as_by_the_twin() -> None:
    random = np.random.default_rng(13)
    curves = [random.integers(-(1 << 20), (1 << 28) + (1 << 20), size).tolist() for size in (2, 7, 256)]
    middle = random.integers(0, (1 << 31) + 1, (500, 3)).astype(np.uint32)
    middle[:3] = [[0, 0, 0], [1 << 31] * 3, [(1 << 31) - 1] * 3]
    knots = np.concatenate([[*curve, curve[-1]] for curve in curves])
    starts = np.array([0, 3, 11], np.uint64)
    segments = np.array([1, 6, 255], np.uint64)
    out = np.zeros((501, 3), np.uint16)
    shape_words(middle.reshape(-1), 500, 3, knots, starts, segments, out.reshape(-1), 1)
    assert np.array_equal(out[1:], shape_plain(middle, curves))
    assert not out[0].any()


@pytest.mark.parametrize("outputs", range(1, 9))
def test_nothing_is_written_outside_a_run(outputs: int) -> None:
    compiled = compile_table(random_table(3, outputs, 14), np.uint8, np.uint8)
    image = random_counts((1, 40, 3), np.uint8, 15)
    whole = compiled.apply(image)[0]
    for pixels in (0, 1, 2, 5, 17):
        out = np.full((60, outputs), 7, np.uint8)
        grid = (compiled._positions, compiled._strides, compiled._nodes, compiled._lanes, outputs)
        apply_grid(image.reshape(-1), 3, pixels, *grid, out.reshape(-1), 11)
        assert np.array_equal(out[11 : 11 + pixels], whole[3 : 3 + pixels])
        assert (out[:11] == 7).all()
        assert (out[11 + pixels :] == 7).all()


def plain_and_shaped() -> list[CompiledTable]:
    plain = ColourTable("rgb", "ink", (Grid(np.random.default_rng(16).random((6, 6, 6, 3))),))
    shaped = ColourTable("rgb", "ink", shaped_stages(17, 3))
    return [compile_table(table, np.uint8, dtype) for table in (plain, shaped) for dtype in (np.uint8, np.uint16)]


def test_threads_and_layout_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    wide = random_counts((301, 258, 3), np.uint8, 18)
    image = wide[:, ::2]
    for compiled in plain_and_shaped():
        whole = compiled.apply(np.ascontiguousarray(image))
        monkeypatch.setattr("tilefab.colour.grid_layout._STRIP_PIXELS", 1000)
        monkeypatch.setattr("tilefab.colour.grid_table.BLOCK_PIXELS", 77)
        out = np.zeros_like(whole)
        assert compiled.apply(image, threads=3, out=out) is out
        monkeypatch.undo()
        assert np.array_equal(out, whole)


@given(rows=st.integers(0, 5), cols=st.integers(0, 9), seed=st.integers(0, 1000), index=st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_any_shape_is_pixel_by_pixel(rows: int, cols: int, seed: int, index: int) -> None:
    compiled = TABLES[index]
    image = np.random.default_rng(seed).integers(0, 256, (rows, cols, 3)).astype(np.uint8)
    found = compiled.apply(image, threads=2)
    assert found.shape == (rows, cols, 3)
    for row in range(rows):
        for col in range(cols):
            assert np.array_equal(compiled.apply(image[row : row + 1, col : col + 1])[0, 0], found[row, col])


TABLES = plain_and_shaped()


def test_chains_are_sampled() -> None:
    turn = Matrix(np.array([[0.6, 0.3, 0.1], [0.1, 0.8, 0.1], [0.0, 0.2, 0.8]]), np.zeros(3))
    table = ColourTable("rgb", "ink", (turn, Grid(np.random.default_rng(19).random((2, 2, 2, 4)))))
    image = random_counts((40, 40, 3), np.uint8, 20)
    worst = [
        worst_counts(table, image, compile_table(table, np.uint8, np.uint8, grid_nodes=nodes).apply(image))
        for nodes in (5, 33)
    ]
    assert worst[1] <= 2
    assert worst[1] < worst[0]


def test_misuse_is_refused() -> None:
    table = random_table(3, 4, 21)
    compiled = compile_table(table, np.uint8, np.uint8)
    image = np.zeros((4, 5, 3), np.uint8)
    with pytest.raises(ValueError, match="must be \\(rows, cols, 3\\) uint8"):
        compiled.apply(image[..., :2])
    with pytest.raises(ValueError, match="uint8"):
        compiled.apply(image.astype(np.uint16))
    with pytest.raises(ValueError, match="threads 0"):
        compiled.apply(image, threads=0)
    with pytest.raises(ValueError, match="C-contiguous"):
        compiled.apply(image, out=np.zeros((4, 5, 8), np.uint8)[..., ::2])
    square = compile_table(random_table(3, 3, 22), np.uint8, np.uint8)
    with pytest.raises(ValueError, match="share no memory"):
        square.apply(image, out=image)
    with pytest.raises(ValueError, match="uint8 or uint16"):
        compile_table(table, np.float32, np.uint8)
    with pytest.raises(ValueError, match="without stages"):
        compile_table(ColourTable("rgb", "ink", ()), np.uint8, np.uint8)
    with pytest.raises(ValueError, match="no numbers"):
        compile_table(ColourTable("gray", "ink", (Grid(np.array([[0.0], [np.nan]])),)), np.uint8, np.uint8)
    with pytest.raises(ValueError, match="2 to 255"):
        compile_table(ColourTable("gray", "ink", (Grid(np.zeros((256, 1))),)), np.uint8, np.uint8)
    with pytest.raises(ValueError, match="1 to 8"):
        compile_table(ColourTable("gray", "ink", (Grid(np.zeros((2, 9))),)), np.uint8, np.uint8)
    steep = Curves((np.array([0.0, 90.0, 1.0]),))
    with pytest.raises(ValueError, match="out of the range"):
        compile_table(ColourTable("gray", "ink", (Grid(np.array([[0.0], [1.0]])), steep)), np.uint8, np.uint8)
