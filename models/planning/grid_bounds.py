r"""Upper bounds on an adaptive grid, compiled.

Values at grid points and an interpolation for every belief that may follow a point make a finite decision problem
of its own; its value at the points is an upper bound of the true one (Lovejoy 1991), and so is every value on the
way down to it. Interpolations are *frozen*: worked out once, looked up again only when the grid has been refined.

Modes without a grid of their own (`models.planning.grid_modes`) are met as *exact* nodes: one belief each, its
value one step ahead. Starting beliefs are exact too. What a choice is worth is convex in the belief as the optimum
is, so a new point inherits bounds of its choices from the points around it, and choices that fall short are never
opened.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.grid_modes import passing_modes
from models.planning.simplex_grid import FINEST, Scratch, cell, find, interpolation, point_belief, rehash
from models.planning.step_kernel import expected_reward, successors

NEW = 1e-300
"""Share of a point whose visits have not been worked out: no weight, but not left out either."""


class Grid(NamedTuple):
    """Points of the grid, their values, and where their successors are interpolated.

    Attributes
    ----------
    counts : int64[1]
        Nodes in use: grid points, and exact nodes, which are no grid points.
    exact : bool[x]
        Modes that are met as exact nodes only.
    table : int32[h]
        Hash table of the points, `h` a power of two.
    points : int64[i, w]
        Coordinates at the finest level; zero for exact nodes.
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
    opened : bool[i, a]
        Whether successors of a choice have been worked out.
    greedy : int32[i]
        The choice that looks best, counted within the mode.
    start : int32[i]
        Level at which to begin to look for the cells of its successors.
    """

    counts: Index
    exact: NDArray[np.bool_]
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
    opened: NDArray[np.bool_]
    greedy: NDArray[np.int32]
    start: NDArray[np.int32]


def empty_grid(problem: ProblemArrays, capacity: int) -> Grid:
    """A grid without points, with room for so many."""
    width = problem.reward.shape[1]
    actions = int(np.diff(problem.mode_choice).max())
    outcomes = int(np.diff(problem.choice_outcome[problem.mode_choice]).max())
    slots = 1 << int(2 * capacity - 1).bit_length()
    return Grid(
        np.zeros(1, dtype=np.int64), passing_modes(problem), np.full(slots, -1, dtype=np.int32),
        np.zeros((capacity, width), dtype=np.int64), np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, width)), np.zeros(capacity), np.zeros((capacity, actions)),
        np.zeros((capacity, outcomes)), np.zeros((capacity, outcomes, width)),
        np.zeros((capacity, outcomes), dtype=np.int32), np.zeros((capacity, outcomes), dtype=np.int32),
        np.zeros((capacity, outcomes, width), dtype=np.int32), np.zeros((capacity, outcomes, width)),
        np.zeros(capacity), np.zeros((capacity, actions)), np.zeros((capacity, actions), dtype=np.bool_),
        np.zeros(capacity, dtype=np.int32), np.zeros(capacity, dtype=np.int32),
    )  # fmt: skip


def grown_grid(grid: Grid, problem: ProblemArrays, capacity: int) -> Grid:
    """The same grid with more room."""
    new = empty_grid(problem, capacity)
    n = int(grid.counts[0])
    for name in Grid._fields:
        if name not in ("counts", "exact", "table"):
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
        j = grid.greedy[i]
        if problem.halt[0] != 0:
            break
        if grid.share[i] == 0.0 or not grid.opened[i, j]:
            continue
        x = grid.mode[i]
        first = problem.choice_outcome[problem.mode_choice[x]]
        c = problem.mode_choice[x] + j
        for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
            mode = problem.outcome_mode[first + z]
            if grid.probability[i, z] > 0.0 and not grid.exact[mode]:
                refreeze(grid, problem, i, z, mode, grid.level[i, z] + 1, scratch)


@kernel
def new_node(grid: Grid, problem: ProblemArrays, mode: int, upper: float, share: float) -> int:
    """The next node, its choices not opened, nothing known of them; its belief is the caller's to fill."""
    i = grid.counts[0]
    grid.counts[0] += 1
    grid.points[i] = 0
    grid.mode[i] = mode
    grid.belief[i] = 0.0
    grid.upper[i] = upper
    grid.share[i] = share
    grid.greedy[i] = 0
    grid.opened[i] = False
    grid.ahead[i] = np.inf
    grid.probability[i] = 0.0
    return i


