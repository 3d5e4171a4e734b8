"""Print data kept within a limit, held against the same in floating point."""

import numpy as np
import pytest

from tilefab.colour.limits import limit_total_ink, max_total_counts, quantise_inks
from tilefab.colour.press_counts import limit_counts
from tilefab.types import PrintImage


def some(inks: int, dtype: type, rows: int = 40, cols: int = 30) -> PrintImage:
    values = np.random.default_rng(inks).random((rows, cols, inks)) ** 2
    return np.rint(values * np.iinfo(dtype).max).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("black", [None, 0, -1])
@pytest.mark.parametrize("inks", [1, 2, 4, 8])
def test_as_in_floating_point(inks: int, black: int | None, dtype: type) -> None:
    channel = black if black is None else black % inks
    counts, limit = some(inks, dtype), 31.0 * inks
    full, most = int(np.iinfo(dtype).max), max_total_counts(limit, np.dtype(dtype))
    before = counts.copy()
    plain = quantise_inks(limit_total_ink(before / full, limit, channel), dtype, limit)
    use = limit_counts(counts, limit, channel, threads=2)
    total = counts.sum(axis=2, dtype=np.int64)
    over = before.sum(axis=2, dtype=np.int64) > most
    assert 0.1 < over.mean() < 0.9
    assert total.max() <= most
    np.testing.assert_array_equal(counts[~over], before[~over])
    assert np.abs(counts.astype(np.int64) - plain).max() <= 1
    if channel is not None:
        np.testing.assert_array_equal(counts[..., channel], np.minimum(before[..., channel].astype(np.int64), most))
    # Nothing is given away beyond what rounding takes.
    assert total[over].min() > most - inks
    np.testing.assert_allclose(use.mean, counts.reshape(-1, inks).mean(axis=0) / full, atol=1e-12)
    assert use.largest_total == total.max() / full
    assert use.share_limited == over.mean()


def test_threads_and_strips_never_change_a_value(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = some(5, np.uint16)
    use = limit_counts(whole, 120.0, 2)
    monkeypatch.setattr("tilefab.colour.grid_layout._STRIP_PIXELS", 100)
    for threads in (1, 3):
        again = some(5, np.uint16)
        assert limit_counts(again, 120.0, 2, threads=threads) == use
        np.testing.assert_array_equal(again, whole)


def test_no_limit_changes_nothing() -> None:
    counts = some(3, np.uint8)
    use = limit_counts(counts, None, None)
    np.testing.assert_array_equal(counts, some(3, np.uint8))
    assert use.share_limited == 0.0
    assert limit_counts(np.zeros((0, 4, 2), np.uint8), 100.0, None).mean == (0.0, 0.0)


def test_black_alone_is_cut_at_the_limit() -> None:
    counts = np.array([[[0, 0, 255], [10, 20, 250]]], np.uint8)
    limit_counts(counts, 50.0, 2)
    assert counts.tolist() == [[[0, 0, 127], [0, 0, 127]]]


def test_misuse_is_refused() -> None:
    counts = some(3, np.uint8)
    with pytest.raises(ValueError, match="black_channel"):
        limit_counts(counts, 100.0, 3)
    with pytest.raises(ValueError, match="limit_percent"):
        limit_counts(counts, 0.0, None)
    with pytest.raises(ValueError, match="C-contiguous"):
        limit_counts(counts[:, ::2], 100.0, None)
