"""The search for the maximum of Laplace's likelihood with random slopes, and when there is none.

Data that the fixed effects separate have none: the likelihood rises for ever (`models.glmm_separation`), whatever
varies between groups. What runs off has no error then; the others have those of the rows that are not predicted
perfectly, exactly as if the search had gone all the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from models.glmm_coordinates import Coordinates
from models.glmm_data import Array
from models.glmm_escape import NO_LOWER, Escape
from models.glmm_optimise import negative_definite
from models.glmm_slope_likelihood import SlopeLikelihood

if TYPE_CHECKING:
    from models.glmm_slope import LogisticSlopeModel

SPREADS = (0.3, 1.0)
"""Standard deviations of slopes, in units of their column, at which searches start."""

STEP = 1e-7
"""Standard errors left at which Newton's steps end."""

CLOSED = 1e-3
"""Entry of a standardised Lambda, in units of the logit, below which a direction has no variance."""

KNOWN = 1e3
"""Standard error of a row's linear predictor from which the likelihood is flat, and the point no maximum.

The tail of a likelihood that rises for ever falls off like its own slope: Newton's steps become short in units of
the standard error only where that is above 1e6. A predictor of a maximum is known to a few logits.
"""

RUN_OFF = 50.0
"""Standard deviation of a row's predictor between groups, in logits, from which groups are all but constant.

Where the covariates separate the outcomes within every group it rises for ever, and Laplace's approximation, which
is at its worst there, puts a maximum somewhere on the way.
"""

FAR = 50.0
"""Coefficient of a working column from which the fit with a random intercept is no place to start."""


@dataclass(frozen=True)
class SlopeMaximum:
    """The best maximum found, in the parameters (beta, entries of Lambda).

    Attributes
    ----------
    theta : array
    value : float
        Log-likelihood there, or what it rises to where the fixed effects separate the data.
    covariance : array
        Inverse of minus the Hessian; zero for entries at zero in a singular fit, NaN for what runs off.
    converged : bool
        A maximum, of the rows that are not predicted perfectly where the fixed effects separate the data.
    ends : tuple of float
        Log-likelihoods at which searches ended.
    escape : Escape
        Of the fit with a random intercept, as far as it is that of this one: what runs off.
    unknown : float
        Standard error of the linear predictor that is known least; NaN without curvature.
    spread : float
        Standard deviation of the linear predictor between groups, in the median row.
    """

    theta: Array
    value: float
    covariance: Array
    converged: bool
    ends: tuple[float, ...]
    escape: Escape
    unknown: float = np.nan
    spread: float = np.nan

    @property
    def runs_off(self) -> bool:
        """Whether groups differ by more logits than outcomes can tell."""
        return bool(self.spread > RUN_OFF)

    @property
    def flat(self) -> bool:
        """Whether the search ended where the likelihood hardly falls in some direction."""
        return bool(self.unknown > KNOWN)


def maximise_slopes(model: LogisticSlopeModel, max_iterations: int) -> SlopeMaximum:
    """The best maximum of a model, from its fit with a random intercept."""
    begin = model.fixed.fit(warn=False)._results
    escape, p, n = begin.escape, model.exog.shape[1], len(model.entries)
    nothing = Escape(np.zeros(p + n, bool), np.zeros(p + n, np.int64))
    signs = np.append(escape.signs[:p], np.zeros(n, np.int64))
    everything = replace(nothing, unbounded=np.ones(p + n, bool), signs=signs)
    beta, sd = np.asarray(begin.params[:-1], float), float(begin.sd)
    found = _search(model, np.ones(len(model.endog), bool), range(p), beta, sd, max_iterations)
    if escape.separation is not None:
        left = _not_predicted(model, begin.model.patterns.design[~escape.separation.left])
        everything = replace(everything, separation=escape.separation)
        if escape.separation.complete or escape.rest is None or not left.any():
            return _without(found, everything)
        columns = list(escape.columns)
        rest = _search(model, left, columns, escape.rest.theta[:-1], float(escape.rest.theta[-1]), max_iterations)
        keep = [*columns, *range(p, p + n)]
        covariance = np.full((p + n, p + n), np.nan)
        covariance[np.ix_(keep, keep)] = rest.covariance
        unbounded = nothing.unbounded.copy()
        unbounded[list(escape.separation.positions)] = True
        covariance[unbounded], covariance[:, unbounded] = np.nan, np.nan
        partly = replace(everything, unbounded=unbounded, signs=np.where(unbounded, everything.signs, 0))
        theta = found.theta.copy()
        theta[p:] = rest.theta[len(columns) :]
        finite = np.flatnonzero(~unbounded[:p])
        theta[finite] = rest.theta[[columns.index(i) for i in finite]]
        return replace(rest, theta=theta, covariance=covariance, escape=partly)
    if escape.limit is None or not escape.within_groups or "Intercept" not in model.effects:
        return found
    # The fit with an intercept alone is this one with slopes that do not vary: it rises as high at least.
    if not found.converged or found.value < escape.limit.value + NO_LOWER:
        return _without(found, replace(everything, limit=escape.limit, within_groups=True))
    return found


def _without(found: SlopeMaximum, escape: Escape) -> SlopeMaximum:
    """The end of a search that has no maximum to find."""
    covariance = np.full_like(found.covariance, np.nan)
    return replace(found, covariance=covariance, converged=False, escape=escape)


