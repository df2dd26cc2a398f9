r"""An observed part of the state found in a problem that does not declare one, as most problem files do not.

If, after every action, each observation can only come from end states of one *block*, then everybody knows the
block the state is in, and beliefs range over its states alone. The finest such blocks are the classes that remain
when all states are joined that may show the same observation after the same action:

.. math:: s \sim s' \iff \exists a, o:\; O(o \mid a, s) > 0,\; O(o \mid a, s') > 0, \text{ both reached by } a

Blocks become modes. A start that is spread over several blocks is a mode of its own, as nobody is told the first.
The problem in terms of blocks has a branch for every pair of blocks and every action, tens of thousands where the
whole has some thousand states: it is put together as arrays, in `models.planning.block_arrays`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.block_arrays import block_arrays, ends
from models.planning.problem import Problem


@dataclass(frozen=True)
class ObservedPart:
    """A problem of one mode in terms of blocks that are known.

    Attributes
    ----------
    whole : Problem
    arrays : ProblemArrays
        The same with blocks as modes.
    members : tuple of int64[y]
        States of the whole problem in each mode; the last mode is the start where that is spread over blocks.
    start_mode : int
    start : float64[y]
        Belief over the members of the mode it starts in.
    """

    whole: Problem
    arrays: ProblemArrays
    members: tuple[Index, ...]
    start_mode: int
    start: Array


def observed_part(problem: Problem) -> ObservedPart | None:
    """Blocks of the state that observations tell; None if there are none, or they leave beliefs half as long.

    Only problems of one mode with one branch an action are looked at: the form of problem files.
    """
    choices = problem.choices[0]
    if problem.n_modes > 1 or any(len(c.branches) != 1 or c.branches[0].emission is None for c in choices):
        return None
    label = _blocks(problem)
    sizes = np.bincount(label)
    if 2 * sizes.max() > problem.n_states:
        return None
    order = np.argsort(label, kind="stable")
    members = tuple(np.split(order, np.cumsum(sizes)[:-1]))
    start = problem.initial[0]
    support = np.flatnonzero(start)
    first = int(label[support[0]])
    if (label[support] != first).any():
        first = len(members)
        members = (*members, support)
    arrays = block_arrays(problem, label, members)
    return ObservedPart(problem, arrays, members, first, start[members[first]])


def _emission(problem: Problem, action: int) -> sparse.csr_array:
    emission = problem.choices[0][action].branches[0].emission
    assert emission is not None  # asked for in `observed_part`
    return emission


def _blocks(problem: Problem) -> Index:
    """Block of every state: components of the graph of states and what they may show."""
    n = problem.n_states
    rows, columns, width = [], [], 0
    for a, choice in enumerate(problem.choices[0]):
        shown = _emission(problem, a).tocoo()
        kept = ends(choice)[shown.row] & (shown.data > 0)
        rows.append(shown.row[kept])
        columns.append(shown.col[kept] + n + width)
        width += shown.shape[1]
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = sparse.coo_array((np.ones(len(row)), (row, column)), shape=(n + width, n + width))
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    return np.unique(label[:n], return_inverse=True)[1].astype(np.int64)
