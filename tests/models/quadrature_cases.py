"""Groups made by hand for tests of the mixed model's integrals, and derivatives by differences."""

import numpy as np

from models.glmm_data import Patterns

GROUPS = {
    "single outcomes": ([0.3, -0.7, 1.1], [1, 0, 1], [1, 1, 1]),
    "some of several": ([0.2, -1.2, 2.0], [2, 1, 0], [3, 1, 2]),
    "one outcome": ([0.4], [1], [1]),
    "many of many": ([0.1, -0.4, 0.2], [250, 30, 1], [500, 90, 1]),  # products would underflow
    "half of many": ([0.0], [600], [1200]),
    "all of many": ([0.0], [600], [600]),
    "none of many": ([0.0, 0.1], [0, 0], [600, 40]),
    "as expected, far out": ([350.0, -340.0], [1, 0], [1, 1]),
    "a surprise": ([200.0, -5.0], [0, 1], [1, 1]),
    "ten surprises among others": ([0.0, 250.0, 0.0], [1, 0, 1], [1, 10, 1]),  # a product of ten would underflow
    "far beyond exponents": ([800.0, 1.0], [2, 1], [2, 3]),
}


def patterns_of(eta, successes, trials):
    """One group whose linear predictors are coefficients, one a row, so that there is a derivative for each."""
    n = len(eta)
    ones, hits, m = np.zeros(n), np.array(successes, float), np.array(trials, float)
    return Patterns.from_rows(np.eye(n), ones, hits, m, np.ones(n), np.zeros(n, int), compress=False)


def differences(value, theta, step=1e-5):
    moved = [step * e for e in np.eye(len(theta))]
    return np.array([(value(theta + e) - value(theta - e)) / (2 * step) for e in moved])
