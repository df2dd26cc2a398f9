"""A problem as flat arrays, the form the compiled kernels work on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.planning.problem import Problem

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class ProblemArrays(NamedTuple):
    """A `models.planning.problem.Problem` as arrays; choices, branches and outcomes are numbered throughout.

    A *choice* is an action in a mode; an *outcome* is an observation at the end of one of its branches.

    Attributes
    ----------
    discount : float
    mode_size : int64[x]
        Hidden states of each mode; the largest is the width `w` of every belief and vector.
    mode_choice : int64[x + 1]
        Where the choices of each mode begin.
    choice_branch, choice_outcome : int64[c + 1]
        Where the branches and the outcomes of each choice begin.
    branch_mode : int64[b]
        Mode a branch leads to.
    branch_row : int64[b]
        Where its rows begin in `row_start`; row `y` has its entries at ``row_start[r + y]:row_start[r + y + 1]``.
    branch_outcome : int64[b + 1]
        Where its outcomes begin.
    branch_seen : int64[b]
        Where its emission begins in `seen_start`, -1 where it has one outcome for certain.
    row_start, column, value : int64[.], int32[.], float64[.]
        Transition matrices by rows, one after the other.
    seen_start, seen_outcome, seen_value : int64[.], int32[.], float64[.]
        Emission matrices by rows (end states); outcomes count from the branch's first.
    outcome_mode, outcome_observation : int64[z]
    reward : float64[c, w]
    span, largest, least : float
        Largest difference between two values, largest size of one, and what values count as at least where gaps are
        told relative to them: `Problem.span`, `Problem.largest_value`, `Problem.least_size`.
    halt : int64[1]
        Set by whoever wants kernels to come back at once, from another thread: they look at it at least once a
        belief, and leave what they worked on sound.
    """

    discount: float
    mode_size: Index
    mode_choice: Index
    choice_branch: Index
    choice_outcome: Index
    branch_mode: Index
    branch_row: Index
    branch_outcome: Index
    branch_seen: Index
    row_start: Index
    column: NDArray[np.int32]
    value: Array
    seen_start: Index
    seen_outcome: NDArray[np.int32]
    seen_value: Array
    outcome_mode: Index
    outcome_observation: Index
    reward: Array
    span: float
    largest: float
    least: float
    halt: Index


def arrays_of(problem: Problem) -> ProblemArrays:
    """Flat arrays of a problem."""
    width = problem.n_states
    choices = [(x, choice) for x in range(problem.n_modes) for choice in problem.choices[x]]
    branches = [branch for _, choice in choices for branch in choice.branches]
    seen = [1 if b.emission is None else b.emission.shape[1] for b in branches]
    branch_outcome = np.concatenate([[0], np.cumsum(seen)]).astype(np.int64)
    choice_branch = np.concatenate([[0], np.cumsum([len(c.branches) for _, c in choices])]).astype(np.int64)
    rows, row_start, columns, values = _stacked([b.transition for b in branches])
    emissions = [b.emission for b in branches if b.emission is not None]
    places, seen_start, seen_outcome, seen_value = _stacked(emissions)
    branch_seen = np.full(len(branches), -1, dtype=np.int64)
    branch_seen[[b.emission is not None for b in branches]] = places
    reward = np.zeros((len(choices), width))
    for c, (_, choice) in enumerate(choices):
        reward[c, : len(choice.reward)] = choice.reward
    return ProblemArrays(
        float(problem.discount),
        np.array([len(s) for s in problem.states], dtype=np.int64),
        np.concatenate([[0], np.cumsum([len(c) for c in problem.choices])]).astype(np.int64),
        choice_branch, branch_outcome[choice_branch],
        np.array([b.mode for b in branches], dtype=np.int64), rows, branch_outcome, branch_seen,
        row_start, columns, values, seen_start, seen_outcome, seen_value,
        np.repeat(np.array([b.mode for b in branches], dtype=np.int64), seen),
        np.array([o for b in branches for o in b.observations], dtype=np.int64), reward,
        problem.span, problem.largest_value, problem.least_size, np.zeros(1, dtype=np.int64),
    )  # fmt: skip


def _stacked(tables: list) -> tuple[Index, Index, NDArray[np.int32], Array]:
    """Sparse matrices one after the other: where each one's rows begin, row starts, columns, values."""
    lengths = [t.shape[0] + 1 for t in tables]
    places = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64) if tables else np.zeros(0, np.int64)
    entries = np.concatenate([[0], np.cumsum([t.nnz for t in tables])]).astype(np.int64)
    starts = [t.indptr.astype(np.int64) + entries[i] for i, t in enumerate(tables)]
    return (
        places,
        np.concatenate(starts) if starts else np.zeros(1, dtype=np.int64),
        np.concatenate([t.indices for t in tables]).astype(np.int32) if tables else np.zeros(0, dtype=np.int32),
        np.concatenate([t.data for t in tables]).astype(np.float64) if tables else np.zeros(0),
    )
