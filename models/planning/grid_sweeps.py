r"""Values on a frozen grid brought down, and the visits that say which of them matter, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.dense_solve import dense_limit, eliminate
from models.planning.grid_bounds import Grid, frozen, open_choice
from models.planning.lazy_choice import highest, next_to_look_at
from models.planning.simplex_grid import Scratch

SWEEPS = 400
"""Sweeps of a round at most."""

SWEEP_WORK = 1e8
"""Multiplications that sweeps take before the clock is looked at, more or less."""

IMPROVEMENTS = 40
"""Policies tried at most where the frozen grid is solved at once."""

NO_ROOM = -1

HALTED = -1
"""Instead of a choice: the sweep was told to come back."""


@kernel
def choice_value(grid: Grid, problem: ProblemArrays, i: int, j: int, first: int) -> float:
    """Upper bound of an opened choice: its reward, and what the frozen interpolations say of its outcomes."""
    c = problem.mode_choice[grid.mode[i]] + j
    total = 0.0
    for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
        p = grid.probability[i, z]
        if p > 0.0:
            total += p * frozen(grid, i, z)
    return grid.reward[i, j] + problem.discount * total


@kernel
def _sweep(
    n: int, backwards: bool, begin: int, node_mode: Index, share: Array, upper: Array, ahead: Array,
    opened: NDArray[np.bool_], greedy: NDArray[np.int32], reward: Array, probability: Array,
    corners: NDArray[np.int32], vertex: NDArray[np.int32], weight: Array, mode_choice: Index, choice_outcome: Index,
    discount: float, fallen: Array, halt: Index,
) -> tuple[int, int]:  # fmt: skip
    """Bring nodes down to the best of one step ahead, one by one, from the `begin`-th on.

    The innermost loop of the solver: it takes plain arrays, because numba counts references whenever one is taken
    out of a tuple, and that took five times as long as the arithmetic.

    Returns
    -------
    int, int
        How far it came, `n` at the end; otherwise the choice there that has to be opened first, or `HALTED`.
        `fallen[0]` and `fallen[1]` are raised by what nodes fell, times visits, and as it is.
    """
    for k in range(begin, n):
        i = n - 1 - k if backwards else k
        if halt[0] != 0:
            return k, HALTED
        if share[i] == 0.0:
            continue
        x = node_mode[i]
        offered = mode_choice[x + 1] - mode_choice[x]
        first = choice_outcome[mode_choice[x]]
        fresh = -1
        j = highest(ahead, i, offered)
        while j != fresh:
            if not opened[i, j]:
                return k, j
            c = mode_choice[x] + j
            total = 0.0
            for z in range(choice_outcome[c] - first, choice_outcome[c + 1] - first):
                p = probability[i, z]
                if p > 0.0:
                    value = 0.0
                    for v in range(corners[i, z]):
                        value += weight[i, z, v] * upper[vertex[i, z, v]]
                    total += p * value
            fresh = j
            j = next_to_look_at(ahead, i, offered, fresh, reward[i, j] + discount * total)
        greedy[i] = fresh
        fall = upper[i] - ahead[i, fresh]
        if fall > 0.0:
            upper[i] = ahead[i, fresh]
            fallen[0] += share[i] * fall
            fallen[1] += fall
    return n, 0


@kernel
def sweep_down(grid: Grid, problem: ProblemArrays, small: float, scratch: Scratch) -> int:
    """Sweep all nodes until what is left matters less than `small` to the root.

    Returns
    -------
    int
        Number of sweeps, a broken off one included; `NO_ROOM` if room for exact nodes is used up.
    """
    fallen = np.empty(2)
    most = int(SWEEP_WORK / (1.0 + grid.counts[0] * grid.probability.shape[1] * grid.belief.shape[1]))
    for sweep in range(min(SWEEPS, max(2, most))):
        n = grid.counts[0]
        fallen[:] = 0.0
        done = 0
        while done < n:
            done, j = _sweep(
                n, sweep % 2 == 0, done, grid.mode, grid.share, grid.upper, grid.ahead, grid.opened, grid.greedy,
                grid.reward, grid.probability, grid.corners, grid.vertex, grid.weight, problem.mode_choice,
                problem.choice_outcome, problem.discount, fallen, problem.halt,
            )  # fmt: skip
            if j == HALTED:
                return sweep + 1
            if done < n:
                i = n - 1 - done if sweep % 2 == 0 else done
                if not open_choice(grid, problem, i, j, scratch):
                    return NO_ROOM
        # Nodes that were met on the way have not been looked at.
        if grid.counts[0] == n and (fallen[0] <= small or fallen[1] == 0.0):
            return sweep + 1
    return min(SWEEPS, max(2, most))


@kernel
def solve_frozen(grid: Grid, problem: ProblemArrays, scratch: Scratch) -> bool:
    r"""Bring all nodes of a small grid down to the value of the frozen problem, by policy iteration.

    The values `W` of the last policy are a proof by themselves: where one step ahead exceeds them by `r` at most,
    :math:`W + r / (1 - \gamma)` is at least the value of the frozen problem (Porteus 1971), and `r` is rounding.

    Returns
    -------
    bool
        Whether it was done; not if there are more nodes than `models.planning.dense_solve.dense_limit` says, or
        it was told to come back.
    """
    most = dense_limit(problem.discount)
    i = 0
    while i < grid.counts[0]:
        if grid.counts[0] > most or problem.halt[0] != 0:
            return False
        for j in range(problem.mode_choice[grid.mode[i] + 1] - problem.mode_choice[grid.mode[i]]):
            if not grid.opened[i, j] and not open_choice(grid, problem, i, j, scratch):
                return False
        i += 1
    n = grid.counts[0]
    if n > most:
        return False
    known = grid.upper[:n].copy()
    policy = grid.greedy[:n].copy()
    ahead = np.empty((n, grid.ahead.shape[1]))
    matrix = np.empty((n, n))
    done = False
    excess = 0.0
    for _ in range(IMPROVEMENTS):
        if problem.halt[0] != 0:
            break
        right = grid.upper[:n]  # values of policies pass through it, as `frozen` reads them there
        for i in range(n):
            _equation(grid, problem, i, policy[i], matrix[i, :n])
            right[i] = grid.reward[i, policy[i]]
        eliminate(matrix, right, n)
        excess = 0.0
        done = True
        for i in range(n):
            x = grid.mode[i]
            offered = problem.mode_choice[x + 1] - problem.mode_choice[x]
            first = problem.choice_outcome[problem.mode_choice[x]]
            best = policy[i]
            for j in range(offered):
                ahead[i, j] = choice_value(grid, problem, i, j, first)
            for j in range(offered):
                if ahead[i, j] > ahead[i, best]:
                    best = j
            excess = max(excess, ahead[i, best] - grid.upper[i])
            if ahead[i, best] > ahead[i, policy[i]] + 1e-13 * problem.largest:
                policy[i] = best
                done = False
        if done:
            break
    lift = excess / (1.0 - problem.discount)
    if done:
        for i in range(n):
            offered = problem.mode_choice[grid.mode[i] + 1] - problem.mode_choice[grid.mode[i]]
            for j in range(offered):
                grid.ahead[i, j] = min(grid.ahead[i, j], ahead[i, j] + problem.discount * lift)
            known[i] = min(known[i], grid.upper[i] + lift)
            grid.greedy[i] = policy[i]
    grid.upper[:n] = known
    return done


@kernel
def _equation(grid: Grid, problem: ProblemArrays, i: int, j: int, row: Array) -> None:
    r"""Row `i` of :math:`I - \gamma P` under choice `j`."""
    x = grid.mode[i]
    first = problem.choice_outcome[problem.mode_choice[x]]
    c = problem.mode_choice[x] + j
    row[:] = 0.0
    row[i] = 1.0
    for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
        p = problem.discount * grid.probability[i, z]
        if p > 0.0:
            for k in range(grid.corners[i, z]):
                row[grid.vertex[i, z, k]] -= p * grid.weight[i, z, k]


@kernel
def visit_shares(
    grid: Grid, problem: ProblemArrays, weight: Array, first_root: int, tolerance: float, anew: bool
) -> None:
    r"""Discounted number of visits of every node under the greedy choices, from roots with weights.

    Solves :math:`\rho = e + \gamma P^\top \rho` by passing on what has not been passed on, until less than
    `tolerance` of a visit is left over. Unless `anew`, it begins with the visits known before, of which mostly
    little has changed, and passes on differences.
    """
    n = grid.counts[0]
    left = np.zeros(n)
    if anew:
        grid.share[:n] = 0.0
    for r in range(len(weight)):
        left[first_root + r] = weight[r]
    small = tolerance / (4.0 * n)
    if not anew:
        for i in range(n):
            mass = grid.share[i]
            left[i] -= mass
            if mass > small:
                _pass_on(grid, problem, i, mass, left)
    for _ in range(1000):
        total = 0.0
        for i in range(n):
            mass = left[i]
            if abs(mass) <= small:
                continue
            left[i] = 0.0
            grid.share[i] += mass
            total += abs(mass)
            _pass_on(grid, problem, i, mass, left)
        if total <= tolerance or problem.halt[0] != 0:
            break
    for i in range(n):
        if grid.share[i] <= small:
            grid.share[i] = 0.0


@kernel
def _pass_on(grid: Grid, problem: ProblemArrays, i: int, mass: float, left: Array) -> None:
    x = grid.mode[i]
    j = grid.greedy[i]
    if not grid.opened[i, j]:
        return
    c = problem.mode_choice[x] + j
    first = problem.choice_outcome[problem.mode_choice[x]]
    for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
        p = problem.discount * mass * grid.probability[i, z]
        if p != 0.0:
            for k in range(grid.corners[i, z]):
                left[grid.vertex[i, z, k]] += p * grid.weight[i, z, k]
