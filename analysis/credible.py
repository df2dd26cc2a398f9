"""Draws of a quantity in four numbers: mean, interval, probability of being positive."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from models.errors import located

Array = NDArray[np.float64]

LEVEL = 0.9
"""Level of every interval from draws, equal-tailed; that of the bootstrap intervals too."""


def interval(draws: Array, level: float = LEVEL) -> tuple[Array, Array]:
    """Equal-tailed interval over the first axis."""
    if not 0 < level < 1:
        raise located("interval, level", level, "between 0 and 1")
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return low, high


def in_four_numbers(draws: Array, level: float = LEVEL) -> pd.DataFrame:
    """Summarise ``draws[draw, quantity]``, one row a quantity.

    Returns
    -------
    DataFrame
        ``mean``, ``low`` and ``high`` of the equal-tailed interval, ``positive``: share of draws above zero, draws
        of exactly zero counting half.

    Examples
    --------
    >>> in_four_numbers(np.array([[-1.0], [0.0], [1.0], [2.0]]), 0.5)
       mean   low  high  positive
    0   0.5 -0.25  1.25     0.625
    """
    low, high = interval(draws, level)
    positive = (draws > 0).mean(axis=0) + 0.5 * (draws == 0).mean(axis=0)
    return pd.DataFrame({"mean": draws.mean(axis=0), "low": low, "high": high, "positive": positive})


def contraction_of(posterior: Array, prior: Array) -> Array:
    """``1 - var(posterior) / var(prior)`` over the first axis; NaN where the prior does not vary.

    Near one: the data have spoken. Near zero: what was believed before. Below zero: wider than before.
    """
    before = prior.var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(before > 1e-20, 1 - posterior.var(axis=0, ddof=1) / before, np.nan)


def as_probability(value: float) -> str:
    """A probability as it is said, never rounded to certainty.

    Examples
    --------
    >>> [as_probability(p) for p in (0.0, 0.5, 0.9734, 0.9999)]
    ['<.01', '.50', '.97', '>.99']
    """
    if value < 0.005:
        return "<.01"
    return ">.99" if value >= 0.995 else f"{value:.2f}".lstrip("0")
