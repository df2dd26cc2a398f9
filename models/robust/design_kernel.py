"""How probable every history of a design is in every draw, compiled."""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.history_kernel import Array, Index, TreeTables, move


@kernel
def history_chances(tables: TreeTables, choice: Index, chance: Array, out: Array) -> None:
    r"""Walk the histories of an arm that ends with a response.

    Histories are numbered by their first event, then their second, and so on: by action, and within it by response.

    Parameters
    ----------
    tables : TreeTables
        Started from :math:`P(s_0 = s \mid \text{draw})`. Here ``actions`` says how many actions each event may see;
        rewards and first actions are not used.
    choice : int64[k, c]
        Those actions.
    chance : float64[k, c]
        Probability of each.
    out : float64[h, d]
        Filled.
    """
    states, draws = tables.start.shape
    last = len(tables.actions) - 1
    w = np.zeros((last + 1, states, draws))
    w[0] = tables.start
    scratch = np.empty(draws)
    step = np.zeros(last + 1, dtype=np.int64)
    step[:] = -1
    h = 0
    k = 0
    while k >= 0:
        if k == last:
            for c in range(tables.actions[k]):
                row = tables.emission_row[choice[k, c]]
                for o in range(tables.outcomes[k]):
                    for d in range(draws):
                        out[h, d] = 0.0
                    for s in range(states):
                        for d in range(draws):
                            out[h, d] += w[k, s, d] * tables.emission[row, s, o, d] * chance[k, c]
                    h += 1
            k -= 1
            continue
        step[k] += 1
        if step[k] == tables.actions[k] * tables.outcomes[k]:
            step[k] = -1
            k -= 1
            continue
        c = step[k] // tables.outcomes[k]
        move(tables, w[k], choice[k, c], step[k] % tables.outcomes[k], w[k + 1], scratch)
        for s in range(states):
            for d in range(draws):
                w[k + 1, s, d] *= chance[k, c]
        k += 1
