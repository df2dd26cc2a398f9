"""One search for a maximum: BFGS on the exact gradient of the likelihood.

The sum of outer products of group scores is the curvature until a search is within a standard error of the top,
BFGS updates refine it from there. The likelihood is even in the standard deviation, so the search is over a signed
one: there is no boundary to run into, and a variance of zero is an ordinary stationary point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.glmm_data import Array, Likelihood

STOP = 1e-8
"""A search ends when the step left is shorter than this many standard errors."""

FAR = 1.0
"""Standard errors to go above which the curvature is made anew from the scores: what BFGS has gathered is stale."""

FRESH = 8
"""Steps after which BFGS goes on alone: where coefficients run off, a search would never come near."""

SAME = 0.2
"""Relative deviation from the parabola around a known maximum below which a search is on its way there."""


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
