r"""Solving a problem without a horizon, with a certificate: both bounds, their gap, and why the solver stopped.

With few hidden states the adaptive grid (`models.planning.grid_solver`) goes first: it closes gaps that point-based
methods close only slowly. With many, trials do the work (`models.planning.sarsop_trial`); where the grid is
not done soon, they begin with the vectors found so far, and both take turns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.planning.arrays import Array, Index, ProblemArrays, arrays_of
from models.planning.grid_run import blind_slots, first_vectors
from models.planning.grid_search import GridSearch, least_points, point_bytes
from models.planning.node_backups import DEEPEST
from models.planning.observed_part import ObservedPart, observed_part
from models.planning.precision import gap_wanted
from models.planning.problem import Problem
from models.planning.solution import Solution, Status, TracePoint
from models.planning.trial_search import TrialSearch
from models.planning.vectors import Vectors, copied_vectors, empty_vectors, evaluate_graph, keep_useful
from models.work_clock import WorkClock

GRID_STATES = 12
"""Modes with more hidden states than that are left to the trials: a cell of the grid has as many vertices."""

CROSSING = 1e-9
"""Bounds that cross by no more than this share of the largest value there can be cross by rounding."""

ALONE = 0.5
"""Seconds that the grid has for itself before trials take turns with it."""

Search = GridSearch | TrialSearch

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
        With a discount below 1. If it has many states, a part of them that observations tell is found and made use
        of (`models.planning.observed_part`); with a warm start it is not.
    precision : float
        Gap wanted at the start, relative to the larger of the bounds' sizes or absolute. Values next to
        zero count as a billionth of what is at stake (`models.planning.precision`), so that an optimum of zero has
        a gap that is small enough.
    relative : bool
    time_limit : float
        Seconds of wall time, compilation apart. Looked at between steps, which may take a second on large problems.
    memory_limit : int
        Bytes. What a search begins with is taken in any case.
    warm : Solution, optional
        Of a problem of the same shape: its policy graph is valued anew here and starts the lower bound.
    progress : callable, optional
        Called with every point of the trace.

    Returns
    -------
    Solution
        Always: what stops early, Ctrl-C included, returns the best so far and says so in its status; before there
        is anything better, policies that look at the mode only, and the highest reward for ever.

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
    if not memory_limit > 0:
        raise located("memory limit", memory_limit, "above 0 bytes")
    clock = WorkClock()
    arrays = arrays_of(problem)
    if not np.isfinite(arrays.largest):
        wanted = "rewards whose discounted sum is a finite number"
        raise located(f"{problem.name}, largest reward divided by 1 - discount", arrays.largest, wanted)
    if warm is not None and not _same_shape(arrays, arrays_of(warm.problem)):
        raise located("warm start, problem", warm.problem.name, "a problem of the same shape")
    trace: list[TracePoint] = []
    lower, upper = -np.inf, np.inf
    status: Status = "stalled"
    best: Search | None = None
    searches: list[Search] = []
    try:
        part = observed_part(problem) if warm is None and problem.n_states > GRID_STATES else None
        if part is not None:
            inner = solve(
                part.problem, precision, relative=relative, time_limit=max(1e-3, time_limit - clock.wall()),
                memory_limit=memory_limit, progress=progress,
            )  # fmt: skip
            whole = _of_the_whole(part, arrays, inner)
            return replace(whole, seconds=clock.wall(), compile_seconds=clock.compile_seconds)
        for search in _turns(problem, arrays, memory_limit, warm, clock, searches):
            done = search.step(precision, relative)
            if best is None or search.lower > best.lower:
                best = search
            lower, upper = max(lower, search.lower), min(upper, search.upper)
            if lower > upper:
                upper = touching(problem.name, lower, upper, arrays.largest)
            vectors = int(search.vectors.counts[0])
            point = TracePoint(clock.wall(), lower, upper, search.name, search.beliefs, vectors)
            trace.append(point)
            if progress is not None:
                progress(point)
            if done or upper - lower <= gap_wanted(precision, relative, lower, upper, arrays.least):
                status = "converged"
            elif clock.wall() >= time_limit:
                status = "time limit"
            else:
                continue
            break
        else:
            status = "memory limit" if any(s.full for s in searches) else "stalled"
    except KeyboardInterrupt:
        status = "interrupted"
    if best is None:
        found, beliefs = _at_once(arrays), 0
        lower, upper = _bounds_at_once(problem, arrays, found)
    else:
        found, beliefs = best.vectors, best.beliefs
    kept = tidied(arrays, found)
    return Solution(
        problem, lower, upper, status, precision, relative, clock.wall(), clock.compile_seconds, *kept, beliefs,
        tuple(trace),
    )  # fmt: skip


def _of_the_whole(part: ObservedPart, arrays: ProblemArrays, inner: Solution) -> Solution:
    """A solution in terms of blocks as one of the problem without them: its policy graph, valued on all states.

    Off its own block a vector begins at the least there can be; on it, it is worth what it was.
    """
    n = inner.alpha_vectors
    vectors = empty_vectors(arrays, n)
    vectors.counts[0] = n
    vectors.alpha[:] = arrays.reward.min() / (1 - arrays.discount)
    for i in range(n):
        x = int(inner.mode[i])
        vectors.alpha[i, part.members[x]] = inner.alpha[i, : len(part.members[x])]
        vectors.choice[i] = inner.choice[i]
        vectors.previous[i] = i - 1
        c = int(inner.choice[i])
        place = {o: z for z, o in enumerate(part.whole.choices[0][c].branches[0].observations)}
        seen = [o for branch in part.problem.choices[x][c].branches for o in branch.observations]
        for z, o in enumerate(seen):
            vectors.follow[i, place[o]] = inner.follow[i, z]
    vectors.last[0] = n - 1
    evaluate_graph(arrays, vectors, 0.0, 2)
    alpha, mode, choice, follow = tidied(arrays, vectors)
    return replace(inner, problem=part.whole, alpha=alpha, mode=mode, choice=choice, follow=follow)


def _turns(
    problem: Problem, arrays: ProblemArrays, memory: int, warm: Solution | None, clock: WorkClock,
    searches: list[Search],
) -> Iterator[Search]:  # fmt: skip
    """The searches in the order of their turns: the grid alone for a while, then both, with equal time.

    Neither is better everywhere: the grid closes gaps where little is learned, trials find policies where much is.
    """
    starts = list(problem.starts())
    modes = np.array([x for x, _, _ in starts], dtype=np.int64)
    weight = np.array([p for _, p, _ in starts])
    beliefs = np.zeros((len(starts), arrays.reward.shape[1]))
    for r, (_, _, belief) in enumerate(starts):
        beliefs[r, : len(belief)] = belief
    known = None if warm is None else warm_vectors(arrays, warm)
    small = arrays.mode_size.max() <= GRID_STATES
    if small and memory // 2 >= least_points(arrays) * point_bytes(arrays):
        grid = GridSearch(arrays, modes, beliefs, weight, memory // 2, known)
        searches.append(grid)
        while not grid.exhausted and clock.wall() < ALONE:
            yield grid
        known = copied_vectors(grid.vectors, 2 * int(grid.vectors.counts[0]) + DEEPEST)
        memory //= 2
    elif known is not None:
        first_vectors(arrays, known, int(known.counts[0]))
    searches.append(TrialSearch(arrays, modes, beliefs, weight, memory, known))
    spent = [0.0] * len(searches)
    while not all(s.exhausted for s in searches):
        k = min((k for k, s in enumerate(searches) if not s.exhausted), key=spent.__getitem__)
        began = clock.wall()
        yield searches[k]
        spent[k] += clock.wall() - began


def _at_once(arrays: ProblemArrays) -> Vectors:
    """Policies that look at the mode only, for who does not wait for anything better."""
    vectors = empty_vectors(arrays, blind_slots(arrays))
    first_vectors(arrays, vectors, 0)
    return vectors


def _bounds_at_once(problem: Problem, arrays: ProblemArrays, vectors: Vectors) -> tuple[float, float]:
    """What these are worth at the start, and the highest reward for ever."""
    n = int(vectors.counts[0])
    low = 0.0
    for x, p, belief in problem.starts():
        low += p * float((vectors.alpha[:n][vectors.mode[:n] == x][:, : len(belief)] @ belief).max())
    return low, max(low, float(arrays.reward.max()) / (1 - problem.discount))


def touching(name: str, lower: float, upper: float, largest: float) -> float:
    """The upper bound of bounds that cross by rounding.

    Raises
    ------
    ArithmeticError
        If they cross by more: one of them is wrong, and neither may be passed on.
    """
    if lower - upper > CROSSING * largest:
        raise ArithmeticError(
            f"{name}: lower bound {lower:.17g} above upper bound {upper:.17g}, which is more than rounding; "
            f"please report this problem"
        )
    return lower


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
