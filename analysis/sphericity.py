r"""Sphericity of repeated measures: Mauchly's test, and the epsilons of Greenhouse-Geisser and Huynh-Feldt.

With groups, all three use the covariance *within* groups, pooled: :math:`S = E / (N - k)`, where `E` holds sums of
squares and products of the residuals in orthonormal contrasts of the times. A covariance over the pooled table
would take differences between groups for noise, and its epsilon is another one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sphericity:
    """Whether all contrasts of the times vary alike, and the corrections if they do not.

    Attributes
    ----------
    w, p : float
        Mauchly's statistic and its p value; NaN where the test does not exist (two times, or fewer degrees of
        freedom than contrasts).
    greenhouse_geisser, huynh_feldt : float
        Epsilons, from 1 / (times - 1) to 1. Huynh and Feldt's has Lecoutre's correction and is cut off at 1.
    """

    w: float
    p: float
    greenhouse_geisser: float
    huynh_feldt: float


def contrasts(times: int) -> Array:
    """Orthonormal contrasts of the times (Helmert's), ``[time, times - 1]``.

    Examples
    --------
    >>> contrasts(2).ravel().round(4).tolist()
    [0.7071, -0.7071]
    """
    out = np.zeros((times, times - 1))
    for j in range(1, times):
        out[:j, j - 1] = 1.0
        out[j, j - 1] = -j
        out[:, j - 1] /= np.sqrt(j * (j + 1.0))
    return out


def sphericity(error: Array, df: int) -> Sphericity:
    r"""Test and corrections from sums of squares and products of residuals.

    .. math::

       W = \frac{\det E}{(\operatorname{tr} E / q)^q}, \quad
       \varepsilon_{GG} = \frac{(\operatorname{tr} E)^2}{q \operatorname{tr} E^2}, \quad
       \varepsilon_{HF} = \frac{(\nu + 1)\, q\, \varepsilon_{GG} - 2}{q\, (\nu - q\, \varepsilon_{GG})}

    with :math:`q` contrasts and :math:`\nu` degrees of freedom (Greenhouse & Geisser 1959; Huynh & Feldt 1976 with
    Lecoutre 1991). The p value is Box's chi-square expansion with its second-order term (Anderson, *Multivariate
    Statistical Analysis*, 10.7), which R's ``mauchly.test`` uses.

    Parameters
    ----------
    error : float64[contrast, contrast]
        In orthonormal contrasts.
    df : int
        Error degrees of freedom, N - k.
    """
    q = len(error)
    if q == 1:
        return Sphericity(np.nan, np.nan, 1.0, 1.0)
    trace = float(np.trace(error))
    gg = trace**2 / (q * float(np.sum(error**2)))
    spread = df - q * gg
    # Without degrees of freedom to spare the formula has no meaning; its limit is no correction.
    hf = ((df + 1) * q * gg - 2) / (q * spread) if spread > 0 else 1.0
    hf = float(np.clip(hf, gg, 1.0))
    if df < q:
        return Sphericity(np.nan, np.nan, gg, hf)
    sign, log_det = np.linalg.slogdet(error / (trace / q))
    if sign <= 0:
        return Sphericity(0.0, 0.0, gg, hf)
    rho = 1 - (2 * q**2 + q + 2) / (6 * q * df)
    second = (q + 2) * (q - 1) * (q - 2) * (2 * q**3 + 6 * q**2 + 3 * q + 2) / (288 * (df * q * rho) ** 2)
    z, f = -df * rho * log_det, q * (q + 1) / 2 - 1
    p = special.chdtrc(f, z) + second * (special.chdtrc(f + 4, z) - special.chdtrc(f, z))
    return Sphericity(float(np.exp(log_det)), float(np.clip(p, 0.0, 1.0)), gg, hf)
