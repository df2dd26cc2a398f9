"""Backups at one node of the belief tree, compiled: its upper bound, its lower bound, what the sawtooth learns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.belief_tree import (
    TINY,
    Tree,
    choice_reward,
    give_up_point,
    look_down,
    look_up,
    open_choice,
    room_for,
)
from models.planning.lazy_choice import highest, next_to_look_at
from models.planning.step_kernel import look_ahead
from models.planning.vectors import Vectors, add_vector

DEEPEST = 400
"""Longest path of a trial."""


class Room(NamedTuple):
    """Scratch for one thread."""

    after: Array
    probability: Array
    reached: Array
    alpha: Array
    follow: NDArray[np.int32]
    path: Index
    taken: Index


def new_room(problem: ProblemArrays) -> Room:
    """Scratch for a problem."""
    width = problem.reward.shape[1]
    outcomes = int(np.diff(problem.choice_outcome).max())
    return Room(
        np.zeros((outcomes, width)), np.zeros(outcomes), np.zeros(width), np.zeros(width),
        np.zeros(outcomes, dtype=np.int32), np.zeros(DEEPEST, dtype=np.int64), np.zeros(DEEPEST, dtype=np.int64),
    )  # fmt: skip


@kernel
def back_up_upper(tree: Tree, problem: ProblemArrays, i: int, room: Room) -> int:
    """Best choice of a node by upper bounds (see `lazy_choice`); -1 if there is no room for its children."""
    x = tree.mode[i]
    offered = problem.mode_choice[x + 1] - problem.mode_choice[x]
    fresh = -1
    j = highest(tree.ahead, i, offered)
    while j != fresh:
        c = problem.mode_choice[x] + j
        if not tree.opened[i, j]:
            if not room_for(tree, problem.choice_outcome[c + 1] - problem.choice_outcome[c]):
                return -1
            open_choice(tree, problem, i, j, room.after, room.probability, room.reached)
        value = tree.charge[i, j]
        for way in range(tree.first_way[i, j], tree.first_way[i, j] + tree.ways[i, j]):
            child = tree.way_child[way]
            look_down(tree, child, problem.mode_size[tree.mode[child]])
            value += tree.way_probability[way] * tree.upper[child]
        value = choice_reward(tree, problem, i, j) + problem.discount * value
        fresh = j
        j = next_to_look_at(tree.ahead, i, offered, fresh, value)
    tree.upper[i] = min(tree.upper[i], tree.ahead[i, fresh])
    return fresh


@kernel
def add_point(tree: Tree, problem: ProblemArrays, i: int) -> None:
    """Let the sawtooth know the upper bound of a node, if it does not yet; there must be room for a point."""
    x = tree.mode[i]
    size = problem.mode_size[x]
    base = 0.0
    heaviest = 0
    for y in range(size):
        base += tree.corner[x, y] * tree.belief[i, y]
        if tree.belief[i, y] > tree.belief[i, heaviest]:
            heaviest = y
    # Only a corner itself: the value of one may be far above that of a belief next to it.
    if tree.belief[i, heaviest] >= 1.0:
        if tree.upper[i] < tree.corner[x, heaviest]:
            fall = tree.corner[x, heaviest] - tree.upper[i]
            tree.corner[x, heaviest] = tree.upper[i]
            # Depths are counted from the plane of the corners, which has just sunk.
            j = tree.point_last[x]
            while j >= 0:
                tree.point_depth[j] = min(
                    0.0, tree.point_depth[j] + fall * tree.belief[tree.point_node[j], heaviest]
                )
                j = tree.point_previous[j]
        return
    depth = tree.upper[i] - base
    least = TINY * problem.largest
    if depth >= -least or tree.upper[i] >= tree.covered[i] - least:
        return
    give_up_point(tree, i)
    tree.covered[i] = tree.upper[i]
    j = tree.counts[1]
    tree.counts[1] += 1
    tree.point_of[i] = j
    tree.point_node[j] = i
    tree.point_depth[j] = depth
    tree.point_previous[j] = tree.point_last[x]
    tree.point_last[x] = j


@kernel
def back_up_lower(
    tree: Tree, problem: ProblemArrays, vectors: Vectors, i: int, least: float, room: Room
) -> tuple[float, bool]:
    """One step ahead by lower bounds over the choices opened so far; a vector is added if it rises by `least`.

    Returns
    -------
    float
        Value of the best choice one step ahead.
    bool
        Whether the lower bound of the node rose.
    """
    x = tree.mode[i]
    size = problem.mode_size[x]
    best = -np.inf
    chosen = -1
    for j in range(problem.mode_choice[x + 1] - problem.mode_choice[x]):
        if not tree.opened[i, j]:
            continue
        value = 0.0
        for way in range(tree.first_way[i, j], tree.first_way[i, j] + tree.ways[i, j]):
            child = tree.way_child[way]
            look_up(tree, vectors, child, problem.mode_size[tree.mode[child]])
            value += tree.way_probability[way] * tree.lower[child]
        value = choice_reward(tree, problem, i, j) + problem.discount * value
        if value > best:
            best = value
            chosen = j
    if chosen < 0 or best <= tree.lower[i] + least:
        return best, False
    c = problem.mode_choice[x] + chosen
    first = problem.choice_outcome[c]
    for z in range(first, problem.choice_outcome[c + 1]):
        # After an impossible outcome any vector of the mode is sound.
        room.follow[z - first] = vectors.last[problem.outcome_mode[z]]
    for way in range(tree.first_way[i, chosen], tree.first_way[i, chosen] + tree.ways[i, chosen]):
        room.follow[tree.way_outcome[way]] = tree.best[tree.way_child[way]]
    look_ahead(problem, c, size, vectors.alpha, room.follow, room.alpha, room.reached)
    tree.counts[2] += size * (problem.choice_outcome[c + 1] - problem.choice_outcome[c])
    value = 0.0
    for y in range(size):
        value += room.alpha[y] * tree.belief[i, y]
    if value <= tree.lower[i] + least:
        return best, False
    j = tree.best[i]
    if vectors.choice[j] == c and _exceeds(room.alpha, vectors.alpha[j], size):
        # The same vector, only better: taking its place keeps the graph small, and lets it close on itself.
        vectors.alpha[j] = room.alpha
        vectors.follow[j] = room.follow
    else:
        j = add_vector(vectors, x, c, room.alpha, room.follow)
    tree.lower[i] = value
    tree.best[i] = j
    return best, True


@kernel
def _exceeds(one: Array, other: Array, size: int) -> bool:
    least = 0.0
    for y in range(size):
        least = min(least, one[y] - other[y])
    return least >= 0.0
