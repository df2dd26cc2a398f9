"""The adaptive quadrature of the logistic mixed model in a few lines of numpy, one group at a time."""

import numpy as np
from scipy.optimize import brentq
from scipy.special import expit, logsumexp, xlog1py


def log_joint(u, eta, successes, trials, s):
    """h(u): log-probability of the outcomes (no binomial coefficients) and of u, up to a constant."""
    x = eta + s * u
    return np.sum(successes * x - trials * np.logaddexp(0.0, x)) - u * u / 2


def mode(eta, successes, trials, s):
    """Root of h', between its two bounds."""

    def slope(u):
        return s * np.sum(successes - trials * expit(eta + s * u)) - u

    low, high = sorted((-s * np.sum(trials - successes), s * np.sum(successes)))
    return 0.0 if low == high else brentq(slope, low - 1e-9, high + 1e-9, xtol=1e-14, rtol=1e-14)


def group(eta, successes, trials, s, n_nodes):
    """log of the K-node sum, the mode and the scale."""
    z, w = np.polynomial.hermite_e.hermegauss(n_nodes)
    centre = mode(eta, successes, trials, s)
    p = expit(eta + s * centre)
    scale = (1 + s**2 * np.sum(trials * p * (1 - p))) ** -0.5
    h = np.array([log_joint(centre + scale * zk, eta, successes, trials, s) for zk in z])
    value = np.log(scale) - np.log(2 * np.pi) / 2 + logsumexp(np.log(w) + z**2 / 2 + h)
    return value, centre, scale


def log_likelihood(theta, design, offset, successes, trials, group_code, n_nodes):
    """Sum over groups, rows as they come."""
    eta = offset + design @ theta[:-1]
    return sum(
        group(eta[rows], successes[rows], trials[rows], theta[-1], n_nodes)[0]
        for rows in (group_code == g for g in np.unique(group_code))
    )


def pooled(theta, design, offset, successes, trials):
    """Log-likelihood without a random intercept."""
    p = expit(offset + design @ theta)
    return np.sum(successes * np.log(p) + xlog1py(trials - successes, -p))
