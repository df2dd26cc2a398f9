r"""Trials of SARSOP: paths of beliefs that an optimal robot might reach, backed up on the way home, compiled.

Kurniawati, Hsu & Lee (2008): a trial follows the choice with the best upper bound and the outcome whose gap matters
most, and goes on below the usual depth where the predicted value of a belief promises to raise the lower bound at
the root. Values are predicted from bins of similar beliefs, by upper bound and entropy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.belief_tree import Tree, choice_reward, look_down, look_up, open_choice
from models.planning.step_kernel import look_ahead
from models.planning.vectors import Vectors, add_vector, keep_useful

DEEPEST = 400
"""Longest path of a trial."""

IMPROVEMENT = 0.5
"""A trial aims at this share of the gap at the root."""

COARSE, FINE = 5, 10
"""Bins a side of the two levels of prediction."""

CORNER = 1.0 - 1e-9
"""A belief that gives one state that much is a corner."""


class Bins(NamedTuple):
    """Predictions of values by bins of similar beliefs, on two levels.

    Attributes
    ----------
    total, error : float64[x, 2, f]
        Sum of members' lower bounds; sum of squared errors of predictions made when members came in.
    members : int64[x, 2, f]
    lowest, highest : float64[x]
        Range of the fast informed bound over the corners of each mode.
    bin : int32[i, 2]
        Bins of each node, -1 before it has been visited.
    counted : float64[i]
        The lower bound with which a node is part of the sums.
    trial : int64[i]
        The last trial that came by.
    """

    total: Array
    error: Array
    members: Index
    lowest: Array
    highest: Array
    bin: NDArray[np.int32]
    counted: Array
    trial: Index


class Room(NamedTuple):
    """Scratch for one thread."""

    after: Array
    probability: Array
    reached: Array
    alpha: Array
    follow: NDArray[np.int32]
    path: Index
    taken: Index


def empty_bins(problem: ProblemArrays, tree: Tree) -> Bins:
    """Bins without members, for the nodes there is room for."""
    modes = len(problem.mode_size)
    corner = [tree.corner[x, : problem.mode_size[x]] for x in range(modes)]
    shape = (modes, 2, FINE * FINE)
    return Bins(
        np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.int64), np.array([c.min() for c in corner]),
        np.array([c.max() for c in corner]), np.full((len(tree.mode), 2), -1, dtype=np.int32),
        np.zeros(len(tree.mode)), np.zeros(len(tree.mode), dtype=np.int64),
    )  # fmt: skip


def grown_bins(bins: Bins, capacity: int) -> Bins:
    """The same bins for more nodes."""
    old = len(bins.counted)
    wide = np.full((capacity, 2), -1, dtype=np.int32)
    wide[:old] = bins.bin
    return bins._replace(
        bin=wide, counted=np.concatenate([bins.counted, np.zeros(capacity - old)]),
        trial=np.concatenate([bins.trial, np.zeros(capacity - old, dtype=np.int64)]),
    )  # fmt: skip


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
    """Best choice of a node by upper bounds, worked out only as far as needed; -1 if there is no room for children.

    Bounds of choices only fall, so a choice is looked at again only while what was last known of it is the best.
    """
    x = tree.mode[i]
    offered = problem.mode_choice[x + 1] - problem.mode_choice[x]
    first = problem.choice_outcome[problem.mode_choice[x]]
    fresh = -1
    while True:
        j = 0
        for k in range(1, offered):
            if tree.ahead[i, k] > tree.ahead[i, j]:
                j = k
        if j == fresh:
            break
        c = problem.mode_choice[x] + j
        if not tree.opened[i, j]:
            if tree.counts[0] + problem.choice_outcome[c + 1] - problem.choice_outcome[c] > len(tree.mode):
                return -1
            open_choice(tree, problem, i, j, room.after, room.probability, room.reached)
        value = 0.0
        for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
            p = tree.probability[i, z]
            if p > 0.0:
                child = tree.child[i, z]
                look_down(tree, child, problem.mode_size[tree.mode[child]])
                value += p * tree.upper[child]
        value = choice_reward(tree, problem, i, j) + problem.discount * value
        tree.ahead[i, j] = min(tree.ahead[i, j], value)
        fresh = j
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
    if tree.belief[i, heaviest] >= CORNER:
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
    if depth >= -1e-10:
        return
    j = tree.counts[1]
    tree.counts[1] += 1
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
    first = problem.choice_outcome[problem.mode_choice[x]]
    best = -np.inf
    chosen = -1
    for j in range(problem.mode_choice[x + 1] - problem.mode_choice[x]):
        if not tree.opened[i, j]:
            continue
        c = problem.mode_choice[x] + j
        value = 0.0
        for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
            p = tree.probability[i, z]
            if p > 0.0:
                child = tree.child[i, z]
                look_up(tree, vectors, child, problem.mode_size[tree.mode[child]])
                value += p * tree.lower[child]
        value = choice_reward(tree, problem, i, j) + problem.discount * value
        if value > best:
            best = value
            chosen = j
    if chosen < 0 or best <= tree.lower[i] + least:
        return best, False
    c = problem.mode_choice[x] + chosen
    for z in range(problem.choice_outcome[c], problem.choice_outcome[c + 1]):
        child = tree.child[i, z - first]
        # After an impossible outcome any vector of the mode is sound.
        after = tree.best[child] if child >= 0 else vectors.last[problem.outcome_mode[z]]
        room.follow[z - problem.choice_outcome[c]] = after
    look_ahead(problem, c, size, vectors.alpha, room.follow, room.alpha, room.reached)
    tree.counts[2] += size * (problem.choice_outcome[c + 1] - problem.choice_outcome[c])
    value = 0.0
    for y in range(size):
        value += room.alpha[y] * tree.belief[i, y]
    if value <= tree.lower[i] + least:
        return best, False
    j = add_vector(vectors, x, c, room.alpha, room.follow)
    tree.lower[i] = value
    tree.best[i] = j
    return best, True


@kernel
def _predict(tree: Tree, problem: ProblemArrays, bins: Bins, i: int) -> float:
    """Predicted value of a node; its part in the bins is brought up to date."""
    x = tree.mode[i]
    size = problem.mode_size[x]
    if bins.bin[i, 0] < 0:
        entropy = 0.0
        for y in range(size):
            b = tree.belief[i, y]
            if b > 0.0:
                entropy -= b * np.log(b)
        flat = entropy / np.log(size) if size > 1 else 0.0
        span = bins.highest[x] - bins.lowest[x]
        height = (tree.upper[i] - bins.lowest[x]) / span if span > 0.0 else 0.0
        flat = min(max(flat, 0.0), 1.0 - 1e-12)
        height = min(max(height, 0.0), 1.0 - 1e-12)
        bins.bin[i, 0] = int(flat * COARSE) * COARSE + int(height * COARSE)
        bins.bin[i, 1] = int(flat * FINE) * FINE + int(height * FINE)
        for level in range(2):
            place = bins.bin[i, level]
            if bins.members[x, level, place] > 0:
                guess = bins.total[x, level, place] / bins.members[x, level, place]
                bins.error[x, level, place] += (guess - tree.lower[i]) ** 2
            bins.members[x, level, place] += 1
            bins.total[x, level, place] += tree.lower[i]
        bins.counted[i] = tree.lower[i]
    elif tree.lower[i] != bins.counted[i]:
        for level in range(2):
            bins.total[x, level, bins.bin[i, level]] += tree.lower[i] - bins.counted[i]
        bins.counted[i] = tree.lower[i]
    level = 1 if bins.error[x, 1, bins.bin[i, 1]] < bins.error[x, 0, bins.bin[i, 0]] else 0
    place = bins.bin[i, level]
    if bins.members[x, level, place] <= 1:
        return tree.upper[i]
    return min(tree.upper[i], max(tree.lower[i], bins.total[x, level, place] / bins.members[x, level, place]))


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
    tree.counts[3] += 1
    scale = 1.0  # discount to the power of the depth; gaps are compared after it, which cannot overflow
    while steps < DEEPEST:
        size = problem.mode_size[tree.mode[i]]
        look_up(tree, vectors, i, size)
        look_down(tree, i, size)
        j = back_up_upper(tree, problem, i, room)
        if j < 0:
            break
        bins.trial[i] = tree.counts[3]
        room.path[steps] = i
        steps += 1
        # Looking at what is known already is work too, or a portion of deep trials would take minutes.
        tree.counts[2] += 50 + size
        gap = tree.upper[i] - tree.lower[i]
        if gap * scale <= 0.5 * aim:
            break
        guess = _predict(tree, problem, bins, i)
        if guess <= floor and tree.upper[i] <= max(ceiling, tree.lower[i] + aim / scale):
            break
        x = tree.mode[i]
        c = problem.mode_choice[x] + j
        first = problem.choice_outcome[problem.mode_choice[x]]
        chosen = -1
        most = -np.inf
        newer = False
        low = 0.0
        high = 0.0
        for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
            p = tree.probability[i, z]
            if p > 0.0:
                child = tree.child[i, z]
                look_up(tree, vectors, child, problem.mode_size[tree.mode[child]])
                low += p * tree.lower[child]
                high += p * tree.upper[child]
                excess = p * ((tree.upper[child] - tree.lower[child]) * scale * discount - aim)
                # Beliefs that this trial has not been at go first: with a discount near one, going round in a
                # circle looks as good at every turn.
                fresh = bins.trial[child] != tree.counts[3] and excess > 0.0
                if (fresh and not newer) or (fresh == newer and excess > most):
                    most = excess
                    chosen = z
                    newer = fresh
        reward = choice_reward(tree, problem, i, j)
        value = reward + discount * low
        floor = max(floor, value)
        ceiling = max(ceiling, value + aim / scale)
        child = tree.child[i, chosen]
        p = tree.probability[i, chosen]
        floor = ((floor - reward) / discount - (low - p * tree.lower[child])) / p
        ceiling = ((ceiling - reward) / discount - (high - p * tree.upper[child])) / p
        i = child
        scale *= discount
    room_left = True
    for step in range(steps - 1, -1, -1):
        i = room.path[step]
        if back_up_upper(tree, problem, i, room) < 0:
            room_left = False
        add_point(tree, problem, i)
        back_up_lower(tree, problem, vectors, i, 1e-12 * abs(tree.lower[i]), room)
    return room_left and steps > 0


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
        if tree.counts[2] > end:
            return 1
        if not trial(tree, problem, vectors, bins, roots[root], wanted, room):
            return 2
        tree.counts[2] += 50


@kernel
def tidy_points(tree: Tree) -> None:
    """Drop sawtooth points that newer ones of the same node supersede."""
    before = tree.counts[1]
    latest = np.full(tree.counts[0], -1, dtype=np.int64)
    for j in range(before):
        latest[tree.point_node[j]] = j
    kept = 0
    tree.point_last[:] = -1
    for j in range(before):
        i = tree.point_node[j]
        if latest[i] == j and tree.point_depth[j] < -1e-10:
            tree.point_node[kept] = i
            tree.point_depth[kept] = tree.point_depth[j]
            tree.point_previous[kept] = tree.point_last[tree.mode[i]]
            tree.point_last[tree.mode[i]] = kept
            kept += 1
    tree.counts[1] = kept
    for i in range(tree.counts[0]):
        # Nodes that knew all points still do; the others look at everything once more.
        tree.seen_points[i] = kept if tree.seen_points[i] == before else 0


@kernel
def tidy_vectors(tree: Tree, problem: ProblemArrays, vectors: Vectors) -> None:
    """Drop vectors that are best at no node and followed by none that is."""
    before = vectors.counts[0]
    useful = np.zeros(before, dtype=np.bool_)
    for i in range(tree.counts[0]):
        if tree.best[i] >= 0:
            useful[tree.best[i]] = True
    number = keep_useful(vectors, problem, useful)
    for i in range(tree.counts[0]):
        if tree.best[i] >= 0:
            tree.best[i] = number[tree.best[i]]
        tree.seen_vectors[i] = vectors.counts[0] if tree.seen_vectors[i] == before else 0
