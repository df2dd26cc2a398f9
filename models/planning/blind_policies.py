"""Policies that look at the mode only: the lower bound that everything begins with, compiled."""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.arrays import ProblemArrays
from models.planning.dense_solve import LARGEST, eliminate
from models.planning.vectors import Vectors, add_vector, evaluate_closed

BLIND_WORK = 1e8
"""Multiplications that blind policies are worth."""


@kernel
def blind_vectors(problem: ProblemArrays, vectors: Vectors, most: int) -> None:
    r"""Add the policies that look at the mode only: all combinations of choices up to `most`, else one an action.

    With alternating modes these are the open-loop policies of period two.

    Parameters
    ----------
    problem : ProblemArrays
    vectors : Vectors
        With free slots for all modes of each policy.
    most : int

    Told to come back, it leaves off after the first policy at the earliest.
    """
    n_modes = len(problem.mode_size)
    lowest = np.inf
    highest = -np.inf
    for x in range(n_modes):
        for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
            for y in range(problem.mode_size[x]):
                lowest = min(lowest, problem.reward[c, y])
                highest = max(highest, problem.reward[c, y])
    start = np.full(problem.reward.shape[1], lowest / (1.0 - problem.discount))
    tolerance = 1e-9 * (highest - lowest) / (1.0 - problem.discount)
    combinations = 1
    deepest = 1
    for x in range(n_modes):
        offered = problem.mode_choice[x + 1] - problem.mode_choice[x]
        combinations = min(combinations * offered, most + 1)
        deepest = max(deepest, offered)
    every = combinations <= most
    follow = np.zeros(vectors.follow.shape[1], dtype=np.int32)
    states = problem.mode_size.sum()
    policies = combinations if every else deepest
    # Sound after every sweep, and large problems must not keep anybody waiting for digits.
    # What a sweep looks at is mostly what end states show, where a branch has few entries of its own.
    entries = 1.0 + len(problem.value) + len(problem.seen_value) + len(problem.row_start)
    sweeps = int(min(10_000.0, max(10.0, BLIND_WORK * deepest / (policies * entries))))
    for number in range(policies):
        if number > 0 and problem.halt[0] != 0:
            break
        first = vectors.counts[0]
        rest = number
        for x in range(n_modes):
            offered = problem.mode_choice[x + 1] - problem.mode_choice[x]
            pick = rest % offered if every else min(number, offered - 1)
            rest //= offered
            choice = problem.mode_choice[x] + pick
            begin = problem.choice_outcome[choice]
            for z in range(begin, problem.choice_outcome[choice + 1]):
                follow[z - begin] = first + problem.outcome_mode[z]
            add_vector(vectors, x, choice, start, follow)
        if states <= LARGEST:
            _solve_blind(problem, vectors, first)
        # Sound from whatever it starts: after the solution one sweep is the proof.
        evaluate_closed(problem, vectors, first, tolerance, sweeps)


@kernel
def _solve_blind(problem: ProblemArrays, vectors: Vectors, first: int) -> None:
    """Values of a policy with one vector a mode, from number `first` on, by one linear system."""
    n_modes = len(problem.mode_size)
    place = np.zeros(n_modes + 1, dtype=np.int64)
    for x in range(n_modes):
        place[x + 1] = place[x] + problem.mode_size[x]
    n = place[n_modes]
    matrix = np.zeros((n, n))
    right = np.empty(n)
    for x in range(n_modes):
        c = vectors.choice[first + x]
        for y in range(problem.mode_size[x]):
            i = place[x] + y
            matrix[i, i] = 1.0
            right[i] = problem.reward[c, y]
        for k in range(problem.choice_branch[c], problem.choice_branch[c + 1]):
            seen = problem.branch_seen[k]
            to = place[problem.branch_mode[k]]
            for y in range(problem.mode_size[x]):
                row = problem.branch_row[k] + y
                for e in range(problem.row_start[row], problem.row_start[row + 1]):
                    column = problem.column[e]
                    weight = problem.value[e]
                    if seen >= 0:
                        shown = 0.0
                        for s in range(problem.seen_start[seen + column], problem.seen_start[seen + column + 1]):
                            shown += problem.seen_value[s]
                        weight *= shown
                    matrix[place[x] + y, to + column] -= problem.discount * weight
    eliminate(matrix, right, n)
    for x in range(n_modes):
        for y in range(problem.mode_size[x]):
            vectors.alpha[first + x, y] = right[place[x] + y]
