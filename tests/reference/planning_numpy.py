"""Planning kernels and oracles in plain numpy, from the problem itself and never from its flat arrays.

`Step` spells out one choice: its reward and, for every outcome in the order of the branches, the joint matrix
``P(x', z, y' | x, y, c)``. Everything below is written with those.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from models.planning.problem import Problem

Array = NDArray[np.float64]


class Step(NamedTuple):
    """One choice: reward ``[y]``; next mode, observation and joint matrix ``[y, y']`` of every outcome."""

    reward: Array
    outcomes: list[tuple[int, int, Array]]


def steps(problem: Problem) -> list[list[Step]]:
    """Every choice of every mode."""
    out = []
    for offered in problem.choices:
        row = []
        for choice in offered:
            outcomes = []
            for b in choice.branches:
                t = b.transition.toarray()
                e = np.ones((t.shape[1], 1)) if b.emission is None else b.emission.toarray()
                outcomes += [(b.mode, o, t * e[:, j]) for j, o in enumerate(b.observations)]
            row.append(Step(np.asarray(choice.reward, dtype=float), outcomes))
        out.append(row)
    return out


def successors(step: Step, belief: Array) -> list[tuple[float, Array]]:
    """Probability of every outcome, and the belief after it (zeros where it is impossible)."""
    joint = [belief @ t for _, _, t in step.outcomes]
    return [(w.sum(), w / w.sum() if w.sum() > 1e-12 else np.zeros_like(w)) for w in joint]


def look_ahead(step: Step, discount: float, followers: Sequence[Array]) -> Array:
    """Value by hidden state of a choice followed by one vector an outcome."""
    return step.reward + discount * sum(
        t @ alpha[: t.shape[1]] for (_, _, t), alpha in zip(step.outcomes, followers, strict=True)
    )


# -- upper bounds --------------------------------------------------------------------------------------
def mdp_values(problem: Problem, sweeps: int = 3000) -> list[Array]:
    """Values with everything observed, by plain sweeps from zero."""
    table = steps(problem)
    values = [np.zeros(len(s)) for s in problem.states]
    for _ in range(sweeps):
        values = [
            np.max([look_ahead(s, problem.discount, [values[x] for x, _, _ in s.outcomes]) for s in row], axis=0)
            for row in table
        ]
    return values


def qmdp_vectors(problem: Problem) -> list[Array]:
    """One step, then everything observed: ``[choice, y]`` of every mode."""
    values = mdp_values(problem)
    return [
        np.array([look_ahead(s, problem.discount, [values[x] for x, _, _ in s.outcomes]) for s in row])
        for row in steps(problem)
    ]


def informed_vectors(problem: Problem, sweeps: int = 3000) -> list[Array]:
    """Hauskrecht's fast informed bound, from above: ``[choice, y]`` of every mode."""
    table = steps(problem)
    alpha = qmdp_vectors(problem)
    for _ in range(sweeps):
        alpha = [
            np.array([
                s.reward + problem.discount * sum((t @ alpha[x].T).max(axis=1) for x, _, t in s.outcomes)
                for s in row
            ])
            for row in table
        ]  # fmt: skip
    return alpha


def freudenthal(belief: Array, size: int) -> list[tuple[Array, float]]:
    """Vertices (as beliefs) and weights of a belief in the triangulation with `size` cells a side."""
    n = len(belief)
    x = size * np.array([belief[i:].sum() for i in range(n)])
    x[0] = size
    base = np.floor(x + 1e-9)
    part = np.clip(x - base, 0, None)
    part[part < 1e-9] = 0
    order = sorted(range(1, n), key=lambda i: (-part[i], i))
    heights = [1.0, *(part[i] for i in order), 0.0]
    out = []
    vertex = base.copy()
    for k in range(n):
        if k:
            vertex[order[k - 1]] += 1
        if heights[k] - heights[k + 1] > 0:
            out.append((-np.diff(np.append(vertex, 0.0)) / size, heights[k] - heights[k + 1]))
    return out


def sawtooth(corner: Array, points: Sequence[tuple[Array, float]], belief: Array) -> float:
    """Least of the corners' plane and the teeth of the points ``(b_i, v_i)``."""
    plane = float(corner @ belief)
    values = [plane]
    for b, v in points:
        held = b > 0
        share = float((belief[held] / b[held]).min())
        values.append(plane + share * (v - float(corner @ b)))
    return min(values)


# -- policies ------------------------------------------------------------------------------------------
def controller_values(
    problem: Problem, mode: Sequence[int], choice: Sequence[int], follow: NDArray[np.int64]
) -> list[Array]:
    """Value of every node of a policy graph by hidden state: one linear system, solved by sweeps if large."""
    table = steps(problem)
    place = np.concatenate([[0], np.cumsum([len(problem.states[x]) for x in mode])])
    size = int(place[-1])
    reward, parts = np.zeros(size), []
    for i, (x, c) in enumerate(zip(mode, choice, strict=True)):
        reward[place[i] : place[i + 1]] = table[x][c].reward
        for z, (after, _, t) in enumerate(table[x][c].outcomes):
            j = int(follow[i][z])
            assert mode[j] == after, f"vector {i}, outcome {z} leads to mode {after}, follower has {mode[j]}"
            y, y_next = np.nonzero(t)
            parts.append((y + place[i], y_next + place[j], t[y, y_next]))
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    ahead = problem.discount * sparse.csr_array((value, (row, column)), shape=(size, size))
    if size <= 3000:
        solved = np.linalg.solve(np.eye(size) - ahead.toarray(), reward)
    else:
        solved = np.zeros(size)
        for _ in range(int(np.ceil(np.log(1e-14) / np.log(problem.discount)))):
            solved = reward + ahead @ solved
    return [solved[place[i] : place[i + 1]] for i in range(len(mode))]


def blind_value(problem: Problem, picks: Sequence[int]) -> list[Array]:
    """Value by mode and hidden state of a fixed choice in every mode."""
    widest = max(len(s.outcomes) for row in steps(problem) for s in row)
    follow = np.zeros((problem.n_modes, widest), dtype=np.int64)
    for x, c in enumerate(picks):
        for z, (after, _, _) in enumerate(steps(problem)[x][c].outcomes):
            follow[x, z] = after
    return controller_values(problem, range(problem.n_modes), picks, follow)


# -- exact ---------------------------------------------------------------------------------------------
Leaf = Callable[[int, Array], Array]


def tree_value(problem: Problem, depth: int, leaf: Leaf) -> float:
    """Best plan of `depth` steps, then `leaf(mode, unnormalised beliefs [i, y]) -> [i]`, from the start."""
    table = steps(problem)

    def value(x: int, w: Array, left: int) -> Array:
        if left == 0:
            return leaf(x, w)
        calls: dict[int, list[Array]] = {}
        for step in table[x]:
            for after, _, t in step.outcomes:
                calls.setdefault(after, []).append(w @ t)
        found = {
            after: iter(np.split(value(after, np.concatenate(parts), left - 1), len(parts)))
            for after, parts in calls.items()
        }
        best = np.full(len(w), -np.inf)
        for step in table[x]:
            ahead = sum(next(found[after]) for after, _, _ in step.outcomes)
            best = np.maximum(best, w @ step.reward + problem.discount * ahead)
        return best

    return sum(float(value(x, joint[None], depth)[0]) for x, joint in enumerate(problem.initial) if joint.sum() > 0)


def tree_interval(problem: Problem, depth: int) -> tuple[float, float]:
    """The optimal value lies in it: `depth` steps, then the worst and the best reward for ever."""
    rewards = [c.reward for offered in problem.choices for c in offered]
    low, high = min(r.min() for r in rewards), max(r.max() for r in rewards)
    return tuple(
        tree_value(problem, depth, lambda _, w, r=r: w.sum(axis=1) * r / (1 - problem.discount))
        for r in (low, high)
    )  # type: ignore[return-value]


def line_interval(problem: Problem, points: int = 401, sweeps: int = 0) -> tuple[float, float]:
    """Bounds of the optimal value where no mode has more than two hidden states: beliefs are points of a line.

    Above: values at equally spaced points, straight lines between them, from the highest value there could be.
    Below: one vector a point, backed up there, from the lowest.
    """
    table = steps(problem)
    assert problem.n_states <= 2
    rewards = np.concatenate([s.reward for row in table for s in row])
    low, high = rewards.min() / (1 - problem.discount), rewards.max() / (1 - problem.discount)
    sweeps = sweeps or int(np.ceil(np.log(1e-9) / np.log(max(problem.discount, 0.1))))
    second = np.linspace(0, 1, points)
    beliefs = [np.stack([1 - second, second], axis=1) if len(s) == 2 else np.ones((1, 1)) for s in problem.states]

    upper = [np.full(len(b), high) for b in beliefs]

    def ahead(x: int, w: Array) -> Array:
        total = np.maximum(w.sum(axis=1), 1e-300)
        share = w[:, -1] / total if w.shape[1] == 2 else np.zeros(len(w))
        return total * (np.interp(share, second, upper[x]) if w.shape[1] == 2 else upper[x][0])

    def best(row: list[Step], b: Array) -> Array:
        return np.max(
            [b @ s.reward + problem.discount * sum(ahead(x, b @ t) for x, _, t in s.outcomes) for s in row], axis=0
        )

    alpha = [np.full((1, len(s)), low) for s in problem.states]
    for _ in range(sweeps):
        upper = [np.minimum(u, best(row, b)) for row, b, u in zip(table, beliefs, upper, strict=True)]
        new = []
        for row, b, old in zip(table, beliefs, alpha, strict=True):
            made = [old[(b @ old.T).argmax(axis=1)]]
            for s in row:
                value = np.broadcast_to(s.reward, b.shape)
                for x, _, t in s.outcomes:
                    value = value + problem.discount * alpha[x][(b @ t @ alpha[x].T).argmax(axis=1)] @ t.T
                made.append(value)
            stacked = np.stack(made)
            winner = np.einsum("ciy,iy->ci", stacked, b).argmax(axis=0)
            new.append(np.unique(stacked[winner, np.arange(len(b))].round(13), axis=0))
        alpha = new
    starts = [(x, joint) for x, joint in enumerate(problem.initial) if joint.sum() > 0]
    return (
        sum(float((alpha[x] @ joint).max()) for x, joint in starts),
        sum(float(best(table[x], joint[None])[0]) for x, joint in starts),
    )
