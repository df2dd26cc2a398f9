"""Maximum likelihood of the mixed model: several starts, quasi-Newton on the exact gradient, diagnostics.

Searches (`models.glmm_climb`) run in working coordinates (`models.glmm_coordinates`); Newton steps on the Hessian
end the best of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.glmm_climb import STOP, Search, climb
from models.glmm_coordinates import Coordinates
from models.glmm_data import MANY, Array, Likelihood, Patterns, Rule
from models.glmm_pooled import pooled_logistic

STARTS = (1.0, 3.0)
"""Standard deviations at which searches start; never 0, where the gradient in s vanishes."""

FEW_NODES_STARTS = (1.0, 8.0)
"""The same for rules with few nodes, Laplace's first of all, whose errors make second maxima far out."""

FEW_NODES = 11
"""Nodes up to which a rule counts as coarse."""

PART = 2_000
"""Patterns on which searches start where there are many."""

EQUAL = 1e-9
"""Relative difference below which two log-likelihoods count as equal."""


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
    coordinates : Coordinates
        In which the search ran.
    top : array [p + 1]
        `theta` in these.
    curvature : array [p + 1, p + 1]
        `hessian` in these: good to nine digits where covariates are far from zero and `hessian` is not.
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
    coordinates: Coordinates
    top: Array
    curvature: Array

    @property
    def working_covariance(self) -> Array:
        """Inverse of minus `curvature`; zero for a standard deviation on the boundary, NaN without a maximum."""
        size = len(self.top)
        free = np.arange(size - 1 if self.boundary else size)
        inverse = np.zeros((size, size))
        block = self.curvature[np.ix_(free, free)]
        inverse[np.ix_(free, free)] = np.linalg.inv(-block) if negative_definite(block) else np.nan
        return inverse

    @property
    def covariance(self) -> Array:
        """The same for the parameters themselves."""
        return self.coordinates.covariance(self.working_covariance)

    @property
    def several_maxima(self) -> bool:
        """Whether searches ended at different maxima."""
        own = [s for s in self.searches if not s.joined]
        return max(s.value for s in own) - min(s.value for s in own) > 1e-6


def maximise(
    patterns: Patterns,
    rule: Rule,
    starts: Sequence[float] | None = None,
    max_iterations: int = 200,
    start_params: Array | None = None,
) -> Maximum:
    """Maximise the likelihood from several standard deviations and keep the best.

    Parameters
    ----------
    starts : sequence of float, optional
        Standard deviations, positive; `STARTS` or `FEW_NODES_STARTS` where none are given. Fixed effects start at
        those of the pooled logistic regression, stretched by the factor by which a random intercept of that size
        attenuates them.
    max_iterations : int
        Of each search.
    start_params : array [p + 1], optional
        Fixed effects and standard deviation at which one search more starts, the first.
    """
    if starts is None:
        starts = FEW_NODES_STARTS if rule.n_nodes <= FEW_NODES else STARTS
    coordinates = Coordinates.of(patterns.design)
    working = coordinates.patterns(patterns)
    likelihood = Likelihood(working, rule)
    pooled, pooled_value = pooled_logistic(working)
    points = [stretched(pooled, sd) for sd in starts]
    if start_params is not None:
        points.insert(0, coordinates.forward(start_params))
    if working.n_patterns > MANY:
        # All starts on a part of the groups; the maxima found there are the starts for all groups.
        part = Likelihood(working.part(PART), rule)
        scouts = _climb_all(part, points, max_iterations)
        found = [s for s in scouts if not s.joined]
        searches: list[Search] = []
        for scout in found:
            search = climb(likelihood, scout.theta, searches, max_iterations, inverse=scout.inverse)
            searches.append(replace(search, start=scout.start))
        searches += [s for s in scouts if s.joined]
    else:
        searches = _climb_all(likelihood, points, max_iterations)
    best = max((s for s in searches if not s.joined), key=lambda s: s.value)
    theta, value = best.theta, best.value
    boundary = value <= pooled_value + EQUAL * max(1.0, abs(pooled_value))
    if boundary:
        theta = np.append(pooled, 0.0)
    free = np.arange(patterns.n_fixed + (0 if boundary else 1))
    theta, value, hessian, step, definite = _polish(likelihood, theta, free, best.converged)
    theta[-1] = abs(theta[-1])
    ends = tuple(
        replace(s, theta=coordinates.back(s.theta), inverse=coordinates.covariance(s.inverse)) for s in searches
    )
    return Maximum(
        coordinates.back(theta),
        value,
        coordinates.hessian(hessian),
        bool(boundary),
        bool(best.converged and definite and step <= 1e3 * STOP),
        step,
        ends,
        likelihood.calls,
        pooled_value,
        coordinates.back(np.append(pooled, 0.0))[:-1],
        coordinates,
        theta,
        hessian,
    )


def stretched(pooled: Array, sd: float) -> Array:
    """A point to start from: pooled coefficients, undoing what a random intercept of that size attenuates."""
    return np.append(pooled * np.sqrt(1 + (0.588 * sd) ** 2), sd)


def _polish(
    likelihood: Likelihood, theta: Array, free: NDArray[np.int64], newton: bool
) -> tuple[Array, float, Array, float, bool]:
    """Newton steps on the Hessian until the step left is below `STOP`, or rounding.

    Returns
    -------
    theta, value, hessian
    step : float
        What is left, in standard errors; infinite where no step was tried.
    definite : bool
    """
    step = np.inf
    for _ in range(3):
        hessian = likelihood.hessian(theta)
        value, gradient = likelihood(theta)
        definite = negative_definite(hessian[np.ix_(free, free)])
        if not definite or not newton:
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
    return theta, value, hessian, step, definite


def _climb_all(likelihood: Likelihood, points: Sequence[Array], max_iterations: int) -> list[Search]:
    searches: list[Search] = []
    for theta in points:
        searches.append(climb(likelihood, theta, searches, max_iterations))
    return searches


def negative_definite(hessian: Array) -> bool:
    """Whether all directions curve down, measured in units of the diagonal."""
    diagonal = -np.diag(hessian)
    if not np.all(np.isfinite(hessian)) or not np.all(diagonal > 0):
        return False
    root = np.sqrt(diagonal)  # one at a time: products of the smallest diagonals are zero
    scaled = -hessian / root[:, None] / root
    return bool(np.isfinite(scaled).all() and np.linalg.eigvalsh(scaled)[0] > 1e-9)
