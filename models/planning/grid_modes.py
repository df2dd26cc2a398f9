r"""Modes that need no grid: passed through on the way from one grid point to the next.

Where a round shows nothing, as when the robot is the one that helps, the belief after it is one known belief, and
its value is best written as one more step ahead, exactly, rather than interpolated between points of that mode.
With alternating modes this takes away half of the points and half of what interpolation loses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.planning.arrays import ProblemArrays


def passing_modes(problem: ProblemArrays) -> NDArray[np.bool_]:
    """Which modes are passed through: never twice in a row, and each choice leads there with one outcome at most.

    No passing mode follows another, so that whatever is left on the grid is two steps away at most. Modes with one
    hidden state are left alone: there is nothing to interpolate, and one point stands for all visits.
    """
    n_modes = len(problem.mode_size)
    ways = np.zeros((n_modes, n_modes), dtype=np.int64)
    for x in range(n_modes):
        for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
            outcomes = problem.outcome_mode[problem.choice_outcome[c] : problem.choice_outcome[c + 1]]
            ways[x] = np.maximum(ways[x], np.bincount(outcomes, minlength=n_modes))
    passing = np.zeros(n_modes, dtype=np.bool_)
    for x in range(n_modes):
        beside = passing & ((ways[x] > 0) | (ways[:, x] > 0))
        passing[x] = problem.mode_size[x] > 1 and ways[x, x] == 0 and ways[:, x].max() <= 1 and not beside.any()
    return passing
