r"""Trials of SARSOP: paths of beliefs that an optimal robot might reach, backed up on the way home, compiled.

Kurniawati, Hsu & Lee (2008): a trial follows the choice with the best upper bound and the outcome whose gap matters
most, and goes on below the usual depth where the predicted value of a belief promises to raise the lower bound at
the root. Values are predicted from bins of similar beliefs, by upper bound and entropy.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.belief_tree import TINY, Tree, choice_reward, look_down, look_up
from models.planning.node_backups import DEEPEST, Room, add_point, back_up_lower, back_up_upper
from models.planning.value_bins import Bins, predict
from models.planning.vectors import Vectors

UNLIKELY = 1e-9
"""Outcomes less probable than this are not followed: what is asked of them is divided by it."""

IMPROVEMENT = 0.5
"""A trial aims at this share of the gap at the root."""


@kernel
def trial(
    tree: Tree, problem: ProblemArrays, vectors: Vectors, bins: Bins, root: int, wanted: float, room: Room
) -> bool:
    """One trial from a root; False if the room for nodes, points or vectors is used up."""
    if tree.counts[1] + DEEPEST > len(tree.point_node) or vectors.counts[0] + DEEPEST > len(vectors.mode):
        return False
    discount = problem.discount
    look_up(tree, vectors, root, problem.mode_size[tree.mode[root]])
    look_down(tree, root, problem.mode_size[tree.mode[root]])
    aim = max(IMPROVEMENT * (tree.upper[root] - tree.lower[root]), 0.5 * wanted)
    floor = tree.lower[root]
    ceiling = tree.lower[root] + aim
    i = root
    steps = 0
    room_left = True
    tree.counts[3] += 1
    scale = 1.0  # discount to the power of the depth; gaps are compared after it, which cannot overflow
    while steps < DEEPEST and problem.halt[0] == 0:
        size = problem.mode_size[tree.mode[i]]
        look_up(tree, vectors, i, size)
        look_down(tree, i, size)
        j = back_up_upper(tree, problem, i, room)
        if j < 0:
            room_left = False
            break
        bins.trial[i] = tree.counts[3]
        room.path[steps] = i
        steps += 1
        # Looking at what is known already is work too, or a portion of deep trials would take minutes.
        tree.counts[2] += 50 + size
        gap = tree.upper[i] - tree.lower[i]
        if gap * scale <= 0.5 * aim:
            break
        guess = predict(tree, problem, bins, i)
        if guess <= floor and tree.upper[i] <= max(ceiling, tree.lower[i] + aim / scale):
            break
        chosen = -1
        most = -np.inf
        newer = False
        low = 0.0
        high = 0.0
        for way in range(tree.first_way[i, j], tree.first_way[i, j] + tree.ways[i, j]):
            p = tree.way_probability[way]
            child = tree.way_child[way]
            look_up(tree, vectors, child, problem.mode_size[tree.mode[child]])
            low += p * tree.lower[child]
            high += p * tree.upper[child]
            excess = p * ((tree.upper[child] - tree.lower[child]) * scale * discount - aim)
            # Beliefs that this trial has not been at go first: with a discount near one, going round in a
            # circle looks as good at every turn.
            fresh = bins.trial[child] != tree.counts[3] and excess > 0.0
            if p > UNLIKELY and ((fresh and not newer) or (fresh == newer and excess > most)):
                most = excess
                chosen = way
                newer = fresh
        reward = choice_reward(tree, problem, i, j)
        value = reward + discount * low
        floor = max(floor, value)
        ceiling = max(ceiling, value + aim / scale)
        child = tree.way_child[chosen]
        p = tree.way_probability[chosen]
        floor = ((floor - reward) / discount - (low - p * tree.lower[child])) / p
        ceiling = ((ceiling - reward) / discount - (high - p * tree.upper[child])) / p
        i = child
        scale *= discount
    for step in range(steps - 1, -1, -1):
        if problem.halt[0] != 0:
            break
        i = room.path[step]
        if back_up_upper(tree, problem, i, room) < 0:
            room_left = False
        add_point(tree, problem, i)
        back_up_lower(tree, problem, vectors, i, TINY * problem.largest, room)
    return room_left


@kernel
def sweep(
    tree: Tree, problem: ProblemArrays, vectors: Vectors, start: int, least: float, work: int, room: Room
) -> int:
    """Back up opened nodes from number `start` downwards until some work has been done.

    Trials come back to a belief only by chance; where the best policy learns little, every belief is new and the
    gap would close only with the reciprocal of time.

    Returns
    -------
    int
        Where to go on, -1 at the end, -2 if the room is used up.
    """
    end = tree.counts[2] + work
    for i in range(start, -1, -1):
        if problem.halt[0] != 0:
            return i
        opened = False
        for j in range(tree.opened.shape[1]):
            opened = opened or tree.opened[i, j]
        if not opened:
            continue
        if tree.counts[1] + 1 > len(tree.point_node) or vectors.counts[0] + 1 > len(vectors.mode):
            return -2
        size = problem.mode_size[tree.mode[i]]
        look_down(tree, i, size)
        before = tree.upper[i]
        if back_up_upper(tree, problem, i, room) < 0:
            return -2
        if tree.upper[i] < before - least:
            add_point(tree, problem, i)
        look_up(tree, vectors, i, size)
        back_up_lower(tree, problem, vectors, i, least, room)
        if tree.counts[2] > end:
            return i - 1
    return -1


@kernel
def run_trials(
    tree: Tree, problem: ProblemArrays, vectors: Vectors, bins: Bins, roots: Index, weight: Array, wanted: float,
    work: int, room: Room,
) -> int:  # fmt: skip
    """Trials until the gap is small enough (0), some work has been done (1), or the room is used up (2)."""
    end = tree.counts[2] + work
    while True:
        total = 0.0
        widest = -1.0
        root = 0
        for r in range(len(roots)):
            gap = weight[r] * (tree.upper[roots[r]] - tree.lower[roots[r]])
            total += gap
            if gap > widest:
                widest = gap
                root = r
        if total <= wanted:
            return 0
        if tree.counts[2] > end or problem.halt[0] != 0:
            return 1
        if not trial(tree, problem, vectors, bins, roots[root], wanted, room):
            return 2
        tree.counts[2] += 50
