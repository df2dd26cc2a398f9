r"""What a fitted mixed model says of people it has not seen: draws of its parameters, and their log predictive.

The belief about the parameters :math:`\theta = (\beta, \sigma)` is the normal approximation at the maximum,
:math:`N(\hat\theta, V)` with V the inverse of the observed information (the model's covariance, not the robust one:
the prediction takes the model at its word). Sigma is signed here, since the likelihood is even in it; so there is
doubt about a standard deviation that is estimated at zero too. For people F that were left out

.. math:: \log p(y_F) = \log \int N(\theta; \hat\theta, V) \prod_{i \in F} L_i(\theta)\, d\theta,

each :math:`L_i` by adaptive quadrature over the person's intercept. The mean over draws of the belief rests on few
of them where F is a whole condition, so the integral is by importance sampling around the mode of its integrand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln, logsumexp

from models.glmm_data import Array, Likelihood, Patterns, Rule
from models.glmm_optimise import Maximum
from models.joint_predictive import LogPredictive

STREAM = 7_109
"""First element of the spawn keys: draws of the parameters, and points of the integral."""

POINTS = 2000
"""Of the integral, half of them mirrored in sigma."""

FREEDOM = 5.0
"""Degrees of freedom of the t distribution of the points: heavier tails than the integrand's."""

WIDEST = 10.0
"""Largest standard error along any direction: where data are separated the information has none to offer."""


@dataclass(frozen=True)
class NormalBelief:
    """Normal approximation to what is known of the parameters.

    Attributes
    ----------
    centre : float64[p + 1]
        Fixed effects, then the standard deviation of the intercept.
    root : float64[p + 1, p + 1]
        Any R with ``R R'`` the covariance.
    """

    centre: Array
    root: Array

    @classmethod
    def of(cls, maximum: Maximum) -> NormalBelief:
        """From the Hessian at a maximum; directions without information get `WIDEST`.

        Raises
        ------
        ValueError
            If the Hessian is not finite.
        """
        if not (np.isfinite(maximum.hessian).all() and np.isfinite(maximum.theta).all()):
            raise ValueError("the information at the estimates is not finite")
        values, vectors = np.linalg.eigh(-maximum.hessian)
        return cls(np.asarray(maximum.theta), vectors / np.sqrt(np.maximum(values, WIDEST**-2)))

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters."""
        return np.asarray(self.root @ self.root.T)

    def draws(self, n: int, seed: int) -> Array:
        """Independent draws ``[n, p + 1]``; the standard deviation is folded to be positive."""
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, 0)))
        theta = self.centre + rng.standard_normal((n, len(self.centre))) @ self.root.T
        theta[:, -1] = np.abs(theta[:, -1])
        return theta


def mixed_log_predictive(
    belief: NormalBelief, draws: Array, patterns: Patterns, rule: Rule, seed: int, points: int = POINTS
) -> LogPredictive:
    """Log predictive of people who were left out.

    Parameters
    ----------
    belief : NormalBelief
        From the rest.
    draws : float64[draw, p + 1]
        Of that belief, for each person's own log predictive.
    patterns : Patterns
        People left out: their rows under the same columns.
    rule : Rule
        Quadrature over intercepts.
    seed, points : int
        Of the integral.

    Returns
    -------
    LogPredictive
        `by_person` in the order of the groups' codes.
    """
    likelihood = Likelihood(patterns, rule)
    values = np.empty((len(draws), patterns.n_patterns))
    for i, theta in enumerate(draws):
        likelihood(theta)
        values[i] = likelihood.values
    by_pattern = logsumexp(values, axis=0) - np.log(len(draws))
    joint, error = _integral(belief, likelihood, seed, points)
    return LogPredictive(joint, error, np.asarray(by_pattern[patterns.of_group]))


def _integral(belief: NormalBelief, likelihood: Likelihood, seed: int, points: int) -> tuple[float, float]:
    """Logarithm of the integral and its Monte Carlo error, in coordinates that make the belief standard normal."""
    centre, root = belief.centre, belief.root
    size = len(centre)
    inverse = np.linalg.inv(root)

    def cost(z: Array) -> tuple[float, Array]:
        value, gradient = likelihood(centre + root @ z)
        return 0.5 * float(z @ z) - value, z - root.T @ gradient

    # At sigma zero the likelihood is flat in sigma: start one standard error away from it.
    start = centre.copy()
    start[-1] = max(abs(start[-1]), float(np.linalg.norm(root[-1])))
    found = minimize(cost, inverse @ (start - centre), jac=True, method="BFGS")
    curvature = np.eye(size) - root.T @ likelihood.hessian(centre + root @ found.x) @ root
    values, vectors = np.linalg.eigh(curvature)
    # What people add is information; where differences say otherwise the belief's own width is kept.
    width = vectors / np.sqrt(np.maximum(values, 1.0))
    narrow = vectors * np.sqrt(np.maximum(values, 1.0))
    log_determinant = -0.5 * float(np.log(np.maximum(values, 1.0)).sum())

    def log_proposal(z: Array) -> Array:
        square = ((z - found.x) @ narrow) ** 2
        constant = gammaln((FREEDOM + size) / 2) - gammaln(FREEDOM / 2) - 0.5 * size * np.log(FREEDOM * np.pi)
        return np.asarray(
            constant - log_determinant - 0.5 * (FREEDOM + size) * np.log1p(square.sum(axis=1) / FREEDOM)
        )

    def mirrored(z: Array) -> Array:
        theta = centre + z @ root.T
        theta[:, -1] *= -1.0
        return np.asarray((theta - centre) @ inverse.T)

    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, 1)))
    stretch = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, points))
    z = found.x + (rng.standard_normal((points, size)) * stretch[:, None]) @ width.T
    # The likelihood is even in sigma, so there may be a second mode on the other side.
    z[points // 2 :] = mirrored(z[points // 2 :])
    share = np.where(np.arange(2) == 0, points // 2, points - points // 2) / points
    proposal = logsumexp(np.stack([log_proposal(z), log_proposal(mirrored(z))]), axis=0, b=share[:, None])
    log_weight = np.array([likelihood(centre + root @ row)[0] for row in z])
    log_weight += -0.5 * (z**2).sum(axis=1) - 0.5 * size * np.log(2 * np.pi) - proposal
    joint = float(logsumexp(log_weight) - np.log(points))
    weight = np.exp(log_weight - joint)
    return joint, float(np.std(weight, ddof=1) / np.sqrt(points))
