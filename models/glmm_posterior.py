r"""The distribution of a group's intercept given its outcomes, on a grid.

For a group with modes and scales as in `models.glmm_kernel`, the posterior of ``u`` is proportional to
:math:`e^{h(u)}`. The trapezoidal rule on an evenly spaced grid converges exponentially for such functions, so the
moments below are exact to rounding, and the quantiles to the interpolation between grid points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from models.compiled import kernel
from models.glmm_data import Array, Likelihood

POINTS = 241
"""Grid points of a posterior."""

HALF_WIDTH = 9.0
"""Half the grid in units of the scale at the mode; widened where the density at an end is not negligible."""


@dataclass(frozen=True)
class Posterior:
    """Moments and quantiles of sigma u, one entry a pattern.

    Attributes
    ----------
    mode, mean, sd, lower, upper : array [patterns]
    """

    mode: Array
    mean: Array
    sd: Array
    lower: Array
    upper: Array

    def table(self, of_group: np.ndarray, labels: pd.Index) -> pd.DataFrame:
        """One row a group."""
        columns = {name: getattr(self, name)[of_group] for name in ("mode", "mean", "sd", "lower", "upper")}
        return pd.DataFrame(columns, index=labels)


def intercepts(likelihood: Likelihood, theta: Array, alpha: float = 0.05) -> Posterior:
    """Posterior of every pattern's intercept sigma u at the estimates.

    Parameters
    ----------
    alpha : float
        The interval from `lower` to `upper` holds 1 - alpha, equal tails. It takes the estimates as known.
    """
    likelihood(theta)
    data, sd = likelihood.patterns, float(theta[-1])
    eta = data.offset + data.design @ theta[:-1]
    out = np.empty((4, data.n_patterns))
    posterior_summaries(
        eta, data.successes, data.trials, data.start, sd, likelihood.modes, likelihood.scales,
        alpha / 2, POINTS, HALF_WIDTH, out,
    )  # fmt: skip
    return Posterior(sd * likelihood.modes, sd * out[0], sd * out[1], sd * out[2], sd * out[3])


@kernel
def log_joint(u, eta, successes, trials, s):  # type: ignore[no-untyped-def]
    """h(u) of one group, without overflow."""
    value = -0.5 * u * u
    for j in range(len(eta)):
        x = eta[j] + s * u
        softplus = max(x, 0.0) + np.log1p(np.exp(-abs(x)))
        value -= successes[j] * (softplus - x) + (trials[j] - successes[j]) * softplus
    return value


@kernel
def posterior_summaries(  # type: ignore[no-untyped-def]
    eta, successes, trials, start, s, modes, scales, tail, points, half_width, out
):
    """Mean, sd and two quantiles of u for every pattern, into ``out[0:4]``."""
    grid, density = np.empty(points), np.empty(points)
    for i in range(len(modes)):
        a, b = start[i], start[i + 1]
        top = log_joint(modes[i], eta[a:b], successes[a:b], trials[a:b], s)
        width = half_width * scales[i]
        for _ in range(20):
            ends = max(
                log_joint(modes[i] - width, eta[a:b], successes[a:b], trials[a:b], s),
                log_joint(modes[i] + width, eta[a:b], successes[a:b], trials[a:b], s),
            )
            if ends - top < -30.0:
                break
            width *= 1.3
        step = 2.0 * width / (points - 1)
        total, mean, square = 0.0, 0.0, 0.0
        for k in range(points):
            grid[k] = modes[i] - width + k * step
            density[k] = np.exp(log_joint(grid[k], eta[a:b], successes[a:b], trials[a:b], s) - top)
            total += density[k]
            mean += density[k] * (grid[k] - modes[i])
        mean /= total
        for k in range(points):
            square += density[k] * (grid[k] - modes[i] - mean) ** 2
        out[0, i], out[1, i] = modes[i] + mean, np.sqrt(square / total)
        # Trapezoidal sums with the first Euler--Maclaurin correction: the distribution function on the grid.
        out[2, i], out[3, i] = grid[0], grid[points - 1]
        summed, before = 0.0, 0.0
        for k in range(1, points - 1):
            summed += 0.5 * (density[k - 1] + density[k]) / total
            below = summed - (density[k + 1] - density[k - 1]) / (24.0 * total)
            for side in range(2):
                target = tail if side == 0 else 1.0 - tail
                if before < target <= below:
                    # The density is nearly linear between grid points: solve the quadratic of its integral.
                    left, right = density[k - 1] / total, density[k] / total
                    scaled = (target - before) / (below - before) * 0.5 * (left + right)
                    root = np.sqrt(left * left + 2.0 * (right - left) * scaled)
                    out[2 + side, i] = grid[k - 1] + step * 2.0 * scaled / (left + root)
            before = below
