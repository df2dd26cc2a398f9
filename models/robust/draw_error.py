"""How sure a mean over draws is: draws of a sampler are correlated, and may be weighted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.errors import located
from models.gate import FEWEST_DRAWS
from models.planning.schedule import Array
from models.quiet import without_warnings


class DrawMean(NamedTuple):
    """A mean over draws.

    Attributes
    ----------
    mean : float
    se : float
        Its standard error as a mean over the draws of a sampler; NaN for a single draw.
    ess : float
        How many independent draws, equally weighted, would know the mean as well.
    """

    mean: float
    se: float
    ess: float


def draw_mean(values: Array, weight: Array, chains: int | None = None) -> DrawMean:
    r"""Weighted mean of one number a draw, with its standard error.

    With weights the mean is a ratio; its error is that of the mean of :math:`N w_i (x_i - \bar x)`.

    Parameters
    ----------
    values : float64[d]
    weight : float64[d]
        Summing to one.
    chains : int, optional
        How many chains of a sampler, one after the other and equally long, the draws come from: their correlation
        is allowed for. Not given: the draws count as independent.

    Raises
    ------
    InputError
        If the draws cannot be cut into so many chains.

    Examples
    --------
    >>> found = draw_mean(np.array([0.0, 2.0]), np.array([0.5, 0.5]))
    >>> found.mean, found.se
    (1.0, 1.0)
    """
    n = len(values)
    check_chains(n, chains)
    mean = float(weight @ values)
    influence = n * weight * (values - mean)
    if n < 2:
        return DrawMean(mean, float("nan"), float(n))
    variance = float(influence.var(ddof=1))
    size = float(n)
    if chains is not None and n // chains >= FEWEST_DRAWS and np.ptp(influence) > 1e-14 * max(1.0, abs(mean)):
        import arviz as az

        with without_warnings():
            found = az.ess(az.from_dict({"posterior": {"q": influence.reshape(chains, -1)}}), method="mean")
        size = min(size, float(np.asarray(found["q"].values)))
    plain = float((values - mean) ** 2 @ weight)
    se = float(np.sqrt(variance / size))
    return DrawMean(mean, se, plain / se**2 if se > 0 else size)


FEWEST_CONTROLLED = 20
"""Simulated data sets below which no control variates are used: their coefficients would be luck."""


def controlled_mean(values: Array, controls: Array) -> tuple[float, float]:
    """Mean of simulated values and its standard error, freed of the luck that shows in quantities of known mean.

    Parameters
    ----------
    values : float64[n]
    controls : float64[n, c]
        Quantities from the same simulations whose true mean is zero. The mean is the intercept of the regression on
        them; its bias is of the order of one over `n`, that of the error is its root.
    """
    n = len(values)
    varies = np.ptp(controls, axis=0) > 1e-12 * np.maximum(np.abs(controls).max(axis=0, initial=0.0), 1e-300)
    if n < FEWEST_CONTROLLED or not varies.any():
        return float(values.mean()), float(values.std(ddof=1) / np.sqrt(n))
    design = np.column_stack([np.ones(n), controls[:, varies]])
    coefficient, *_ = np.linalg.lstsq(design, values, rcond=None)
    rest = values - design @ coefficient
    # The variance of the intercept: that of the controls' means counts as well.
    spread = float(np.linalg.pinv(design.T @ design)[0, 0]) * float(rest @ rest) / (n - design.shape[1])
    return float(coefficient[0]), float(np.sqrt(spread))


def check_chains(draws: int, chains: int | None) -> None:
    """Refuse a number of chains that the draws cannot come from."""
    if chains is not None and (chains < 1 or draws % chains):
        raise located("chains", chains, f"a number that divides the {draws} draws, or none")


def effective_draws(weight: Array) -> Array:
    r"""Kish's effective number of draws, :math:`(\sum w)^2 / \sum w^2`, along the last axis."""
    return np.asarray(weight.sum(axis=-1) ** 2 / (weight**2).sum(axis=-1))
