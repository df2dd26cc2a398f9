"""Sums over the histories that a budget can pay for: what every action adds after each, compiled.

Everything is a sum over draws, so portions of draws may be walked one by one and their sums added up. What to do
follows from the sums (`models.planning.budget_tree`), for every amount left and every price of spending at once.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.history_kernel import Array, Index, TreeTables, move, products


@kernel
def history_rewards(
    tables: TreeTables, reward: Array, end: Array, child: Index, rewards: Array, mass: Array
) -> None:  # fmt: skip
    """Walk the histories depth first, and write down what each is worth to every action.

    Parameters
    ----------
    tables : TreeTables
    reward : float64[a, s]
        The same in all draws.
    end : float64[s, d, a]
        What each action of the last event is worth more, because of the state that it leads to; empty if nothing
        is.
    child : int64[h, z]
        History that follows each choice and response, z = choice * responses + response; -1 for those that are not
        followed.
    rewards : float64[h, c]
        Filled, zero beforehand: expected reward of each choice after each history, times the history's probability.
    mass : float64[h]
        Filled, zero beforehand: probability of each history.
    """
    states, draws = tables.start.shape
    events = len(tables.first)
    w = np.zeros((events, states, draws))
    w[0] = tables.start
    scratch = np.empty(draws)
    dots = np.empty(tables.reward.shape[2])
    history = np.zeros(events, dtype=np.int64)
    step = np.full(events, -1)
    k = 0
    while k >= 0:
        h, n = history[k], tables.actions[k]
        if step[k] < 0:
            for s in range(states):
                total = 0.0
                for d in range(draws):
                    total += w[k, s, d]
                mass[h] += total
                for c in range(n):
                    rewards[h, c] += total * reward[tables.first[k] + c, s]
            if k == events - 1 and end.size > 0:
                products(w[k], end, dots)
                for c in range(n):
                    rewards[h, c] += dots[tables.first[k] + c]
        step[k] += 1
        if k == events - 1 or step[k] == n * tables.outcomes[k]:
            step[k] = -1
            k -= 1
            continue
        after = child[h, step[k]]
        if after < 0:
            continue
        action = tables.first[k] + step[k] // tables.outcomes[k]
        if move(tables, w[k], action, step[k] % tables.outcomes[k], w[k + 1], scratch) > 0.0:
            history[k + 1] = after
            k += 1
