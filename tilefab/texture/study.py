"""How well measures of quality agree with people who ranked images, and combinations of measures fitted to them.

A combination is only worth what it orders right of textures that it wasn't fitted to: each is left out in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

Image: TypeAlias = tuple[str, str]
"""Texture and method."""
Values: TypeAlias = Mapping[Image, NDArray[np.float64]]
"""Measures of images, (measures,), as they are to be added up with weights; less is better."""

_RIDGE = 0.01


@dataclass(frozen=True)
class Pair:
    """Two images of a texture that people compared.

    Attributes
    ----------
    texture, first, second
        Which.
    prefer_first
        Share of people who rank the first better, 0 to 1.
    """

    texture: str
    first: str
    second: str
    prefer_first: float


def agreement(scores: Mapping[Image, float], pairs: Sequence[Pair]) -> float:
    """Share of pairs that scores order as most people do, less being better; a tie counts half.

    Raises
    ------
    ValueError
        If there are no pairs.
    """
    return _mean([_right(scores, pair) for pair in pairs])


def agreement_with_one(scores: Mapping[Image, float], pairs: Sequence[Pair]) -> float:
    """Share of pairs and people on which scores and the person agree: what a score would get from single people.

    Raises
    ------
    ValueError
        If there are no pairs.
    """
    return _mean([_liked(scores, pair) for pair in pairs])


def one_person(pairs: Sequence[Pair]) -> float:
    """Share of pairs that one person orders as most people do.

    Raises
    ------
    ValueError
        If there are no pairs.

    Examples
    --------
    >>> one_person([Pair("marble", "a", "b", 0.75), Pair("marble", "a", "c", 0.25)])
    0.75
    """
    return _mean([max(pair.prefer_first, 1 - pair.prefer_first) for pair in pairs])


def fit_weights(values: Values, pairs: Sequence[Pair]) -> NDArray[np.float64]:
    """Weights, none negative, with which the sum of measures predicts best what people prefer.

    Parameters
    ----------
    values
        Measures of every image of the pairs.
    pairs
        What people said.

    Returns
    -------
    ndarray
        (measures,). Logistic regression on differences (Bradley and Terry 1952, "Rank analysis of incomplete block
        designs", with measures for abilities), held small by a ridge over measures scaled to one spread.

    Raises
    ------
    ValueError
        If there are no pairs.
    """
    if not pairs:
        raise ValueError("weights need pairs to be fitted to")
    differences = np.array(
        [values[pair.texture, pair.second] - values[pair.texture, pair.first] for pair in pairs], dtype=np.float64
    )
    preferred = np.array([pair.prefer_first for pair in pairs])
    spread = np.maximum(np.sqrt(np.mean(differences**2, axis=0)), 1e-9)
    scaled = differences / spread

    def loss(weights: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        better = scaled @ weights
        value = np.mean(np.logaddexp(0, better) - preferred * better) + _RIDGE * float(weights @ weights)
        slope = scaled.T @ (1 / (1 + np.exp(-better)) - preferred) / len(preferred) + 2 * _RIDGE * weights
        return float(value), slope

    start = np.full(scaled.shape[1], 0.1)
    found = optimize.minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(0, None)] * len(start))
    return np.asarray(found.x / spread, dtype=np.float64)


def left_out_scores(values: Values, pairs: Sequence[Pair]) -> dict[Image, float]:
    """Scores of images by weights that were fitted to the pairs of all other textures.

    Raises
    ------
    ValueError
        If there are pairs of fewer than two textures.
    """
    return _left_out(pairs, lambda others: (values, fit_weights(values, others)))


def chosen_left_out_scores(choices: Sequence[Values], pairs: Sequence[Pair]) -> dict[Image, float]:
    """As `left_out_scores`, with the set of measures chosen anew for each texture left out, by the others alone.

    Of several sets, the one is taken that agrees with the most people when each of the other textures is left out in
    turn; of equal ones the first. So nothing of what is judged has been looked at.

    Raises
    ------
    ValueError
        If there are pairs of fewer than three textures, or no choices.
    """
    if not choices:
        raise ValueError("there is no set of measures to choose from")

    def fitted(others: Sequence[Pair]) -> tuple[Values, NDArray[np.float64]]:
        agreed = [agreement_with_one(left_out_scores(values, others), others) for values in choices]
        best = choices[int(np.argmax(agreed))]
        return best, fit_weights(best, others)

    return _left_out(pairs, fitted)


def _left_out(
    pairs: Sequence[Pair], fitted: Callable[[Sequence[Pair]], tuple[Values, NDArray[np.float64]]]
) -> dict[Image, float]:
    scores: dict[Image, float] = {}
    for texture in dict.fromkeys(pair.texture for pair in pairs):
        values, weights = fitted([pair for pair in pairs if pair.texture != texture])
        methods = {name for pair in pairs if pair.texture == texture for name in (pair.first, pair.second)}
        for method in sorted(methods):
            scores[texture, method] = float(values[texture, method] @ weights)
    return scores


def _right(scores: Mapping[Image, float], pair: Pair) -> float:
    better = scores[pair.texture, pair.second] - scores[pair.texture, pair.first]
    people = pair.prefer_first - 0.5
    return 0.5 if better == 0 or people == 0 else float((better > 0) == (people > 0))


def _liked(scores: Mapping[Image, float], pair: Pair) -> float:
    better = scores[pair.texture, pair.second] - scores[pair.texture, pair.first]
    return 0.5 if better == 0 else pair.prefer_first if better > 0 else 1 - pair.prefer_first


def _mean(values: list[float]) -> float:
    if not values:
        raise ValueError("there are no pairs to agree on")
    return float(np.mean(values))
