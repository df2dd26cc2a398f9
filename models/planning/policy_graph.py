r"""Alpha vectors by what follows them: an acyclic policy graph over product modes, and its values.

A vector's value follows from its action and from the vectors that take over after each response,

.. math:: \alpha(i, s) = R(s, a) + g \sum_o O_i(o \mid s, a) \sum_{s'} T_i(s' \mid s, a)\, \alpha_o(i, s')

so a file needs the graph and the models only, and cannot hold values that are not those of its plan.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.planning.draw_beliefs import DrawBeliefs
from models.planning.product_modes import OVER, ProductModes

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class PolicyGraph(NamedTuple):
    """Which vector follows which: choice of each, and the vector after each response (-1 beyond them).

    Vectors are numbered so that those that follow belong to product modes with larger numbers.
    """

    choice: Index
    follow: Index


def graph_vectors(
    beliefs: DrawBeliefs, product: ProductModes, mode: Index, graph: PolicyGraph, discount: float,
    terminal: Array | None, place: str = "policy graph",
) -> Array:  # fmt: skip
    """Values of the vectors of an acyclic policy graph, shape ``[k, s, d]``.

    Raises
    ------
    InputError
        On a choice that is not allowed, or a follower of another product mode than the choice leads to.
    """
    s, d = beliefs.start.shape
    out = np.zeros((len(mode), s, d))
    for x in range(len(product) - 1, -1, -1):
        own = np.flatnonzero(mode == x)
        m = int(product.mode[x])
        if m == OVER:
            out[own] = 0.0 if terminal is None else terminal[:, None]
            continue
        outcomes, after = beliefs.outcomes(m), np.flatnonzero(product.chance[x] > 0)
        where = f"{place}, product mode {product.names[x]}"
        if len(after) != 1:
            raise located(f"{where}, modes that may follow", len(after), "1 in a policy graph")
        for c in np.unique(graph.choice[own]).tolist():
            if not (0 <= c < product.allowed.shape[1] and product.allowed[x, c]):
                raise located(f"{where}, choice", c, "one that is allowed there")
            vectors, y = own[graph.choice[own] == c], int(product.follow[x, c, after[0]])
            follow = graph.follow[vectors, :outcomes]
            if y <= x or np.any((follow < 0) | (follow >= len(mode))) or np.any(mode[follow] != y):
                raise located(f"{where}, choice {c}, followers", follow.tolist(), f"vectors of {product.names[y]}")
            out[vectors] = beliefs.rewards[m][c][:, None]
            for o in range(outcomes):
                table = beliefs.joint[m][:, c, o]
                out[vectors] += discount * np.einsum("std,ktd->ksd", table, out[follow[:, o]])
    return out
