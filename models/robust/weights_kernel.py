"""What every choice after every history is worth, draw by draw, compiled.

The vector of a history is linear in the weights of the draws, and so is what each choice adds to a plan's worth.
With the weights left out, one walk gives these numbers for every draw; they are then multiplied with as many
weights as wanted.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.history_kernel import Array, Index, TreeTables, move


@kernel
def history_rows(tables: TreeTables, leaf: int, leaf_vectors: Array, begin: Index, rows: Array) -> None:
    r"""Walk all histories up to `leaf` once.

    Parameters
    ----------
    tables : TreeTables
        Started from :math:`P(s_0 = s \mid \text{draw})`, without weights.
    leaf : int
        Event at which the walk stops.
    leaf_vectors : float64[s, j, d]
        As in `models.planning.history_kernel.walk_tree`, draws last.
    begin : int64[leaf + 1]
        Where the rows of each event begin: history by history, choice by choice.
    rows : float64[., d]
        Filled, and zero before: expected reward of the choice there, times the probability of the history; at event
        `leaf` the product with each of `leaf_vectors`.
    """
    states, draws = tables.start.shape
    w = np.zeros((leaf + 1, states, draws))
    w[0] = tables.start
    scratch = np.empty(draws)
    history = np.zeros(leaf + 1, dtype=np.int64)
    step = np.zeros(leaf + 1, dtype=np.int64)
    step[:] = -1
    plans = leaf_vectors.shape[1]
    k = 0
    while k >= 0:
        if k == leaf:
            at = begin[k] + history[k] * plans
            for s in range(states):
                for j in range(plans):
                    for d in range(draws):
                        rows[at + j, d] += w[k, s, d] * leaf_vectors[s, j, d]
            k -= 1
            continue
        if step[k] < 0:
            at = begin[k] + history[k] * tables.actions[k]
            for a in range(tables.actions[k]):
                for s in range(states):
                    for d in range(draws):
                        rows[at + a, d] += w[k, s, d] * tables.reward[s, d, tables.first[k] + a]
        step[k] += 1
        if step[k] == tables.actions[k] * tables.outcomes[k]:
            step[k] = -1
            k -= 1
            continue
        action = tables.first[k] + step[k] // tables.outcomes[k]
        if move(tables, w[k], action, step[k] % tables.outcomes[k], w[k + 1], scratch) > 0.0:
            history[k + 1] = history[k] * tables.actions[k] * tables.outcomes[k] + step[k]
            k += 1
