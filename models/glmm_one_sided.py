r"""Profile intervals of parameters without a finite estimate: one end is infinite, the other need not be.

Where a covariate predicts outcomes perfectly its coefficient runs off, and the interval of its profile likelihood
is open on that side. On the other side the profile falls: the end is where it lies half a quantile of chi-square
below the supremum,

.. math::

   \sup_{\theta : \beta_j = c} \ell(\theta) = \sup_\theta \ell(\theta) - \tfrac12 \chi^2_{1, 1 - \alpha},

with suprema on both sides, because others may run off as well (`models.glmm_supremum`). A coefficient is held by
making an offset of its column, so that the profile is the fit of a smaller model, with its own starts, boundary and
separation. Where other coefficients separate the same rows without this one the profile is flat, and the interval
is the whole line.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from models.glmm_climb import climb
from models.glmm_data import Array, Patterns, Rule
from models.glmm_escape import Escape
from models.glmm_exact import ExactLikelihood, exact_log_likelihood
from models.glmm_exact_maximum import exact_maximum
from models.glmm_limit import find_limit
from models.glmm_optimise import FEW_NODES, Maximum, maximise
from models.glmm_separation import separated_without
from models.glmm_supremum import supremum

STEPS = 24
"""Steps, soon each twice the one before, after which an end that has not been met is called infinite."""

FIRST_STEP = 0.125
"""The first, as a share of how far out the steps start."""

HALVINGS = 50
"""How often a point at which a search stopped is halved, to find one less far out."""

BEYOND = 1.5
"""How far a step goes, against where the logarithm of the fall would have come to its end if it were linear."""

RIGHT = 1e-3
"""Error of quadrature's log-likelihood above which an end is sought without it."""

SEEN = 1e-6
"""Fall of the log-likelihood below which it may be rounding."""

LEVEL = 1e-9
"""Change of the logarithm of the fall, over a step, of a profile that is level."""

CLOSE = 1e-7
"""Precision of an end, relative to where the search for the maximum stopped."""


