"""One order of the states for every estimate, draw, plan and plot.

The likelihood does not change when states are permuted. The canonical order is by increasing expected
response score, averaged over the response-showing actions with weights fixed for the data set: how many
responses were recorded under each, so an arm never observed cannot decide the order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from models.errors import located

Array = NDArray[np.float64]


def expected_score(emission: Array, scores: Sequence[float], weights: Array | None = None) -> Array:
    """Expected response score of each state.

    Parameters
    ----------
    emission : float64[..., e, s, o]
    scores : sequence of float
        Score of each response.
    weights : float64[e], optional
        Responses recorded under each response-showing action; equal if not given or all zero.

    Returns
    -------
    float64[..., s]
    """
    by_action = emission @ np.asarray(scores, dtype=np.float64)
    n = by_action.shape[-2]
    if weights is None or not np.any(weights):
        share = np.full(n, 1.0 / n)
    else:
        share = np.asarray(weights, dtype=np.float64)
        if share.shape != (n,) or np.any(share < 0):
            raise located("label weights", share.tolist(), f"{n} non-negative numbers")
        share = share / share.sum()
    return np.einsum("...es,e->...s", by_action, share)


def canonical_order(emission: Array, scores: Sequence[float], weights: Array | None = None) -> NDArray[np.int64]:
    """Permutation that puts states in canonical order; ties keep their order. Shape ``[..., s]``.

    Examples
    --------
    >>> emission = np.array([[[0.1, 0.9], [0.8, 0.2]]])
    >>> canonical_order(emission, (0, 1))
    array([1, 0])
    """
    return np.argsort(expected_score(emission, scores, weights), axis=-1, kind="stable")


def permute(
    order: NDArray[np.int64], initial: Array, transition: Array, emission: Array
) -> tuple[Array, Array, Array]:
    """Permute the states of ``initial[s]``, ``transition[a, s, s']``, ``emission[e, s, o]``."""
    return (
        np.ascontiguousarray(initial[order]),
        np.ascontiguousarray(transition[:, order][:, :, order]),
        np.ascontiguousarray(emission[:, order]),
    )


def stationary_distribution(table: Array) -> Array:
    """Stationary probabilities of a transition matrix ``[s, s']``, or of many, ``[..., s, s']``.

    Where several exist (a reducible chain, such as a table pinned to the identity) this is the limit of the
    time average from a uniform start.
    """
    n = table.shape[-1]
    lazy = 0.5 * (table + np.eye(n))
    for _ in range(60):  # squaring reaches step 2**60: the limit to rounding
        lazy = lazy @ lazy
        lazy /= lazy.sum(axis=-1, keepdims=True)
    return np.full(n, 1.0 / n) @ lazy


def stationary_is_unique(table: Array) -> bool:
    """Whether a transition matrix ``[s, s']`` has one stationary distribution: one eigenvalue within 1e-6 of 1.

    Examples
    --------
    >>> stationary_is_unique(np.array([[0.9, 0.1], [0.3, 0.7]])), stationary_is_unique(np.eye(2))
    (True, False)
    """
    return int(np.sum(np.abs(np.linalg.eigvals(table) - 1.0) < 1e-6)) == 1


def dwell_time(table: Array) -> Array:
    """Expected rounds spent in each state before leaving, 1 / (1 - T[s, s]); infinite where never left."""
    leave = 1.0 - np.diag(table)
    with np.errstate(divide="ignore"):
        return np.where(leave > 0, 1.0 / leave, np.inf)
