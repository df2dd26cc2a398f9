r"""Upper bounds on an adaptive grid, compiled.

Values at grid points and an interpolation for every belief that may follow a point make a finite decision problem
of its own; its value at the points is an upper bound of the true one (Lovejoy 1991), and so is every value on the
way down to it. Interpolations are *frozen*: worked out once, looked up again only when the grid has been refined.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.simplex_grid import (
    FINEST,
    Scratch,
    cell,
    find,
    interpolation,
    new_scratch,
    point_belief,
    rehash,
)
from models.planning.step_kernel import expected_reward, successors

NEW = 1e-300
"""Share of a point whose visits have not been worked out: no weight, but not left out either."""


class Grid(NamedTuple):
    """Points of the grid, their values, and where their successors are interpolated.

    Attributes
    ----------
    counts : int64[1]
        Points in use, starting beliefs among them, which are no grid points.
    table : int32[h]
        Hash table of the points, `h` a power of two.
    points : int64[i, w]
        Coordinates at the finest level; zero for roots.
    mode : int64[i]
    belief : float64[i, w]
    upper : float64[i]
        Upper bound of the value.
    reward : float64[i, a]
        Expected reward of each choice of the mode.
    probability : float64[i, z]
        Of every outcome of every choice of the mode, zero where impossible.
    after : float64[i, z, w]
        Belief after each.
    level : int32[i, z]
        Level of the cell it is interpolated in.
    corners : int32[i, z]
        How many vertices that has.
    vertex, weight : int32[i, z, w], float64[i, z, w]
    share : float64[i]
        Discounted number of visits from the root under the choices that look best.
    ahead : float64[i, a]
        Upper bound of each choice, as of when it was last looked at.
    greedy : int32[i]
        The choice that looks best, counted within the mode.
    """

    counts: Index
    table: NDArray[np.int32]
    points: Index
    mode: Index
    belief: Array
    upper: Array
    reward: Array
    probability: Array
    after: Array
    level: NDArray[np.int32]
    corners: NDArray[np.int32]
    vertex: NDArray[np.int32]
    weight: Array
    share: Array
    ahead: Array
    greedy: NDArray[np.int32]


def empty_grid(problem: ProblemArrays, capacity: int) -> Grid:
    """A grid without points, with room for so many."""
    width = problem.reward.shape[1]
    actions = int(np.diff(problem.mode_choice).max())
    outcomes = int(np.diff(problem.choice_outcome[problem.mode_choice]).max())
    slots = 1 << int(2 * capacity - 1).bit_length()
    return Grid(
        np.zeros(1, dtype=np.int64), np.full(slots, -1, dtype=np.int32),
        np.zeros((capacity, width), dtype=np.int64), np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, width)), np.zeros(capacity), np.zeros((capacity, actions)),
        np.zeros((capacity, outcomes)), np.zeros((capacity, outcomes, width)),
        np.zeros((capacity, outcomes), dtype=np.int32), np.zeros((capacity, outcomes), dtype=np.int32),
        np.zeros((capacity, outcomes, width), dtype=np.int32), np.zeros((capacity, outcomes, width)),
        np.zeros(capacity), np.zeros((capacity, actions)), np.zeros(capacity, dtype=np.int32),
    )  # fmt: skip


def grown_grid(grid: Grid, problem: ProblemArrays, capacity: int) -> Grid:
    """The same grid with more room."""
    new = empty_grid(problem, capacity)
    n = int(grid.counts[0])
    for name in Grid._fields:
        if name not in ("counts", "table"):
            getattr(new, name)[:n] = getattr(grid, name)[:n]
    new.counts[:] = grid.counts
    rehash(new.table, new.points, new.mode, problem.mode_size, n)
    return new


@kernel
def frozen(grid: Grid, i: int, z: int) -> float:
    """Upper bound after an outcome, by its frozen interpolation."""
    total = 0.0
    for k in range(grid.corners[i, z]):
        total += grid.weight[i, z, k] * grid.upper[grid.vertex[i, z, k]]
    return total


@kernel
def refreeze(
    grid: Grid, problem: ProblemArrays, i: int, z: int, mode: int, from_level: int, scratch: Scratch
) -> None:
    """Interpolate the belief after an outcome in the finest cell there is, looking from a level on.

    If the grid has no such cell at that level, coarser ones are tried, down to the mode's corners.
    """
    n = problem.mode_size[mode]
    level = min(from_level, FINEST)
    step = 0
    while 0 <= level <= FINEST:
        count = interpolation(grid.table, grid.points, grid.mode, grid.after[i, z], n, mode, level, scratch)
        if count == 0:
            if step == 1 or level - 1 <= grid.level[i, z]:
                break
            step = -1
        else:
            grid.level[i, z] = level
            grid.corners[i, z] = count
            for k in range(count):
                grid.vertex[i, z, k] = scratch.vertices[k]
                grid.weight[i, z, k] = scratch.weights[k]
            if step == -1:
                break
            step = 1
        level += step


@kernel
def look_up_again(grid: Grid, problem: ProblemArrays, scratch: Scratch) -> None:
    """After a refinement: the interpolations that matter move to finer cells where there are some now.

    Only those of choices that look best: others are bounded by what was known of them before, and looked up when
    that comes out on top.
    """
    for i in range(grid.counts[0]):
        if grid.share[i] == 0.0:
            continue
        x = grid.mode[i]
        first = problem.choice_outcome[problem.mode_choice[x]]
        c = problem.mode_choice[x] + grid.greedy[i]
        for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
            if grid.probability[i, z] > 0.0:
                refreeze(grid, problem, i, z, problem.outcome_mode[first + z], grid.level[i, z] + 1, scratch)


@kernel
def step_point(grid: Grid, problem: ProblemArrays, i: int, level: int, scratch: Scratch) -> None:
    """Work out rewards and successors of a new point whose belief is set, and freeze their interpolations.

    `level` is where to begin to look for their cells: fine cells are mostly followed by fine ones.
    """
    x = grid.mode[i]
    size = problem.mode_size[x]
    first = problem.choice_outcome[problem.mode_choice[x]]
    reached = np.empty(grid.belief.shape[1])
    for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
        grid.reward[i, c - problem.mode_choice[x]] = expected_reward(problem, c, grid.belief[i], size)
        grid.ahead[i, c - problem.mode_choice[x]] = np.inf
        begin = problem.choice_outcome[c] - first
        end = problem.choice_outcome[c + 1] - first
        successors(
            problem, c, grid.belief[i], size, grid.after[i, begin:end], grid.probability[i, begin:end], reached
        )
        for z in range(begin, end):
            if grid.probability[i, z] > 0.0:
                grid.level[i, z] = -1
                refreeze(grid, problem, i, z, problem.outcome_mode[first + z], level, scratch)


@kernel
def add_root(grid: Grid, problem: ProblemArrays, mode: int, belief: Array, upper: float) -> None:
    """Add a starting belief, exact in itself; roots come after the corners and before any refinement."""
    i = grid.counts[0]
    grid.counts[0] += 1
    grid.points[i] = 0
    grid.mode[i] = mode
    grid.belief[i] = belief
    grid.upper[i] = upper
    grid.share[i] = 1.0  # until it is worked out; left at zero it would not even be swept
    grid.greedy[i] = 0
    step_point(grid, problem, i, 0, new_scratch(grid.belief.shape[1]))


@kernel
def add_corners(grid: Grid, problem: ProblemArrays, upper: float) -> None:
    """Start with the corners of every mode, all at one upper bound."""
    scratch = new_scratch(grid.belief.shape[1])
    for x in range(len(problem.mode_size)):
        for y in range(problem.mode_size[x]):
            i = grid.counts[0]
            grid.counts[0] += 1
            grid.points[i] = 0
            for j in range(y + 1):
                grid.points[i, j] = 1 << FINEST
            grid.mode[i] = x
            grid.belief[i] = 0.0
            grid.belief[i, y] = 1.0
            grid.upper[i] = upper
            free = find(grid.table, grid.points, grid.mode, grid.points[i], problem.mode_size[x], x)
            grid.table[-1 - free] = i
    for i in range(grid.counts[0]):
        grid.share[i] = 1.0 / (1.0 - problem.discount)  # until they are worked out
        grid.greedy[i] = 0
        step_point(grid, problem, i, 0, scratch)


@kernel
def refine(grid: Grid, problem: ProblemArrays, mode: int, belief: Array, level: int, scratch: Scratch) -> bool:
    """Add what is missing of the cell of a belief at a level; False if there is no room."""
    n = problem.mode_size[mode]
    order = np.empty(n, dtype=np.int64)
    more = cell(belief, n, level, scratch.base, scratch.fraction, order)
    shift = FINEST - level
    corner = scratch.base[:n] << shift
    for k in range(more + 1):
        if k > 0:
            corner[order[k - 1]] += 1 << shift
        free = find(grid.table, grid.points, grid.mode, corner, n, mode)
        if free >= 0:
            continue
        if grid.counts[0] >= len(grid.upper):
            return False
        i = grid.counts[0]
        grid.points[i] = 0
        grid.points[i, :n] = corner
        grid.mode[i] = mode
        grid.belief[i] = 0.0
        point_belief(corner, n, grid.belief[i])
        # A new point starts at what the grid says of it before it is there.
        value = np.inf
        for coarser in range(level - 1, -1, -1):
            count = interpolation(
                grid.table, grid.points, grid.mode, grid.belief[i], n, mode, coarser, scratch
            )  # fmt: skip
            if count > 0:
                value = 0.0
                for j in range(count):
                    value += scratch.weights[j] * grid.upper[scratch.vertices[j]]
                break
        grid.upper[i] = value
        grid.share[i] = NEW
        grid.greedy[i] = 0
        grid.table[-1 - free] = i
        grid.counts[0] += 1
        step_point(grid, problem, i, level - 1, scratch)
    return True


@kernel
def lower_point(grid: Grid, problem: ProblemArrays, i: int) -> float:
    """Bring a point down to the best of one step ahead; returns by how much it fell.

    Bounds of choices only fall, so a choice is looked at again only while what was last known of it is the best.
    """
    x = grid.mode[i]
    offered = problem.mode_choice[x + 1] - problem.mode_choice[x]
    first = problem.choice_outcome[problem.mode_choice[x]]
    fresh = -1
    while True:
        j = 0
        for k in range(1, offered):
            if grid.ahead[i, k] > grid.ahead[i, j]:
                j = k
        if j == fresh:
            break
        c = problem.mode_choice[x] + j
        value = grid.reward[i, j]
        for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
            p = grid.probability[i, z]
            if p > 0.0:
                value += problem.discount * p * frozen(grid, i, z)
        # Rounding must not let two choices take turns for ever.
        grid.ahead[i, j] = min(grid.ahead[i, j], value)
        fresh = j
    grid.greedy[i] = fresh
    fall = grid.upper[i] - grid.ahead[i, fresh]
    if fall > 0.0:
        grid.upper[i] = grid.ahead[i, fresh]
        return fall
    return 0.0


@kernel
def visit_shares(grid: Grid, problem: ProblemArrays, weight: Array, first_root: int, tolerance: float) -> None:
    r"""Discounted number of visits of every point under the greedy choices, from roots with weights.

    Solves :math:`\rho = e + \gamma P^\top \rho` by pushing what has not been passed on, until less than `tolerance`
    of a visit is left over.
    """
    n = grid.counts[0]
    left = np.zeros(n)
    grid.share[:n] = 0.0
    for r in range(len(weight)):
        left[first_root + r] = weight[r]
    small = tolerance / (4.0 * n)
    for _ in range(1000):
        total = 0.0
        for i in range(n):
            mass = left[i]
            if mass <= small:
                continue
            left[i] = 0.0
            grid.share[i] += mass
            total += mass
            x = grid.mode[i]
            c = problem.mode_choice[x] + grid.greedy[i]
            first = problem.choice_outcome[problem.mode_choice[x]]
            for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
                p = problem.discount * mass * grid.probability[i, z]
                if p > 0.0:
                    for k in range(grid.corners[i, z]):
                        left[grid.vertex[i, z, k]] += p * grid.weight[i, z, k]
        if total <= tolerance:
            break
