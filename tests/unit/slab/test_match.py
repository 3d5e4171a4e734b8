"""Colour matching: means and spreads reached, limits kept, constants and masks handled."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from tilefab.slab.match import MatchOptions, SlabColour, match_slabs, slab_colour


def slab(mean: tuple[float, float, float], spread: tuple[float, float, float], seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((60, 50, 3)).clip(-2.5, 2.5)
    return (np.array(mean) + noise * np.array(spread)).astype(np.float32)


def masks(labs: list[np.ndarray]) -> list[np.ndarray]:
    return [np.ones(lab.shape[:2], np.bool_) for lab in labs]


def test_colour_is_the_plain_mean_and_deviation_of_valid_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    lab = slab((60, 5, -10), (8, 2, 3), 1)
    valid = np.random.default_rng(2).random(lab.shape[:2]) > 0.4
    valid[20:40] = False
    for band_px in (1 << 20, 200):
        monkeypatch.setattr("tilefab.slab.match._BAND_PX", band_px)
        colour = slab_colour(lab, valid)
        assert_allclose(colour.mean, lab[valid].astype(np.float64).mean(axis=0), rtol=1e-12)
        assert_allclose(colour.spread, lab[valid].astype(np.float64).std(axis=0), rtol=1e-10)


def test_slabs_meet_at_the_mean_of_their_means_and_spreads() -> None:
    labs = [slab((60, 5, 10), (8, 2, 3), 1), slab((66, 1, 14), (10, 3, 4), 2), slab((57, 3, 9), (7, 2, 3), 3)]
    colours = [slab_colour(lab, valid) for lab, valid in zip(labs, masks(labs), strict=True)]
    out, records = match_slabs(labs, masks(labs))
    mean = np.mean([colour.mean for colour in colours], axis=0)
    spread = np.mean([colour.spread for colour in colours], axis=0)
    for lab, record in zip(out, records, strict=True):
        after = slab_colour(lab, np.ones(lab.shape[:2], np.bool_))
        assert_allclose(after.mean, mean, atol=1e-4)
        assert_allclose(after.spread, spread, rtol=1e-4)
        assert_allclose(record.after.mean, after.mean, atol=1e-4)
        assert lab.dtype == np.float32
        assert not record.limited
        assert "dE" in record.summary


def test_matching_again_changes_nothing_of_note() -> None:
    labs = [slab((60, 5, 10), (8, 2, 3), 1), slab((66, 1, 14), (10, 3, 4), 2)]
    once, _ = match_slabs(labs, masks(labs))
    twice, records = match_slabs(once, masks(once))
    assert_allclose(twice[0], once[0], atol=1e-3)
    assert max(record.shift_de for record in records) < 1e-3


def test_one_slab_without_a_target_is_left_alone() -> None:
    lab = slab((60, 5, 10), (8, 2, 3), 1)
    out, records = match_slabs([lab], masks([lab]))
    assert_array_equal(out[0], lab)
    assert out[0] is lab
    assert records[0].summary.startswith("nothing, because")


def test_a_grey_scan_is_tinted_by_the_mean_of_the_job() -> None:
    grey = slab((60, 0, 0), (8, 0, 0), 1)
    out, records = match_slabs([grey], masks([grey]), SlabColour((55.0, 4.0, 12.0)))
    assert_allclose(slab_colour(out[0], masks(out)[0]).mean, (55, 4, 12), atol=1e-3)
    assert_allclose(out[0][..., 0] - out[0][..., 0].mean(), grey[..., 0] - grey[..., 0].mean(), atol=1e-3)
    assert_array_equal(records[0].gains, (1.0, 1.0, 1.0))


def test_a_constant_channel_has_no_spread_to_scale() -> None:
    labs = [np.full((4, 4, 3), 50.0, np.float32), slab((60, 5, 10), (8, 2, 3), 1)]
    out, records = match_slabs(labs, masks(labs))
    assert np.isfinite(out[0]).all()
    assert records[0].gains == (1.0, 1.0, 1.0)
    assert_array_equal(np.ptp(out[0], axis=(0, 1)), 0.0)


def test_gains_keep_their_limits_and_say_so() -> None:
    lab = slab((60, 5, 10), (8, 2, 3), 1)
    target = SlabColour((60.0, 5.0, 10.0), (80.0, 0.1, 3.0))
    out, (record,) = match_slabs([lab], masks([lab]), target)
    assert record.gains[:2] == (2.0, 0.5)
    assert record.limited
    assert "limit" in record.summary
    assert out[0][..., 0].min() >= 0.0
    assert out[0][..., 0].max() <= 100.0


def test_strength_goes_part_of_the_way() -> None:
    lab = slab((60, 5, 10), (4, 2, 3), 1)
    target = SlabColour((70.0, 5.0, 10.0), (6.0, 2.0, 3.0))
    before = slab_colour(lab, masks([lab])[0])
    half, (record,) = match_slabs([lab], masks([lab]), target, MatchOptions(strength=0.5))
    after = slab_colour(half[0], masks(half)[0])
    assert after.mean[0] == pytest.approx((before.mean[0] + 70.0) / 2, abs=1e-3)
    assert record.gains[0] == pytest.approx((1.0 + 6.0 / before.spread[0]) / 2)
    none, (record,) = match_slabs([lab], masks([lab]), target, MatchOptions(strength=0.0))
    assert_array_equal(none[0], lab)
    assert "strength is 0" in record.summary


def test_invalid_pixels_do_not_count() -> None:
    lab = slab((60, 5, 10), (4, 2, 3), 1)
    valid = np.ones(lab.shape[:2], np.bool_)
    valid[:20] = False
    spoilt = lab.copy()
    spoilt[:20] = 1000.0
    target = SlabColour((50.0, 0.0, 0.0))
    clean, _ = match_slabs([lab], [valid], target)
    other, _ = match_slabs([spoilt], [valid], target)
    assert_array_equal(clean[0][valid], other[0][valid])


@given(st.floats(0, 100), st.floats(-60, 60), st.floats(0.0, 30.0), st.floats(0.0, 1.0))
@settings(max_examples=30, deadline=None)
def test_lightness_stays_possible(mean_l: float, mean_b: float, spread: float, strength: float) -> None:
    lab = slab((50, 0, 0), (10, 3, 3), 5)
    target = SlabColour((mean_l, 0.0, mean_b), (spread, spread, spread))
    out, _ = match_slabs([lab], masks([lab]), target, MatchOptions(strength=strength))
    assert np.isfinite(out[0]).all()
    assert out[0][..., 0].min() >= 0.0
    assert out[0][..., 0].max() <= 100.0


def test_refuses_misuse() -> None:
    lab = slab((60, 5, 10), (4, 2, 3), 1)
    valid = masks([lab])[0]
    with pytest.raises(ValueError, match="at least one"):
        match_slabs([], [])
    with pytest.raises(ValueError, match="masks"):
        match_slabs([lab], [])
    with pytest.raises(ValueError, match="strength"):
        match_slabs([lab], [valid], None, MatchOptions(strength=1.5))
    with pytest.raises(ValueError, match="limits"):
        match_slabs([lab], [valid], None, MatchOptions(min_gain=1.2))
    with pytest.raises(ValueError, match="target"):
        match_slabs([lab], [valid], SlabColour((float("nan"), 0.0, 0.0)))
    with pytest.raises(ValueError, match="no pixel"):
        match_slabs([lab], [~valid])
