"""The filter: what textbooks say of it, whatever form the evidence comes in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.control.drift_filter import Estimate, Reading, aged_estimate, judge, reading_of


def evidence(seed: int, size: int, rank: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Readings (rank, size), what they read, information, vector and where; noise 1."""
    random = np.random.default_rng(seed)
    lean, value, at = random.normal(size=(rank, size)), random.normal(size=rank), random.normal(size=size)
    return lean, value, lean.T @ lean, lean.T @ (value - lean @ at), at


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10_000), size=st.integers(1, 6), rank=st.integers(1, 8))
def test_evidence_is_learnt_as_the_readings_it_was_made_of(seed: int, size: int, rank: int) -> None:
    lean, value, information, vector, at = evidence(seed, size, rank)
    random = np.random.default_rng(seed + 1)
    root = np.tril(random.normal(size=(size, size)))
    root[np.diag_indices(size)] = random.uniform(0.5, 2.0, size)
    prior = root @ root.T
    start = Estimate(np.append(random.normal(size=size), 0.1), np.zeros((size + 1, size + 1)))
    start.covariance[:-1, :-1] = prior
    start.covariance[-1, -1] = 0.04
    applied = random.normal(size=size)
    reading = reading_of(information, vector, at, root)
    assert len(reading.value) <= min(rank, size)
    _, learnt = judge(start, reading, applied, 1.0, None)
    # Bayes, in one go.
    whole = np.column_stack([lean, lean @ applied])
    precision = np.linalg.inv(start.covariance) + whole.T @ whole
    covariance = np.linalg.inv(precision)
    mean = start.mean + covariance @ whole.T @ (value - whole @ start.mean)
    np.testing.assert_allclose(learnt.covariance, covariance, atol=0.02 * np.abs(start.covariance).max())
    np.testing.assert_allclose(learnt.mean, mean, atol=0.1)


def test_a_scalar_filter_settles_at_the_solution_of_riccatis_equation() -> None:
    noise, wander = 0.09, 0.0045
    estimate = Estimate(np.zeros(2), np.diag([9.0, 0.0]))
    reading = Reading(np.zeros(1), np.array([[1.0]]))
    for _ in range(300):
        share = -np.log1p(-wander / 9.0)
        estimate = aged_estimate(estimate, np.array([[9.0]]), share, 1.0, 0.0)
        _, estimate = judge(estimate, reading, np.zeros(1), noise, None)
    predicted = 0.5 * (wander + np.sqrt(wander**2 + 4.0 * wander * noise))
    assert estimate.covariance[0, 0] == pytest.approx(predicted * noise / (predicted + noise), rel=0.005)


def test_ageing_ends_at_a_fresh_state() -> None:
    prior = np.array([[4.0, 1.0], [1.0, 2.0]])
    estimate = Estimate(np.array([3.0, -2.0, 0.3]), 0.01 * np.eye(3))
    old = aged_estimate(estimate, prior, 60.0, 1.0, 0.02)
    np.testing.assert_allclose(old.mean, [0.0, 0.0, 0.3], atol=1e-9)
    np.testing.assert_allclose(old.covariance[:2, :2], prior, rtol=1e-9)
    assert old.covariance[2, 2] == pytest.approx(0.03)
    same = aged_estimate(estimate, prior, 0.0, 1.0, 0.0)
    np.testing.assert_array_equal(same.covariance, estimate.covariance)
    half = aged_estimate(aged_estimate(estimate, prior, 0.3, 1.0, 0.01), prior, 0.3, 1.0, 0.01)
    whole = aged_estimate(estimate, prior, 0.6, 1.0, 0.02)
    np.testing.assert_allclose(half.covariance, whole.covariance, rtol=1e-12)


def test_surprise_is_about_standard_normal() -> None:
    random = np.random.default_rng(3)
    for size in (1, 4, 12):
        estimate = Estimate(np.zeros(size + 1), np.eye(size + 1) * 0.5)
        estimate.covariance[-1, -1] = 0.0
        found = []
        for _ in range(2000):
            value = random.normal(0.0, np.sqrt(1.5), size)
            surprise, _ = judge(estimate, Reading(value, np.eye(size)), np.zeros(size), 1.0, None)
            found.append(surprise.standard)
        assert np.mean(found) == pytest.approx(0.0, abs=0.1)
        assert np.std(found) == pytest.approx(1.0, abs=0.1)


def test_a_press_that_answers_otherwise_is_found_out() -> None:
    random, excess = np.random.default_rng(4), 0.3
    estimate = Estimate(np.zeros(2), np.diag([9.0, 0.04]))
    for number in range(200):
        applied = np.array([2.0 * (number // 10 % 2)])
        value = 1.0 + excess * applied + random.normal(0.0, 0.3, 1)
        _, estimate = judge(estimate, Reading(value / 0.3, np.array([[1.0 / 0.3]])), applied, 1.0, None)
    assert estimate.mean[1] == pytest.approx(excess, abs=0.05)
    assert estimate.mean[0] == pytest.approx(1.0, abs=0.1)


def test_a_late_tile_teaches_less() -> None:
    estimate = Estimate(np.zeros(2), np.diag([1.0, 0.0]))
    reading = Reading(np.ones(1), np.eye(1))
    _, now = judge(estimate, reading, np.zeros(1), 1.0, None)
    _, late = judge(estimate, reading, np.zeros(1), 1.0, 2.0 * np.eye(1))
    assert now.mean[0] == pytest.approx(0.5)
    assert late.mean[0] == pytest.approx(0.25)


def test_evidence_that_says_nothing_teaches_nothing() -> None:
    estimate = Estimate(np.zeros(3), np.eye(3))
    reading = reading_of(np.zeros((2, 2)), np.zeros(2), np.zeros(2), np.eye(2))
    surprise, same = judge(estimate, reading, np.zeros(2), 1.0, None)
    assert same is estimate
    assert surprise.standard == 0.0
