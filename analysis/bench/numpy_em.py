"""Baum-Welch as one writes it in plain numpy, without a compiler: all people at once, a loop over rounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def em_step(
    action: NDArray[np.int64],
    response: NDArray[np.int64],
    initial: Array,
    transition: Array,
    emission: Array,
    emission_index: NDArray[np.int64],
) -> tuple[float, Array, Array, Array]:
    """One iteration for runs of equal length; `action`, `response` have shape ``[people, rounds]``."""
    people, rounds = action.shape
    states = len(initial)
    evidence = np.ones((people, rounds, states))
    seen = response >= 0
    evidence[seen] = emission[emission_index[action[seen]], :, response[seen]]
    alpha = np.empty((people, rounds, states))
    scale = np.empty((people, rounds))
    belief = np.broadcast_to(initial, (people, states))
    for k in range(rounds):
        weighted = belief * evidence[:, k]
        scale[:, k] = weighted.sum(axis=1)
        alpha[:, k] = weighted / scale[:, k, None]
        belief = np.einsum("ps,pst->pt", alpha[:, k], transition[action[:, k]])
    beta = np.ones((people, states))
    gamma = np.empty((people, rounds, states))
    gamma[:, -1] = alpha[:, -1]
    moved = np.zeros_like(transition)
    for k in range(rounds - 2, -1, -1):
        ahead = evidence[:, k + 1] * beta / scale[:, k + 1, None]
        xi = alpha[:, k, :, None] * transition[action[:, k]] * ahead[:, None, :]
        np.add.at(moved, action[:, k], xi)
        beta = np.einsum("pst,pt->ps", transition[action[:, k]], ahead)
        gamma[:, k] = alpha[:, k] * beta
    shown = np.zeros_like(emission)
    np.add.at(shown.transpose(0, 2, 1), (emission_index[action[seen]], response[seen]), gamma[seen])
    start = gamma[:, 0].sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        transition = np.where(moved.sum(-1, keepdims=True) > 0, moved / moved.sum(-1, keepdims=True), transition)
        emission = np.where(shown.sum(-1, keepdims=True) > 0, shown / shown.sum(-1, keepdims=True), emission)
    return float(np.log(scale).sum()), start / start.sum(), transition, emission
