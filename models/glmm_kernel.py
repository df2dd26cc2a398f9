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

inlined = kernel(inline="always")
"""For parts of a group's likelihood: slices of arrays, and calls with a dozen of them, cost as much as a small
group's arithmetic; so do inner loops over covariates, which compilers prepare for being long."""

REACH = 300.0
"""Largest exponent for which plain products of probabilities are used; beyond it sums of logarithms are."""

MODE_ERROR = 1e-16
"""A search for a mode ends with a step whose cube times 1 + s^2, more than the error left, is below this."""

ROUNDING = 1e-15
"""A step so short, against 1 + |u|, is rounding."""

FARTHEST_GUESS = 1.0
"""How far a guess of a mode may lie from the mode at the parameters before."""


@kernel
def logistic(eta):  # type: ignore[no-untyped-def]
    """P and q = 1 - p, each to full relative precision."""
    e = np.exp(-abs(eta))
    small, large = e / (1.0 + e), 1.0 / (1.0 + e)
    return (large, small) if eta > 0.0 else (small, large)


@inlined
def _moments(u, eta, odds, successes, trials, first, n_rows, s, moderate, at_mode):  # type: ignore[no-untyped-def]
    """Sums over rows of y - m p, m p q and m p q (q - p) at intercept u.

    `odds` are exp(eta), used where they are moderate; `at_mode` receives p, m p q and q of the rows.
    """
    residual, information, skew = 0.0, 0.0, 0.0
    quick = moderate and abs(s * u) < REACH
    factor = np.exp(s * u) if quick else 0.0
    for j in range(n_rows):
        if quick:
            e = odds[j] * factor
            q = 1.0 / (1.0 + e)
            p = e * q
        else:
            p, q = logistic(eta[first + j] + s * u)
        hits, m = successes[first + j], trials[first + j]
        # y - m p, as y q - (m - y) p: no cancellation where p is close to 0 or 1.
        residual += hits * q - (m - hits) * p
        w = m * p * q
        information += w
        skew += w * (q - p)
        at_mode[0, j] = p
        at_mode[1, j] = w
        at_mode[2, j] = q
    return residual, information, skew


@inlined
def find_mode(  # type: ignore[no-untyped-def]
    eta, odds, successes, trials, first, n_rows, s, guess, hits, misses, moderate, at_mode
):
    """Mode of h, and `_moments` there: Halley's steps inside a bracket that shrinks, bisection out of it.

    h'(u) = s sum(y - m p) - u, so the mode lies between -s sum(m - y) and s sum(y), `misses` and `hits` being the
    sums. Unguarded Newton cycles between two points for large s.
    """
    lower, upper = -s * misses, s * hits
    if lower > upper:
        lower, upper = upper, lower
    u = min(max(guess, lower), upper)
    residual, information, skew = 0.0, 0.0, 0.0
    arrived = False
    for _ in range(200):
        residual, information, skew = _moments(u, eta, odds, successes, trials, first, n_rows, s, moderate, at_mode)
        if arrived:
            break
        slope = s * residual - u
        if slope > 0.0:
            lower = u
        else:
            upper = u
        curvature = 1.0 + s * s * information
        step = slope / curvature
        bend = 1.0 + 0.5 * step * s * s * s * skew / curvature
        if bend > 0.5:
            step /= bend
        if abs(step) <= ROUNDING * (1.0 + abs(u)):
            break
        new = u + step
        if lower <= new <= upper:
            # The error left is of the order of the last step cubed: no further pass is needed to see it.
            arrived = step * step * abs(step) * (1.0 + s * s) <= MODE_ERROR
        if not arrived and not lower < new < upper:
            new = 0.5 * (lower + upper)
            arrived = new in (lower, upper)
        u = new
    return u, residual, information, skew


@inlined
def _laplace(mode, s, scale, eta, successes, trials, first, n_rows, at_mode):  # type: ignore[no-untyped-def]
    """Laplace's log-likelihood of a group from what the search for its mode has left; moderate exponents only."""
    value, product = -0.5 * mode * mode, scale
    for j in range(n_rows):
        value += successes[first + j] * (eta[first + j] + s * mode)
        if trials[first + j] == 1.0:
            product *= at_mode[2, j]
        else:
            value += trials[first + j] * np.log(at_mode[2, j])
    return value + np.log(product)


