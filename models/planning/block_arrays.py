"""A problem of one mode in terms of blocks of its states, put together as arrays without a matrix a branch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.problem import Choice, Problem


def block_arrays(problem: Problem, label: Index, members: tuple[Index, ...]) -> ProblemArrays:
    """Arrays of a problem whose modes are blocks of states.

    Parameters
    ----------
    problem : Problem
        One mode, and one branch with an emission for every choice.
    label : int64[s]
        Block of every state, from 0 on; states of a block may not be joined with others by what they show.
    members : tuple of int64[y]
        States of each block, in rising order; one more entry is a mode that the problem may start in but does not
        come back to.
    """
    choices = problem.choices[0]
    n_blocks, n_actions, n_modes = int(label.max()) + 1, len(choices), len(members)
    size = np.array([len(m) for m in members], dtype=np.int64)
    place = np.empty(len(label), dtype=np.int64)
    for block in members[:n_blocks]:
        place[block] = np.arange(len(block))
    steps = _steps(problem, label, place, members, n_blocks)
    # A branch for every mode, action and block that has an entry; entries are sorted that way.
    new = np.flatnonzero(np.diff(steps.branch, prepend=-1))
    branch = steps.branch[new]
    branch_choice, branch_mode = branch // n_blocks, branch % n_blocks
    rows = size[branch_choice // n_actions] + 1  # the end of the last row is written down too
    branch_row = np.concatenate([[0], np.cumsum(rows)])
    number = np.repeat(np.arange(len(new)), np.diff(np.append(new, len(steps.branch))))
    entries = np.bincount(branch_row[number] + steps.row, minlength=branch_row[-1])
    shown = _shown(problem, label, place, size[:n_blocks])
    table = branch_choice % n_actions * n_blocks + branch_mode
    seen = np.diff(shown.begin)[table]
    branch_outcome = np.concatenate([[0], np.cumsum(seen)]).astype(np.int64)
    within = np.arange(branch_outcome[-1]) - np.repeat(branch_outcome[:-1], seen)
    choice_branch = np.searchsorted(branch_choice, np.arange(n_modes * n_actions + 1)).astype(np.int64)
    reward = np.zeros((n_modes * n_actions, int(size.max())))
    for x, rows_of in enumerate(members):
        for a, choice in enumerate(choices):
            reward[x * n_actions + a, : len(rows_of)] = choice.reward[rows_of]
    return ProblemArrays(
        float(problem.discount), size, np.arange(n_modes + 1, dtype=np.int64) * n_actions,
        choice_branch, branch_outcome[choice_branch], branch_mode.astype(np.int64),
        branch_row[:-1].astype(np.int64), branch_outcome, shown.row[table],
        np.concatenate([[0], np.cumsum(entries)[:-1]]).astype(np.int64), steps.column.astype(np.int32), steps.value,
        shown.start, shown.outcome.astype(np.int32), shown.value, np.repeat(branch_mode, seen).astype(np.int64),
        shown.observation[np.repeat(shown.begin[:-1][table], seen) + within], reward,
        problem.span, problem.largest_value, problem.least_size, np.zeros(1, dtype=np.int64),
    )  # fmt: skip


class _Steps(NamedTuple):
    """Entries of all transition matrices: branch ``(mode * actions + action) * blocks + block``, places, value."""

    branch: Index
    row: Index
    column: Index
    value: Array


def _steps(problem: Problem, label: Index, place: Index, members: tuple[Index, ...], n_blocks: int) -> _Steps:
    n_actions = len(problem.choices[0])
    found = []
    for a, choice in enumerate(problem.choices[0]):
        table = choice.branches[0].transition
        row = np.repeat(np.arange(table.shape[0]), np.diff(table.indptr))
        kept = table.data > 0
        row, column, value = row[kept], table.indices[kept], table.data[kept]
        parts = [(label[row], place[row], column, value)]
        if len(members) > n_blocks:
            start = np.full(len(label), -1)
            start[members[-1]] = np.arange(len(members[-1]))
            from_start = start[row] >= 0
            mode = np.full(int(from_start.sum()), n_blocks)
            parts.append((mode, start[row[from_start]], column[from_start], value[from_start]))
        for mode, local, to, p in parts:
            found.append(_Steps((mode * n_actions + a) * n_blocks + label[to], local, place[to], p))
    branch, row, column = (np.concatenate([part[k] for part in found]) for k in range(3))
    order = np.lexsort((column, row, branch))
    value = np.concatenate([part.value for part in found])
    return _Steps(branch[order], row[order], column[order], value[order])


def ends(choice: Choice) -> NDArray[np.bool_]:
    """Which states the one branch of an action leads to, from any state."""
    table = choice.branches[0].transition
    reached = np.zeros(table.shape[1], dtype=bool)
    reached[table.indices[table.data > 0]] = True
    return reached


class _Shown(NamedTuple):
    """Emission tables, one for every action and block, numbered ``action * blocks + block``.

    Attributes
    ----------
    begin : int64[t + 1]
        Where the observations of each table begin.
    observation : int64[.]
    row : int64[t]
        Where its rows begin in `start`.
    start, outcome, value : int64[.], int64[.], float64[.]
        Its rows, as in `ProblemArrays`.
    """

    begin: Index
    observation: Index
    row: Index
    start: Index
    outcome: Index
    value: Array


def _shown(problem: Problem, label: Index, place: Index, size: Index) -> _Shown:
    """Emissions of the states that an action reaches: others may show what tells another block."""
    choices, n_blocks, n_seen = problem.choices[0], len(size), len(problem.observations)
    tables, states, observations, values = [], [], [], []
    for a, choice in enumerate(choices):
        emission = sparse.csr_array(choice.branches[0].emission)
        state = np.repeat(np.arange(emission.shape[0]), np.diff(emission.indptr))
        kept = (emission.data > 0) & ends(choice)[state]
        tables.append(a * n_blocks + label[state[kept]])
        states.append(place[state[kept]])
        observations.append(np.asarray(choice.branches[0].observations)[emission.indices[kept]])
        values.append(emission.data[kept])
    table, state = np.concatenate(tables), np.concatenate(states)
    kind, outcome = np.unique(table * n_seen + np.concatenate(observations), return_inverse=True)
    begin = np.searchsorted(kind // n_seen, np.arange(len(choices) * n_blocks + 1)).astype(np.int64)
    outcome = outcome - begin[table]
    row = np.concatenate([[0], np.cumsum(np.tile(size + 1, len(choices)))])
    order = np.lexsort((outcome, state, table))
    entries = np.bincount(row[table] + state, minlength=row[-1])
    start = np.concatenate([[0], np.cumsum(entries)[:-1]]).astype(np.int64)
    return _Shown(
        begin, (kind % n_seen).astype(np.int64), row[:-1].astype(np.int64), start, outcome[order],
        np.concatenate(values)[order],
    )  # fmt: skip
