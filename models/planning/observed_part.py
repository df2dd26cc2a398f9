r"""An observed part of the state found in a problem that does not declare one, as most problem files do not.

If, after every action, each observation can only come from end states of one *block*, then everybody knows the
block the state is in, and beliefs range over its states alone. The finest such blocks are the classes that remain
when all states are joined that may show the same observation after the same action:

.. math:: s \sim s' \iff \exists a, o:\; O(o \mid a, s) > 0,\; O(o \mid a, s') > 0, \text{ both reached by } a

Blocks become modes. A start that is spread over several blocks is a mode of its own, as nobody is told the first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from models.planning.arrays import Index
from models.planning.problem import Branch, Choice, Problem, csr

START = "start"
"""Name of the mode before the first observation."""


@dataclass(frozen=True)
class ObservedPart:
    """A problem of one mode in terms of blocks that are known.

    Attributes
    ----------
    whole : Problem
    problem : Problem
        The same with blocks as modes.
    members : tuple of int64[y]
        States of the whole problem in each mode.
    """

    whole: Problem
    problem: Problem
    members: tuple[Index, ...]


def observed_part(problem: Problem) -> ObservedPart | None:
    """Blocks of the state that observations tell; None if there are none, or they leave beliefs half as long.

    Only problems of one mode with one branch an action are looked at: the form of problem files.
    """
    choices = problem.choices[0]
    if problem.n_modes > 1 or any(len(c.branches) != 1 or c.branches[0].emission is None for c in choices):
        return None
    n = problem.n_states
    label = _blocks(problem)
    members = [np.flatnonzero(label == k) for k in range(label.max() + 1)]
    if 2 * max(map(len, members)) > n:
        return None
    start = problem.initial[0]
    support = np.flatnonzero(start)
    spread = len(np.unique(label[support])) > 1
    modes = [*members, support] if spread else members
    offered: list[list[Choice]] = [[] for _ in modes]
    for choice in choices:
        branch = choice.branches[0]
        shown = [_shown(branch, block) for block in members]
        for row, rows in zip(offered, modes, strict=True):
            branches = tuple(
                Branch(k, table, *shown[k]) for k, table in _by_block(branch.transition[rows], label, members)
            )
            row.append(Choice(choice.action, choice.reward[rows], branches))
    initial = [np.zeros(len(rows)) for rows in modes]
    first = len(members) if spread else int(label[support[0]])
    initial[first] = start[modes[first]]
    names = [f"block {k}" for k in range(len(members))] + [START] * spread
    states = tuple(tuple(problem.states[0][s] for s in rows) for rows in modes)
    factored = Problem(
        tuple(names), states, tuple(map(tuple, offered)), problem.observations, tuple(initial), problem.discount,
        problem.name, problem.costs,
    )  # fmt: skip
    return ObservedPart(problem, factored, tuple(modes))


def _shown(branch: Branch, block: Index) -> tuple[tuple[int, ...], sparse.csr_array]:
    """Observations that a block may show, and how probable each is in its states."""
    emission = _emission(branch)[block].tocsc()
    shown = np.flatnonzero(np.diff(emission.indptr))
    return tuple(branch.observations[o] for o in shown), csr(emission[:, shown])


def _by_block(
    table: sparse.csr_array, label: Index, members: list[Index]
) -> Iterator[tuple[int, sparse.csr_array]]:
    """Columns of a table by the blocks they belong to, for those with entries: all taken out in one go."""
    entries = table.tocoo()
    block = label[entries.col]
    order = np.argsort(block, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(block[order])) + 1):
        k = int(block[part[0]])
        column = np.searchsorted(members[k], entries.col[part])
        shape = (table.shape[0], len(members[k]))
        yield k, csr(sparse.coo_array((entries.data[part], (entries.row[part], column)), shape=shape))


def _emission(branch: Branch) -> sparse.csr_array:
    assert branch.emission is not None  # asked for in `observed_part`
    return branch.emission


def _blocks(problem: Problem) -> Index:
    """Block of every state: components of the graph of states and what they may show."""
    n = problem.n_states
    rows, columns, width = [], [], 0
    for choice in problem.choices[0]:
        branch = choice.branches[0]
        reached = np.zeros(n, dtype=bool)
        reached[branch.transition.indices] = True
        shown = _emission(branch).tocoo()
        kept = reached[shown.row] & (shown.data > 0)
        rows.append(shown.row[kept])
        columns.append(shown.col[kept] + n + width)
        width += shown.shape[1]
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = sparse.coo_array((np.ones(len(row)), (row, column)), shape=(n + width, n + width))
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    return np.unique(label[:n], return_inverse=True)[1].astype(np.int64)
