"""Maximum likelihood of the hierarchical model, where Baum-Welch has no closed step for sigma."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from models.baum_welch_fit import BaumWelchFit
from models.hmm_density import HmmDensity
from models.parameters import Array

STARTS = (0.3, 1.0, 2.5)
"""Values of sigma from which the search starts, in log-odds."""

INSIDE = 0.02
"""Share of the uniform tables mixed into the plain estimate, which may sit on a boundary that no step leaves."""

FLAT = 1e-9
"""Dirichlet parameter that leaves the likelihood alone: prior and Jacobian together are powers of it."""


@dataclass(frozen=True)
class PeopleMaximum:
    """The maximum found.

    Attributes
    ----------
    theta : float64[p]
        Learned vector, sigma last.
    log_likelihood : float
    converged : bool
        Whether the best search converged.
    searches : float64[searches]
        Where each search ended.
    """

    theta: Array
    log_likelihood: float
    converged: bool
    searches: Array


def people_maximum(density: HmmDensity, plain: BaumWelchFit) -> PeopleMaximum:
    """Search from the plain model's estimate with several values of sigma, by L-BFGS with the exact gradient.

    Parameters
    ----------
    density : HmmDensity
        Of the hierarchical model; its priors are not used.
    plain : BaumWelchFit
        Of the same states and pins, without offsets.
    """
    flat = replace(
        density,
        alpha=np.full_like(density.alpha, FLAT),
        people=density.people._replace(prior_scale=np.array([1e9])),
    )

    def loss(x: Array) -> tuple[float, Array]:
        value, gradient = flat(x)
        # What is left of the prior of sigma is the Jacobian of its logarithm.
        gradient[-1] -= 1.0
        return -(value - flat.constant - x[-1]), -gradient

    model = plain.model
    layout = density.layout
    tables = layout.pack(model.initial, model.transition, model.emission)
    inside = (1 - INSIDE) * tables + INSIDE * layout.uniform
    theta = np.where(layout.free_entries(density.pins), inside, tables)  # type: ignore[arg-type]
    found = []
    for spread in STARTS:
        start = flat.unconstrained(np.append(theta, spread))
        found.append(minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 2000, "maxfun": 4000}))
    best = min(found, key=lambda r: float(r.fun))
    return PeopleMaximum(
        flat.theta(best.x), -float(best.fun), bool(best.success), np.array([-float(r.fun) for r in found])
    )
