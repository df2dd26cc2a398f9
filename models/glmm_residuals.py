r"""Randomised quantile residuals: whether the fitted model could have made the data.

Rows of a group are taken in order. The probability of each outcome given the group's *earlier* outcomes,
:math:`F(y_j \mid y_1, \dots, y_{j-1})`, follows from the posterior of the intercept so far; a uniform draw between
:math:`F(y_j - 1)` and :math:`F(y_j)` is then exactly uniform, and independent between rows, if the model is right
(Rosenblatt 1952; Dunn & Smyth 1996). Residuals that use fitted intercepts have no such distribution: they look tame
whatever the data.

Two questions are asked of them. Their distribution over all rows (Kolmogorov--Smirnov) says little: an intercept in
the formula makes it nearly uniform whatever else is missing. Means within classes of rows (`ResidualCheck.by`) show
what the formula misses, and outweigh it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import kstest, norm

from models.compiled import kernel
from models.errors import Phrase, located
from models.glmm_data import Array, Likelihood
from models.glmm_input import kept, unwrapped

STREAM = 7_403
"""First element of the spawn keys used here."""


@dataclass(frozen=True)
class ResidualCheck:
    """Residuals of every row and what they say together.

    Attributes
    ----------
    uniform : array [n]
        Between 0 and 1, uniform under the model.
    normal : array [n]
        Their standard normal quantiles.
    ks, p : float
        Kolmogorov--Smirnov distance from the uniform distribution, and its p; estimated parameters make it
        cautious, and a large p is no evidence for the model.
    seed : int
    """

    uniform: Array
    normal: Array
    ks: float
    p: float
    seed: int

    @property
    def text(self) -> str:
        """The check in a sentence."""
        return (
            f"randomised quantile residuals, all rows together: Kolmogorov-Smirnov {self.ks:.4f}, p = {self.p:.3g} "
            f"({len(self.uniform)} rows, seed {self.seed}); classes of rows can be off all the same"
        )

    def verdict(self, by: pd.DataFrame) -> str:
        """One judgement from classes of rows and the distribution together, classes first.

        Parameters
        ----------
        by : DataFrame
            Rows of `ResidualCheck.by`, of one or several variables; its index names the classes.
        """
        limit = self.limit(len(by))
        worst = by.loc[by["z"].abs() > limit, "z"].sort_values(key=np.abs, ascending=False)
        apart = f"Kolmogorov-Smirnov p = {self.p:.2g} over all rows"
        if len(worst):
            named = ", ".join(f"{name} ({z:+.1f})" for name, z in worst.items())
            even = " does not show it, as it looks at all of them at once" if self.p >= 0.05 else " agrees"
            return (
                f"The residuals speak against the model: mean residuals beyond {limit:.1f} standard errors in "
                f"{named}. {apart}{even}."
            )
        if self.p < 0.05:
            return f"The residuals speak against the model ({apart}), though no class of rows stands out."
        return (
            f"The residuals show nothing against the model: no class of {len(by)} has a mean beyond {limit:.1f} "
            f"standard errors ({apart})."
        )

    @staticmethod
    def limit(n_classes: int) -> float:
        """|z| that one of all classes exceeds with a probability of 5% if the model is right (Šidák)."""
        return float(norm.isf((1 - 0.95 ** (1 / max(n_classes, 1))) / 2))

    def by(self, values: Any, name: str = "value") -> pd.DataFrame:
        """Mean residual within classes of a variable, in or out of the model.

        Parameters
        ----------
        values : array_like [n]

        Returns
        -------
        DataFrame
            ``rows``, ``mean`` of the normal residuals, ``z`` (mean over its standard error under the model) and its
            two-sided ``p``, one row a class.

        Raises
        ------
        InputError
            Of another length.
        """
        if len(values) != len(self.normal):
            raise located(name, Phrase(f"{len(values)} values"), f"one for each of the {len(self.normal)} rows")
        grouped = pd.Series(self.normal).groupby(np.asarray(values))
        table = pd.DataFrame({"rows": grouped.size(), "mean": grouped.mean()})
        table["z"] = table["mean"] * np.sqrt(table["rows"])
        table["p"] = 2 * norm.sf(np.abs(table["z"]))
        table.index.name = name
        return table


def residual_check(results: Any, seed: int = 1) -> ResidualCheck:
    """Randomised quantile residuals of a fit, rows in the order of the data within each group.

    Rows with a frequency weight above one count as binomial rows with that many times their trials; rows with
    weight zero are refused.

    Raises
    ------
    InputError
    """
    results = unwrapped(results)
    model, theta = results.model, np.asarray(results.params)
    kept(model, "patterns", "residual_check")
    if (model.freq_weights == 0).any():
        raise located("frequency weights", 0, "positive weights for residuals")
    order = np.argsort(model.group_code, kind="stable")
    start = np.searchsorted(model.group_code[order], np.arange(model.n_groups + 1))
    likelihood = Likelihood(model.patterns, model.rule)
    likelihood(theta)
    # The grid resolves the narrowest posterior and the logistic function.
    step = min(0.05, 0.5 * float(likelihood.scales.min()), 0.5 / max(theta[-1], 1e-12))
    grid = np.arange(-9.0, 9.0 + step, step)
    eta = model.offset + model.exog @ theta[:-1]
    lower, upper = np.empty(len(eta)), np.empty(len(eta))
    sequential_distribution(
        eta[order], (model.successes * model.freq_weights)[order], (model.trials * model.freq_weights)[order],
        start.astype(np.int64), theta[-1], grid, lower, upper,
    )  # fmt: skip
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM,)))
    uniform = np.empty(len(eta))
    uniform[order] = lower + (upper - lower) * rng.random(len(eta))
    ks = kstest(uniform, "uniform")
    inside = np.clip(uniform, 1e-15, 1 - 1e-15)
    return ResidualCheck(uniform, norm.ppf(inside), float(ks.statistic), float(ks.pvalue), seed)


@kernel
def sequential_distribution(  # type: ignore[no-untyped-def]
    eta, successes, trials, start, s, grid, lower, upper
):
    """F(y - 1) and F(y) of every row given the earlier rows of its group; `grid` holds even values of u."""
    log_weight = np.empty(len(grid))
    for g in range(len(start) - 1):
        for k in range(len(grid)):
            log_weight[k] = -0.5 * grid[k] * grid[k]
        for row in range(start[g], start[g + 1]):
            top = -np.inf
            for k in range(len(grid)):
                top = max(top, log_weight[k])
            total, below, at = 0.0, 0.0, 0.0
            y, m = successes[row], trials[row]
            for k in range(len(grid)):
                weight = np.exp(log_weight[k] - top)
                x = eta[row] + s * grid[k]
                softplus = max(x, 0.0) + np.log1p(np.exp(-abs(x)))
                total += weight
                # Binomial probabilities up to y by their recursion, from log q^m up.
                log_term = -m * softplus
                for i in range(int(y) + 1):
                    if i < y:
                        below += weight * np.exp(log_term)
                        log_term += np.log((m - i) / (i + 1.0)) + x
                    else:
                        at += weight * np.exp(log_term)
                log_weight[k] += y * x - m * softplus
            lower[row], upper[row] = below / total, min(1.0, (below + at) / total)
