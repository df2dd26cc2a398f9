r"""What controllers are worth in every draw, exactly: linear systems eliminated node by node, many draws at once.

The value of a node `n` in hidden state `y` solves

.. math:: V_n(y) = \sum_c \pi(c \mid n) \Big[ R(c, y) + \gamma \sum_z \sum_{y'} P(z, y' \mid y, c)\,
   V_{n'(n, c, z)}(y') \Big]

which has one `S x S` block for every pair of nodes of which one may follow the other. Which blocks there are
depends on the controller only, so the order of elimination and what it fills in are worked out once, and the
numbers are those of all draws side by side. Rows are diagonally dominant and stay so when nodes are eliminated, so
no pivots are needed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.robust.controllers import Controller


class Elimination(NamedTuple):
    """The order in which a controller's nodes are eliminated, and which blocks that takes.

    Nodes are renumbered by that order; the blocks `0..n-1` are those of the diagonal.

    Attributes
    ----------
    blocks : int
        Blocks in all.
    term_node, term_choice : int64[t]
    term_share : float64[t]
        Which choices each node takes, and how often.
    entry_node, entry_after, entry_block, entry_outcome : int64[e]
    entry_share : float64[e]
        Which node follows which outcome, its block, and how often the choice is taken.
    row_begin : int64[n + 1]
    row_node, row_block : int64[r]
        Later nodes in the row of each node when it is eliminated.
    column_begin : int64[n + 1]
    column_node, column_block : int64[k]
        Later nodes in its column.
    target_begin : int64[n + 1]
    target : int64[p]
        Block that each pair (column, row) changes, rows of a column together.
    start : int64[x]
        Node of each first mode, -1 for none.
    """

    blocks: int
    term_node: Index
    term_choice: Index
    term_share: Array
    entry_node: Index
    entry_after: Index
    entry_block: Index
    entry_outcome: Index
    entry_share: Array
    row_begin: Index
    row_node: Index
    row_block: Index
    column_begin: Index
    column_node: Index
    column_block: Index
    target_begin: Index
    target: Index
    start: Index


def elimination(problem: ProblemArrays, controller: Controller) -> Elimination:
    """Work out how to eliminate a controller: at each step the node whose elimination costs least (Markowitz)."""
    n = controller.n_nodes
    terms, entries = [], []
    for i in range(n):
        for c in np.flatnonzero(controller.share[i]):
            number, share = int(problem.mode_choice[controller.mode[i]] + c), float(controller.share[i, c])
            terms.append((i, number, share))
            begin, end = problem.choice_outcome[number : number + 2].tolist()
            entries += [(i, int(controller.follow[i, c, z - begin]), z, share) for z in range(begin, end)]
    after: list[set[int]] = [set() for _ in range(n)]
    before: list[set[int]] = [set() for _ in range(n)]
    for i, j, _, _ in entries:
        if i != j:
            after[i].add(j)
            before[j].add(i)
    block = {(i, i): 0 for i in range(n)}
    steps, left = [], set(range(n))
    while left:
        v = min(left, key=lambda i: (len(before[i]) * len(after[i]), len(before[i]) + len(after[i]), i))
        left.discard(v)
        rows, columns = sorted(after[v]), sorted(before[v])
        steps.append((v, rows, columns))
        for u in columns:
            after[u].discard(v)
            after[u] |= after[v] - {u}
        for w in rows:
            before[w].discard(v)
            before[w] |= before[v] - {w}
    place = {v: k for k, (v, _, _) in enumerate(steps)}
    block = {(place[i], place[i]): place[i] for i in range(n)}

    def number_of(i: int, j: int) -> int:
        return block.setdefault((i, j), len(block))

    rows_of, columns_of, targets = [], [], []
    for v, rows, columns in steps:
        k = place[v]
        rows_of.append([(place[w], number_of(k, place[w])) for w in rows])
        columns_of.append([(place[u], number_of(place[u], k)) for u in columns])
        targets.append([number_of(place[u], place[w]) for u in columns for w in rows])
    flat = [(place[i], place[j], number_of(place[i], place[j]), z, p) for i, j, z, p in entries]
    start = np.array([place[i] if i >= 0 else -1 for i in controller.start.tolist()], dtype=np.int64)
    term_node, term_choice = _columns([(place[i], c) for i, c, _ in terms], 2)
    entry_node, entry_after, entry_block, entry_outcome = _columns([e[:4] for e in flat], 4)
    row_node, row_block = _columns([x for part in rows_of for x in part], 2)
    column_node, column_block = _columns([x for part in columns_of for x in part], 2)
    return Elimination(
        len(block), term_node, term_choice, np.array([p for *_, p in terms]), entry_node, entry_after, entry_block,
        entry_outcome, np.array([e[4] for e in flat]), _begins(rows_of), row_node, row_block, _begins(columns_of),
        column_node, column_block, _begins(targets),
        np.array([x for part in targets for x in part], dtype=np.int64), start,
    )  # fmt: skip


def _columns(rows: list, width: int) -> list[Index]:
    table = np.array(rows, dtype=np.int64).reshape(-1, width)
    return [np.ascontiguousarray(column) for column in table.T]


def _begins(parts: list) -> Index:
    return np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)


@kernel
def controller_values(
    joint: Array, reward: Array, discount: float, initial: Array, starts: Array, plan: Elimination, value: Array
) -> float:
    r"""Value of one controller in many draws; returns the largest residual of its equations.

    The values are off by no more than the residual over :math:`1 - \gamma`.

    Parameters
    ----------
    joint : float64[z, y, y', d]
        Probability of each outcome of every choice together with the next state.
    reward : float64[c, y]
    discount : float
    initial : float64[y, d]
    starts : float64[x]
        Probability of each first mode.
    plan : Elimination
    value : float64[d]
        Filled.
    """
    n = len(plan.row_begin) - 1
    size, draws = initial.shape
    a = np.zeros((plan.blocks, size, size, draws))
    v = np.zeros((n, size, draws))
    for i in range(n):
        for y in range(size):
            a[i, y, y] = 1.0
    for t in range(len(plan.term_node)):
        for y in range(size):
            v[plan.term_node[t], y] += plan.term_share[t] * reward[plan.term_choice[t], y]
    for e in range(len(plan.entry_node)):
        own, seen, factor = a[plan.entry_block[e]], joint[plan.entry_outcome[e]], discount * plan.entry_share[e]
        for y in range(size):
            for x in range(size):
                for d in range(draws):
                    own[y, x, d] -= factor * seen[y, x, d]
    for k in range(n):
        _factorise(a[k])
        for r in range(plan.row_begin[k], plan.row_begin[k + 1]):
            other = a[plan.row_block[r]]
            for x in range(size):
                _solve(a[k], other[:, x])
        _solve(a[k], v[k])
        rows = plan.row_begin[k + 1] - plan.row_begin[k]
        for c in range(plan.column_begin[k], plan.column_begin[k + 1]):
            left = a[plan.column_block[c]]
            changed = v[plan.column_node[c]]
            for y in range(size):
                for m in range(size):
                    for d in range(draws):
                        changed[y, d] -= left[y, m, d] * v[k, m, d]
            first = plan.target_begin[k] + (c - plan.column_begin[k]) * rows
            for r in range(rows):
                other = a[plan.row_block[plan.row_begin[k] + r]]
                out = a[plan.target[first + r]]
                for y in range(size):
                    for x in range(size):
                        for m in range(size):
                            for d in range(draws):
                                out[y, x, d] -= left[y, m, d] * other[m, x, d]
    for k in range(n - 1, -1, -1):
        for r in range(plan.row_begin[k], plan.row_begin[k + 1]):
            other, after = a[plan.row_block[r]], v[plan.row_node[r]]
            for y in range(size):
                for m in range(size):
                    for d in range(draws):
                        v[k, y, d] -= other[y, m, d] * after[m, d]
    value[:] = 0.0
    for x in range(len(starts)):
        if starts[x] > 0.0:
            for y in range(size):
                value += starts[x] * initial[y] * v[plan.start[x], y]
    return _residual(joint, reward, discount, plan, v)


@kernel
def _factorise(block: Array) -> None:
    """Factors of a block of every draw, in its place."""
    size, _, draws = block.shape
    for k in range(size):
        for i in range(k + 1, size):
            for d in range(draws):
                block[i, k, d] /= block[k, k, d]
            for j in range(k + 1, size):
                for d in range(draws):
                    block[i, j, d] -= block[i, k, d] * block[k, j, d]


@kernel
def _solve(factors: Array, right: Array) -> None:
    """Solve a factorised block for a right-hand side ``[y, d]``, in its place."""
    size, _, draws = factors.shape
    for i in range(size):
        for k in range(i):
            for d in range(draws):
                right[i, d] -= factors[i, k, d] * right[k, d]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            for d in range(draws):
                right[i, d] -= factors[i, k, d] * right[k, d]
        for d in range(draws):
            right[i, d] /= factors[i, i, d]


@kernel
def _residual(joint: Array, reward: Array, discount: float, plan: Elimination, v: Array) -> float:
    """Largest amount by which values miss their equations."""
    _, size, draws = v.shape
    short = -v.copy()
    for t in range(len(plan.term_node)):
        for y in range(size):
            short[plan.term_node[t], y] += plan.term_share[t] * reward[plan.term_choice[t], y]
    for e in range(len(plan.entry_node)):
        out, after, seen = short[plan.entry_node[e]], v[plan.entry_after[e]], joint[plan.entry_outcome[e]]
        factor = discount * plan.entry_share[e]
        for y in range(size):
            for m in range(size):
                for d in range(draws):
                    out[y, d] += factor * seen[y, m, d] * after[m, d]
    return np.abs(short).max()
