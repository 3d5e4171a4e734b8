"""Repeated patches: noise, and those that disagree."""

from __future__ import annotations

import numpy as np
import pytest

from tilefab.chart.repeats import check_repeats


def test_noise_and_the_odd_one_out() -> None:
    random = np.random.default_rng(8)
    ink = np.repeat(random.integers(0, 256, (40, 4)), 3, axis=0)
    lab = np.repeat(random.random((40, 3)) * [80, 20, 20] + [10, -10, -10], 3, axis=0)
    lab = lab + 0.2 * random.standard_normal(lab.shape)
    lab[31] += [6.0, 0.0, 0.0]
    check = check_repeats(ink, lab)
    assert check.groups == 40
    assert check.noise_delta_e == pytest.approx(0.25, abs=0.1)
    assert np.flatnonzero(check.disagree).tolist() == [31]


def test_nothing_repeated() -> None:
    check = check_repeats(np.arange(8).reshape(4, 2), np.full((4, 3), 50.0))
    assert check.groups == 0
    assert check.noise_delta_e is None
    assert np.isnan(check.delta_e).all()
    assert not check.disagree.any()
