r"""The log-likelihood of the mixed model without quadrature error, whatever the standard deviation.

Adaptive Gauss--Hermite quadrature assumes an integrand like a normal density. With a large standard deviation a
group's is one between thresholds, flat with steep edges, and the error makes maxima of its own. Here the line is
cut at unit steps and around every row's threshold :math:`-\eta_j / \sigma`, in multiples of the logistic function's
own width, and Gauss--Legendre's rule is used in between. Slower, for fits whose quadrature cannot be believed.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.glmm_data import Array, Patterns

NODES = 10
"""Gauss--Legendre nodes of an interval: with the marks below, errors stay under 1e-12."""

MARKS = np.array([-30.0, -15.0, -7.0, -3.0, -1.0, 0.0, 1.0, 3.0, 7.0, 15.0, 30.0])
"""Where the line is cut around a threshold, on the logit scale."""

TAIL = 12.0
"""Standard deviations beyond thresholds and modes where the integral ends: what is left is below e^-72."""

FARTHEST = 50.0
"""Thresholds and modes further out are not followed."""


def exact_log_likelihood(patterns: Patterns, theta: Array) -> float:
    """Log-likelihood at (fixed effects, sd), constant included."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    eta = patterns.offset + patterns.design @ theta[:-1]
    value = piecewise_likelihood(
        eta, patterns.successes, patterns.trials, patterns.start, patterns.multiplicity, float(abs(theta[-1])),
        MARKS, nodes, weights,
    )  # fmt: skip
    return float(value + patterns.constant)


@kernel
def piecewise_likelihood(  # type: ignore[no-untyped-def]
    eta, successes, trials, start, multiplicity, s, marks, nodes, weights
):
    """Sum over patterns of the logarithms of their integrals, without binomial coefficients."""
    total = 0.0
    for i in range(len(start) - 1):
        a, b = start[i], start[i + 1]
        count, size = 0.0, 0.0
        for j in range(a, b):
            count += trials[j]
            size = max(size, abs(eta[j]))
        # Modes lie no further out than s times the trials, nor much beyond the rows' thresholds.
        out = TAIL + min(FARTHEST, s * count)
        if s > 0.0:
            out = min(out, TAIL + size / s)
        units = int(np.ceil(out))
        cuts = np.empty(2 * units + 1 + (b - a) * len(marks))
        for k in range(2 * units + 1):
            cuts[k] = k - units
        used = 2 * units + 1
        if s > 0.5:
            for j in range(a, b):
                for k in range(len(marks)):
                    cut = (marks[k] - eta[j]) / s
                    if abs(cut) < units:
                        cuts[used] = cut
                        used += 1
        cuts = np.sort(cuts[:used])
        top, summed = -np.inf, 0.0
        for c in range(used - 1):
            half = 0.5 * (cuts[c + 1] - cuts[c])
            if half <= 0.0:
                continue
            middle = 0.5 * (cuts[c + 1] + cuts[c])
            for k in range(len(nodes)):
                u = middle + half * nodes[k]
                h = -0.5 * u * u
                for j in range(a, b):
                    x = eta[j] + s * u
                    softplus = max(x, 0.0) + np.log1p(np.exp(-abs(x)))
                    h -= successes[j] * (softplus - x) + (trials[j] - successes[j]) * softplus
                if h > top:
                    summed *= np.exp(top - h)
                    top = h
                summed += half * weights[k] * np.exp(h - top)
        total += multiplicity[i] * (top + np.log(summed) - 0.5 * np.log(2.0 * np.pi))
    return total
