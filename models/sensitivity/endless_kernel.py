r"""One decision without a horizon, compiled: bounds of what each action is worth, driven apart until one is best.

What an action `a` is worth at a belief `b` in a mode `x` is one step and the best that can follow it,

.. math:: Q(b, a) = \sum_y b(y) R(a, y) + \gamma \sum_z P(z \mid b, a)\, V^*(x_z, b_z)

so bounds of :math:`V^*` at the beliefs that the actions lead to are bounds of :math:`Q`. The adaptive grid
(`models.planning.grid_solver`) starts from all of these beliefs at once, and stops as soon as the lower bound of
one action lies above the upper bounds of all others: a proof that it is best. Near a tie that takes long, and
bounds that have come as close as was asked leave the decision open.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.arrays import Array, ProblemArrays
from models.planning.grid_bounds import add_corners, add_root
from models.planning.grid_run import GridRun, first_vectors
from models.planning.grid_solver import GO_ON, advance
from models.planning.step_kernel import expected_reward, successors
from models.planning.vectors import best_vector

OPEN = -1
"""In place of an action: the bounds do not say which is best."""


@kernel
def certain_choice(lower: Array, upper: Array) -> int:
    """The choice whose lower bound lies above all other upper bounds; `OPEN` if there is none."""
    best = 0
    for c in range(1, len(lower)):
        if lower[c] > lower[best]:
            best = c
    for c in range(len(lower)):
        if c != best and not lower[best] > upper[c]:
            return OPEN
    return best


@kernel
def decide(
    problem: ProblemArrays, run: GridRun, mode: int, belief: Array, tolerance: float, rounds: int, warm: int,
    lower: Array, upper: Array,
) -> int:  # fmt: skip
    """Bounds of what each choice is worth at a belief, and the choice that they prove best.

    Parameters
    ----------
    problem : ProblemArrays
    run : GridRun
        What it held before is forgotten, but for warm vectors.
    mode : int
    belief : float64[w]
    tolerance : float
        Bounds that lie no further apart than this leave the decision open.
    rounds : int
        At most.
    warm : int
        So many vectors of another problem's policy graph are kept and valued anew in this one; 0 for none.
    lower, upper : float64[c]
        Filled: bounds of each choice of the mode.

    Returns
    -------
    int
        Number of the choice within its mode, or `OPEN`.
    """
    grid, vectors = run.grid, run.vectors
    size = problem.mode_size[mode]
    width = len(belief)
    first = problem.mode_choice[mode]
    count = problem.mode_choice[mode + 1] - first
    begin = problem.choice_outcome[first]
    total = problem.choice_outcome[first + count] - begin
    after = np.zeros((total, width))
    probability = np.zeros(total)
    reached = np.empty(width)
    now = np.empty(count)
    for c in range(count):
        now[c] = expected_reward(problem, first + c, belief, size)
        z0, z1 = problem.choice_outcome[first + c] - begin, problem.choice_outcome[first + c + 1] - begin
        successors(problem, first + c, belief, size, after[z0:z1], probability[z0:z1], reached)
    grid.counts[:] = 0
    grid.table[:] = -1
    run.rounds[0] = 0
    top = first_vectors(problem, vectors, warm) / (1.0 - problem.discount)
    add_corners(grid, problem, top)
    first_root = grid.counts[0]
    possible = 0
    for z in range(total):
        if probability[z] > 0.0:
            possible += 1
    weight = np.empty(possible)
    root = 0
    for z in range(total):
        if probability[z] > 0.0:
            add_root(grid, problem, problem.outcome_mode[begin + z], after[z], top)
            weight[root] = problem.discount * probability[z]
            root += 1
    status = GO_ON
    while True:
        if run.rounds[0] > 0:
            # The weighted gap of all roots bounds that of each action.
            status = advance(problem, grid, vectors, weight, first_root, tolerance, False, run.bounds)
        root = first_root
        for c in range(count):
            lower[c] = now[c]
            upper[c] = now[c]
            for z in range(
                problem.choice_outcome[first + c] - begin, problem.choice_outcome[first + c + 1] - begin
            ):
                if probability[z] > 0.0:
                    x = problem.outcome_mode[begin + z]
                    _, low = best_vector(vectors, x, after[z], problem.mode_size[x])
                    share = problem.discount * probability[z]
                    lower[c] += share * low
                    upper[c] += share * max(low, grid.upper[root])
                    root += 1
        found = certain_choice(lower, upper)
        if found != OPEN or status != GO_ON or run.rounds[0] >= rounds or problem.halt[0] != 0:
            return found
        run.rounds[0] += 1
