r"""The tree of histories of a known schedule, compiled and walked depth first.

A history is worked on as the unnormalised vector
:math:`w_k(s, i) = g^k P(\text{history}, s_k = s, \text{draw} = i)`. It moves by

.. math:: w_{k+1}(s', i) = g \sum_s w_k(s, i)\, O_i(o \mid s, a)\, T_i(s' \mid s, a)

and what a plan is still worth is linear in it, so a history costs one addition to its parent and nothing is
approximated. Draws (models that may be true, weighted) share the robot's actions and nothing else: the vector of a
single model is the case of one draw, and with many the recursion is the Bayes-adaptive optimum, in which the robot
learns which draw it faces. Draws are the last index, so that the innermost loops run over neighbours in memory.

One vector a level is held. The last events are not walked: below `leaf` every plan is a vector of its own
(`models.planning.tail_plans`), and the best one is found by scalar products.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class TreeTables(NamedTuple):
    r"""What the walk needs of models and schedule.

    Attributes
    ----------
    start : float64[s, d]
        :math:`P(s_0 = s, \text{draw})`.
    transition : float64[a, s, s', d]
        Times the discount.
    emission : float64[e, s, o, d]
    emission_row : int64[a]
        -1 for actions that show no response.
    reward : float64[s, d, a]
    first, actions, outcomes : int64[k]
        The event's first action, how many actions it offers, how many responses it may show (1: nothing).
    """

    start: Array
    transition: Array
    emission: Array
    emission_row: Index
    reward: Array
    first: Index
    actions: Index
    outcomes: Index


@kernel
def move(tables: TreeTables, w: Array, action: int, response: int, out: Array, scratch: Array) -> float:
    """One round: `out` becomes the vector after an action and a response (-1: none, or not recorded); its sum."""
    states, draws = w.shape
    row = tables.emission_row[action]
    out[:] = 0.0
    for s in range(states):
        if row >= 0 and response >= 0:
            for d in range(draws):
                scratch[d] = w[s, d] * tables.emission[row, s, response, d]
        else:
            for d in range(draws):
                scratch[d] = w[s, d]
        for after in range(states):
            for d in range(draws):
                out[after, d] += scratch[d] * tables.transition[action, s, after, d]
    total = 0.0
    for s in range(states):
        for d in range(draws):
            total += out[s, d]
    return total


@kernel
def products(w: Array, vectors: Array, out: Array) -> None:
    """Scalar products of `w` with vectors ``[s, d, j]``, all at once."""
    out[:] = 0.0
    states, draws = w.shape
    n = vectors.shape[2]
    for s in range(states):
        for d in range(draws):
            weight = w[s, d]
            for j in range(n):
                out[j] += weight * vectors[s, d, j]


@kernel
def walk_tree(
    tables: TreeTables, leaf: int, leaf_vectors: Array, n_plans: int, offset: Index, decision: NDArray[np.int8],
    tail: NDArray[np.int16], first_values: Array,
) -> float:  # fmt: skip
    r"""Best expected reward from the first event on; what to do after every history.

    Histories of event `k` are numbered :math:`h_{k+1} = (h_k A_k + a) O_k + o`.

    Parameters
    ----------
    tables : TreeTables
    leaf : int
        Event at which the walk stops.
    leaf_vectors : float64[s, d, j]
        First the reward of each action of event `leaf`; then, for each action, response and plan of the events
        after it (in this order), what following that plan is worth.
    n_plans : int
    offset : int64[leaf + 1]
        Where the histories of each event begin in `decision`.
    decision : int8[.]
        Filled: the best action after each history, counted within its event; lowest of equals. 0 where the history
        is impossible.
    tail : int16[h, o]
        Filled: for each history of event `leaf` and each response, the plan that follows the best action.
    first_values : float64[a]
        Filled: value of each action at the first event.
    """
    states, draws = tables.start.shape
    w = np.zeros((leaf + 1, states, draws))
    w[0] = tables.start
    scratch = np.empty(draws)
    rewards = np.empty((leaf + 1, tables.reward.shape[2]))
    dots = np.empty(leaf_vectors.shape[2])
    history = np.zeros(leaf + 1, dtype=np.int64)
    action = np.zeros(leaf + 1, dtype=np.int64)
    outcome = np.zeros(leaf + 1, dtype=np.int64)
    total = np.zeros(leaf + 1)
    best = np.zeros(leaf + 1)
    chosen = np.zeros(leaf + 1, dtype=np.int64)
    picked = np.zeros(tail.shape[1], dtype=np.int16)
    k = 0
    while True:
        if k < leaf:
            products(w[k], tables.reward, rewards[k])
            action[k] = 0
            outcome[k] = -1
            best[k] = -np.inf
            total[k] = rewards[k, tables.first[k]]
        else:
            products(w[k], leaf_vectors, dots)
            value = -np.inf
            for a in range(tables.actions[k]):
                worth = dots[a]
                for o in range(tables.outcomes[k]):
                    begin = tables.actions[k] + (a * tables.outcomes[k] + o) * n_plans
                    top = begin
                    for j in range(begin + 1, begin + n_plans):
                        if dots[j] > dots[top]:
                            top = j
                    worth += dots[top]
                    picked[o] = top - begin
                if k == 0:
                    first_values[a] = worth
                if worth > value:
                    value = worth
                    decision[offset[k] + history[k]] = a
                    for o in range(tables.outcomes[k]):
                        tail[history[k], o] = picked[o]
            k -= 1
            if k < 0:
                return value
            total[k] += value
        # On to the next response that can come, the next action after the last response, or back to the parent.
        while True:
            outcome[k] += 1
            if outcome[k] < tables.outcomes[k]:
                a = tables.first[k] + action[k]
                if move(tables, w[k], a, outcome[k], w[k + 1], scratch) > 0.0:
                    history[k + 1] = (history[k] * tables.actions[k] + action[k]) * tables.outcomes[k] + outcome[k]
                    k += 1
                    break
                continue
            if k == 0:
                first_values[action[k]] = total[k]
            if total[k] > best[k]:
                best[k] = total[k]
                chosen[k] = action[k]
            action[k] += 1
            if action[k] < tables.actions[k]:
                outcome[k] = -1
                total[k] = rewards[k, tables.first[k] + action[k]]
                continue
            decision[offset[k] + history[k]] = chosen[k]
            value = best[k]
            k -= 1
            if k < 0:
                return value
            total[k] += value


@kernel
def history_sums(tables: TreeTables, leaf: int, leaf_vectors: Array, begin: Index, totals: Array) -> None:
    """What every choice after every history adds, summed over draws: linear, so that draws may come in portions.

    Parameters
    ----------
    tables, leaf, leaf_vectors
        As in `walk_tree`.
    begin : int64[leaf + 1]
        Where the entries of each event begin in `totals`: history by history, then one an action, or one a leaf
        vector at event `leaf`.
    totals : float64[.]
        Filled; zero where a history is impossible.
    """
    states, draws = tables.start.shape
    w = np.zeros((leaf + 1, states, draws))
    w[0] = tables.start
    scratch = np.empty(draws)
    rewards = np.empty(tables.reward.shape[2])
    dots = np.empty(leaf_vectors.shape[2])
    history = np.zeros(leaf + 1, dtype=np.int64)
    step = np.full(leaf + 1, -1)
    totals[:] = 0.0
    k = 0
    while k >= 0:
        if k == leaf:
            products(w[k], leaf_vectors, dots)
            at = begin[k] + history[k] * len(dots)
            totals[at : at + len(dots)] = dots
            k -= 1
            continue
        n = tables.actions[k]
        if step[k] < 0:
            products(w[k], tables.reward, rewards)
            at = begin[k] + history[k] * n
            for a in range(n):
                totals[at + a] = rewards[tables.first[k] + a]
        step[k] += 1
        if step[k] == n * tables.outcomes[k]:
            step[k] = -1
            k -= 1
            continue
        action = tables.first[k] + step[k] // tables.outcomes[k]
        if move(tables, w[k], action, step[k] % tables.outcomes[k], w[k + 1], scratch) > 0.0:
            history[k + 1] = history[k] * n * tables.outcomes[k] + step[k]
            k += 1