def _not_predicted(model: LogisticSlopeModel, predicted: Array) -> NDArray[np.bool_]:
    """Rows of the model whose covariates are not among the given ones."""
    known = {(row + 0.0).tobytes() for row in np.ascontiguousarray(predicted)}  # + 0.0: no minus zero
    return np.array([(row + 0.0).tobytes() not in known for row in np.ascontiguousarray(model.exog)], bool)


def _search(
    model: LogisticSlopeModel, rows: NDArray[np.bool_], columns: range | list[int], beta: Array, sd: float,
    max_iterations: int,
) -> SlopeMaximum:  # fmt: skip
    """Search the likelihood of some rows and columns of the design."""
    columns = list(columns)
    design, p = model.exog[np.ix_(rows, columns)], len(columns)
    coordinates = Coordinates.of(design)
    scale = np.sqrt(np.mean(model.random[rows] ** 2, axis=0))
    scale[scale == 0] = 1.0
    likelihood = model.likelihood(coordinates, scale, rows, columns)
    start = coordinates.forward(np.append(beta, 0.0))[:-1]
    if not np.isfinite(start).all() or np.abs(start).max() >= FAR:
        start = np.zeros(p)
    ends = []
    for spread in SPREADS:
        theta = np.concatenate([start, [0.0 if i != j else spread for i, j in model.entries]])
        for k, (i, j) in enumerate(model.entries):
            if i == j and model.effects[i] == "Intercept":
                theta[p + k] = min(max(sd, 0.3), 5.0)
        options = {"maxiter": max_iterations, "gtol": 1e-5}
        ends.append(minimize(partial(_negative, likelihood), theta, jac=True, method="BFGS", options=options))
    best = min(ends, key=lambda f: f.fun)
    theta, value, covariance, converged = _newton(likelihood, np.asarray(best.x), p)
    unknown = np.nan
    if converged:
        unknown = _least_known(likelihood, covariance)
    spread = float(np.median(np.linalg.norm(likelihood.random @ likelihood.factor(theta), axis=1)))
    if converged and (unknown > KNOWN or spread > RUN_OFF):
        converged, covariance = False, np.full_like(covariance, np.nan)
    out = np.eye(len(theta))
    out[:p, :p] = coordinates.matrix[:-1, :-1]
    for k, (i, _) in enumerate(model.entries):
        out[p + k, p + k] = 1.0 / scale[i]
    size = len(theta)
    escape = Escape(np.zeros(size, bool), np.zeros(size, np.int64))
    values = tuple(float(-f.fun) for f in ends)
    return SlopeMaximum(out @ theta, value, out @ covariance @ out.T, converged, values, escape, unknown, spread)


def _least_known(likelihood: SlopeLikelihood, covariance: Array) -> float:
    """Largest standard error of a row's fixed part, or of what one entry of Lambda adds to it."""
    p = likelihood.design.shape[1]
    fixed = np.einsum("jp,pq,jq->j", likelihood.design, covariance[:p, :p], likelihood.design).max()
    reach = np.abs(likelihood.random).max(axis=0)
    entries = [covariance[p + k, p + k] * reach[i] ** 2 for k, (i, _) in enumerate(likelihood.entries)]
    return float(np.sqrt(max(fixed, *entries)))


def _negative(likelihood: SlopeLikelihood, theta: Array) -> tuple[float, Array]:
    value, gradient = likelihood(theta)
    return -value, -gradient


def _newton(likelihood: SlopeLikelihood, theta: Array, p: int) -> tuple[Array, float, Array, bool]:
    """Newton's steps from near the top; entries of Lambda that are zero there stay so, as they do by symmetry."""
    theta = theta.copy()
    diagonal = np.array([i == j for i, j in likelihood.entries])
    converged = False
    for _ in range(20):
        small = np.abs(theta[p:]) < CLOSED
        trial = theta.copy()
        trial[p:][small & diagonal] = 0.0
        if likelihood(trial)[0] >= likelihood(theta)[0] - 1e-6:
            theta = trial
        fixed = np.append(np.zeros(p, bool), diagonal & (theta[p:] == 0.0))
        # A row of Lambda before a column without variance is not determined: nor is what stands below a zero.
        empty = {j for (i, j), zero in zip(likelihood.entries, fixed[p:], strict=True) if i == j and zero}
        below = [j in empty and abs(theta[p + k]) < CLOSED for k, (_, j) in enumerate(likelihood.entries)]
        fixed[p:] |= np.array(below)
        theta[fixed] = 0.0
        free = np.flatnonzero(~fixed)
        hessian = likelihood.hessian(theta)[np.ix_(free, free)]
        value, gradient = likelihood(theta)
        if not negative_definite(hessian):
            break
        step = np.linalg.solve(-hessian, gradient[free])
        if gradient[free] @ step <= STEP**2:
            converged = True
            break
        length = 1.0
        while length > 1e-6:
            trial = theta.copy()
            trial[free] += length * step
            if likelihood(trial)[0] >= value - 1e-12 * abs(value):
                break
            length *= 0.5
        theta = trial
    covariance = np.full((len(theta), len(theta)), np.nan)
    if converged:
        covariance = np.zeros((len(theta), len(theta)))
        covariance[np.ix_(free, free)] = np.linalg.inv(-hessian)
    return theta, float(likelihood(theta)[0]), covariance, converged
