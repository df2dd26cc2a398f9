r"""The log-likelihood of the mixed model without quadrature error, whatever the standard deviation.

Adaptive Gauss--Hermite quadrature assumes an integrand like a normal density. With a large standard deviation a
group's is one between thresholds, flat with steep edges, and the error makes maxima of its own. Here the line is
cut in steps of the mode's own width and around every row's threshold :math:`-\eta_j / \sigma`, in multiples of the
logistic function's own width, and Gauss--Legendre's rule is used in between, for the integral and for its
derivatives, wherever the integrand is not negligible. Slower, for fits whose quadrature cannot be believed.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.glmm_data import Array, Likelihood, Patterns, Rule

NODES = 10
"""Gauss--Legendre nodes of an interval: cut as below, a group's logarithm is right to 1e-11."""

MARKS = np.array([-30.0, -15.0, -7.0, -3.0, -1.0, 0.0, 1.0, 3.0, 7.0, 15.0, 30.0])
"""Where the line is cut around an edge, on the logit scale."""

WIDTHS = 9
"""Steps of the mode's own width, in either direction, before they grow."""

GROWTH = 1.5
"""So many times the last is a step from there on, up to one standard deviation."""

CLOSE = 0.5
"""Cuts nearer than this are one, in widths of the mode or of the logistic function, whichever is smaller."""

NEGLIGIBLE = 50.0
"""How far, in logarithms, an integrand has fallen where the integral ends: it is log-concave."""

