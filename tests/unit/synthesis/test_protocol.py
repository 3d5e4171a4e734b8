"""What every method may rely on, and what every method must do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis import METHODS, Step, SynthesisRequest, render
from tilefab.types import SizePx

Stone = Callable[[int, int, int], NDArray[np.float32]]
SIZE = SizePx(48, 40)


def request_of(lab: NDArray[np.float32], size: SizePx = SIZE, **options: Any) -> SynthesisRequest:
    return SynthesisRequest(lab, np.ones(lab.shape[:2], dtype=bool), size, **{"seed": 5, **options})


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"exemplar": np.zeros((20, 20), dtype=np.float32)}, "float32"),
        ({"exemplar": np.zeros((20, 20, 0), dtype=np.float32)}, "float32"),
        ({"exemplar": np.zeros((20, 20, 3))}, "float64"),
        ({"exemplar": np.full((20, 20, 3), np.nan, dtype=np.float32)}, "NaN"),
        ({"exemplar": np.full((20, 20, 3), -np.inf, dtype=np.float32)}, "infinity"),
        ({"valid": np.ones((20, 21), dtype=bool)}, "mask"),
        ({"valid": np.ones((20, 20), dtype=np.uint8)}, "mask"),
        ({"valid": np.zeros((20, 20), dtype=bool)}, "no pixel"),
        ({"weights": np.zeros((20, 20), dtype=np.float32)}, "weights"),
        ({"weights": np.zeros((19, 20), dtype=np.uint8)}, "weights"),
        ({"size": SizePx(0, 20)}, "0 "),
        ({"size": SizePx(20, 32769)}, "32,768"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**63}, "seed"),
        ({"feature_px": 0}, "feature_px"),
        ({"threads": 0}, "threads"),
    ],
)
def test_what_no_method_could_use_is_refused(wrong: dict[str, Any], match: str) -> None:
    right = request_of(np.zeros((20, 20, 3), dtype=np.float32))
    assert replace(right, seed=2**63 - 1, size=SizePx(1, 32768)).seed == 2**63 - 1
    with pytest.raises(ValueError, match=match):
        replace(right, **wrong)


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2", "f4", "f8", "i8", "b1"])
@pytest.mark.parametrize("channels", [(), (1,), (3,), (7,)])
def test_layers_are_copied_exactly(dtype: str, channels: tuple[int, ...]) -> None:
    random = np.random.default_rng(1)
    layer = random.integers(0, 250, size=(5, 7, *channels)).astype(dtype)
    source = random.integers(0, 35, size=(11, 4)).astype(np.int32)
    out = render(layer, source)
    assert out.dtype == layer.dtype
    assert out.shape == (11, 4, *channels)
    for row in range(11):
        for col in range(4):
            assert_array_equal(out[row, col], layer[divmod(int(source[row, col]), 7)])


@pytest.mark.parametrize("place", [-1, 35])
def test_a_map_of_another_layer_is_refused(place: int) -> None:
    with pytest.raises(ValueError, match="outside a layer of 7 x 5"):
        render(np.zeros((5, 7)), np.array([[0, place]], dtype=np.int32))
    with pytest.raises(ValueError, match="shape"):
        render(np.zeros(35), np.array([[0]], dtype=np.int32))
    with pytest.raises(ValueError, match="shape"):
        render(np.zeros((5, 7)), np.array([0], dtype=np.int32))


@pytest.fixture(params=sorted(METHODS))
def method(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_same_request_same_result_with_any_threads(method: str, stone: Stone) -> None:
    request = request_of(stone(40, 44, 3))
    first = METHODS[method](request)
    assert first.source.shape == (48, 40)
    assert first.source.dtype == np.int32
    assert first.complete
    for threads in (1, 2, 3):
        assert_array_equal(METHODS[method](replace(request, threads=threads)).source, first.source)
    other = METHODS[method](replace(request, seed=6))
    assert (other.source != first.source).mean() > 0.5


@pytest.mark.parametrize("toroidal", [True, False])
def test_only_valid_pixels_are_shown(method: str, stone: Stone, toroidal: bool) -> None:
    valid = np.ones((48, 50), dtype=bool)
    valid[:6, :] = valid[20:25, 30:36] = False
    request = replace(request_of(stone(48, 50, 3)), valid=valid, toroidal=toroidal)
    assert valid.ravel()[METHODS[method](request).source].all()


@pytest.mark.parametrize(
    ("shape", "size"), [((16, 16), SizePx(40, 33)), ((60, 70), SizePx(30, 20)), ((16, 60), SizePx(50, 30))]
)
def test_small_exemplars_and_small_results(method: str, stone: Stone, shape: tuple[int, int], size: SizePx) -> None:
    result = METHODS[method](request_of(stone(*shape, 2), size))
    assert result.source.shape == (size.rows, size.cols)
    assert result.source.min() >= 0
    assert result.source.max() < shape[0] * shape[1]


def test_one_colour(method: str) -> None:
    lab = np.full((20, 24, 3), (62.0, 1.5, 7.0), dtype=np.float32)
    assert METHODS[method](request_of(lab)).source.shape == (48, 40)


@pytest.mark.parametrize("channels", [1, 2, 5])
def test_any_number_of_channels(method: str, stone: Stone, channels: int) -> None:
    lab = stone(32, 36, 2)
    many = np.ascontiguousarray(np.concatenate([lab, lab[..., ::-1]], axis=2)[..., :channels])
    result = METHODS[method](request_of(many))
    assert result.source.shape == (48, 40)


def test_whoever_watches_is_told_and_may_stop(method: str, stone: Stone) -> None:
    request, shares, drafts = request_of(stone(40, 44, 3)), [], []

    def watch(step: Step) -> bool:
        shares.append(step.share)
        if step.draft is not None:
            drafts.append(step.draft())
        return True

    complete = METHODS[method](request, watch)
    assert shares == sorted(shares)
    assert 0 < shares[-1] <= 1
    assert drafts
    for draft in drafts:
        assert (draft.shape, draft.dtype) == ((48, 40), np.dtype(np.int32))
        assert draft.min() >= 0
        assert draft.max() < 40 * 44
    assert_array_equal(METHODS[method](request).source, complete.source)
    stopped = METHODS[method](request, lambda _: False)
    assert not stopped.complete
    assert stopped.source.shape == (48, 40)
    assert stopped.source.min() >= 0
