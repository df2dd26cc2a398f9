r"""The value of a policy graph, solved for at once, compiled.

Every sweep over a graph closes a share :math:`1 - \gamma` of what its values are short of: a ten-thousandth at a
discount of .9999. The vectors that the best one leads to are mostly few. They follow only each other, so their
values are one linear system, and all vectors that lead there profit from the next sweep.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.dense_solve import dense_limit, eliminate
from models.planning.step_kernel import look_ahead
from models.planning.vectors import Vectors


@kernel
def solve_reachable(problem: ProblemArrays, vectors: Vectors, start: int) -> bool:
    r"""Bring a vector and all that follow it, however far on, up to their value; False if they are too many.

    As the solution of a system is only as good as rounding, one step ahead of it is looked at: where that falls
    short by `m` at most, :math:`v - m / (1 - \gamma)` is below the value for certain.
    """
    most = dense_limit(problem.discount)
    number = np.full(vectors.counts[0], -1, dtype=np.int64)
    members = np.empty(most + 1, dtype=np.int64)
    place = np.zeros(most + 2, dtype=np.int64)
    members[0] = start
    number[start] = 0
    count = 1
    k = 0
    while k < count:
        i = members[k]
        place[k + 1] = place[k] + problem.mode_size[vectors.mode[i]]
        if place[k + 1] > most:
            return False
        c = vectors.choice[i]
        for z in range(problem.choice_outcome[c + 1] - problem.choice_outcome[c]):
            j = vectors.follow[i, z]
            if number[j] < 0:
                if count > most:
                    return False
                number[j] = count
                members[count] = j
                count += 1
        k += 1
    n = place[count]
    matrix = np.zeros((n, n))
    right = np.empty(n)
    for k in range(count):
        _equations(problem, vectors, members[k], place[k], number, place, matrix, right)
    eliminate(matrix, right, n)
    width = vectors.alpha.shape[1]
    new = np.empty(width)
    after = np.empty(width)
    old = np.empty((count, width))
    for k in range(count):
        old[k] = vectors.alpha[members[k]]
        for y in range(place[k + 1] - place[k]):
            vectors.alpha[members[k], y] = right[place[k] + y]
    short = 0.0
    for k in range(count):
        i = members[k]
        size = place[k + 1] - place[k]
        look_ahead(problem, vectors.choice[i], size, vectors.alpha, vectors.follow[i], new, after)
        for y in range(size):
            short = max(short, vectors.alpha[i, y] - new[y])
    for k in range(count):
        for y in range(place[k + 1] - place[k]):
            value = vectors.alpha[members[k], y] - short / (1.0 - problem.discount)
            vectors.alpha[members[k], y] = max(old[k, y], value)
    return True


@kernel
def _equations(
    problem: ProblemArrays, vectors: Vectors, i: int, begin: int, number: Index, place: Index, matrix: Array,
    right: Array,
) -> None:  # fmt: skip
    r"""Rows of :math:`I - \gamma P` of one vector."""
    c = vectors.choice[i]
    first = problem.choice_outcome[c]
    size = problem.mode_size[vectors.mode[i]]
    for y in range(size):
        matrix[begin + y, begin + y] += 1.0
        right[begin + y] = problem.reward[c, y]
    for k in range(problem.choice_branch[c], problem.choice_branch[c + 1]):
        outcome = problem.branch_outcome[k] - first
        seen = problem.branch_seen[k]
        for y in range(size):
            row = problem.branch_row[k] + y
            for e in range(problem.row_start[row], problem.row_start[row + 1]):
                column = problem.column[e]
                weight = problem.discount * problem.value[e]
                if seen < 0:
                    to = place[number[vectors.follow[i, outcome]]]
                    matrix[begin + y, to + column] -= weight
                else:
                    for s in range(problem.seen_start[seen + column], problem.seen_start[seen + column + 1]):
                        to = place[number[vectors.follow[i, outcome + problem.seen_outcome[s]]]]
                        matrix[begin + y, to + column] -= weight * problem.seen_value[s]
