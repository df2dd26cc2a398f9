r"""Dunnett's distribution: the largest of several t statistics that share one reference group.

With comparisons of groups of sizes :math:`n_i` with a reference of size :math:`n_0` the statistics correlate as
:math:`\lambda_i \lambda_j`, :math:`\lambda_i = \sqrt{n_i / (n_i + n_0)}`, so that given a common normal :math:`z`
and the scale :math:`s` they are independent:

.. math::

   P(\max_i |t_i| > c) = \int f_\nu(s) \int \varphi(z) \Big(1 - \prod_i \Big[
   \Phi\Big(\tfrac{c s - \lambda_i z}{\sqrt{1 - \lambda_i^2}}\Big) -
   \Phi\Big(\tfrac{- c s - \lambda_i z}{\sqrt{1 - \lambda_i^2}}\Big)\Big]\Big) \,dz\, ds

(Dunnett 1955). Both integrals are trapezoid sums of analytic integrands that die off at both ends, which converge
faster than any power of the step: scipy's `dunnett`, by random numbers, is good to three or four digits, this to
about twelve.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from models.errors import located

Array = NDArray[np.float64]

REACH = 9.0
"""Standard deviations at which the normal density is cut off, beyond where the integrand peaks."""


def dunnett_tail(c: float, sizes: Array, reference_size: float, df: float) -> float:
    """Probability that the largest absolute statistic exceeds `c` when all means are equal.

    Parameters
    ----------
    c : float
        At least 0.
    sizes : float64[comparison]
        Sizes of the groups compared with the reference.
    reference_size : float
    df : float
        Of the pooled variance.

    Examples
    --------
    >>> from scipy.stats import t
    >>> bool(abs(dunnett_tail(2.5, np.array([20.0]), 20.0, 38) - 2 * t.sf(2.5, 38)) < 1e-13)
    True
    """
    if c < 0 or df <= 0:
        raise located("Dunnett's distribution", (c, df), "c of at least 0 and positive degrees of freedom")
    load = np.sqrt(sizes / (sizes + reference_size))
    rest = np.sqrt(reference_size / (sizes + reference_size))
    # Scale: x = log s, whose density has width 1/sqrt(2 df) and falls off as exp(df x) to the left. Large values of
    # c come from small scales, around s^2 = df / (df + c^2).
    width = (2 * df) ** -0.5
    step = min(width / 3, 0.04)
    lowest = -0.5 * np.log1p(c**2 / df) - max(45.0 / df, 8 * width) - 4 * width
    x = np.arange(lowest, min(12 * width, 4.0), step)
    constant = np.log(2) + 0.5 * df * np.log(0.5 * df) - special.gammaln(0.5 * df)
    weight = step * np.exp(df * x - 0.5 * df * np.exp(2 * x) + constant)
    x, weight = x[weight > 0], weight[weight > 0]
    half = min(REACH + float(load.max()) * c, 37.0)
    step = min(0.25, float(rest.min()) / 2.5)
    z = np.arange(-half, half + step, step)
    normal = step * np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    reach = c * np.exp(x)
    log_inside = np.zeros((len(x), len(z)))
    with np.errstate(divide="ignore"):
        for a, r in zip(load, rest, strict=True):
            outside = special.ndtr((a * z - reach[:, None]) / r) + special.ndtr((-a * z - reach[:, None]) / r)
            log_inside += np.log1p(-np.minimum(outside, 1.0))
    return float(min(1.0, weight @ (-np.expm1(log_inside)) @ normal))


def dunnett_critical(level: float, sizes: Array, reference_size: float, df: float) -> float:
    """Value that the largest absolute statistic exceeds with probability ``1 - level``."""
    if not 0 < level < 1:
        raise located("level", level, "between 0 and 1")
    # Between one comparison and Bonferroni's bound for all.
    low = float(special.stdtrit(df, (1 + level) / 2))
    high = float(special.stdtrit(df, 1 - (1 - level) / (2 * len(sizes)))) + 1e-6

    def excess(c: float) -> float:
        return dunnett_tail(c, sizes, reference_size, df) - (1 - level)

    return float(optimize.brentq(excess, low - 1e-6, high, xtol=1e-13, rtol=1e-14))