@inlined
def _node_weights(  # type: ignore[no-untyped-def]
    eta, odds, successes, trials, first, n_rows, s, mode, scale, nodes, log_weights, moderate, depth,
    probability, expected, weight,
):  # fmt: skip
    """Log of the quadrature sum.

    `weight[k]` receives the normalised terms, `probability[j, k]` p at every node, `expected[k]` sum_j m p.
    """
    n_nodes = len(nodes)
    for k in range(n_nodes):
        expected[k] = 0.0
    if depth < REACH:
        constant, total_successes = 0.0, 0.0
        for j in range(n_rows):
            constant += successes[first + j] * (eta[first + j] + s * mode)
            total_successes += successes[first + j]
        # exp(y eta) times a product of q = 1 / (1 + exp(eta)): one division per row and node, no logarithm, and
        # nothing can under- or overflow.
        quick = moderate and abs(s * mode) < REACH
        shift = np.exp(s * mode) if quick else 0.0
        for k in range(n_nodes):
            # Nodes are symmetric about zero.
            mirrored = n_nodes - 1 - k
            if k <= mirrored:
                probability[n_rows, k] = np.exp(s * scale * nodes[k])
            else:
                probability[n_rows, k] = 1.0 / probability[n_rows, mirrored]
            u = mode + scale * nodes[k]
            tilt = total_successes * s * scale * nodes[k]
            weight[k] = np.exp(log_weights[k] + 0.5 * (nodes[k] * nodes[k] - u * u) + tilt)
        for j in range(n_rows):
            e = odds[j] * shift if quick else np.exp(eta[first + j] + s * mode)
            m = trials[first + j]
            if m == 1.0:
                for k in range(n_nodes):
                    ratio = e * probability[n_rows, k]
                    q = 1.0 / (1.0 + ratio)
                    probability[j, k] = ratio * q
                    expected[k] += ratio * q
                    weight[k] *= q
            else:
                for k in range(n_nodes):
                    ratio = e * probability[n_rows, k]
                    q = 1.0 / (1.0 + ratio)
                    probability[j, k] = ratio * q
                    expected[k] += m * ratio * q
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
            x = eta[first + j] + s * u
            hits, m = successes[first + j], trials[first + j]
            softplus = max(x, 0.0) + np.log1p(np.exp(-abs(x)))
            # y x - m softplus(x), in the two parts that do not cancel.
            value -= hits * (softplus - x) + (m - hits) * softplus
            probability[j, k] = logistic(x)[0]
            expected[k] += m * probability[j, k]
        weight[k] = value
        largest = max(largest, value)
    total = 0.0
    for k in range(n_nodes):
        weight[k] = np.exp(weight[k] - largest)
        total += weight[k]
    for k in range(n_nodes):
        weight[k] /= total
    return largest + np.log(total)


@inlined
def _group(  # type: ignore[no-untyped-def]
    eta, odds, successes, trials, first, n_rows, s, guess, hits, misses, size, moderate, nodes, log_weights,
    at_mode, probability, expected, weight, entries, drift,
):  # fmt: skip
    """Log-likelihood, mode, scale, derivative by s, and the mode's derivative by s, of one group.

    `entries` and `drift` receive the derivatives of the log-likelihood and of the mode by eta of the rows.
    """
    n_nodes = len(nodes)
    mode, pull, information, skew = find_mode(
        eta, odds, successes, trials, first, n_rows, s, guess, hits, misses, moderate, at_mode
    )
    curvature = 1.0 + s * s * information
    variance, scale = 1.0 / curvature, 1.0 / np.sqrt(curvature)
    # The largest exponent at any node.
    reach = scale * nodes[n_nodes - 1]
    depth = (abs(mode) + 0.5 * reach) * reach + 0.5 * mode * mode + size
    depth += (hits + misses) * (abs(s) * (abs(mode) + reach) + 0.7)
    # d value = (partial of h) + along_mode d mode + along_scale d scale / scale, the last including log t itself.
    along_mode, along_scale, spread = 0.0, 1.0, 0.0
    single = n_nodes == 1 and depth < REACH
    if single:
        value = _laplace(mode, s, scale, eta, successes, trials, first, n_rows, at_mode)
        along_mode = s * pull - mode
        spread = mode * pull
    else:
        value = -0.5 * np.log(curvature * 2.0 * np.pi)
        value += _node_weights(
            eta, odds, successes, trials, first, n_rows, s, mode, scale, nodes, log_weights, moderate, depth,
            probability, expected, weight,
        )  # fmt: skip
        for k in range(n_nodes):
            u = mode + scale * nodes[k]
            residual = hits - expected[k]
            slope = weight[k] * (s * residual - u)
            along_mode += slope
            along_scale += slope * scale * nodes[k]
            spread += weight[k] * u * residual
    # d log t = -(1/2) dH / H, and dH has a part through the mode.
    through_mode = along_mode - along_scale * 0.5 * s * s * s * skew * variance
    for j in range(n_rows):
        p, w = at_mode[0, j], at_mode[1, j]
        mean = 0.0
        if single:
            mean = p
        else:
            for k in range(n_nodes):
                mean += weight[k] * probability[j, k]
        entry = successes[first + j] - trials[first + j] * mean
        entries[first + j] = entry - (through_mode * s + along_scale * 0.5 * s * s * (1.0 - 2.0 * p)) * w * variance
        drift[first + j] = -s * w * variance
    along = (pull - s * information * mode) * variance
    slope_in_s = spread + through_mode * along
    slope_in_s -= along_scale * 0.5 * (2.0 * s * information + s * s * skew * mode) * variance
    return value, mode, scale, slope_in_s, along


