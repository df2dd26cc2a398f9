r"""Solving a problem without a horizon, with a certificate: both bounds, their gap, and why the solver stopped.

With few hidden states the adaptive grid (`models.planning.grid_solver`) goes first: it closes gaps that point-based
methods close only slowly. With many, trials do the work (`models.planning.sarsop_trial`); where the grid is
not done soon, they begin with the vectors found so far, and both take turns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.planning.arrays import Array, Index, ProblemArrays, arrays_of
from models.planning.at_once import at_once
from models.planning.grid_run import blind_slots, first_vectors
from models.planning.grid_search import GridSearch, least_points, point_bytes
from models.planning.loading import load_kernels
from models.planning.node_backups import DEEPEST
from models.planning.observed_part import ObservedPart, observed_part
from models.planning.precision import gap_wanted
from models.planning.problem import Problem
from models.planning.solution import Solution, Status, TracePoint
from models.planning.time_watch import TimeWatch
from models.planning.trial_search import TrialSearch
from models.planning.vectors import Vectors, copied_vectors, empty_vectors, evaluate_graph, keep_useful
from models.planning.within_reach import WORK, beyond_reach, within_reach
from models.work_clock import WorkClock

GRID_STATES = 12
"""Modes with more hidden states than that are left to the trials: a cell of the grid has as many vertices."""

CROSSING = 1e-9
"""Bounds that cross by no more than this share of the largest value there can be cross by rounding."""

ALONE = 0.5
"""Seconds that the grid has for itself before trials take turns with it."""

COURTESY = 1e7
"""Multiplications that values of vectors are worth where they are not needed."""

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
        Seconds of wall time, compilation apart. Kernels come back when it is up; what is left is to put the policy
        into order.
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
        is anything better, a policy that makes sure of something, and the highest reward for ever.

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
    whole = arrays_of(problem)
    if not np.isfinite(whole.largest):
        wanted = "rewards whose discounted sum is a finite number"
        raise located(f"{problem.name}, largest reward divided by 1 - discount", whole.largest, wanted)
    if warm is not None and not _same_shape(whole, arrays_of(warm.problem)):
        raise located("warm start, problem", warm.problem.name, "a problem of the same shape")
    trace: list[TracePoint] = []
    lower, upper = -np.inf, np.inf
    status: Status = "stalled"
    best: Search | None = None
    searches: list[Search] = []
    part: ObservedPart | None = None
    arrays, tamed = whole, False
    with TimeWatch(clock, time_limit, whole.halt) as watch:
        try:
            part = observed_part(problem) if warm is None and problem.n_states > GRID_STATES else None
            arrays, tamed = within_reach(part.arrays if part else whole, problem)
            arrays = arrays._replace(halt=whole.halt)
            known = None if warm is None else warm_vectors(arrays, warm)
            starts = _starts(problem, part, arrays.reward.shape[1])
            for search in _turns(arrays, *starts, memory_limit, known, clock, watch, searches):
                done = search.step(precision, relative)
                if best is None or search.lower > best.lower:
                    best = search
                before = upper
                lower, upper = max(lower, search.lower), min(upper, search.upper)
                if lower > upper:  # one number for both, at which neither goes back on what it said
                    lower = upper = min(touching(problem.name, lower, upper, arrays.largest), before)
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
        lower, upper, kept = at_once(whole)
        beliefs = 0
    else:
        beliefs = best.beliefs
        try:
            kept = _in_order(problem, part, arrays, whole, best.vectors, tamed)
        except KeyboardInterrupt:
            status = "interrupted"
            kept = _in_order(problem, part, arrays, whole, best.vectors, tamed, hurry=True)
    return Solution(
        problem, lower, upper, status, precision, relative, clock.wall(), clock.compile_seconds, *kept, beliefs,
        tuple(trace),
    )  # fmt: skip


def _starts(problem: Problem, part: ObservedPart | None, width: int) -> tuple[Index, Array, Array]:
    """Modes that a problem may start in, beliefs there with zeros up to a width, and how probable each is."""
    starts = list(problem.starts()) if part is None else [(part.start_mode, 1.0, part.start / part.start.sum())]
    beliefs = np.zeros((len(starts), width))
    for r, (_, _, belief) in enumerate(starts):
        beliefs[r, : len(belief)] = belief
    return np.array([x for x, _, _ in starts], dtype=np.int64), beliefs, np.array([p for _, p, _ in starts])


def _in_order(
    problem: Problem, part: ObservedPart | None, arrays: ProblemArrays, whole: ProblemArrays, vectors: Vectors,
    tamed: bool, hurry: bool = False,
) -> tuple[Array, Index, Index, NDArray[np.int32]]:  # fmt: skip
    """What a search found as it is passed on; done again after Ctrl-C in the middle of it, without courtesies."""
    if part is None:
        # First, as there are fewer vectors to be valued then; out of reach it matters to nobody which are left.
        keep_useful(vectors, arrays, np.ones(int(vectors.counts[0]), dtype=np.bool_))
    else:
        # In terms of blocks they are tidied; on all states comparing them may take longer than the rest.
        vectors = _of_the_whole(part, arrays, whole, vectors, 0.0 if hurry else COURTESY)
    if tamed:
        beyond_reach(problem, whole, vectors, 0.0 if hurry else WORK)
    return _copied(whole, vectors)


def _of_the_whole(
    part: ObservedPart, arrays: ProblemArrays, whole: ProblemArrays, inner: Vectors, courtesy: float
) -> Vectors:
    """Vectors of a problem in terms of blocks as those of the problem without them, valued on all states.

    Off its own block a vector begins at the least there can be; on it, it is worth what it was.
    """
    alpha, mode, choice, follow = tidied(arrays, inner)
    n = len(alpha)
    vectors = empty_vectors(whole, n)
    vectors.counts[0] = n
    vectors.alpha[:] = whole.reward.min() / (1 - whole.discount)
    vectors.choice[:] = choice
    vectors.previous[:] = np.arange(n) - 1
    vectors.last[0] = n - 1
    choices = part.whole.choices[0]
    place = np.zeros((len(choices), len(part.whole.observations)), dtype=np.int64)
    for c, offered in enumerate(choices):
        place[c, list(offered.branches[0].observations)] = np.arange(len(offered.branches[0].observations))
    for i in range(n):
        members = part.members[mode[i]]
        vectors.alpha[i, members] = alpha[i, : len(members)]
        c = arrays.mode_choice[mode[i]] + choice[i]
        seen = arrays.outcome_observation[arrays.choice_outcome[c] : arrays.choice_outcome[c + 1]]
        vectors.follow[i, place[choice[i], seen]] = follow[i, : len(seen)]
    # Off its block nobody asks a vector that has others there; a look ahead is a courtesy.
    if n * (len(whole.value) + len(whole.seen_value)) < courtesy:
        evaluate_graph(whole, vectors, 0.0, 2)
    return vectors


def _turns(
    arrays: ProblemArrays, modes: Index, beliefs: Array, weight: Array, memory: int, known: Vectors | None,
    clock: WorkClock, watch: TimeWatch, searches: list[Search],
) -> Iterator[Search]:  # fmt: skip
    """The searches in the order of their turns: the grid alone for a while, then both, with equal time.

    Neither is better everywhere: the grid closes gaps where little is learned, trials find policies where much is.
    """
    small = arrays.mode_size.max() <= GRID_STATES
    if small and memory // 2 >= least_points(arrays) * point_bytes(arrays):
        with watch.preparing():
            load_kernels("grid")
        grid = GridSearch(arrays, modes, beliefs, weight, memory // 2, known)
        searches.append(grid)
        while not grid.exhausted and clock.wall() < ALONE:
            yield grid
        known = copied_vectors(grid.vectors, 2 * int(grid.vectors.counts[0]) + DEEPEST)
        memory //= 2
    with watch.preparing():
        load_kernels("trials")
    if known is not None and not searches:
        first_vectors(arrays, known, int(known.counts[0]))
    searches.append(TrialSearch(arrays, modes, beliefs, weight, memory, known))
    spent = [0.0] * len(searches)
    while not all(s.exhausted for s in searches):
        k = min((k for k, s in enumerate(searches) if not s.exhausted), key=spent.__getitem__)
        began = clock.wall()
        yield searches[k]
        spent[k] += clock.wall() - began


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
    return _copied(arrays, vectors)


def _copied(arrays: ProblemArrays, vectors: Vectors) -> tuple[Array, Index, Index, NDArray[np.int32]]:
    """Vectors as they are: values, modes, choices counted within the mode, followers."""
    n = int(vectors.counts[0])
    mode = vectors.mode[:n].copy()
    return vectors.alpha[:n].copy(), mode, vectors.choice[:n] - arrays.mode_choice[mode], vectors.follow[:n].copy()
