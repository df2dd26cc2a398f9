r"""Solving a problem without a horizon, with a certificate: both bounds, their gap, and why the solver stopped.

With few hidden states the adaptive grid (`models.planning.grid_solver`) goes first: it closes gaps that point-based
methods close only slowly. With many, or where the grid gives up, SARSOP's trials take over, with the vectors found
so far (`models.planning.sarsop_trial`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.planning.arrays import Array, Index, ProblemArrays, arrays_of
from models.planning.grid_run import blind_slots, first_vectors
from models.planning.grid_search import GridSearch
from models.planning.problem import Problem
from models.planning.solution import Solution, Status, TracePoint
from models.planning.trial_search import TrialSearch
from models.planning.vectors import Vectors, empty_vectors, keep_useful
from models.work_clock import WorkClock

GRID_STATES = 12
"""Modes with more hidden states than that are left to the trials: a cell of the grid has as many vertices."""

MEMORY = 2_000_000_000
"""Bytes for grid, beliefs and vectors, unless told otherwise."""


def solve(
    problem: Problem,
    precision: float = 1e-3,
    *,
    relative: bool = True,
    time_limit: float = 60.0,
    memory_limit: int = MEMORY,
    warm: Solution | None = None,
    progress: Callable[[TracePoint], None] | None = None,
) -> Solution:
    """Solve a discounted problem without a horizon.

    Parameters
    ----------
    problem : Problem
        With a discount below 1.
    precision : float
        Gap wanted at the start, relative to the larger of the bounds' sizes or absolute.
    relative : bool
    time_limit : float
        Seconds of wall time, compilation apart. Looked at between steps, which may take a second on large problems.
    memory_limit : int
        Bytes.
    warm : Solution, optional
        Of a problem of the same shape: its policy graph is valued anew here and starts the lower bound.
    progress : callable, optional
        Called with every point of the trace.

    Returns
    -------
    Solution
        Always: what stops early, Ctrl-C included, returns the best so far and says so in its status.

    Raises
    ------
    InputError
        On a discount of 1, or settings that make no sense.
    """
    if problem.discount >= 1:
        raise located(
            f"{problem.name}, discount", problem.discount, "below 1: without a horizon values would be infinite"
        )
    if not (np.isfinite(precision) and precision >= 0):
        raise located("precision", precision, "a number from 0 on")
    if not time_limit > 0:
        raise located("time limit", time_limit, "above 0 seconds")
    arrays = arrays_of(problem)
    if warm is not None and not _same_shape(arrays, arrays_of(warm.problem)):
        raise located("warm start, problem", warm.problem.name, "a problem of the same shape")
    clock = WorkClock()
    trace: list[TracePoint] = []
    lower, upper = -np.inf, np.inf
    status: Status = "interrupted"
    vectors, beliefs = None, 0
    try:
        for search in _searches(problem, arrays, memory_limit, warm):
            while True:
                done = search.step(precision, relative)
                lower, upper = max(lower, search.lower), min(upper, search.upper)
                vectors, beliefs = search.vectors, search.beliefs
                point = TracePoint(clock.wall(), lower, upper, search.name, beliefs, int(vectors.counts[0]))
                trace.append(point)
                if progress is not None:
                    progress(point)
                wanted = precision * (max(abs(lower), abs(upper)) if relative else 1.0)
                if done or upper - lower <= wanted:
                    status = "converged"
                elif clock.wall() >= time_limit:
                    status = "time limit"
                elif search.exhausted:
                    status = "memory limit" if search.full else "stalled"
                else:
                    continue
                break
            if status in ("converged", "time limit"):
                break
    except KeyboardInterrupt:
        status = "interrupted"
    if vectors is None:
        raise KeyboardInterrupt("stopped before the first bounds were there")
    kept = tidied(arrays, vectors)
    return Solution(
        problem, lower, upper, status, precision, relative, clock.wall(), clock.compile_seconds, *kept, beliefs,
        tuple(trace),
    )  # fmt: skip


def _searches(
    problem: Problem, arrays: ProblemArrays, memory: int, warm: Solution | None
) -> Iterator[GridSearch | TrialSearch]:
    """The methods in the order in which they are tried, each with the vectors of the one before."""
    starts = list(problem.starts())
    modes = np.array([x for x, _, _ in starts], dtype=np.int64)
    weight = np.array([p for _, p, _ in starts])
    beliefs = np.zeros((len(starts), arrays.reward.shape[1]))
    for r, (_, _, belief) in enumerate(starts):
        beliefs[r, : len(belief)] = belief
    known = None if warm is None else warm_vectors(arrays, warm)
    if arrays.mode_size.max() <= GRID_STATES:
        grid = GridSearch(arrays, modes, beliefs, weight, memory // 2, known)
        yield grid
        known = grid.vectors
    elif known is not None:
        first_vectors(arrays, known, int(known.counts[0]))
    yield TrialSearch(arrays, modes, beliefs, weight, memory, known)


def _same_shape(one: ProblemArrays, other: ProblemArrays) -> bool:
    same = ("mode_size", "mode_choice", "choice_outcome", "outcome_mode")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in same)


def warm_vectors(arrays: ProblemArrays, solution: Solution) -> Vectors:
    """Vectors of another solution's policy graph, with room for the blind policies; values are left out."""
    n = solution.alpha_vectors
    out = empty_vectors(arrays, n + blind_slots(arrays))
    out.counts[0] = n
    out.mode[:n], out.follow[:n] = solution.mode, solution.follow
    out.choice[:n] = solution.choice + arrays.mode_choice[solution.mode]
    for i in range(n):
        out.previous[i] = out.last[out.mode[i]]
        out.last[out.mode[i]] = i
    return out


def tidied(arrays: ProblemArrays, vectors: Vectors) -> tuple[Array, Index, Index, NDArray[np.int32]]:
    """Vectors without dominated ones: values, modes, choices counted within the mode, followers."""
    keep_useful(vectors, arrays, np.ones(int(vectors.counts[0]), dtype=np.bool_))
    n = int(vectors.counts[0])
    mode = vectors.mode[:n].copy()
    return (
        vectors.alpha[:n].copy(), mode, vectors.choice[:n] - arrays.mode_choice[mode], vectors.follow[:n].copy()
    )  # fmt: skip
