"""Total ink limits: exact sums, nearest counts, and the kernel against a plain twin."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.colour.limits import limit_total_ink, max_total_counts, quantise_inks


def plain_counts(pixel: np.ndarray, top: int, most: int) -> list[int]:
    exact = [min(max(float(np.float32(value)), 0.0), 1.0) * top for value in pixel]
    total = 0.0
    for value in exact:
        total += value
    scale = most / total if total > most else 1.0
    exact = [value * scale for value in exact]
    rounded = [math.floor(value + 0.5) for value in exact]
    while sum(rounded) > most:
        ups = [(r - e if r > 0 else -math.inf) for r, e in zip(rounded, exact, strict=True)]
        rounded[ups.index(max(ups))] -= 1
    return rounded


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("limit", [0.0, 37.5, 199.9, 280.0, 400.0])
def test_kernel_agrees_with_its_twin(dtype: type, limit: float) -> None:
    inks = np.random.default_rng(3).random((300, 4)).astype(np.float32)
    inks[:40] = np.round(inks[:40] * 4) / 4
    inks[40:50] = -0.2
    inks[50:60] = 1.3
    top = int(np.iinfo(dtype).max)
    most = math.floor(limit * top / 100)
    found = quantise_inks(inks, dtype, limit)
    assert found.dtype == dtype
    assert found.tolist() == [plain_counts(pixel, top, most) for pixel in inks]
    assert found.sum(axis=1, dtype=np.int64).max() <= most == max_total_counts(limit, np.dtype(dtype))


@given(st.lists(st.floats(0, 1, width=32), min_size=1, max_size=8), st.floats(0, 800))
@settings(max_examples=150, deadline=None)
def test_sum_never_passes_the_limit(pixel: list[float], limit: float) -> None:
    inks = np.array([[pixel]], dtype=np.float32)
    for dtype in (np.uint8, np.uint16):
        top = int(np.iinfo(dtype).max)
        counts = quantise_inks(inks, dtype, limit)
        assert counts.sum(dtype=np.int64) <= math.floor(limit * top / 100)
        exact = inks[0, 0].astype(np.float64) * top
        if np.floor(exact + 0.5).sum() <= max_total_counts(limit, np.dtype(dtype)):
            assert np.abs(counts[0, 0] - exact).max() <= 0.5


def test_counts_are_nearest_within_the_limit() -> None:
    inks = np.array([[0.5, 0.1, 0.0, 1.0]])
    assert quantise_inks(inks, np.uint8, 280.0).tolist() == [[128, 26, 0, 255]]
    assert quantise_inks(inks[0], np.uint16, 280.0).tolist() == [32768, 6554, 0, 65535]


def test_misuse_is_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        quantise_inks(np.array([[np.nan, 0.0]]), np.uint8, 280.0)
    with pytest.raises(ValueError, match="dtype"):
        quantise_inks(np.zeros((1, 4)), np.float32, 280.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="limit_percent"):
        quantise_inks(np.zeros((1, 4)), np.uint8, -1.0)
    with pytest.raises(ValueError, match="limit_percent"):
        limit_total_ink(np.zeros((1, 4)), 0.0, 3)
    with pytest.raises(ValueError, match="black_channel"):
        limit_total_ink(np.zeros((1, 4)), 280.0, 4)


def test_black_is_kept_where_the_limit_allows() -> None:
    inks = np.array([[[1.0, 1.0, 1.0, 0.8], [0.2, 0.1, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]]])
    limited = limit_total_ink(inks, 200.0, 3)
    assert limited.dtype == np.float32
    np.testing.assert_allclose(limited[0, 0], [0.4, 0.4, 0.4, 0.8], atol=1e-7)
    np.testing.assert_allclose(limited[0, 1:], inks[0, 1:], atol=1e-7)
    np.testing.assert_allclose(limit_total_ink(inks, 50.0, 3)[0, 0], [0.0, 0.0, 0.0, 0.5], atol=1e-7)
    np.testing.assert_allclose(limit_total_ink(inks, 190.0, None)[0, 0], [0.5, 0.5, 0.5, 0.4], atol=1e-7)
