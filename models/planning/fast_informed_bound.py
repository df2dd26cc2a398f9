r"""Upper bounds that know more than the robot will: the fully observed problem, and the fast informed bound.

.. math::
   V_{MDP}(x, y) &= \max_c R_c(y) + \gamma \textstyle\sum P(x', y' \mid x, y, c)\, V_{MDP}(x', y') \\
   \alpha_c(y) &= R_c(y) + \gamma \textstyle\sum_z \max_{c'} \sum_{y'} P(x', z, y' \mid x, y, c)\, \alpha_{c'}(y')

and :math:`V^* \le \max_c \alpha_c \cdot b \le \max_c Q^{MDP}_c \cdot b \le V_{MDP} \cdot b` (Hauskrecht 2000). Both
are iterated from above, so every sweep is sound; started at zero, as is often seen, they are not.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.arrays import Array, ProblemArrays


@kernel
def mdp_bound(problem: ProblemArrays, tolerance: float, most: int, values: Array) -> int:
    r"""Values of the problem with everything observed, from above; returns the number of sweeps.

    After a sweep the values lie at least at the fixed point once :math:`\gamma / (1 - \gamma)` times the largest
    change is added (Porteus 1971), a negative number while values fall, which takes the slow common part at once.

    Parameters
    ----------
    problem : ProblemArrays
    tolerance : float
        Stop when no value changes by more.
    most : int
        Sweeps at most.
    values : float64[x, w]
        Filled.
    """
    n_modes = len(problem.mode_size)
    highest = -np.inf
    for x in range(n_modes):
        for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
            for y in range(problem.mode_size[x]):
                highest = max(highest, problem.reward[c, y])
    values[:] = 0.0
    for x in range(n_modes):
        values[x, : problem.mode_size[x]] = highest / (1.0 - problem.discount)
    return lower_mdp_bound(problem, tolerance, most, values)


@kernel
def lower_mdp_bound(problem: ProblemArrays, tolerance: float, most: int, values: Array) -> int:
    """Go on with `mdp_bound` from an upper bound."""
    n_modes = len(problem.mode_size)
    new = np.zeros((n_modes, values.shape[1]))
    ahead = problem.discount / (1.0 - problem.discount)
    for sweep in range(most):
        rise = -np.inf
        for x in range(n_modes):
            for y in range(problem.mode_size[x]):
                if problem.halt[0] != 0:
                    return sweep
                best = -np.inf
                for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
                    best = max(best, problem.reward[c, y] + problem.discount * _expected(problem, c, y, values))
                new[x, y] = best
                rise = max(rise, best - values[x, y])
        change = 0.0
        for x in range(n_modes):
            for y in range(problem.mode_size[x]):
                value = min(values[x, y], new[x, y] + ahead * rise)
                change = max(change, values[x, y] - value)
                values[x, y] = value
        if change <= tolerance:
            return sweep + 1
    return most


@kernel
def _expected(problem: ProblemArrays, choice: int, y: int, values: Array) -> float:
    """Expected value after a choice in a hidden state, everything observed."""
    total = 0.0
    for k in range(problem.choice_branch[choice], problem.choice_branch[choice + 1]):
        row = problem.branch_row[k] + y
        mode = problem.branch_mode[k]
        seen = problem.branch_seen[k]
        for e in range(problem.row_start[row], problem.row_start[row + 1]):
            column = problem.column[e]
            weight = problem.value[e]
            if seen >= 0:
                shown = 0.0
                for s in range(problem.seen_start[seen + column], problem.seen_start[seen + column + 1]):
                    shown += problem.seen_value[s]
                weight *= shown
            total += weight * values[mode, column]
    return total


@kernel
def informed_vectors(problem: ProblemArrays, values: Array, tolerance: float, most: int, vectors: Array) -> int:
    """The fast informed bound, from the fully observed values; returns the number of sweeps.

    Parameters
    ----------
    problem : ProblemArrays
    values : float64[x, w]
        An upper bound of the fully observed values (`mdp_bound`).
    tolerance : float
        Stop when no entry falls by more.
    most : int
        Sweeps at most.
    vectors : float64[c, w]
        Filled: one vector a choice.
    """
    vectors[:] = 0.0
    highest = values.max()
    for x in range(len(problem.mode_size)):
        for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
            for y in range(problem.mode_size[x]):
                if problem.halt[0] != 0:
                    vectors[c, y] = problem.reward[c, y] + problem.discount * highest
                    continue
                vectors[c, y] = problem.reward[c, y] + problem.discount * _expected(problem, c, y, values)
    return lower_informed_vectors(problem, tolerance, most, vectors)


@kernel
def lower_informed_vectors(problem: ProblemArrays, tolerance: float, most: int, vectors: Array) -> int:
    """Go on with `informed_vectors` from an upper bound."""
    outcomes = 0
    for c in range(len(problem.choice_branch) - 1):
        outcomes = max(outcomes, problem.choice_outcome[c + 1] - problem.choice_outcome[c])
    actions = 0
    for x in range(len(problem.mode_size)):
        actions = max(actions, problem.mode_choice[x + 1] - problem.mode_choice[x])
    gains = np.empty((outcomes, actions))
    for sweep in range(most):
        fall = 0.0
        for x in range(len(problem.mode_size)):
            for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
                for y in range(problem.mode_size[x]):
                    if problem.halt[0] != 0:
                        return sweep
                    value = problem.reward[c, y] + problem.discount * _informed(problem, c, y, vectors, gains)
                    if value < vectors[c, y]:
                        fall = max(fall, vectors[c, y] - value)
                        vectors[c, y] = value
        if fall <= tolerance:
            return sweep + 1
    return most


@kernel
def _informed(problem: ProblemArrays, choice: int, y: int, vectors: Array, gains: Array) -> float:
    """Expected value after a choice in a hidden state, the best choice taken after every outcome."""
    total = 0.0
    for k in range(problem.choice_branch[choice], problem.choice_branch[choice + 1]):
        row = problem.branch_row[k] + y
        first, last = problem.row_start[row], problem.row_start[row + 1]
        if first == last:
            continue
        mode = problem.branch_mode[k]
        begin, end = problem.mode_choice[mode], problem.mode_choice[mode + 1]
        seen = problem.branch_seen[k]
        shown = problem.branch_outcome[k + 1] - problem.branch_outcome[k]
        gains[:shown, : end - begin] = 0.0
        for e in range(first, last):
            column = problem.column[e]
            if seen < 0:
                for c in range(begin, end):
                    gains[0, c - begin] += problem.value[e] * vectors[c, column]
            else:
                for s in range(problem.seen_start[seen + column], problem.seen_start[seen + column + 1]):
                    weight = problem.value[e] * problem.seen_value[s]
                    z = problem.seen_outcome[s]
                    for c in range(begin, end):
                        gains[z, c - begin] += weight * vectors[c, column]
        for z in range(shown):
            best = gains[z, 0]
            for j in range(1, end - begin):
                best = max(best, gains[z, j])
            total += best
    return total