NEAR_MODE = 0.01
"""Last step to the mode, in its own widths: where the line is cut need not be known better."""


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
        Where the line is cut around an edge, on the logit scale, and Gauss--Legendre's rule.
    values, slopes, slopes_in_s : arrays [patterns], [rows], [patterns]
        Receive the logarithms, and their derivatives by the linear predictors and by s.
    """
    for i in range(len(start) - 1):
        a, b = start[i], start[i + 1]
        mode, width, top = _peak(eta, successes, trials, a, b, s)
        cuts = _cuts(eta, successes, trials, a, b, s, marks, mode, width, top)
        summed, summed_in_s = 0.0, 0.0
        residual, summed_slopes = np.empty(b - a), np.zeros(b - a)
        for c in range(len(cuts) - 1):
            half, middle = 0.5 * (cuts[c + 1] - cuts[c]), 0.5 * (cuts[c + 1] + cuts[c])
            for k in range(len(nodes)):
                u = middle + half * nodes[k]
                h, in_s = -0.5 * u * u, 0.0
                for j in range(a, b):
                    softplus, p, q = _logistic(eta[j] + s * u)
                    misses = trials[j] - successes[j]
                    h -= successes[j] * (softplus - (eta[j] + s * u)) + misses * softplus
                    residual[j - a] = successes[j] * q - misses * p
                    in_s += residual[j - a]
                weight = half * weights[k] * np.exp(h - top)
                summed += weight
                summed_in_s += weight * u * in_s
                for j in range(b - a):
                    summed_slopes[j] += weight * residual[j]
        values[i] = top + np.log(summed) - 0.5 * np.log(2.0 * np.pi)
        slopes_in_s[i] = summed_in_s / summed
        for j in range(a, b):
            slopes[j] = summed_slopes[j - a] / summed


@kernel
def _logistic(x):  # type: ignore[no-untyped-def]
    """log(1 + e^x), and the probabilities of a success and of a failure, at any x."""
    e = np.exp(-abs(x))
    high, low = 1.0 / (1.0 + e), e / (1.0 + e)
    return max(x, 0.0) + np.log1p(e), high if x > 0.0 else low, low if x > 0.0 else high


@kernel
def _log_integrand(eta, successes, trials, a, b, s, u):  # type: ignore[no-untyped-def]
    """Logarithm of the integrand of rows ``a:b`` at u standard deviations."""
    h = -0.5 * u * u
    for j in range(a, b):
        softplus, _, _ = _logistic(eta[j] + s * u)
        h -= successes[j] * (softplus - (eta[j] + s * u)) + (trials[j] - successes[j]) * softplus
    return h


@kernel
def _peak(eta, successes, trials, a, b, s):  # type: ignore[no-untyped-def]
    """Mode of an integrand, its width there (one over the root of the curvature) and the logarithm at it.

    Newton's method in a bracket: where the slope has not halved, on the far side of an edge, the bracket is halved.
    """
    most = 1.0 + abs(s) * trials[a:b].sum()
    low, high, u, before = -most, most, 0.0, np.inf
    while True:
        slope, curvature = -u, 1.0
        for j in range(a, b):
            _, p, q = _logistic(eta[j] + s * u)
            slope += s * (successes[j] * q - (trials[j] - successes[j]) * p)
            curvature += s * s * trials[j] * p * q
        if slope > 0.0:
            low = u
        else:
            high = u
        step = slope / curvature
        width = 1.0 / np.sqrt(curvature)
        if abs(step) <= NEAR_MODE * width:
            return u, width, _log_integrand(eta, successes, trials, a, b, s, u)
        slow = abs(slope) > 0.5 * before or not low < u + step < high
        before = abs(slope)
        u = 0.5 * (low + high) if slow else u + step


@kernel
def _end(eta, successes, trials, a, b, s, mode, width, top):  # type: ignore[no-untyped-def]
    """How far from the mode, on the side of the sign of `width`, the integrand has become negligible.

    At most 10 standard deviations and a tenth more, as its logarithm falls by half the squared distance at least.
    """
    near, far = 0.0, width
    while _log_integrand(eta, successes, trials, a, b, s, mode + far) > top - NEGLIGIBLE:
        near, far = far, 2.0 * far
    while abs(far - near) > 0.1 * abs(far):
        middle = 0.5 * (near + far)
        if _log_integrand(eta, successes, trials, a, b, s, mode + middle) > top - NEGLIGIBLE:
            near = middle
        else:
            far = middle
    return far


@kernel
def _cuts(eta, successes, trials, a, b, s, marks, mode, width, top):  # type: ignore[no-untyped-def]
    """Where the line is cut: steps from the mode, and marks around the edges of every row's probability.

    A row of n successes is a step at log n above its threshold, not at it, and one of n failures as far below:
    there ``(1 + e^-x)^-n`` has its edge.
    """
    size, finest = abs(s), width
    below = _end(eta, successes, trials, a, b, s, mode, -width, top)
    above = _end(eta, successes, trials, a, b, s, mode, width, top)
    # Steps of one width, growing ones, and whole standard deviations.
    steps = WIDTHS + int(np.ceil(-np.log(width) / np.log(GROWTH))) + int(above - below) + 2
    cuts = np.empty(1 + 2 * steps + 2 * (b - a) * len(marks) + 2)
    cuts[0], used = mode, 1
    for end in (below, above):
        step, distance, taken = width, width, 1
        while distance < abs(end):
            cuts[used] = mode + np.sign(end) * distance
            used, taken = used + 1, taken + 1
            if taken > WIDTHS:
                step = min(GROWTH * step, 1.0)
            distance += step
        cuts[used] = mode + end
        used += 1
    if size > 0.0:
        finest = min(width, 1.0 / size)
        for j in range(a, b):
            rise = np.log(max(successes[j], 1.0))
            fall = -np.log(max(trials[j] - successes[j], 1.0))
            for edge in (rise, fall):
                for k in range(len(marks)):
                    cut = (marks[k] + edge - eta[j]) / s
                    if below < cut - mode < above:
                        cuts[used] = cut
                        used += 1
    cuts = np.sort(cuts[:used])
    kept, last = 1, cuts[used - 1]
    for k in range(1, used - 1):
        if cuts[k] - cuts[kept - 1] > CLOSE * finest and last - cuts[k] > CLOSE * finest:
            cuts[kept] = cuts[k]
            kept += 1
    cuts[kept] = last
    return cuts[: kept + 1]
