r"""States that a problem can come to from its start, and rewards that it can pay.

What lies beyond cannot be met, whatever is done: it says nothing about how large values are, or how much is at
stake, and may hold any number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

if TYPE_CHECKING:
    from models.planning.problem import Problem


class Stakes(NamedTuple):
    """Rewards that a problem can pay.

    Attributes
    ----------
    lowest, highest : float
    sure : float
        What can be made sure of at every step by a choice that looks at the mode only.
    """

    lowest: float
    highest: float
    sure: float


def reachable_states(problem: Problem) -> tuple[NDArray[np.bool_], ...]:
    """Which states any actions may lead to from the start, one array ``[y]`` a mode."""
    sizes = [len(s) for s in problem.states]
    if all((start > 0).all() for start in problem.initial):
        return tuple(np.ones(n, dtype=bool) for n in sizes)
    begin = np.concatenate([[0], np.cumsum(sizes)])
    rows, columns = [np.full(1, begin[-1])], [np.full(1, begin[-1])]
    for x, offered in enumerate(problem.choices):
        for branch in (b for choice in offered for b in choice.branches):
            table = branch.transition
            kept = table.data > 0
            rows.append(np.repeat(np.arange(begin[x], begin[x + 1]), np.diff(table.indptr))[kept])
            columns.append(begin[branch.mode] + table.indices[kept])
    start = np.flatnonzero(np.concatenate(problem.initial) > 0)
    rows.append(np.full(len(start), begin[-1]))
    columns.append(start)
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = sparse.csr_array((np.ones(len(row)), (row, column)), shape=(begin[-1] + 1, begin[-1] + 1))
    met = np.zeros(begin[-1] + 1, dtype=bool)
    met[sparse.csgraph.breadth_first_order(graph, begin[-1], return_predecessors=False)] = True
    return tuple(np.split(met[:-1], begin[1:-1]))


def stakes_of(problem: Problem) -> Stakes:
    """Rewards of the states that the problem can come to."""
    lowest, highest, sure = np.inf, -np.inf, np.inf
    for offered, met in zip(problem.choices, reachable_states(problem), strict=True):
        if met.any():
            paid = np.stack([choice.reward[met] for choice in offered])
            lowest, highest = min(lowest, float(paid.min())), max(highest, float(paid.max()))
            sure = min(sure, float(paid.min(axis=1).max()))
    return Stakes(lowest, highest, sure)
