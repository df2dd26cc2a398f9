r"""Plans in many models at once, compiled: what a plan is worth in every draw, and the best plan of each draw.

Both walk histories on the unnormalised vectors of `models.planning.history_kernel`, started from
:math:`P(s_0 = s \mid \text{draw})` without the draws' weights, so that sums over states are values by draw.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.history_kernel import Array, Index, TreeTables, move


@kernel
def plan_values(tables: TreeTables, terminal: Array, level: Index, decision: NDArray[np.int8], out: Array) -> None:
    r"""Value of one plan in every draw.

    Parameters
    ----------
    tables : TreeTables
    terminal : float64[s]
        Worth of the state after the last event.
    level : int64[k]
        Where the responses of each event begin in `decision`.
    decision : int8[.]
        Action of each event (counted within it) by the number of the responses so far.
    out : float64[d]
        Filled.
    """
    states, draws = tables.start.shape
    events = len(level)
    w = np.zeros((events + 1, states, draws))
    w[0] = tables.start
    scratch = np.empty(draws)
    number = np.zeros(events + 1, dtype=np.int64)
    outcome = np.full(events + 1, -1)
    out[:] = 0.0
    k = 0
    while k >= 0:
        if k == events:
            # The vector carries the discount of all events already.
            for s in range(states):
                if terminal[s] != 0.0:
                    for d in range(draws):
                        out[d] += terminal[s] * w[k, s, d]
            k -= 1
            continue
        a = tables.first[k] + decision[level[k] + number[k]]
        if outcome[k] < 0:
            for s in range(states):
                for d in range(draws):
                    out[d] += w[k, s, d] * tables.reward[s, d, a]
        outcome[k] += 1
        if outcome[k] == tables.outcomes[k]:
            outcome[k] = -1
            k -= 1
            continue
        if move(tables, w[k], a, outcome[k], w[k + 1], scratch) > 0.0:
            number[k + 1] = number[k] * tables.outcomes[k] + outcome[k]
            k += 1


@kernel
def own_optima(
    tables: TreeTables, leaf: int, leaf_vectors: Array, n_plans: int, offset: Index, decision: NDArray[np.int8],
    tail: NDArray[np.int16], first_values: Array,
) -> None:  # fmt: skip
    r"""Best expected reward of every draw by itself, with what it does after every history.

    As `models.planning.history_kernel.walk_tree`, with the maximum taken draw by draw instead of over their sum.

    Parameters
    ----------
    tables, leaf, leaf_vectors, n_plans, offset
        As there.
    decision : int8[., d]
        Filled: the best action of each draw after each history, lowest of equals.
    tail : int16[h, o, d]
        Filled: plan that follows each response to the best action of event `leaf`.
    first_values : float64[a, d]
        Filled: value of each action at the first event.
    """
    states, draws = tables.start.shape
    most = 0
    for k in range(leaf + 1):
        most = max(most, tables.actions[k])
    w = np.zeros((leaf + 1, states, draws))
    w[0] = tables.start
    scratch = np.empty(draws)
    dots = np.empty(leaf_vectors.shape[2])
    history = np.zeros(leaf + 1, dtype=np.int64)
    action = np.zeros(leaf + 1, dtype=np.int64)
    outcome = np.full(leaf + 1, -1)
    q = np.zeros((leaf + 1, most, draws))
    best = np.zeros((leaf + 1, draws))
    picked = np.zeros(tail.shape[1], dtype=np.int16)
    k = 0
    while True:
        if k < leaf:
            action[k] = 0
            outcome[k] = -1
            for a in range(tables.actions[k]):
                for d in range(draws):
                    q[k, a, d] = 0.0
                for s in range(states):
                    for d in range(draws):
                        q[k, a, d] += w[k, s, d] * tables.reward[s, d, tables.first[k] + a]
        else:
            for d in range(draws):
                for j in range(len(dots)):
                    dots[j] = 0.0
                for s in range(states):
                    weight = w[k, s, d]
                    for j in range(len(dots)):
                        dots[j] += weight * leaf_vectors[s, d, j]
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
                        first_values[a, d] = worth
                    if worth > value:
                        value = worth
                        decision[offset[k] + history[k], d] = a
                        for o in range(tables.outcomes[k]):
                            tail[history[k], o, d] = picked[o]
                best[k, d] = value
            k -= 1
            if k < 0:
                return
            for d in range(draws):
                q[k, action[k], d] += best[k + 1, d]
        while True:
            outcome[k] += 1
            if outcome[k] < tables.outcomes[k]:
                if move(tables, w[k], tables.first[k] + action[k], outcome[k], w[k + 1], scratch) > 0.0:
                    history[k + 1] = (history[k] * tables.actions[k] + action[k]) * tables.outcomes[k] + outcome[k]
                    k += 1
                    break
                continue
            action[k] += 1
            outcome[k] = -1
            if action[k] < tables.actions[k]:
                continue
            for d in range(draws):
                chosen = 0
                for a in range(1, tables.actions[k]):
                    if q[k, a, d] > q[k, chosen, d]:
                        chosen = a
                best[k, d] = q[k, chosen, d]
                decision[offset[k] + history[k], d] = chosen
            if k == 0:
                for a in range(tables.actions[0]):
                    for d in range(draws):
                        first_values[a, d] = q[0, a, d]
                return
            k -= 1
            for d in range(draws):
                q[k, action[k], d] += best[k + 1, d]
