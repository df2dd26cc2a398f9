"""Maximum likelihood of the mixed model: several starts, quasi-Newton on the exact gradient, diagnostics.

The sum of outer products of group scores is the curvature until a search is within a standard error of the top,
BFGS updates refine it from there, one Newton step on the Hessian ends the search. The likelihood is even in the
standard deviation, so the search is over a signed one: there is no boundary to run into, and a variance of zero is
an ordinary stationary point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.glmm_data import MANY, Array, Likelihood, Patterns, Rule
from models.glmm_pooled import pooled_logistic

STARTS = (1.0, 3.0)
"""Standard deviations at which searches start; never 0, where the gradient in s vanishes."""

FEW_NODES_STARTS = (1.0, 8.0)
"""The same for rules with few nodes, Laplace's first of all, whose errors make second maxima far out."""

FEW_NODES = 11
"""Nodes up to which a rule counts as coarse."""

STOP = 1e-8
"""A search ends when the step left is shorter than this many standard errors."""

FAR = 1.0
"""Standard errors to go above which the curvature is made anew from the scores: what BFGS has gathered is stale."""

FRESH = 8
"""Steps after which BFGS goes on alone: where coefficients run off, a search would never come near."""

SAME = 0.2
"""Relative deviation from the parabola around a known maximum below which a search is on its way there."""

PART = 2_000
"""Patterns on which searches start where there are many."""

EQUAL = 1e-9
"""Relative difference below which two log-likelihoods count as equal."""


@dataclass(frozen=True)
class Search:
    """Where one search ended.

    Attributes
    ----------
    start : float
        Standard deviation it started from.
    theta : array [p + 1]
        Fixed effects and standard deviation, not negative.
    value : float
        Log-likelihood.
    inverse : array [p + 1, p + 1]
        Approximate inverse of minus the Hessian.
    iterations : int
    converged : bool
    joined : bool
        Stopped early because it ran into a maximum that is known already.
    """

    start: float
    theta: Array
    value: float
    inverse: Array
    iterations: int
    converged: bool
    joined: bool = False


@dataclass(frozen=True)
class Maximum:
    """The best maximum found, and how.

    Attributes
    ----------
    theta : array [p + 1]
        Fixed effects and standard deviation, not negative.
    value : float
        Log-likelihood, constant included.
    hessian : array [p + 1, p + 1]
        Second derivatives of the log-likelihood.
    boundary : bool
        The standard deviation is exactly zero.
    converged : bool
        The last step was shorter than `STOP` standard errors (a thousand times that where rounding prevents it),
        and the Hessian is negative definite.
    step : float
        Length, in standard errors, of the Newton step that is left.
    searches : tuple of Search
    evaluations : int
        Likelihoods and gradients computed, all searches and the Hessian together.
    pooled_value : float
        Log-likelihood without a random intercept (sd = 0).
    pooled_beta : array [p]
    """

    theta: Array
    value: float
    hessian: Array
    boundary: bool
    converged: bool
    step: float
    searches: tuple[Search, ...]
    evaluations: int
    pooled_value: float
    pooled_beta: Array

    @property
    def several_maxima(self) -> bool:
        """Whether searches ended at different maxima."""
        own = [s for s in self.searches if not s.joined]
        return max(s.value for s in own) - min(s.value for s in own) > 1e-6


def maximise(
    patterns: Patterns, rule: Rule, starts: Sequence[float] | None = None, max_iterations: int = 200
) -> Maximum:
    """Maximise the likelihood from several standard deviations and keep the best.

    Parameters
    ----------
    starts : sequence of float, optional
        Standard deviations, positive; `STARTS` or `FEW_NODES_STARTS` where none are given. Fixed effects start at
        those of the pooled logistic regression, stretched by the factor by which a random intercept of that size
        attenuates them.
    """
    if starts is None:
        starts = FEW_NODES_STARTS if rule.n_nodes <= FEW_NODES else STARTS
    likelihood = Likelihood(patterns, rule)
    pooled, pooled_value = pooled_logistic(patterns)
    if patterns.n_patterns > MANY:
        # All starts on a part of the groups; the maxima found there are the starts for all groups.
        part = Likelihood(patterns.part(PART), rule)
        scouts = _climb_all(part, pooled, starts, max_iterations)
        found = [s for s in scouts if not s.joined]
        searches: list[Search] = []
        for scout in found:
            search = climb(likelihood, scout.theta, searches, max_iterations, inverse=scout.inverse)
            searches.append(replace(search, start=scout.start))
        searches += [s for s in scouts if s.joined]
    else:
        searches = _climb_all(likelihood, pooled, starts, max_iterations)
    best = max((s for s in searches if not s.joined), key=lambda s: s.value)
    theta, value = best.theta, best.value
    boundary = value <= pooled_value + EQUAL * max(1.0, abs(pooled_value))
    if boundary:
        theta = np.append(pooled, 0.0)
        value = likelihood(theta)[0]
    free = np.arange(patterns.n_fixed + (0 if boundary else 1))
    step = np.inf
    for _ in range(3):
        hessian = likelihood.hessian(theta)
        value, gradient = likelihood(theta)
        definite = negative_definite(hessian[np.ix_(free, free)])
        if not definite or not best.converged:
            break
        move = np.linalg.solve(-hessian[np.ix_(free, free)], gradient[free])
        step = float(np.sqrt(max(0.0, float(gradient[free] @ move))))
        if step <= STOP:
            break
        moved = theta.copy()
        moved[free] += move
        moved_value, moved_gradient = likelihood(moved)
        left = np.linalg.solve(-hessian[np.ix_(free, free)], moved_gradient[free])
        left_step = float(np.sqrt(max(0.0, float(moved_gradient[free] @ left))))
        if left_step >= step:
            break  # rounding
        theta, value, step = moved, moved_value, left_step
        if step <= STOP:
            break
    theta[-1] = abs(theta[-1])
    converged = bool(best.converged and definite and step <= 1e3 * STOP)
    return Maximum(
        theta,
        value,
        hessian,
        bool(boundary),
        converged,
        step,
        tuple(searches),
        likelihood.calls,
        pooled_value,
        pooled,
    )


