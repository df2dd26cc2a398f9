r"""Lower bounds: alpha vectors that are nodes of a policy graph, compiled.

Each vector belongs to a mode, carries the choice it takes there and, for every outcome of that choice, the vector
it goes on with. So the set is a finite-state controller at every moment, and every vector is at most that
controller's value: re-evaluating the graph (`evaluate_graph`) only raises it, and re-evaluating it in another model
gives a sound bound there, which carrying the numbers over would not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.step_kernel import look_ahead

SLACK = 1e-14
"""A vector that another one exceeds everywhere but for this share of an entry is dominated: rounding only, as
vectors that lead there are not valued anew, and a policy may come by for ever."""


class Vectors(NamedTuple):
    """Alpha vectors in slots of fixed number.

    Attributes
    ----------
    counts : int64[1]
        Slots in use.
    alpha : float64[k, w]
    mode, choice : int64[k]
    follow : int32[k, z]
        For each outcome of the choice the vector that follows.
    last : int64[x]
        The newest vector of each mode, -1 if it has none.
    previous : int64[k]
        The next older vector of the same mode, -1 at the end.
    """

    counts: Index
    alpha: Array
    mode: Index
    choice: Index
    follow: NDArray[np.int32]
    last: Index
    previous: Index


def empty_vectors(problem: ProblemArrays, capacity: int) -> Vectors:
    """Slots for so many vectors."""
    outcomes = int(np.diff(problem.choice_outcome).max())
    width = problem.reward.shape[1]
    return Vectors(
        np.zeros(1, dtype=np.int64), np.zeros((capacity, width)), np.zeros(capacity, dtype=np.int64),
        np.zeros(capacity, dtype=np.int64), np.zeros((capacity, outcomes), dtype=np.int32),
        np.full(len(problem.mode_size), -1, dtype=np.int64), np.full(capacity, -1, dtype=np.int64),
    )  # fmt: skip


def copied_vectors(vectors: Vectors, capacity: int) -> Vectors:
    """A copy with more slots."""
    wider = grown_vectors(vectors, capacity)
    return wider._replace(counts=vectors.counts.copy(), last=vectors.last.copy())


def grown_vectors(vectors: Vectors, capacity: int) -> Vectors:
    """The same vectors with more slots."""
    n = int(vectors.counts[0])
    slots = {name: getattr(vectors, name) for name in ("alpha", "mode", "choice", "follow", "previous")}
    wider = {name: np.zeros((capacity, *a.shape[1:]), dtype=a.dtype) for name, a in slots.items()}
    for name, a in slots.items():
        wider[name][:n] = a[:n]
    return vectors._replace(**wider)


@kernel
def best_vector(vectors: Vectors, mode: int, belief: Array, size: int) -> tuple[int, float]:
    r"""The vector of a mode with the highest :math:`\alpha \cdot b`, the oldest of equals, and that value."""
    best = -1
    value = -np.inf
    i = vectors.last[mode]
    while i >= 0:
        total = 0.0
        for y in range(size):
            total += vectors.alpha[i, y] * belief[y]
        if total >= value:
            value = total
            best = i
        i = vectors.previous[i]
    return best, value


@kernel
def best_since(vectors: Vectors, mode: int, belief: Array, size: int, since: int, value: float) -> float:
    r"""The larger of a value and the highest :math:`\alpha \cdot b` of a mode's vectors from number `since` on."""
    i = vectors.last[mode]
    while i >= since:
        total = 0.0
        for y in range(size):
            total += vectors.alpha[i, y] * belief[y]
        value = max(value, total)
        i = vectors.previous[i]
    return value


@kernel
def add_vector(vectors: Vectors, mode: int, choice: int, alpha: Array, follow: NDArray[np.int32]) -> int:
    """Put a vector into the next slot, which must exist; returns its number."""
    i = vectors.counts[0]
    vectors.counts[0] += 1
    vectors.alpha[i] = alpha
    vectors.mode[i] = mode
    vectors.choice[i] = choice
    vectors.follow[i] = follow
    vectors.previous[i] = vectors.last[mode]
    vectors.last[mode] = i
    return i


@kernel
def evaluate_graph(problem: ProblemArrays, vectors: Vectors, tolerance: float, most: int) -> int:
    """Raise every vector towards the value of the controller they form; returns the number of sweeps.

    Each vector becomes the larger of itself and one step followed by its followers, entry by entry. From valid
    vectors every intermediate state is valid.

    Parameters
    ----------
    problem : ProblemArrays
    vectors : Vectors
        Changed in place.
    tolerance : float
        Stop when no entry rises by more.
    most : int
        Sweeps at most.
    """
    width = vectors.alpha.shape[1]
    new = np.empty(width)
    after = np.empty(width)
    for sweep in range(most):
        rise = 0.0
        for i in range(vectors.counts[0] - 1, -1, -1):
            if problem.halt[0] != 0:
                return sweep + 1
            size = problem.mode_size[vectors.mode[i]]
            look_ahead(problem, vectors.choice[i], size, vectors.alpha, vectors.follow[i], new, after)
            for y in range(size):
                if new[y] > vectors.alpha[i, y]:
                    rise = max(rise, new[y] - vectors.alpha[i, y])
                    vectors.alpha[i, y] = new[y]
        if rise <= tolerance:
            return sweep + 1
    return most


