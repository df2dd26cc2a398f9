r"""One step of a problem, compiled: beliefs after an action, and the value of an action given what follows.

For a choice `c` with branches `k` into mode :math:`x'_k` and outcomes `z` of the branch,

.. math::
   \tau_z(y') \propto e_z(y') \sum_y b(y)\, T_k(y, y'), \qquad
   \alpha(y) = R_c(y) + \gamma \sum_k \sum_{y'} T_k(y, y') \sum_{z \in k} e_z(y')\, \alpha_z(y')

with :math:`e_z = 1` where the branch has one outcome for certain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, ProblemArrays

POSSIBLE = 1e-200
"""Outcomes less probable than this are taken for impossible; what they are worth is lost to an upper bound."""


@kernel
def expected_reward(problem: ProblemArrays, choice: int, belief: Array, size: int) -> float:
    r""":math:`\sum_y b(y) R_c(y)`."""
    total = 0.0
    for y in range(size):
        total += belief[y] * problem.reward[choice, y]
    return total


@kernel
def successors(
    problem: ProblemArrays,
    choice: int,
    belief: Array,
    size: int,
    beliefs: Array,
    probability: Array,
    reached: Array,
) -> None:
    """Belief and probability after every outcome of a choice.

    Parameters
    ----------
    problem : ProblemArrays
    choice, size : int
        The choice, and the number of hidden states of its mode.
    belief : float64[w]
    beliefs : float64[z, w]
        Filled: normalised beliefs, one row an outcome; zero where the outcome is impossible.
    probability : float64[z]
        Filled; zero where it is not above `POSSIBLE`.
    reached : float64[w]
        Scratch.
    """
    first = problem.choice_outcome[choice]
    for k in range(problem.choice_branch[choice], problem.choice_branch[choice + 1]):
        n = problem.mode_size[problem.branch_mode[k]]
        reached[:n] = 0.0
        row = problem.branch_row[k]
        for y in range(size):
            weight = belief[y]
            if weight != 0.0:
                for e in range(problem.row_start[row + y], problem.row_start[row + y + 1]):
                    reached[problem.column[e]] += weight * problem.value[e]
        begin = problem.branch_outcome[k] - first
        end = problem.branch_outcome[k + 1] - first
        seen = problem.branch_seen[k]
        if seen < 0:
            beliefs[begin, :n] = reached[:n]
        else:
            beliefs[begin:end, :n] = 0.0
            for y in range(n):
                if reached[y] != 0.0:
                    for e in range(problem.seen_start[seen + y], problem.seen_start[seen + y + 1]):
                        beliefs[begin + problem.seen_outcome[e], y] = reached[y] * problem.seen_value[e]
        for z in range(begin, end):
            total = 0.0
            for y in range(n):
                total += beliefs[z, y]
            if total > POSSIBLE:
                probability[z] = total
                for y in range(n):
                    beliefs[z, y] /= total
            else:
                probability[z] = 0.0
                beliefs[z, :n] = 0.0


@kernel
def look_ahead(
    problem: ProblemArrays,
    choice: int,
    size: int,
    vectors: Array,
    follow: NDArray[np.int32],
    out: Array,
    after: Array,
) -> None:
    """Value of a choice in every hidden state, when each outcome is followed by a vector.

    Parameters
    ----------
    problem : ProblemArrays
    choice, size : int
    vectors : float64[i, w]
    follow : int32[z]
        Which vector follows each outcome of the choice.
    out : float64[w]
        Filled.
    after : float64[w]
        Scratch.
    """
    first = problem.choice_outcome[choice]
    for y in range(size):
        out[y] = problem.reward[choice, y]
    for k in range(problem.choice_branch[choice], problem.choice_branch[choice + 1]):
        n = problem.mode_size[problem.branch_mode[k]]
        begin = problem.branch_outcome[k] - first
        seen = problem.branch_seen[k]
        if seen < 0:
            for y in range(n):
                after[y] = vectors[follow[begin], y]
        else:
            for y in range(n):
                total = 0.0
                for e in range(problem.seen_start[seen + y], problem.seen_start[seen + y + 1]):
                    total += problem.seen_value[e] * vectors[follow[begin + problem.seen_outcome[e]], y]
                after[y] = total
        row = problem.branch_row[k]
        for y in range(size):
            total = 0.0
            for e in range(problem.row_start[row + y], problem.row_start[row + y + 1]):
                total += problem.value[e] * after[problem.column[e]]
            out[y] += problem.discount * total
