r"""The log-likelihood of the mixed model without quadrature error, whatever the standard deviation.

Adaptive Gauss--Hermite quadrature assumes an integrand like a normal density. With a large standard deviation a
group's is one between thresholds, flat with steep edges, and the error makes maxima of its own. Here the line is
cut at unit steps and around every row's threshold :math:`-\eta_j / \sigma`, in multiples of the logistic function's
own width, and Gauss--Legendre's rule is used in between, for the integral and for its derivatives. Slower, for fits
whose quadrature cannot be believed.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.glmm_data import Array, Likelihood, Patterns, Rule

NODES = 10
"""Gauss--Legendre nodes of an interval: with the marks below, errors stay under 1e-12."""

MARKS = np.array([-30.0, -15.0, -7.0, -3.0, -1.0, 0.0, 1.0, 3.0, 7.0, 15.0, 30.0])
"""Where the line is cut around a threshold, on the logit scale."""

TAIL = 12.0
"""Standard deviations beyond thresholds and modes where the integral ends: what is left is below e^-72."""

FARTHEST = 50.0
"""Thresholds and modes further out are not followed."""


NEGLIGIBLE = 50.0
"""How far, in logarithms, an integrand must have fallen for the rest to be left out: it is log-concave."""


class ExactLikelihood(Likelihood):
    """The exact log-likelihood with its gradient, to be called as a `models.glmm_data.Likelihood` is."""

    def __init__(self, patterns: Patterns) -> None:
        super().__init__(patterns, Rule(np.empty(0), np.empty(0)))
        self._nodes, self._weights = np.polynomial.legendre.leggauss(NODES)

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Log-likelihood, constant included, and gradient at ``theta = (beta, s)``; s may have either sign."""
        data, theta = self.patterns, np.asarray(theta, float)
        self.calls += 1
        slopes, in_s = np.empty(len(data.offset)), np.empty(data.n_patterns)
        piecewise_likelihood(
            data.offset + data.design @ theta[:-1], data.successes, data.trials, data.start, float(theta[-1]),
            MARKS, self._nodes, self._weights, self.values, slopes, in_s,
        )  # fmt: skip
        self.scores[:, :-1] = np.add.reduceat(slopes[:, None] * data.design, data.start[:-1])
        self.scores[:, -1] = in_s
        return float(data.multiplicity @ self.values) + data.constant, data.multiplicity @ self.scores


def exact_log_likelihood(patterns: Patterns, theta: Array) -> float:
    """Log-likelihood at (fixed effects, sd), constant included."""
    return ExactLikelihood(patterns)(theta)[0]


@kernel
def piecewise_likelihood(  # type: ignore[no-untyped-def]
    eta, successes, trials, start, s, marks, nodes, weights, values, slopes, slopes_in_s
):
    """Logarithms of the patterns' integrals, without binomial coefficients, and their derivatives.

    Parameters
    ----------
    eta, successes, trials : arrays [rows]
        Linear predictors without the random intercept, and outcomes; rows of pattern ``i`` are
        ``start[i]:start[i + 1]``.
    start : array [patterns + 1]
    s : float
        Standard deviation of the intercept, of either sign.
    marks, nodes, weights : arrays
        Where the line is cut around a threshold, on the logit scale, and Gauss--Legendre's rule.
    values, slopes, slopes_in_s : arrays [patterns], [rows], [patterns]
        Receive the logarithms, and their derivatives by the linear predictors and by s.
    """
    size = abs(s)
    for i in range(len(start) - 1):
        a, b = start[i], start[i + 1]
        count, farthest = 0.0, 0.0
        for j in range(a, b):
            count += trials[j]
            farthest = max(farthest, abs(eta[j]))
        # Modes lie no further out than s times the trials, nor much beyond the rows' thresholds.
        out = TAIL + min(FARTHEST, size * count)
        if size > 0.0:
            out = min(out, TAIL + farthest / size)
        units = int(np.ceil(out))
        cuts = np.empty(2 * units + 1 + (b - a) * len(marks))
        for k in range(2 * units + 1):
            cuts[k] = k - units
        used = 2 * units + 1
        if size > 0.5:
            for j in range(a, b):
                for k in range(len(marks)):
                    cut = (marks[k] - eta[j]) / s
                    if abs(cut) < units:
                        cuts[used] = cut
                        used += 1
        cuts = np.sort(cuts[:used])
        top, summed, summed_in_s = -np.inf, 0.0, 0.0
        residual, summed_slopes = np.empty(b - a), np.zeros(b - a)
        for c in range(used - 1):
            half = 0.5 * (cuts[c + 1] - cuts[c])
            if half <= 0.0:
                continue
            middle = 0.5 * (cuts[c + 1] + cuts[c])
            h = -np.inf
            for k in range(len(nodes)):
                u = middle + half * nodes[k]
                h, in_s = -0.5 * u * u, 0.0
                for j in range(a, b):
                    x = eta[j] + s * u
                    e = np.exp(-abs(x))
                    softplus = max(x, 0.0) + np.log1p(e)
                    misses = trials[j] - successes[j]
                    h -= successes[j] * (softplus - x) + misses * softplus
                    p = 1.0 / (1.0 + e) if x > 0.0 else e / (1.0 + e)
                    q = e / (1.0 + e) if x > 0.0 else 1.0 / (1.0 + e)
                    residual[j - a] = successes[j] * q - misses * p
                    in_s += residual[j - a]
                if h > top:
                    shrink = np.exp(top - h)
                    summed *= shrink
                    summed_in_s *= shrink
                    for j in range(b - a):
                        summed_slopes[j] *= shrink
                    top = h
                weight = half * weights[k] * np.exp(h - top)
                summed += weight
                summed_in_s += weight * u * in_s
                for j in range(b - a):
                    summed_slopes[j] += weight * residual[j]
            if h < top - NEGLIGIBLE:
                break
        values[i] = top + np.log(summed) - 0.5 * np.log(2.0 * np.pi)
        slopes_in_s[i] = summed_in_s / summed
        for j in range(a, b):
            slopes[j] = summed_slopes[j - a] / summed
