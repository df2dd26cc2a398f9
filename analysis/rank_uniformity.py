"""Whether ranks are uniform: exact tests, to be judged by one error rate for all of them together.

Among L independent draws of a calibrated posterior the truth has a rank that is uniform on 0..L. Three tests look
at each statistic: Kolmogorov and Smirnov's on the ranks (blurred to continuous numbers, so it is exact), and the
coverage of the central 50% and 90% intervals against the binomial distribution. The first sees shifts, the
others posteriors that are too narrow or too wide.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

FAMILY_WISE = 0.01
"""Probability that a calibrated model fails any of the tests (Bonferroni)."""

LEVELS = (0.5, 0.9)


def ranks_of(truth: NDArray[np.float64], draws: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Rank of each truth among its draws; ties are broken at random.

    Parameters
    ----------
    truth : float64[quantity]
    draws : float64[draw, quantity]
    rng : numpy.random.Generator
    """
    below = np.sum(draws < truth, axis=0)
    equal = np.sum(draws == truth, axis=0)
    return below + rng.integers(0, equal + 1)


def interval_of_ranks(level: float, largest: int) -> tuple[int, int]:
    """First and last rank inside the central interval that has probability `level` exactly.

    Examples
    --------
    >>> interval_of_ranks(0.9, 99)
    (5, 94)
    """
    outside = (1 - level) / 2 * (largest + 1)
    if abs(outside - round(outside)) > 1e-9:
        raise ValueError(f"no central interval of level {level} among {largest + 1} ranks")
    return round(outside), largest - round(outside)


def examine(ranks: NDArray[np.int64], largest: int, names: Sequence[str], rng: np.random.Generator) -> pd.DataFrame:
    """Test every statistic.

    Parameters
    ----------
    ranks : int64[replicate, statistic]
        Each in 0..`largest`.
    largest : int
        Number of draws each truth was ranked among.
    names : sequence of str
    rng : numpy.random.Generator
        Blurs the ranks.

    Returns
    -------
    pandas.DataFrame
        One row a statistic: mean of (rank + 1/2) / (L + 1), coverages, and the p-values of the three tests.
    """
    n = len(ranks)
    blurred = (ranks + rng.random(ranks.shape)) / (largest + 1)
    rows = []
    for column in range(ranks.shape[1]):
        own = ranks[:, column]
        row = {
            "mean_rank": float(np.mean((own + 0.5) / (largest + 1))),
            "p_uniform": float(stats.kstest(blurred[:, column], "uniform", method="exact").pvalue),
        }
        for level in LEVELS:
            low, high = interval_of_ranks(level, largest)
            inside = int(np.sum((own >= low) & (own <= high)))
            row[f"coverage_{100 * level:.0f}"] = inside / n
            row[f"p_coverage_{100 * level:.0f}"] = float(stats.binomtest(inside, n, level).pvalue)
        rows.append(row)
    return pd.DataFrame(rows, index=pd.Index(names, name="statistic"))


def p_values(table: pd.DataFrame) -> pd.DataFrame:
    """The columns of `examine` that hold p-values."""
    return table[[c for c in table.columns if c.startswith("p_")]]


def bonferroni(table: pd.DataFrame) -> float:
    """Smallest p-value of a table times the number of them, at most 1."""
    p = p_values(table).to_numpy()
    return min(1.0, float(p.min()) * p.size)
