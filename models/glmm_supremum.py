"""The highest value that the likelihood takes or tends to: what a likelihood-ratio test is about.

A covariate that predicts outcomes perfectly has no estimate, standard error or Wald test, but the likelihood rises
to a finite value all the same, and twice its distance to that of a smaller model is the likelihood ratio. Leaving
such data out would leave out those where the effect is largest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.glmm_data import Patterns, Rule
from models.glmm_escape import Escape, find_escape
from models.glmm_exact_maximum import exact_maximum
from models.glmm_nodes import check_nodes
from models.glmm_optimise import Maximum


@dataclass(frozen=True)
class Supremum:
    """Of one fit.

    Attributes
    ----------
    value : float
        Log-likelihood, constant included.
    escape : Escape
        Which parameters run off on the way to it.
    attained : bool
        It is that of `Maximum.theta`, within half a standard error.
    """

    value: float
    escape: Escape
    attained: bool


def supremum(patterns: Patterns, rule: Rule, best: Maximum) -> Supremum:
    """What the likelihood of a fit rises to, also where quadrature has no maximum or one of its own making."""
    escape = find_escape(patterns, rule, best, [str(i) for i in range(patterns.n_fixed)])
    value = escape.supremum(best)
    if not np.isfinite(value):
        return Supremum(exact_maximum(best.coordinates.patterns(patterns), best).value, escape, False)
    if not escape.within_groups:
        check = check_nodes(patterns, rule, best)
        if np.isfinite(check.best_exact):
            attained = best.converged and not escape.any and not check.elsewhere
            return Supremum(check.best_exact, escape, attained)
    return Supremum(value, escape, bool(best.converged and not escape.any and np.isfinite(value)))
