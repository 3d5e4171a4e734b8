"""Agreement with people, on people made up here."""

from __future__ import annotations

import doctest
from itertools import combinations

import numpy as np
import pytest

from tilefab.texture import study as module
from tilefab.texture.study import (
    Pair,
    agreement,
    agreement_with_one,
    chosen_left_out_scores,
    fit_weights,
    left_out_scores,
    one_person,
)

METHODS = "abcd"


def people(textures: int, weights: list[float], seed: int) -> tuple[dict, list[Pair]]:
    """Images with random measures, and people who prefer by a sum of them."""
    random = np.random.default_rng(seed)
    names = [f"texture {k}" for k in range(textures)]
    values = {(name, method): random.normal(size=len(weights)) for name in names for method in METHODS}
    pairs = []
    for name in names:
        for first, second in combinations(METHODS, 2):
            better = float((values[name, second] - values[name, first]) @ np.array(weights))
            pairs.append(Pair(name, first, second, 1 / (1 + np.exp(-better))))
    return values, pairs


def test_agreement_counts_pairs_ordered_as_by_most() -> None:
    pairs = [Pair("t", "a", "b", 0.9), Pair("t", "a", "c", 0.2), Pair("t", "b", "c", 0.6)]
    scores = {("t", "a"): 1.0, ("t", "b"): 2.0, ("t", "c"): 2.0}
    # a before b, as people say; a before c, as they don't; b and c alike.
    assert agreement(scores, pairs) == pytest.approx((1 + 0 + 0.5) / 3)
    assert agreement_with_one(scores, pairs) == pytest.approx((0.9 + 0.2 + 0.5) / 3)
    assert one_person(pairs) == pytest.approx((0.9 + 0.8 + 0.6) / 3)


def test_weights_are_those_by_which_people_prefer() -> None:
    values, pairs = people(30, [1.0, 0.0, 2.0], 1)
    weights = fit_weights(values, pairs)
    assert weights[2] / weights[0] == pytest.approx(2, rel=0.15)
    assert weights[1] == pytest.approx(0, abs=0.05)


def test_a_measure_that_misleads_gets_no_weight() -> None:
    values, pairs = people(20, [1.0, -1.0], 2)
    assert fit_weights(values, pairs)[1] == 0


def test_left_out_scores_dont_know_what_they_are_judged_by() -> None:
    values, pairs = people(8, [1.0, 1.0], 3)
    scores = left_out_scores(values, pairs)
    assert agreement(scores, pairs) > 0.9
    # Other answers about a texture change nothing of its own scores.
    turned = [Pair(p.texture, p.first, p.second, 1 - p.prefer_first) if p.texture == "texture 3" else p for p in pairs]
    again = left_out_scores(values, turned)
    assert all(again["texture 3", method] == scores["texture 3", method] for method in METHODS)
    assert any(again["texture 1", method] != scores["texture 1", method] for method in METHODS)


def test_noise_fitted_to_few_people_agrees_with_them_but_not_with_others() -> None:
    fitted, left_out = [], []
    for seed in range(12):
        _, pairs = people(7, [1.0], seed)
        random = np.random.default_rng(100 + seed)
        noise = {
            (name, method): random.normal(size=8)
            for name in dict.fromkeys(p.texture for p in pairs)
            for method in METHODS
        }
        weights = fit_weights(noise, pairs)
        fitted.append(agreement({image: float(values @ weights) for image, values in noise.items()}, pairs))
        left_out.append(agreement(left_out_scores(noise, pairs), pairs))
    assert np.mean(fitted) > np.mean(left_out) + 0.08
    assert np.mean(left_out) < 0.58


def test_the_set_that_tells_most_is_chosen() -> None:
    good, pairs = people(7, [1.0, 1.0], 6)
    random = np.random.default_rng(7)
    bad = {image: random.normal(size=2) for image in good}
    assert chosen_left_out_scores([bad, good], pairs) == left_out_scores(good, pairs)


def test_without_pairs_there_is_nothing_to_tell() -> None:
    for function in (one_person, lambda pairs: agreement({}, pairs), lambda pairs: fit_weights({}, pairs)):
        with pytest.raises(ValueError, match="pairs"):
            function([])
    with pytest.raises(ValueError, match="choose"):
        chosen_left_out_scores([], [])


def test_example_in_the_docstring_holds() -> None:
    failed, tried = doctest.testmod(module)
    assert (failed, tried > 0) == (0, True)
