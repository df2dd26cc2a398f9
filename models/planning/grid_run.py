"""A problem with few hidden states solved from start to end in one compiled call, for batches in threads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.blind_policies import blind_vectors
from models.planning.grid_bounds import Grid, add_corners, add_root, empty_grid
from models.planning.grid_solver import GO_ON, advance
from models.planning.vectors import Vectors, empty_vectors, evaluate_closed

BLIND = 64
"""Blind policies tried: all combinations of choices up to that many, else one an action."""


def blind_slots(problem: ProblemArrays) -> int:
    """Vectors that the blind policies take."""
    offered = np.diff(problem.mode_choice)
    combinations = float(np.prod(offered.astype(float)))
    return len(offered) * int(combinations if combinations <= BLIND else offered.max())


class GridRun(NamedTuple):
    """What a solution works on; used again for the next problem of the same shape.

    Attributes
    ----------
    grid : Grid
    vectors : Vectors
    bounds : float64[2]
        Lower and upper bound at the start.
    rounds : int64[1]
    """

    grid: Grid
    vectors: Vectors
    bounds: Array
    rounds: Index


def new_run(problem: ProblemArrays, points: int, vectors: int) -> GridRun:
    """Room for a solution with so many grid points and vectors; for corners and a start in every mode at least."""
    points = max(points, int(problem.mode_size.sum()) + len(problem.mode_size))
    return GridRun(
        empty_grid(problem, points), empty_vectors(problem, vectors), np.zeros(2), np.zeros(1, dtype=np.int64)
    )


@kernel
def first_vectors(problem: ProblemArrays, vectors: Vectors, warm: int) -> float:
    """Value warm vectors anew and add the blind policies; returns the highest reward.

    Parameters
    ----------
    problem : ProblemArrays
    vectors : Vectors
        With free slots for the blind policies; what it held before is forgotten, but for warm vectors.
    warm : int
        So many vectors of another model's policy graph are kept, and valued in this one.
    """
    lowest = np.inf
    highest = -np.inf
    for x in range(len(problem.mode_size)):
        for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
            for y in range(problem.mode_size[x]):
                lowest = min(lowest, problem.reward[c, y])
                highest = max(highest, problem.reward[c, y])
    vectors.counts[0] = warm
    if warm > 0:
        # Numbers of another model are no bounds here; the policy graph is a policy everywhere.
        vectors.alpha[:warm] = lowest / (1.0 - problem.discount)
        evaluate_closed(problem, vectors, 0, 1e-9 * (highest - lowest) / (1.0 - problem.discount), 1000)
    else:
        vectors.last[:] = -1
    blind_vectors(problem, vectors, BLIND)
    return highest


@kernel
def begin(problem: ProblemArrays, run: GridRun, modes: Index, beliefs: Array, warm: int) -> int:
    """Set up corners, starting beliefs and blind policies; returns the number of the first starting belief.

    Parameters
    ----------
    problem : ProblemArrays
    run : GridRun
        What it held before is forgotten, but for warm vectors.
    modes : int64[r]
    beliefs : float64[r, w]
        Where the problem may start.
    warm : int
        So many vectors of another model's policy graph are kept and valued anew in this one.
    """
    grid = run.grid
    grid.counts[:] = 0
    grid.table[:] = -1
    run.rounds[0] = 0
    top = first_vectors(problem, run.vectors, warm) / (1.0 - problem.discount)
    add_corners(grid, problem, top)
    first_root = grid.counts[0]
    for r in range(len(modes)):
        add_root(grid, problem, modes[r], beliefs[r], top)
    return first_root


@kernel
def solve_run(
    problem: ProblemArrays, run: GridRun, modes: Index, beliefs: Array, weight: Array, precision: float,
    relative: bool, rounds: int, warm: int,
) -> int:  # fmt: skip
    """Solve a problem; returns what the last round said (`models.planning.grid_solver.advance`)."""
    first_root = begin(problem, run, modes, beliefs, warm)
    status = GO_ON
    while status == GO_ON and run.rounds[0] < rounds:
        status = advance(problem, run.grid, run.vectors, weight, first_root, precision, relative, run.bounds)
        run.rounds[0] += 1
    return status