@kernel
def evaluate_closed(problem: ProblemArrays, vectors: Vectors, first: int, tolerance: float, most: int) -> None:
    r"""Bring the vectors from `first` on, which follow only each other, up to their value.

    One step of all of them changes the values by between `m` and `M`, so the controller is worth at least
    :math:`H\alpha + m\gamma/(1-\gamma)` (Porteus 1971): what all values have in common, the slow part, is there
    at once. Sound after every sweep.

    Parameters
    ----------
    problem : ProblemArrays
    vectors : Vectors
        Changed in place.
    first : int
    tolerance : float
        Stop when no entry changes by more.
    most : int
        Sweeps at most.
    """
    last = vectors.counts[0]
    new = np.empty((last - first, vectors.alpha.shape[1]))
    after = np.empty(vectors.alpha.shape[1])
    ahead = problem.discount / (1.0 - problem.discount)
    for _ in range(most):
        least = np.inf
        change = 0.0
        for i in range(first, last):
            if problem.halt[0] != 0:
                return  # what the last whole step left behind is sound; half a step proves nothing
            size = problem.mode_size[vectors.mode[i]]
            look_ahead(problem, vectors.choice[i], size, vectors.alpha, vectors.follow[i], new[i - first], after)
            for y in range(size):
                least = min(least, new[i - first, y] - vectors.alpha[i, y])
        for i in range(first, last):
            for y in range(problem.mode_size[vectors.mode[i]]):
                value = new[i - first, y] + ahead * least
                change = max(change, abs(value - vectors.alpha[i, y]))
                vectors.alpha[i, y] = value
        if change <= tolerance:
            break


@kernel
def keep_useful(vectors: Vectors, problem: ProblemArrays, useful: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Drop vectors that are dominated, or neither useful nor followed by a useful one; the rest close ranks.

    A dominated vector's place in the graph goes to the one that dominates it.

    Parameters
    ----------
    vectors : Vectors
        Changed in place.
    problem : ProblemArrays
    useful : bool[k]
        Which vectors are wanted for themselves; followers are kept by themselves. Overwritten.

    Returns
    -------
    int32[k]
        New number of each vector, or of the one that dominates it; -1 where it is gone.
    """
    count = vectors.counts[0]
    place = np.empty(count, dtype=np.int32)
    for i in range(count):
        place[i] = i
    for i in range(count):
        size = problem.mode_size[vectors.mode[i]]
        for j in range(count):
            if j == i or vectors.mode[j] != vectors.mode[i] or place[j] != j:
                continue
            below = True
            equal = True
            for y in range(size):
                slack = SLACK * max(abs(vectors.alpha[i, y]), abs(vectors.alpha[j, y]))
                if vectors.alpha[i, y] > vectors.alpha[j, y] + slack:
                    below = False
                    break
                if vectors.alpha[i, y] < vectors.alpha[j, y] - slack:
                    equal = False
            if below and (not equal or j < i):
                place[i] = j
                if useful[i]:
                    useful[j] = True
                break
    for i in range(count):
        while place[place[i]] != place[i]:
            place[i] = place[place[i]]
        if place[i] != i and useful[i]:
            useful[place[i]] = True
            useful[i] = False
    for i in range(count):
        outcomes = problem.choice_outcome[vectors.choice[i] + 1] - problem.choice_outcome[vectors.choice[i]]
        for z in range(outcomes):
            vectors.follow[i, z] = place[vectors.follow[i, z]]
    # A mode that no visited point is in yet may be come to later, and any vector of it is sound.
    for x in range(len(vectors.last)):
        held = False
        for i in range(count):
            held = held or (useful[i] and vectors.mode[i] == x)
        i = 0
        while not held and i < count:
            if vectors.mode[i] == x and place[i] == i:
                useful[i] = True
                held = True
            i += 1
    left = np.empty(count, dtype=np.int64)
    n_left = 0
    for i in range(count):
        if useful[i]:
            left[n_left] = i
            n_left += 1
    while n_left > 0:
        n_left -= 1
        i = left[n_left]
        outcomes = problem.choice_outcome[vectors.choice[i] + 1] - problem.choice_outcome[vectors.choice[i]]
        for z in range(outcomes):
            j = vectors.follow[i, z]
            if not useful[j]:
                useful[j] = True
                left[n_left] = j
                n_left += 1
    kept = 0
    number = np.full(count, -1, dtype=np.int32)
    for i in range(count):
        if useful[i]:
            number[i] = kept
            vectors.alpha[kept] = vectors.alpha[i]
            vectors.mode[kept] = vectors.mode[i]
            vectors.choice[kept] = vectors.choice[i]
            vectors.follow[kept] = vectors.follow[i]
            kept += 1
    vectors.counts[0] = kept
    vectors.last[:] = -1
    for i in range(kept):
        vectors.previous[i] = vectors.last[vectors.mode[i]]
        vectors.last[vectors.mode[i]] = i
        outcomes = problem.choice_outcome[vectors.choice[i] + 1] - problem.choice_outcome[vectors.choice[i]]
        for z in range(outcomes):
            vectors.follow[i, z] = number[vectors.follow[i, z]]
    for i in range(count):
        number[i] = number[place[i]]
    return number