def one_sided_intervals(
    patterns: Patterns, rule: Rule, best: Maximum, escape: Escape, which: Sequence[int], alpha: float
) -> Array:
    """Ends of the profile intervals of parameters that run off.

    Parameters
    ----------
    patterns, rule, best, escape
        Of the fit.
    which : sequence of int
        Positions in ``(beta, sd)`` of parameters without a finite estimate.
    alpha : float
        One minus the level.

    Returns
    -------
    array [len(which), 2]
        At least one end of each is infinite. NaN for parameters of rows that tell nothing of a variance.
    """
    ends = np.full((len(which), 2), np.nan)
    allowed = 0.5 * float(chi2.ppf(1 - alpha, 1))
    top = supremum(patterns, rule, best).value if escape.any else np.nan
    if not np.isfinite(top):
        return ends
    working = best.coordinates.patterns(patterns)
    start = best.coordinates.back(_less_far(working, _far_out(working, best, escape), top - 0.5 * allowed))
    right = escape.within_groups or _is_right(escape.patterns or patterns, rule, escape.rest or best)
    for row, index in enumerate(which):
        is_sd = index == len(best.theta) - 1
        if not _known(escape, index, is_sd):
            continue
        lowest = 0.0 if is_sd else -np.inf
        ends[row] = lowest, np.inf
        if _flat(patterns, escape, index, is_sd, top - allowed):
            continue
        if is_sd:
            sds = _HeldSd(patterns, best, start, top)
            ends[row, 0] = _end(sds, float(start[-1]), -1, allowed, 0.0, float(start[-1]))
            continue
        held = _HeldCoefficient(patterns, rule, index, top, exact=escape.within_groups)
        size = float(np.sqrt(np.mean(patterns.design[:, index] ** 2)))
        reach = max(abs(float(start[index])), 1.0 / size)
        for side in (-1, 1):
            if side != escape.signs[index]:
                end = _end(held, float(start[index]), side, allowed, lowest, reach)
                if not (held.exact or (right and held.believed(end))):
                    end = _end(held.exactly(best), float(start[index]), side, allowed, lowest, reach)
                ends[row, (side + 1) // 2] = end
    return ends


def _far_out(patterns: Patterns, best: Maximum, escape: Escape) -> Array:
    """A point close below the supremum: where the search stopped, or on the way to the limit."""
    if not escape.within_groups or escape.limit is None:
        return best.top
    likelihood = ExactLikelihood(patterns)
    ray = np.zeros(len(best.theta))
    ray[list(escape.columns)], ray[-1] = escape.limit.direction, 1.0
    ray = best.coordinates.forward(ray)
    points = [exact_maximum(patterns, best).theta, *(ray * 10.0**power for power in range(1, 5))]
    start = max(points, key=lambda point: likelihood(point)[0])
    if escape.separation is None:
        return start
    return climb(likelihood, start).theta  # the coefficients that the rows predicted perfectly ask for


def _less_far(patterns: Patterns, theta: Array, floor: float) -> Array:
    """The nearest point on the way to a limit that is still inside all intervals: further out all is rounding."""
    likelihood = ExactLikelihood(patterns)
    inside = [theta]
    for _ in range(HALVINGS):
        theta = 0.5 * theta
        if likelihood(theta)[0] >= floor:
            inside.append(theta)
    return inside[-1]


def _known(escape: Escape, index: int, is_sd: bool) -> bool:
    """Whether a profile of the parameter means anything: not where no row is left to tell of it."""
    if escape.within_groups or escape.separation is None or escape.separation.complete:
        return True
    return not is_sd and index in escape.separation.positions


def _flat(patterns: Patterns, escape: Escape, index: int, is_sd: bool, floor: float) -> bool:
    """Whether the profile never falls below `floor`, because others can run off in the parameter's place."""
    separation, limit = escape.separation, escape.limit
    if is_sd:
        # Where every row is predicted perfectly any standard deviation will do.
        return not escape.within_groups
    if separation is not None and index in separation.positions:
        return separated_without(patterns, separation, index)
    if limit is None or index not in escape.columns:
        return False
    return bool(limit.held[escape.columns.index(index)] >= floor)


@dataclass(frozen=True)
class _HeldCoefficient:
    """How far the profile of a coefficient lies below the supremum `top`, by quadrature or exactly."""

    patterns: Patterns
    rule: Rule
    index: int
    top: float
    exact: bool = False

    def __call__(self, value: float) -> float:
        smaller = self._smaller(value)
        best = maximise(smaller, self.rule)
        if not self.exact:
            return self.top - supremum(smaller, self.rule, best).value
        value = exact_maximum(best.coordinates.patterns(smaller), best).value
        limit = find_limit(smaller, best.coordinates)
        return self.top - (value if limit is None else max(value, limit.value))

    def _smaller(self, value: float) -> Patterns:
        column = self.patterns.design[:, self.index]
        rest = np.ascontiguousarray(np.delete(self.patterns.design, self.index, axis=1))
        return replace(self.patterns, design=rest, offset=self.patterns.offset + value * column)

    def believed(self, value: float) -> bool:
        """Whether quadrature is right about the profile at a value."""
        if not np.isfinite(value):
            return True
        smaller = self._smaller(value)
        return _is_right(smaller, self.rule, maximise(smaller, self.rule))

    def exactly(self, best: Maximum) -> _HeldCoefficient:
        """The same without quadrature error; `best` is the fit."""
        top = exact_maximum(best.coordinates.patterns(self.patterns), best).value
        return replace(self, top=top, exact=True)


@dataclass(frozen=True)
class _HeldSd:
    """The same of the standard deviation: without quadrature error, which is what makes it look large."""

    patterns: Patterns
    best: Maximum
    start: Array
    top: float

    def __call__(self, value: float) -> float:
        if value <= 0.0:
            return self.top - self.best.pooled_value
        coordinates = self.best.coordinates
        likelihood = ExactLikelihood(coordinates.patterns(self.patterns))
        # Coefficients and standard deviation grow together.
        theta = coordinates.forward(self.start) * (value / self.start[-1])
        return self.top - climb(likelihood, theta, fixed=len(theta) - 1).value


def _is_right(patterns: Patterns, rule: Rule, best: Maximum) -> bool:
    """Whether the log-likelihood of a fit is without error; rules with few nodes are approximations by choice."""
    if rule.n_nodes <= FEW_NODES:
        return True
    return abs(exact_log_likelihood(best.coordinates.patterns(patterns), best.top) - best.value) <= RIGHT


def _end(
    fall: Callable[[float], float], start: float, side: int, allowed: float, lowest: float, reach: float
) -> float:
    """Where the fall of a profile comes to `allowed` on one side of where the search for the maximum stopped.

    Far out the fall is exponential in the parameter, and its logarithm nearly linear.
    """

    def excess(value: float) -> float:
        return float(np.log(max(fall(value), SEEN) / allowed))

    at, step, value, unseen = start, FIRST_STEP * reach, excess(start), float(np.log(2.0 * SEEN / allowed))
    if value >= 0.0:
        return np.nan
    for _ in range(STEPS):
        new = at + side * step
        if np.isfinite(lowest) and new <= lowest:
            new = lowest
        new_value = excess(new)
        if new_value >= 0.0:
            break
        if new == lowest:
            return lowest
        if value > unseen:
            level = abs(new_value - value) <= LEVEL
            if level and side * at > 0.0:
                break  # it has come down to a likelihood at infinity, and stays there
            step *= 1.0 if level else 2.0
            slope = (new_value - value) / abs(new - at)
            if slope > 0.0 and not level:
                # Not much further than the line through both: far beyond the end fits are laborious.
                step = min(step, BEYOND * -new_value / slope)
        at, value = new, new_value
    if new_value < 0.0:
        return side * np.inf
    low, high = sorted((at, new))
    return float(brentq(excess, low, high, xtol=CLOSE * reach, rtol=1e-12))
