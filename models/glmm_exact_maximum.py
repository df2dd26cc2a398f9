"""The maximum of the likelihood without quadrature error: slow, for fits whose quadrature cannot be believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.glmm_climb import Search, climb
from models.glmm_data import Patterns
from models.glmm_exact import ExactLikelihood
from models.glmm_optimise import STARTS, Maximum, stretched

MANY_EXACT = 600
"""Patterns beyond which searches run on a part of them, and the best one is continued on all."""

PART_EXACT = 300
"""Patterns of that part."""

STEPS = 80
"""Iterations of a search: one that runs off to infinity has come within rounding of its limit by then."""

PRECISION = 1e-3
"""Standard errors left where a search takes its last step."""


def exact_maximum(patterns: Patterns, best: Maximum) -> Search:
    """Maximise the exact likelihood from moderate standard deviations, and from where quadrature ended.

    Quadrature may have ended far out on a maximum of its own making, from which no search comes back, or on the far
    side of the likelihood's own.

    Parameters
    ----------
    patterns : Patterns
        In the working coordinates of `best`.
    best : Maximum
        Of the same data by quadrature.

    Returns
    -------
    Search
        The best end, in working coordinates. Where the likelihood rises for ever its standard deviation is large
        and its value close below the limit.
    """
    pooled = best.coordinates.forward(np.append(best.pooled_beta, 0.0))[:-1]
    points = [*(stretched(pooled, sd) for sd in STARTS), best.top]
    points = [point for point in points if np.isfinite(point).all()]
    many = patterns.n_patterns > MANY_EXACT
    likelihood = ExactLikelihood(patterns.part(PART_EXACT) if many else patterns)
    found: list[Search] = []
    for point in points:
        found.append(climb(likelihood, point, found, STEPS, stop=PRECISION))
    first = max((s for s in found if not s.joined), key=lambda s: s.value)
    if not many:
        return first
    again = climb(ExactLikelihood(patterns), first.theta, (), STEPS, inverse=first.inverse, stop=PRECISION)
    return replace(again, start=first.start)
