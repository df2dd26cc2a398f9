r"""The compiled marginal likelihood of the logistic random-intercept model, with the gradient of the rule used.

For one group with rows ``j``, linear predictor :math:`\eta_j(u) = o_j + x_j'\beta + s u`, successes ``y_j`` of
``m_j`` trials and :math:`p = 1/(1+e^{-\eta})`,

.. math::

   h(u) = \sum_j [y_j \eta_j(u) - m_j \log(1 + e^{\eta_j(u)})] - u^2/2, \qquad
   \hat u = \arg\max h, \quad H = 1 + s^2 \sum_j m_j p_j (1 - p_j), \quad t = H^{-1/2},

.. math::

   \ell = \log t - \tfrac12 \log 2\pi + \log \sum_k w_k e^{z_k^2/2} e^{h(\hat u + t z_k)}

with probabilists' Gauss--Hermite nodes: adaptive quadrature (Pinheiro & Bates 1995; Liu & Pierce 1994), and
Laplace's approximation when there is one node. The gradient differentiates this sum as it stands, mode and scale
included (implicit differentiation of :math:`h'(\hat u)=0`), so it is exact for any number of nodes. The likelihood
is even in ``s``.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel

REACH = 300.0
"""Largest exponent for which plain products of probabilities are used; beyond it sums of logarithms are."""

MODE_ERROR = 1e-15
"""A search for a mode ends with a step whose square times 1 + |s|, about the error left, is below this."""


@kernel
def _logistic(eta):  # type: ignore[no-untyped-def]
    """P and q = 1 - p, each to full relative precision."""
    e = np.exp(-abs(eta))
    small, large = e / (1.0 + e), 1.0 / (1.0 + e)
    return (large, small) if eta > 0.0 else (small, large)


@kernel
def _moments(u, eta, odds, successes, trials, s, moderate, at_mode):  # type: ignore[no-untyped-def]
    """Sums over rows of y - m p, m p q and m p q (q - p) at intercept u.

    `odds` are exp(eta), used where they are moderate; `at_mode` receives p and m p q of the rows.
    """
    residual, information, skew = 0.0, 0.0, 0.0
    quick = moderate and abs(s * u) < REACH
    factor = np.exp(s * u) if quick else 0.0
    for j in range(len(eta)):
        if quick:
            e = odds[j] * factor
            q = 1.0 / (1.0 + e)
            p = e * q
        else:
            p, q = _logistic(eta[j] + s * u)
        # y - m p, as y q - (m - y) p: no cancellation where p is close to 0 or 1.
        residual += successes[j] * q - (trials[j] - successes[j]) * p
        w = trials[j] * p * q
        information += w
        skew += w * (q - p)
        at_mode[0, j] = p
        at_mode[1, j] = w
    return residual, information, skew


@kernel
def find_mode(eta, odds, successes, trials, s, guess, moderate, at_mode):  # type: ignore[no-untyped-def]
    """Mode of h: Newton steps inside a bracket that shrinks, bisection whenever a step would leave it.

    h'(u) = s sum(y - m p) - u, so the mode lies between -s sum(m - y) and s sum(y). Unguarded Newton cycles
    between two points for large s.
    """
    failures, total = 0.0, 0.0
    for j in range(len(eta)):
        failures += trials[j] - successes[j]
        total += successes[j]
    lower, upper = -s * failures, s * total
    if lower > upper:
        lower, upper = upper, lower
    u = min(max(guess, lower), upper)
    for _ in range(200):
        residual, information, _ = _moments(u, eta, odds, successes, trials, s, moderate, at_mode)
        slope = s * residual - u
        if slope > 0.0:
            lower = u
        else:
            upper = u
        step = slope / (1.0 + s * s * information)
        new = u + step
        # Newton's error is of the order of its last step squared: no further pass is needed to see it.
        if lower <= new <= upper and step * step * (1.0 + abs(s)) <= MODE_ERROR:
            return new
        if not lower < new < upper:
            new = 0.5 * (lower + upper)
            if new in (lower, upper):
                return new
        u = new
    return u


@kernel
def _node_weights(  # type: ignore[no-untyped-def]
    eta, odds, successes, trials, s, mode, scale, nodes, log_weights, moderate, probability, expected, weight
):
    """Log of the quadrature sum.

    `weight[k]` receives the normalised terms, `probability[j, k]` p at every node, `expected[k]` sum_j m p.
    """
    n_rows, n_nodes = len(eta), len(nodes)
    reach = abs(s) * scale * nodes[n_nodes - 1]
    depth = abs(mode) * scale * nodes[n_nodes - 1] + 0.5 * mode * mode
    constant, total_successes = 0.0, 0.0
    for j in range(n_rows):
        depth += trials[j] * (abs(eta[j] + s * mode) + reach + 0.7)
        constant += successes[j] * (eta[j] + s * mode)
        total_successes += successes[j]
    for k in range(n_nodes):
        expected[k] = 0.0
    if depth < REACH:
        # exp(y eta) times a product of q = 1 / (1 + exp(eta)): one division per row and node, no logarithm, and
        # nothing can under- or overflow.
        quick = moderate and abs(s * mode) < REACH
        shift = np.exp(s * mode) if quick else 0.0
        factor = probability[n_rows]
        for k in range(n_nodes):
            # Nodes are symmetric about zero.
            mirrored = n_nodes - 1 - k
            if k <= mirrored:
                factor[k] = np.exp(s * scale * nodes[k])
            else:
                factor[k] = 1.0 / factor[mirrored]
            u = mode + scale * nodes[k]
            tilt = total_successes * s * scale * nodes[k]
            weight[k] = np.exp(log_weights[k] + 0.5 * (nodes[k] * nodes[k] - u * u) + tilt)
        for j in range(n_rows):
            e = odds[j] * shift if quick else np.exp(eta[j] + s * mode)
            row = probability[j]
            m = trials[j]
            if m == 1.0:
                for k in range(n_nodes):
                    ratio = e * factor[k]
                    q = 1.0 / (1.0 + ratio)
                    row[k] = ratio * q
                    expected[k] += row[k]
                    weight[k] *= q
            else:
                for k in range(n_nodes):
                    ratio = e * factor[k]
                    q = 1.0 / (1.0 + ratio)
                    row[k] = ratio * q
                    expected[k] += m * row[k]
                    for _ in range(int(m)):
                        weight[k] *= q
        total = 0.0
        for k in range(n_nodes):
            total += weight[k]
        for k in range(n_nodes):
            weight[k] /= total
        return constant + np.log(total)
    largest = -np.inf
    for k in range(n_nodes):
        u = mode + scale * nodes[k]
        value = log_weights[k] + 0.5 * (nodes[k] * nodes[k] - u * u)
        for j in range(n_rows):
            x = eta[j] + s * u
            softplus = max(x, 0.0) + np.log1p(np.exp(-abs(x)))
            # y x - m softplus(x), in the two parts that do not cancel.
            value -= successes[j] * (softplus - x) + (trials[j] - successes[j]) * softplus
            probability[j, k] = _logistic(x)[0]
            expected[k] += trials[j] * probability[j, k]
        weight[k] = value
        largest = max(largest, value)
    total = 0.0
    for k in range(n_nodes):
        weight[k] = np.exp(weight[k] - largest)
        total += weight[k]
    for k in range(n_nodes):
        weight[k] /= total
    return largest + np.log(total)


@kernel
def _group(  # type: ignore[no-untyped-def]
    eta,
    odds,
    design,
    successes,
    trials,
    s,
    guess,
    nodes,
    log_weights,
    at_mode,
    probability,
    expected,
    weight,
    score,
):
    """Log-likelihood, mode and scale of one group; its score in (beta, s) is written to `score`."""
    n_rows, n_nodes, n_fixed = len(eta), len(nodes), design.shape[1]
    moderate, total_successes = True, 0.0
    for j in range(n_rows):
        moderate = moderate and abs(eta[j]) < REACH
        odds[j] = np.exp(eta[j])
        total_successes += successes[j]
    mode = find_mode(eta, odds, successes, trials, s, guess, moderate, at_mode)
    pull, information, skew = _moments(mode, eta, odds, successes, trials, s, moderate, at_mode)
    curvature = 1.0 + s * s * information
    scale = 1.0 / np.sqrt(curvature)
    value = -0.5 * np.log(curvature * 2.0 * np.pi)
    value += _node_weights(
        eta, odds, successes, trials, s, mode, scale, nodes, log_weights, moderate, probability, expected, weight
    )  # fmt: skip
    # d value = (partial of h) + along_mode d mode + along_scale d scale / scale, the last including log t itself.
    along_mode, along_scale, spread = 0.0, 1.0, 0.0
    for k in range(n_nodes):
        u = mode + scale * nodes[k]
        residual = total_successes - expected[k]
        slope = weight[k] * (s * residual - u)
        along_mode += slope
        along_scale += slope * scale * nodes[k]
        spread += weight[k] * u * residual
    # d log t = -(1/2) dH / H, and dH has a part through the mode.
    through_mode = along_mode - along_scale * 0.5 * s * s * s * skew / curvature
    for c in range(n_fixed):
        score[c] = 0.0
    for j in range(n_rows):
        mean = 0.0
        for k in range(n_nodes):
            mean += weight[k] * probability[j, k]
        p, w = at_mode[0, j], at_mode[1, j]
        entry = successes[j] - trials[j] * mean
        entry -= (through_mode * s + along_scale * 0.5 * s * s * (1.0 - 2.0 * p)) * w / curvature
        for c in range(n_fixed):
            score[c] += entry * design[j, c]
    score[n_fixed] = (
        spread
        + through_mode * (pull - s * information * mode) / curvature
        - along_scale * 0.5 * (2.0 * s * information + s * s * skew * mode) / curvature
    )
    return value, mode, scale


@kernel
def marginal_likelihood(  # type: ignore[no-untyped-def]
    theta, design, offset, successes, trials, start, multiplicity, nodes, log_weights,
    modes, scales, values, scores, gradient,
):  # fmt: skip
    """Log-likelihood of all patterns at ``theta = (beta, s)``, without binomial coefficients.

    Parameters
    ----------
    theta : array [p + 1]
        Fixed effects and the signed standard deviation of the intercept.
    design, offset, successes, trials : arrays [rows, p], [rows], [rows], [rows]
        Rows of pattern ``i`` are ``start[i]:start[i + 1]``; successes and trials are whole numbers.
    multiplicity : array [patterns]
        How many groups share the pattern.
    nodes, log_weights : arrays [K]
        Probabilists' nodes, ascending and symmetric about zero, and the logarithms of their weights.
    modes : array [patterns]
        On entry guesses, on exit the modes.
    scales, values : arrays [patterns]
        Receive ``t`` and the log-likelihoods, without binomial coefficients.
    scores : array [patterns, p + 1]
        Receives the derivatives of `values`.
    gradient : array [p + 1]
        Receives the derivative of the whole.

    Returns
    -------
    float
        Sum of `values` by multiplicity. The sums are made here because a threaded library's are slower than the
        rest where processors are shared, and their order varies.
    """
    n_fixed = design.shape[1]
    longest = 0
    for i in range(len(start) - 1):
        longest = max(longest, start[i + 1] - start[i])
    eta, odds = np.empty(longest), np.empty(longest)
    at_mode = np.empty((2, longest))
    probability = np.empty((longest + 1, len(nodes)))  # one row more for the nodes' factors
    weight, expected = np.empty(len(nodes)), np.empty(len(nodes))
    total = 0.0
    gradient[:] = 0.0
    for i in range(len(start) - 1):
        first, last = start[i], start[i + 1]
        n_rows = last - first
        for j in range(n_rows):
            predictor = offset[first + j]
            for c in range(n_fixed):
                predictor += design[first + j, c] * theta[c]
            eta[j] = predictor
        values[i], modes[i], scales[i] = _group(
            eta[:n_rows], odds[:n_rows], design[first:last], successes[first:last], trials[first:last],
            theta[n_fixed], modes[i], nodes, log_weights, at_mode, probability, expected, weight, scores[i],
        )  # fmt: skip
        total += multiplicity[i] * values[i]
        for c in range(n_fixed + 1):
            gradient[c] += multiplicity[i] * scores[i, c]
    return total


@kernel
def pooled_likelihood(  # type: ignore[no-untyped-def]
    beta, design, offset, successes, trials, start, multiplicity, gradient, information
):
    """Log-likelihood without a random intercept, with its gradient and information; arrays as above."""
    n_fixed = design.shape[1]
    gradient[:] = 0.0
    information[:] = 0.0
    total = 0.0
    for i in range(len(start) - 1):
        for j in range(start[i], start[i + 1]):
            eta = offset[j]
            for c in range(n_fixed):
                eta += design[j, c] * beta[c]
            p, q = _logistic(eta)
            hits, misses = successes[j], trials[j] - successes[j]
            softplus = max(eta, 0.0) + np.log1p(np.exp(-abs(eta)))
            total -= multiplicity[i] * (hits * (softplus - eta) + misses * softplus)
            pull = multiplicity[i] * (hits * q - misses * p)
            w = multiplicity[i] * trials[j] * p * q
            for c in range(n_fixed):
                gradient[c] += pull * design[j, c]
                for d in range(c + 1):
                    information[c, d] += w * design[j, c] * design[j, d]
    for c in range(n_fixed):
        for d in range(c):
            information[d, c] = information[c, d]
    return total