@kernel
def open_choice(grid: Grid, problem: ProblemArrays, i: int, j: int, scratch: Scratch) -> bool:
    """Work out reward and successors of a choice and freeze their interpolations; False if there is no room."""
    x = grid.mode[i]
    size = problem.mode_size[x]
    c = problem.mode_choice[x] + j
    first = problem.choice_outcome[problem.mode_choice[x]]
    begin = problem.choice_outcome[c] - first
    end = problem.choice_outcome[c + 1] - first
    if grid.counts[0] + end - begin > len(grid.upper):
        return False
    grid.reward[i, j] = expected_reward(problem, c, grid.belief[i], size)
    successors(
        problem, c, grid.belief[i], size, grid.after[i, begin:end], grid.probability[i, begin:end], scratch.reached
    )
    for z in range(begin, end):
        if grid.probability[i, z] > 0.0:
            mode = problem.outcome_mode[first + z]
            if grid.exact[mode]:
                node = new_node(grid, problem, mode, np.inf, NEW)
                grid.belief[node] = grid.after[i, z]
                grid.start[node] = grid.start[i]
                grid.corners[i, z] = 1
                grid.vertex[i, z, 0] = node
                grid.weight[i, z, 0] = 1.0
            else:
                grid.level[i, z] = -1
                refreeze(grid, problem, i, z, mode, grid.start[i], scratch)
    grid.opened[i, j] = True
    return True


@kernel
def add_corners(grid: Grid, problem: ProblemArrays, upper: float) -> None:
    """Start with the corners of every mode that has a grid, all at one upper bound."""
    for x in range(len(problem.mode_size)):
        if grid.exact[x]:
            continue
        for y in range(problem.mode_size[x]):
            # Visits are unknown: for ever, until they are worked out.
            i = new_node(grid, problem, x, upper, 1.0 / (1.0 - problem.discount))
            for j in range(y + 1):
                grid.points[i, j] = 1 << FINEST
            grid.belief[i, y] = 1.0
            grid.start[i] = 0
            free = find(grid.table, grid.points, grid.mode, grid.points[i], problem.mode_size[x], x)
            grid.table[-1 - free] = i


@kernel
def add_root(grid: Grid, problem: ProblemArrays, mode: int, belief: Array, upper: float) -> None:
    """Add a starting belief, exact in itself; roots come after the corners and before any refinement."""
    i = new_node(grid, problem, mode, upper, 1.0)
    grid.belief[i] = belief
    grid.start[i] = 0


@kernel
def refine(grid: Grid, problem: ProblemArrays, mode: int, belief: Array, level: int, scratch: Scratch) -> bool:
    """Add what is missing of the cell of a belief at a level; False if there is no room."""
    if level > FINEST:
        return True  # there is nothing finer; what is lost in that cell stays lost
    n = problem.mode_size[mode]
    offered = problem.mode_choice[mode + 1] - problem.mode_choice[mode]
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
        i = new_node(grid, problem, mode, np.inf, NEW)
        grid.points[i, :n] = corner
        point_belief(corner, n, grid.belief[i])
        # A new point starts at what the grid says of it before it is there, and so do its choices. It looks for
        # cells of its successors from the level before on: fine cells are mostly followed by fine ones.
        grid.start[i] = level - 1
        for coarser in range(level - 1, -1, -1):
            count = interpolation(
                grid.table, grid.points, grid.mode, grid.belief[i], n, mode, coarser, scratch
            )  # fmt: skip
            if count > 0:
                grid.upper[i] = 0.0
                grid.ahead[i, :offered] = 0.0
                for v in range(count):
                    weight = scratch.weights[v]
                    grid.upper[i] += weight * grid.upper[scratch.vertices[v]]
                    for j in range(offered):
                        grid.ahead[i, j] += weight * grid.ahead[scratch.vertices[v], j]
                break
        grid.table[-1 - free] = i
    return True
