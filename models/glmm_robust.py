r"""Cluster-robust covariance: the sandwich over groups.

:math:`\frac{G}{G-1} A^{-1} (\sum_i s_i s_i') A^{-1}` with the observed information ``A`` and the scores ``s_i`` of
the groups (White 1982; Liang & Zeger 1986). It stays right where the distribution of the intercept is not normal or
the outcomes of a group depend on each other in another way, as far as the coefficients still mean something then.
"""

from __future__ import annotations

import numpy as np

from models.glmm_data import Array, Likelihood


def sandwich(likelihood: Likelihood, theta: Array, inverse: Array) -> Array:
    """Robust covariance at an estimate.

    Parameters
    ----------
    theta : array [p + 1]
    inverse : array [p + 1, p + 1]
        Inverse information; rows of parameters on a boundary are zero and stay so.

    Returns
    -------
    array [p + 1, p + 1]
    """
    likelihood(theta)
    groups = likelihood.patterns.n_groups
    covariance = inverse @ likelihood.outer_product() @ inverse * (groups / (groups - 1))
    return np.asarray(0.5 * (covariance + covariance.T))