@kernel
def marginal_likelihood(  # type: ignore[no-untyped-def]
    theta, covariates, offset, successes, trials, start, multiplicity, nodes, log_weights,
    before, modes, eta, drift, drift_in_s, scales, values, scores, gradient,
):  # fmt: skip
    """Log-likelihood of all patterns at ``theta = (beta, s)``, without binomial coefficients.

    Parameters
    ----------
    theta : array [p + 1]
        Fixed effects and the signed standard deviation of the intercept.
    covariates, offset, successes, trials : arrays [p, rows], [rows], [rows], [rows]
        Rows of pattern ``i`` are ``start[i]:start[i + 1]``; successes and trials are whole numbers.
    multiplicity : array [patterns]
        How many groups share the pattern.
    nodes, log_weights : arrays [K]
        Probabilists' nodes, ascending and symmetric about zero, and the logarithms of their weights.
    before : array [1]
        s at the call before; receives that of `theta`.
    modes : array [patterns]
        On entry the modes found by the call before, or guesses; on exit the modes.
    eta, drift, drift_in_s : arrays [rows], [rows], [patterns]
        On entry linear predictors without the random intercept, and the derivatives of the modes by these and by s,
        all of the call before, or zero: searches start where these point to. On exit those at `theta`.
    scales, values : arrays [patterns]
        Receive ``t`` and the log-likelihoods, without binomial coefficients.
    scores : array [patterns, p + 1]
        Receives the derivatives of `values`.
    gradient : array [p + 1]
        Receives the derivative of the whole.

    Returns
    -------
    float
        Sum of `values` by multiplicity, made here because a threaded library's sums are slow and vary in order.
    """
    n_fixed, n_all, n_patterns = len(covariates), len(offset), len(start) - 1
    longest = 0
    for i in range(n_patterns):
        longest = max(longest, start[i + 1] - start[i])
    odds, at_mode = np.empty(longest), np.empty((3, longest))
    probability = np.empty((longest + 1, len(nodes)))  # one row more for the nodes' factors
    weight, expected = np.empty(len(nodes)), np.empty(len(nodes))
    predictor, entries = offset.copy(), np.empty(n_all)
    for c in range(n_fixed):
        for row in range(n_all):
            predictor[row] += covariates[c, row] * theta[c]
    s, moved, total, total_in_s = theta[n_fixed], theta[n_fixed] - before[0], 0.0, 0.0
    before[0] = s
    for i in range(n_patterns):
        first, n_rows = start[i], start[i + 1] - start[i]
        hits, misses, size, moderate, shift = 0.0, 0.0, 0.0, True, drift_in_s[i] * moved
        for j in range(n_rows):
            row = first + j
            hits += successes[row]
            misses += trials[row] - successes[row]
            size += trials[row] * abs(predictor[row])
            moderate = moderate and abs(predictor[row]) < REACH
            shift += drift[row] * (predictor[row] - eta[row])
            eta[row] = predictor[row]
            odds[j] = np.exp(predictor[row])
        guess = modes[i] + min(max(shift, -FARTHEST_GUESS), FARTHEST_GUESS)
        guess = 0.0 if np.isnan(guess) else guess  # the call before may have had predictors that were not finite
        values[i], modes[i], scales[i], in_s, drift_in_s[i] = _group(
            eta, odds, successes, trials, first, n_rows, s, guess, hits, misses, size, moderate, nodes, log_weights,
            at_mode, probability, expected, weight, entries, drift,
        )  # fmt: skip
        scores[i, n_fixed], total = in_s, total + multiplicity[i] * values[i]
        total_in_s += multiplicity[i] * in_s
    gradient[n_fixed] = total_in_s
    for c in range(n_fixed):
        slope = 0.0
        for i in range(n_patterns):
            score = 0.0
            for row in range(start[i], start[i + 1]):
                score += entries[row] * covariates[c, row]
            scores[i, c] = score
            slope += multiplicity[i] * score
        gradient[c] = slope
    return total
