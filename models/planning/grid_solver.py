r"""Both bounds of a problem with few hidden states, driven to each other where it counts.

With the visits :math:`\rho` that the choices that look best make from the root, the gap at the root is at most

.. math::
   \bar V(b_0) - \underline V(b_0) \le \sum_i \rho_i \Big( U_i + S_i + \gamma \sum_z p_{iz} J_{iz} \Big)

where at grid point `i` the upper bound lies by :math:`U_i` above one step ahead, the lower one by :math:`S_i`
below, and :math:`J_{iz} = \sum_k w_k \underline V(v_k) - \underline V(\sum_k w_k v_k)` is what interpolating after
outcome `z` gives away. So :math:`\rho U` says when to stop sweeping, :math:`\rho S` where a vector is missing, and
:math:`\rho \gamma p J` which cells to refine: a dual-weighted residual, as in adaptive finite elements (Becker &
Rannacher 2001). Nothing in it needs to be right for the bounds to be sound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, ProblemArrays
from models.planning.graph_value import solve_reachable
from models.planning.grid_bounds import Grid, look_up_again, refine
from models.planning.grid_sweeps import solve_frozen, sweep_down, visit_shares
from models.planning.precision import gap_wanted
from models.planning.simplex_grid import new_scratch
from models.planning.step_kernel import look_ahead
from models.planning.vectors import Vectors, add_vector, best_since, best_vector, evaluate_graph, keep_useful

DONE, GO_ON, FULL = 0, 1, 2
"""What a round says: the gap is small enough, another round may help, or there is no room for points or vectors."""

SWEEP_SHARE = 0.3
"""Sweeping stops when what is left of it matters less to the gap than this share."""

REFINE_SHARE = 0.7
"""A round refines and backs up where this share of the estimated gap comes from."""

BACKUP_SHARE = 0.5
"""Vectors are added until what they are short of is this share of what the grid loses."""

BACKUPS = 8
"""Times a round looks for missing vectors at most."""

AGREEMENTS = 10
"""Times a round works out visits anew at most."""

VISITS_LEFT = 0.05
"""Visits that need not be accounted for, at most."""

GAP_LEFT = 0.1
"""What these may be worth, as a share of the gap: nodes that nobody is known to visit are not swept."""


ROUND_WORK = 3e8
"""Multiplications that a round spends on sweeps, more or less."""


class _Look(NamedTuple):
    """What a round knows of the lower bound.

    Attributes
    ----------
    low : float64[i]
        At the points that matter and at the vertices of their successors' cells.
    reached : float64[i, z]
        After each outcome of the choices that look best.
    short : float64[i]
        What the lower bound of each point lies below one step ahead, times visits.
    lossy : float64[i, z]
        What each interpolation loses, times visits.
    """

    low: Array
    reached: Array
    short: Array
    lossy: Array


@kernel
def root_bounds(
    grid: Grid, vectors: Vectors, problem: ProblemArrays, weight: Array, first_root: int, out: Array
) -> None:
    """Lower and upper bound of the starting beliefs, weighted; filled into `out`."""
    out[0] = 0.0
    out[1] = 0.0
    for r in range(len(weight)):
        i = first_root + r
        _, low = best_vector(vectors, grid.mode[i], grid.belief[i], problem.mode_size[grid.mode[i]])
        out[0] += weight[r] * low
        out[1] += weight[r] * grid.upper[i]


@kernel
def advance(
    problem: ProblemArrays, grid: Grid, vectors: Vectors, weight: Array, first_root: int, precision: float,
    relative: bool, bounds: Array,
) -> int:  # fmt: skip
    """One round: sweep, estimate, back up, refine.

    Parameters
    ----------
    problem : ProblemArrays
    grid, vectors : Grid, Vectors
        Changed in place.
    weight : float64[r]
        Probability of each root.
    first_root : int
    precision : float
        Wanted gap, absolute or relative to the larger of the bounds' sizes.
    relative : bool
    bounds : float64[2]
        Filled: lower and upper bound.

    Returns
    -------
    int
        `DONE`, `GO_ON` or `FULL`; `GO_ON` too where it was told to come back (`ProblemArrays.halt`).
    """
    scratch = new_scratch(grid.belief.shape[1])
    look_up_again(grid, problem, scratch)
    root_bounds(grid, vectors, problem, weight, first_root, bounds)
    unseen = VISITS_LEFT
    if problem.span > 0.0:
        worth = (1.0 - problem.discount) * problem.span
        unseen = min(unseen, GAP_LEFT * max(0.0, bounds[1] - bounds[0]) / worth)
    if solve_frozen(grid, problem, scratch):
        visit_shares(grid, problem, weight, first_root, unseen, True)
    else:
        # Falling bounds change the choices that look best, and with them which points matter: until both agree.
        done = 0.0
        for attempt in range(AGREEMENTS):
            root_bounds(grid, vectors, problem, weight, first_root, bounds)
            # Nothing is known yet of how much the points count that the last round added: one look at visits.
            sweeps = sweep_down(grid, problem, SWEEP_SHARE * (bounds[1] - bounds[0]), scratch)
            if sweeps < 0:
                return FULL
            done += float(sweeps * grid.counts[0] * grid.probability.shape[1] * grid.belief.shape[1])
            if (sweeps == 1 and attempt > 0) or done > ROUND_WORK or problem.halt[0] != 0:
                break
            visit_shares(grid, problem, weight, first_root, unseen, False)
    root_bounds(grid, vectors, problem, weight, first_root, bounds)
    wanted = gap_wanted(precision, relative, bounds[0], bounds[1], problem.least)
    if bounds[1] - bounds[0] <= wanted:
        return DONE
    if problem.halt[0] != 0:
        return GO_ON
    n = grid.counts[0]
    look = _Look(
        np.full(n, -np.inf), np.full(grid.probability[:n].shape, -np.inf), np.empty(n),
        np.zeros(grid.probability[:n].shape),
    )  # fmt: skip
    useful = _look_up(problem, grid, vectors, look)
    total_lossy = 0.0
    since = 0
    for attempt in range(BACKUPS):
        total_short, total_lossy = _estimate(problem, grid, vectors, look, since)
        if total_short <= BACKUP_SHARE * total_lossy or problem.halt[0] != 0:
            break
        if attempt == 0:
            keep_useful(vectors, problem, useful)
        since = vectors.counts[0]
        if not _back_up(problem, grid, vectors, look.short, total_short, wanted):
            return FULL
        _value_policy(problem, grid, vectors, len(weight), first_root)
    root_bounds(grid, vectors, problem, weight, first_root, bounds)
    wanted = gap_wanted(precision, relative, bounds[0], bounds[1], problem.least)
    if bounds[1] - bounds[0] <= wanted:
        return DONE
    if problem.halt[0] != 0:
        return GO_ON
    return GO_ON if _refine(problem, grid, look.lossy, total_lossy) else FULL


@kernel
def _value_policy(problem: ProblemArrays, grid: Grid, vectors: Vectors, roots: int, first_root: int) -> None:
    """Value the policy of every root exactly, and the vectors that lead to it by some sweeps."""
    for r in range(roots):
        i = first_root + r
        best, _ = best_vector(vectors, grid.mode[i], grid.belief[i], problem.mode_size[grid.mode[i]])
        solve_reachable(problem, vectors, best)
    evaluate_graph(problem, vectors, 0.0, 10)


@kernel
def _look_up(problem: ProblemArrays, grid: Grid, vectors: Vectors, look: _Look) -> NDArray[np.bool_]:
    """Compare all points that matter with all vectors; returns which vectors are best somewhere."""
    useful = np.zeros(len(vectors.mode), dtype=np.bool_)
    for i in range(len(look.low)):
        if problem.halt[0] != 0:
            break
        if grid.share[i] == 0.0:
            continue
        x = grid.mode[i]
        if look.low[i] == -np.inf:
            best, look.low[i] = best_vector(vectors, x, grid.belief[i], problem.mode_size[x])
            useful[best] = True
        first = problem.choice_outcome[problem.mode_choice[x]]
        c = problem.mode_choice[x] + grid.greedy[i]
        for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
            if grid.probability[i, z] > 0.0:
                mode = problem.outcome_mode[first + z]
                size = problem.mode_size[mode]
                best, look.reached[i, z] = best_vector(vectors, mode, grid.after[i, z], size)
                useful[best] = True
                for k in range(grid.corners[i, z]):
                    v = grid.vertex[i, z, k]
                    if look.low[v] == -np.inf:
                        best, look.low[v] = best_vector(vectors, mode, grid.belief[v], size)
                        useful[best] = True
    return useful


@kernel
def _estimate(problem: ProblemArrays, grid: Grid, vectors: Vectors, look: _Look, since: int) -> tuple[float, float]:
    """Where the gap comes from, vectors from number `since` on being new: sums of `short` and of `lossy`."""
    n = len(look.low)
    if since > 0:
        for i in range(n):
            if problem.halt[0] != 0:
                return 0.0, 0.0
            if look.low[i] > -np.inf:
                x = grid.mode[i]
                look.low[i] = best_since(vectors, x, grid.belief[i], problem.mode_size[x], since, look.low[i])
    total_short = 0.0
    total_lossy = 0.0
    for i in range(n):
        if problem.halt[0] != 0:
            break
        look.short[i] = 0.0
        if grid.share[i] == 0.0:
            continue
        x = grid.mode[i]
        first = problem.choice_outcome[problem.mode_choice[x]]
        j = grid.greedy[i]
        c = problem.mode_choice[x] + j
        value = grid.reward[i, j]
        for z in range(problem.choice_outcome[c] - first, problem.choice_outcome[c + 1] - first):
            p = problem.discount * grid.probability[i, z]
            if p == 0.0:
                continue
            reached = look.reached[i, z]
            if since > 0:
                mode = problem.outcome_mode[first + z]
                size = problem.mode_size[mode]
                reached = best_since(vectors, mode, grid.after[i, z], size, since, reached)
                look.reached[i, z] = reached
            value += p * reached
            loss = -reached
            for k in range(grid.corners[i, z]):
                loss += grid.weight[i, z, k] * look.low[grid.vertex[i, z, k]]
            look.lossy[i, z] = max(0.0, grid.share[i] * p * loss)
            total_lossy += look.lossy[i, z]
        look.short[i] = grid.share[i] * max(0.0, value - look.low[i])
        total_short += look.short[i]
    return total_short, total_lossy


@kernel
def _threshold(scores: Array, total: float) -> float:
    """The score above which the entries together make up `REFINE_SHARE` of the total."""
    highest = scores.max()
    level = highest
    for _ in range(30):
        level *= 0.6
        above = 0.0
        for score in scores:
            if score >= level:
                above += score
        if above >= REFINE_SHARE * total:
            break
    return level


@kernel
def _back_up(
    problem: ProblemArrays, grid: Grid, vectors: Vectors, short: Array, total: float, wanted: float
) -> bool:
    """Add a vector at every point that is short of one; False if there is no room for all."""
    if total == 0.0:
        return True
    width = grid.belief.shape[1]
    least = _threshold(short, total)
    best_alpha = np.zeros(width)
    after = np.empty(width)
    follow = np.zeros(vectors.follow.shape[1], dtype=np.int32)
    best_follow = np.zeros(vectors.follow.shape[1], dtype=np.int32)
    room = True
    for i in range(len(short)):
        if problem.halt[0] != 0:
            break
        if short[i] < least:
            continue
        if vectors.counts[0] >= len(vectors.mode):
            room = False
            break
        x = grid.mode[i]
        size = problem.mode_size[x]
        first = problem.choice_outcome[problem.mode_choice[x]]
        _, low = best_vector(vectors, x, grid.belief[i], size)
        best = -np.inf
        best_choice = -1
        for c in range(problem.mode_choice[x], problem.mode_choice[x + 1]):
            value = grid.reward[i, c - problem.mode_choice[x]]
            begin = problem.choice_outcome[c]
            for z in range(begin, problem.choice_outcome[c + 1]):
                mode = problem.outcome_mode[z]
                p = grid.probability[i, z - first]
                # After an impossible outcome any vector of the mode is sound.
                belief = grid.after[i, z - first] if p > 0.0 else grid.belief[i]
                found, reached = best_vector(vectors, mode, belief, problem.mode_size[mode])
                follow[z - begin] = found
                value += problem.discount * p * reached
            if value > best:
                best = value
                best_choice = c
                best_follow[:] = follow
        if best <= low + 0.05 * (1.0 - problem.discount) * wanted:
            continue
        look_ahead(problem, best_choice, size, vectors.alpha, best_follow, best_alpha, after)
        add_vector(vectors, x, best_choice, best_alpha, best_follow)
    return room


@kernel
def _refine(problem: ProblemArrays, grid: Grid, lossy: Array, total: float) -> bool:
    """Refine the cells that give most away; False if there is no room for all."""
    scratch = new_scratch(grid.belief.shape[1])
    least = _threshold(lossy.ravel(), total)
    for i in range(len(lossy)):
        if problem.halt[0] != 0:
            break
        x = grid.mode[i]
        first = problem.choice_outcome[problem.mode_choice[x]]
        for z in range(lossy.shape[1]):
            if lossy[i, z] >= least and lossy[i, z] > 0.0:
                mode = problem.outcome_mode[first + z]
                if not refine(grid, problem, mode, grid.after[i, z], grid.level[i, z] + 1, scratch):
                    return False
    return True
