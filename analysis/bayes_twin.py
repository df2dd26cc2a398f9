"""The Bayesian twin of the regression: the same formula in bambi, with bambi's default priors.

An optional extra (``bayes-twin``). It shares no code with the mixed model: another likelihood (every person's
intercept is a parameter), another engine. Where the two agree, neither quadrature nor prior is behind the answer.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.util import find_spec
from typing import Any

import numpy as np
import pandas as pd

from analysis.regression import LEVEL
from analysis.regression_data import PERSON, ResponseTable
from models.errors import InputError
from models.notebook_view import NotebookView, View, table_rows

MAX_RHAT, MIN_ESS = 1.01, 400.0
"""What a sample has to keep before its numbers are shown without a warning, as in `models.gate`."""


@dataclass(frozen=True)
class Twin(NotebookView):
    """Posterior of the formula.

    Attributes
    ----------
    terms : DataFrame
        Indexed by term: ``estimate`` (median of the odds ratio for one person), ``low, high`` (95%, equal-tailed),
        ``positive`` (probability of being above 1).
    sd, sd_low, sd_high : float
        Of the intercepts: median and interval.
    divergences : int
    max_rhat, min_ess : float
        Of the coefficients and the standard deviation.
    priors : str
    version : str
        Of bambi.
    draws, chains, seed : int
    """

    terms: pd.DataFrame
    sd: float
    sd_low: float
    sd_high: float
    divergences: int
    max_rhat: float
    min_ess: float
    priors: str
    version: str
    draws: int
    chains: int
    seed: int

    @property
    def passed(self) -> bool:
        """Whether the sample may be relied on."""
        return self.divergences == 0 and self.max_rhat <= MAX_RHAT and self.min_ess >= MIN_ESS

    @property
    def sentence(self) -> str:
        """What it is and whether it may be relied on."""
        verdict = "passed" if self.passed else "FAILED: do not rely on the twin"
        return (
            f"Bayesian twin: bambi {self.version}, priors {self.priors}, {self.chains} chains of {self.draws} "
            f"draws, seed {self.seed}; sampling {verdict} ({self.divergences} divergences, r-hat at most "
            f"{self.max_rhat:.3f}, at least {self.min_ess:.0f} effective draws)."
        )

    def _view(self) -> View:
        warnings = () if self.passed else ("the chains do not agree well enough: do not rely on these numbers.",)
        return View("Bayesian twin", "", warnings, (), (self.sentence,), (table_rows(self.terms, ".terms"),))


def why_absent() -> str:
    """Why there can be no twin here; empty if there can."""
    return "" if find_spec("bambi") else "bambi is not installed (the extra 'bayes-twin')"


def bayes_twin(
    table: ResponseTable, right: str, *, draws: int = 2000, tune: int = 1000, chains: int = 4, seed: int = 1
) -> Twin:
    """Sample the formula of the regression in bambi.

    Parameters
    ----------
    table : ResponseTable
    right : str
        Right-hand side without the random intercept.
    draws, tune, chains, seed : int

    Raises
    ------
    InputError
        Where bambi is not installed.
    """
    if reason := why_absent():
        raise InputError(f"Bayesian twin: {reason}")
    import arviz as az

    bambi: Any = import_module("bambi")  # optional, and not typed

    with _quiet():
        model = bambi.Model(table.formula(right), table.frame, family="bernoulli")
        model.build()
        trace = model.fit(
            draws=draws, tune=tune, chains=chains, random_seed=seed, inference_method="nutpie", target_accept=0.95,
            progressbar=False,
        )  # fmt: skip
        spread = f"1|{PERSON}_sigma"
        names = [name for name in trace["posterior"].data_vars if name not in (f"1|{PERSON}", spread)]
        summary = az.summary(trace, var_names=[*names, spread], round_to="none")
        components = model.components["p"]
        priors = ", ".join(f"{name} {term.prior}" for name, term in components.terms.items())
        priors = priors.replace("\n", " ")
    posterior = trace["posterior"]
    tails = [0.5, (1 - LEVEL) / 2, (1 + LEVEL) / 2]
    terms = {}
    for name in (n for n in names if n != "Intercept"):
        values = posterior[name].to_numpy().ravel()
        estimate, low, high = np.exp(np.quantile(values, tails))
        terms[name] = {"estimate": estimate, "low": low, "high": high, "positive": float((values > 0).mean())}
    sd, sd_low, sd_high = np.quantile(posterior[spread].to_numpy().ravel(), tails)
    return Twin(
        pd.DataFrame.from_dict(terms, orient="index"), float(sd), float(sd_low), float(sd_high),
        int(trace["sample_stats"]["diverging"].sum()), float(summary["r_hat"].max()),
        float(summary[["ess_bulk", "ess_tail"]].min().min()), priors, metadata.version("bambi"), draws, chains,
        seed,
    )  # fmt: skip


@contextmanager
def _quiet() -> Iterator[None]:
    """No log lines and no deprecation warnings of packages that are not ours to mend."""
    loggers = [logging.getLogger(name) for name in ("bambi", "pymc", "pytensor")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for logger in loggers:
                logger.setLevel(logging.ERROR)
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)