def _climb_all(likelihood: Likelihood, pooled: Array, starts: Sequence[float], max_iterations: int) -> list[Search]:
    searches: list[Search] = []
    for sd in starts:
        theta = np.append(pooled * np.sqrt(1 + (0.588 * sd) ** 2), sd)
        searches.append(climb(likelihood, theta, searches, max_iterations))
    return searches


def climb(
    likelihood: Likelihood,
    theta: Array,
    known: Sequence[Search] = (),
    max_iterations: int = 200,
    fixed: int | None = None,
    inverse: Array | None = None,
    stop: float = STOP,
) -> Search:
    """BFGS from one point.

    Parameters
    ----------
    likelihood : Likelihood
    theta : array [p + 1]
        Where to start; the sd may have either sign.
    known : sequence of Search
        Maxima found before: the search stops as soon as it joins one.
    fixed : int, optional
        Position of a parameter that does not move (profile likelihood).
    inverse : array [p + 1, p + 1], optional
        Inverse of minus the Hessian to start with; from the scores at the start where it is not given.
    stop : float
        Standard errors left at which the search ends. Where that is coarse the step left is taken unseen, which
        leaves about its square.
    """
    start, theta = float(theta[-1]), np.array(theta, float)
    free = np.delete(np.arange(len(theta)), [] if fixed is None else [fixed])
    value, gradient = likelihood(theta)
    if inverse is None:
        inverse = _from_scores(likelihood)
    b = inverse[np.ix_(free, free)].copy()
    if fixed is not None:
        column = inverse[free, fixed]
        b -= np.outer(column, column) / inverse[fixed, fixed]
    converged, joined, iteration = False, False, 0
    for iteration in range(max_iterations + 1):
        move = b @ gradient[free]
        decrement = float(gradient[free] @ move)
        if decrement <= stop**2:
            converged = True
            if stop > STOP:
                theta[free] += move
            break
        if iteration == max_iterations:
            break
        if any(_same_hill(theta, value, gradient, s) for s in known if s.converged and not s.joined):
            converged = joined = True
            break
        if fixed is None or fixed != len(theta) - 1:
            # The sd at most doubles (plus one): a first step may otherwise land on a plateau far away.
            move *= min(1.0, (1.0 + abs(theta[-1])) / max(abs(move[-1]), 1e-300))
        slope = float(gradient[free] @ move)
        length = 1.0
        for _ in range(40):
            trial = theta.copy()
            trial[free] += length * move
            new_value, new_gradient = likelihood(trial)
            # Near the top differences of values are rounding: there the slope decides.
            flat = abs(new_value - value) <= 1e-13 * abs(value) and abs(new_gradient[free] @ move) < slope
            if new_value >= value + 1e-4 * length * slope or flat:
                break
            curvature = 2.0 * (value + length * slope - new_value) / length**2
            length = min(0.5 * length, max(0.1 * length, slope / curvature)) if curvature > 0 else 0.1 * length
        else:
            converged = decrement <= (1e3 * stop) ** 2
            break
        s, y = trial[free] - theta[free], gradient[free] - new_gradient[free]
        theta, value, gradient = trial, new_value, new_gradient
        if decrement > FAR**2 and fixed is None and iteration < FRESH:
            b = _from_scores(likelihood)
        sy = float(s @ y)
        if sy > 1e-10 * float(np.linalg.norm(s) * np.linalg.norm(y)):
            by = b @ y
            b += np.outer(s, s) * ((sy + y @ by) / sy**2) - (np.outer(by, s) + np.outer(s, by)) / sy
    whole = np.zeros((len(theta), len(theta)))
    whole[np.ix_(free, free)] = b
    if theta[-1] < 0:
        theta[-1] = -theta[-1]
        whole[-1] *= -1
        whole[:, -1] *= -1
    return Search(start, theta, value, whole, iteration, converged, joined)


def _from_scores(likelihood: Likelihood) -> Array:
    """Inverse of the sum of outer products of the scores at the last call."""
    outer = likelihood.outer_product()
    # A ridge of a thousandth keeps steps finite where scores say nothing yet.
    return np.linalg.inv(outer + 1e-3 * np.diag(np.maximum(np.diag(outer), 1e-3)))


def negative_definite(hessian: Array) -> bool:
    """Whether all directions curve down, measured in units of the diagonal."""
    diagonal = -np.diag(hessian)
    if not np.all(np.isfinite(hessian)) or not np.all(diagonal > 0):
        return False
    scaled = -hessian / np.sqrt(np.outer(diagonal, diagonal))
    return bool(np.linalg.eigvalsh(scaled)[0] > 1e-9)


def _same_hill(theta: Array, value: float, gradient: Array, search: Search) -> bool:
    """Whether the value and the gradient at a point are those of the parabola around a known maximum.

    Both within a fifth, in the metric of the maximum; whichever sign the sd has.
    """
    sign = np.ones(len(theta))
    sign[-1] = -1.0 if theta[-1] < 0 else 1.0
    ahead = search.theta - sign * theta
    try:
        predicted = np.linalg.solve(search.inverse, ahead)
    except np.linalg.LinAlgError:
        return False
    square = float(ahead @ predicted)
    off = sign * gradient - predicted
    return bool(
        off @ search.inverse @ off <= SAME**2 * square
        and abs(search.value - value - 0.5 * square) <= SAME * square / 2
    )
