"""The logistic regression that ignores the groups: where searches start, and what a variance of zero comes to."""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.glmm_data import Array, Patterns
from models.glmm_kernel import logistic


def pooled_logistic(patterns: Patterns, max_iterations: int = 100) -> tuple[Array, float]:
    """Logistic regression that ignores the groups: coefficients, and log-likelihood with the constant.

    Newton's method with step halving. Where the data are separated it stops once every separated probability is 0
    or 1 to nine digits and more.
    """
    size = patterns.n_fixed

    def at(b: Array) -> tuple[float, Array, Array]:
        gradient, information = np.empty(size), np.empty((size, size))
        value = pooled_likelihood(
            b, patterns.design, patterns.offset, patterns.successes, patterns.trials, patterns.start,
            patterns.multiplicity, gradient, information,
        )  # fmt: skip
        return value, gradient, information

    beta = np.zeros(size)
    value, gradient, information = at(beta)
    for _ in range(max_iterations):
        try:
            step = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            break
        decrement = float(gradient @ step)
        if decrement <= 1e-20:
            break
        length = 1.0
        new = at(beta + step)
        # So close to the top differences of values are rounding, and Newton's step needs no check.
        while new[0] < value and length > 1e-6 and decrement > 1e-9:
            length *= 0.5
            new = at(beta + length * step)
        if length <= 1e-6:
            break
        beta = beta + length * step
        value, gradient, information = new
    return beta, value + patterns.constant


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
            p, q = logistic(eta)
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
