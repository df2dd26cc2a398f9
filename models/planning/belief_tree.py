r"""The beliefs a solver has met, with both bounds and the sawtooth, compiled.

*Upper bound* of a belief: the least of its own backed-up value, the planes of the fast informed bound, and the
sawtooth (Hauskrecht 2000), :math:`c \cdot b + \min_i \phi_i(b)\,(v_i - c \cdot b_i)` with
:math:`\phi_i(b) = \min_{y: b_i(y) > 0} b(y) / b_i(y)` over the points :math:`(b_i, v_i)` of its mode and the
values `c` of its corners. *Lower bound*: the best alpha vector. Both are looked up anew only against points and
vectors that have come since the last look: what was not better then is not better now.

A point that another one is at least as deep as at its own belief is so everywhere: from
:math:`b \ge \phi_i(b)\, b_i` and :math:`b_i \ge \phi_k(b_i)\, b_k` follows
:math:`\phi_k(b) \ge \phi_i(b)\, \phi_k(b_i)`. It is given up as soon as that is seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.step_kernel import expected_reward, successors
from models.planning.vectors import Vectors

SAME = 1e-14
"""Beliefs that agree to this are one node; what they differ by is charged to the upper bound."""

WAYS = 4
"""Ways on that there is room for, a node."""

TINY = 1e-13
"""Improvements below this share of the largest value there can be are rounding."""


class Tree(NamedTuple):
    r"""Nodes (beliefs) and sawtooth points.

    Attributes
    ----------
    counts : int64[5]
        Nodes, points, units of work done, trials, and ways.
    table : int32[h]
        Hash table of nodes, -1 where free; `h` a power of two.
    mode : int64[i]
    belief : float64[i, w]
    lower, upper : float64[i]
    best : int64[i]
        The vector behind `lower`.
    seen_vectors, seen_points : int64[i]
        How many vectors and points there were when the node was last looked up.
    ahead : float64[i, a]
        Upper bound of each choice as of when it was last looked at.
    first_way, ways : int64[i, a], int32[i, a]
        Where the ways on from an opened choice begin, and how many there are: one for every possible outcome.
    way_outcome : int32[e]
        Outcome of a way, counted from the choice's first.
    way_child : int32[e]
        Node it leads to.
    way_probability : float64[e]
    charge : float64[i, a]
        What the children of a choice may be worth more than the nodes that stand for them: by
        :math:`\lVert b - b' \rVert_1 / 2` of the largest difference between values.
    opened : bool[i, a]
        Whether the children of a choice are there.
    corner : float64[x, w]
        Upper bound where the hidden state is known.
    point_of : int64[i]
        The sawtooth point of each node, -1 if it has none.
    covered : float64[i]
        What the sawtooth is known to say of each node at most.
    point_node : int64[p]
        Node of each sawtooth point.
    point_depth : float64[p]
        How far it lies below the plane of the corners, negative; zero once it has been given up.
    point_previous : int64[p]
        The next older point of the same mode, -1 at the end.
    point_last : int64[x]
        The newest point of each mode.
    planes : float64[c, w]
        The fast informed bound.
    """

    counts: Index
    table: NDArray[np.int32]
    mode: Index
    belief: Array
    lower: Array
    upper: Array
    best: Index
    seen_vectors: Index
    seen_points: Index
    ahead: Array
    first_way: Index
    ways: NDArray[np.int32]
    way_outcome: NDArray[np.int32]
    way_child: NDArray[np.int32]
    way_probability: Array
    charge: Array
    opened: NDArray[np.bool_]
    corner: Array
    point_of: Index
    covered: Array
    point_node: Index
    point_depth: Array
    point_previous: Index
    point_last: Index
    planes: Array


def empty_tree(problem: ProblemArrays, capacity: int, corner: Array, planes: Array) -> Tree:
    """A tree without nodes, with room for so many nodes, twice as many points and `WAYS` times as many ways.

    Room is zeros, which cost nothing before they are written to; nodes are filled in when they are made.
    """
    width = problem.reward.shape[1]
    actions = int(np.diff(problem.mode_choice).max())
    ways = max(WAYS * capacity, int(np.diff(problem.choice_outcome).max()))
    slots = 1 << int(2 * capacity - 1).bit_length()
    return Tree(
        np.zeros(5, dtype=np.int64), np.full(slots, -1, dtype=np.int32), np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, width)), np.zeros(capacity), np.zeros(capacity), np.zeros(capacity, dtype=np.int64),
        np.zeros(capacity, dtype=np.int64), np.zeros(capacity, dtype=np.int64), np.zeros((capacity, actions)),
        np.zeros((capacity, actions), dtype=np.int64), np.zeros((capacity, actions), dtype=np.int32),
        np.zeros(ways, dtype=np.int32), np.zeros(ways, dtype=np.int32), np.zeros(ways),
        np.zeros((capacity, actions)), np.zeros((capacity, actions), dtype=np.bool_), corner.copy(),
        np.zeros(capacity, dtype=np.int64), np.zeros(capacity),
        np.zeros(2 * capacity, dtype=np.int64), np.zeros(2 * capacity), np.zeros(2 * capacity, dtype=np.int64),
        np.full(len(problem.mode_size), -1, dtype=np.int64), planes,
    )  # fmt: skip


def grown_tree(tree: Tree, problem: ProblemArrays, capacity: int) -> Tree:
    """The same tree with more room."""
    new = empty_tree(problem, capacity, tree.corner, tree.planes)
    nodes, points, ways = int(tree.counts[0]), int(tree.counts[1]), int(tree.counts[4])
    new.counts[:] = tree.counts
    new.point_last[:] = tree.point_last
    for name in ("mode", "belief", "lower", "upper", "best", "seen_vectors", "seen_points", "ahead", "first_way",
                 "ways", "charge", "opened", "point_of", "covered"):  # fmt: skip
        getattr(new, name)[:nodes] = getattr(tree, name)[:nodes]
    for name in ("point_node", "point_depth", "point_previous"):
        getattr(new, name)[:points] = getattr(tree, name)[:points]
    for name in ("way_outcome", "way_child", "way_probability"):
        getattr(new, name)[:ways] = getattr(tree, name)[:ways]
    _index_nodes(new, problem)
    return new


@kernel
def _index_nodes(tree: Tree, problem: ProblemArrays) -> None:
    for i in range(tree.counts[0]):
        slot = _find(tree, tree.mode[i], tree.belief[i], problem.mode_size[tree.mode[i]])
        if slot < 0:
            tree.table[-1 - slot] = i


@kernel
def _find(tree: Tree, mode: int, belief: Array, size: int) -> int:
    """Node of a belief, or ``-1 - slot`` of the free place where it would go."""
    code = np.uint64(14695981039346656037)
    prime = np.uint64(1099511628211)
    code = (code ^ np.uint64(mode)) * prime
    for y in range(size):
        # Coarser than the comparison, so that beliefs that differ by rounding mostly meet.
        code = (code ^ np.uint64(np.int64(belief[y] * 1e8 + 0.5))) * prime
        code ^= code >> np.uint64(29)
    mask = len(tree.table) - 1
    slot = int(np.int64(code & np.uint64(mask)))
    while True:
        i = tree.table[slot]
        if i < 0:
            return -1 - slot
        if tree.mode[i] == mode:
            same = True
            for y in range(size):
                if abs(tree.belief[i, y] - belief[y]) > SAME:
                    same = False
                    break
            if same:
                return i
        slot = (slot + 1) & mask


@kernel
def plane_bound(tree: Tree, problem: ProblemArrays, mode: int, belief: Array, size: int) -> float:
    """The fast informed bound of a belief."""
    best = -np.inf
    for c in range(problem.mode_choice[mode], problem.mode_choice[mode + 1]):
        total = 0.0
        for y in range(size):
            total += tree.planes[c, y] * belief[y]
        best = max(best, total)
    return best


@kernel
def look_up(tree: Tree, vectors: Vectors, i: int, size: int) -> None:
    """Compare a node with the vectors that have come since it was last looked up."""
    value = tree.lower[i]
    j = tree.best[i]
    if j >= 0:
        # It may have been raised in its place.
        total = 0.0
        for y in range(size):
            total += vectors.alpha[j, y] * tree.belief[i, y]
        value = max(value, total)
    j = vectors.last[tree.mode[i]]
    seen = tree.seen_vectors[i]
    while j >= seen:
        total = 0.0
        for y in range(size):
            total += vectors.alpha[j, y] * tree.belief[i, y]
        tree.counts[2] += size
        if total > value:
            value = total
            tree.best[i] = j
        j = vectors.previous[j]
    tree.lower[i] = value
    tree.seen_vectors[i] = vectors.counts[0]


@kernel
def note_risen(tree: Tree, problem: ProblemArrays, vectors: Vectors) -> None:
    """Let lower bounds of nodes follow the vectors behind them, after these have been valued anew."""
    for i in range(tree.counts[0]):
        j = tree.best[i]
        if j >= 0:
            total = 0.0
            for y in range(problem.mode_size[tree.mode[i]]):
                total += vectors.alpha[j, y] * tree.belief[i, y]
            tree.lower[i] = max(tree.lower[i], total)


@kernel
def look_down(tree: Tree, i: int, size: int) -> None:
    """Compare a node with the sawtooth points that have come since it was last looked up."""
    mode = tree.mode[i]
    j = tree.point_last[mode]
    seen = tree.seen_points[i]
    if j >= seen:
        base = 0.0
        for y in range(size):
            base += tree.corner[mode, y] * tree.belief[i, y]
        lowest = min(0.0, tree.upper[i] - base)
        better = False
        while j >= seen:
            other = tree.point_node[j]
            depth = tree.point_depth[j]
            share = 1.0
            if depth < lowest:
                for y in range(size):
                    theirs = tree.belief[other, y]
                    if theirs > 0.0 and tree.belief[i, y] < share * theirs:
                        share = tree.belief[i, y] / theirs
                        if share * depth >= lowest:
                            break
                tree.counts[2] += 8
                if share * depth < lowest:
                    lowest = share * depth
                    better = better or other != i
            j = tree.point_previous[j]
        tree.upper[i] = min(tree.upper[i], base + lowest)
        if better:
            give_up_point(tree, i)
            tree.covered[i] = tree.upper[i]
    tree.seen_points[i] = tree.counts[1]


@kernel
def give_up_point(tree: Tree, i: int) -> None:
    """Forget the sawtooth point of a node, of which others say as much."""
    j = tree.point_of[i]
    if j >= 0:
        tree.point_depth[j] = 0.0
        tree.point_of[i] = -1


@kernel
def node_of(tree: Tree, problem: ProblemArrays, mode: int, belief: Array) -> int:
    """The node of a belief, made if it is not there; there must be room for it."""
    size = problem.mode_size[mode]
    slot = _find(tree, mode, belief, size)
    if slot >= 0:
        return slot
    i = tree.counts[0]
    tree.counts[0] += 1
    tree.table[-1 - slot] = i
    tree.mode[i] = mode
    tree.belief[i] = 0.0
    tree.belief[i, :size] = belief[:size]
    tree.lower[i] = -np.inf
    tree.upper[i] = plane_bound(tree, problem, mode, belief, size)
    tree.best[i] = -1
    tree.seen_vectors[i] = 0
    tree.seen_points[i] = 0
    tree.opened[i] = False
    tree.point_of[i] = -1
    tree.covered[i] = np.inf
    for c in range(problem.mode_choice[mode], problem.mode_choice[mode + 1]):
        total = 0.0
        for y in range(size):
            total += tree.planes[c, y] * belief[y]
        tree.ahead[i, c - problem.mode_choice[mode]] = total
    return i


@kernel
def room_for(tree: Tree, outcomes: int) -> bool:
    """Whether there is room for a choice with so many outcomes."""
    return tree.counts[0] + outcomes <= len(tree.mode) and tree.counts[4] + outcomes <= len(tree.way_child)


@kernel
def open_choice(
    tree: Tree, problem: ProblemArrays, i: int, j: int, after: Array, probability: Array, reached: Array
) -> None:
    """Make the children of a choice; there must be room for all its outcomes (`room_for`)."""
    x = tree.mode[i]
    c = problem.mode_choice[x] + j
    successors(problem, c, tree.belief[i], problem.mode_size[x], after, probability, reached)
    tree.counts[2] += problem.mode_size[x] * (problem.choice_outcome[c + 1] - problem.choice_outcome[c])
    charge = 0.0
    first = problem.choice_outcome[c]
    tree.first_way[i, j] = tree.counts[4]
    for z in range(first, problem.choice_outcome[c + 1]):
        p = probability[z - first]
        if p > 0.0:
            belief = after[z - first]
            child = node_of(tree, problem, problem.outcome_mode[z], belief)
            way = tree.counts[4]
            tree.counts[4] += 1
            tree.way_outcome[way] = z - first
            tree.way_child[way] = child
            tree.way_probability[way] = p
            for y in range(problem.mode_size[problem.outcome_mode[z]]):
                charge += 0.5 * p * abs(tree.belief[child, y] - belief[y])
    tree.ways[i, j] = tree.counts[4] - tree.first_way[i, j]
    tree.charge[i, j] = charge * problem.span
    tree.opened[i, j] = True


@kernel
def choice_reward(tree: Tree, problem: ProblemArrays, i: int, j: int) -> float:
    """Expected reward of a choice at a node."""
    x = tree.mode[i]
    return expected_reward(problem, problem.mode_choice[x] + j, tree.belief[i], problem.mode_size[x])
