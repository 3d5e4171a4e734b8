"""Nodes of a table moved so that what a reader interpolates between them is right, not only what stands on them.

A table sampled from a curved function is exact at its nodes and errs to one side between them; at the edge of a gamut
the nodes beyond it pull inside cells astray. Nodes that fit many places of their cells best, in the least squares,
halve the one and mend most of the other.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import lsmr

Float64Array = NDArray[np.float64]

_STEPS = 20


def multilinear_weights(place: Float64Array, shape: tuple[int, ...]) -> csr_matrix:
    """Weights (S, nodes) of a grid's nodes, in C order, at places (S, I) counted in nodes, as readers interpolate."""
    counts = np.array(shape)
    cell = np.clip(np.floor(place).astype(np.int64), 0, counts - 2)
    fraction = np.clip(place - cell, 0.0, 1.0)
    strides = np.array([int(np.prod(counts[axis + 1 :])) for axis in range(len(counts))])
    base = cell @ strides
    columns, weights = [], []
    for corner in itertools.product((0, 1), repeat=len(counts)):
        up = np.array(corner)
        columns.append(base + strides @ up)
        weights.append(np.prod(np.where(up == 1, fraction, 1.0 - fraction), axis=1))
    rows = np.tile(np.arange(len(place)), len(columns))
    return csr_matrix(
        (np.concatenate(weights), (rows, np.concatenate(columns))), shape=(len(place), int(np.prod(counts)))
    )


def fit_nodes(
    grid: Float64Array, weights: csr_matrix, values: Float64Array, importance: Float64Array, *, stiffness: float
) -> Float64Array:
    """Move a grid's nodes towards wanted values between them.

    Parameters
    ----------
    grid
        (..., O): the nodes as they are.
    weights
        (S, nodes) from `multilinear_weights`.
    values
        (S, O) wanted there.
    importance
        (S,) weight of each place's error.
    stiffness
        Weight of moving a node, against errors of unit importance.

    Returns
    -------
    numpy.ndarray
        (..., O) the moved nodes.
    """
    flat = grid.reshape(-1, grid.shape[-1])
    scale = np.sqrt(importance)
    scaled = csr_matrix(weights.multiply(scale[:, np.newaxis]))
    missed = (values - weights @ flat) * scale[:, np.newaxis]
    moved = flat.copy()
    for channel in range(flat.shape[1]):
        moved[:, channel] += lsmr(scaled, missed[:, channel], damp=stiffness, atol=1e-6, btol=1e-6, maxiter=_STEPS)[0]
    return moved.reshape(grid.shape)
