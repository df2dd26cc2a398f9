r"""The master problem of column generation: how to mix the plans found so far.

.. math:: \max_{\lambda \ge 0, \sum \lambda = 1} \; \min_{q \in Q} \; \sum_p \lambda_p \sum_i q_i X_{p, i}

is solved in its dual form, which has one row a plan and one bounded column a draw, so that it stays small however
many draws there are. The linear program is solved by HiGHS to its own tolerance; the vertex that it finds is then
computed again from its active rows and columns, to rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from models.planning.arrays import Index
from models.planning.schedule import Array
from models.robust.risk import RiskSet

TOLERANCE = 1e-10
"""Feasibility that is asked of the linear program, after scaling; the tightest that it takes."""


class Mix(NamedTuple):
    """Shares of the plans ``[p]`` and least favourable weights of the draws ``[d]``."""

    share: Array
    weight: Array


def mix(outcomes: Array, risk: RiskSet) -> Mix:
    """Best shares of given plans, and weights under which none of them does better.

    Parameters
    ----------
    outcomes : float64[p, d]
    risk : RiskSet

    Raises
    ------
    ArithmeticError
        If the linear program fails, with its own words.
    """
    if risk.is_mean or len(outcomes) == 1:
        best = int(np.argmax(outcomes @ risk.weight)) if risk.is_mean else 0
        share = np.zeros(len(outcomes))
        share[best] = 1.0
        return Mix(share, risk.lowest(outcomes[best])[1])
    kappa, used = risk.mean_share, np.flatnonzero(risk.weight > 0)
    centre = outcomes[:, used].mean()
    scale = max(float(np.abs(outcomes[:, used] - centre).max()), 1e-300)
    x = (outcomes[:, used] - centre) / scale
    plans, draws = x.shape
    # t - (1 - kappa) sum_i z_i x_pi >= kappa w x_p, minimise t; columns t, z.
    matrix = np.hstack([-np.ones((plans, 1)), (1 - kappa) * x])
    known = -kappa * (x @ risk.weight[used])
    total = np.concatenate([[0.0], np.ones(draws)])[None]
    bounds = np.column_stack([np.zeros(draws + 1), np.concatenate([[np.inf], risk.caps[used]])])
    bounds[0, 0] = -np.inf
    cost = np.zeros(draws + 1)
    cost[0] = 1.0
    options = {"primal_feasibility_tolerance": TOLERANCE, "dual_feasibility_tolerance": TOLERANCE}
    found = linprog(cost, matrix, known, total, [1.0], bounds, method="highs-ds", options=options)
    if found.status != 0:
        raise ArithmeticError(f"mixing {plans} plans over {draws} draws: {found.message}")
    share = np.maximum(-found.ineqlin.marginals, 0.0)
    z = np.clip(found.x[1:], 0.0, risk.caps[used])
    share, z = _vertex(x, risk, used, share / share.sum(), z)
    q = risk.mean_share * risk.weight
    q[used] += (1 - kappa) * z
    return Mix(share, q)


def _vertex(x: Array, risk: RiskSet, used: Index, share: Array, z: Array) -> tuple[Array, Array]:
    """The same vertex from its active rows and columns, where they determine it; else what came in."""
    kappa, caps = risk.mean_share, risk.caps[used]
    active = np.flatnonzero(share > 1e-9)
    inner = np.flatnonzero((z > 1e-9 * caps) & (z < (1 - 1e-9) * caps))
    n = len(active)
    if n < 2 or len(inner) != n:
        return share, z
    # Shares: outcomes of the mixture are equal in all inner draws, and shares sum to one.
    rows = np.vstack([np.hstack([x[np.ix_(active, inner)].T, -np.ones((n, 1))]), [*np.ones(n), 0.0]])
    # Weights: all active plans have the same outcome under them, and they sum to one.
    fixed = z.copy()
    fixed[inner] = 0.0
    columns = np.vstack([np.hstack([(1 - kappa) * x[np.ix_(active, inner)], -np.ones((n, 1))]), [*np.ones(n), 0.0]])
    outer = -kappa * (x[active] @ risk.weight[used]) - (1 - kappa) * (x[active] @ fixed)
    try:
        exact = np.linalg.solve(rows, np.array([*np.zeros(n), 1.0]))[:n]
        inside = np.linalg.solve(columns, np.array([*outer, 1.0 - fixed.sum()]))[:n]
    except np.linalg.LinAlgError:
        return share, z
    if np.any(exact < 0) or np.any(inside < 0) or np.any(inside > caps[inner]):
        return share, z
    out, fixed[inner] = np.zeros_like(share), inside
    out[active] = exact
    return out, fixed
