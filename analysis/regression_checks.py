"""Whether the regression describes the data: rates by condition, and residuals by what is not in the formula."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import expit, logit
from scipy.stats import norm

from analysis import response_rates as rates
from analysis.regression import LEVEL, Regression
from models.events import EventLog
from models.glmm_input import unwrapped
from models.glmm_marginal import probability_and_slopes
from models.glmm_residuals import ResidualCheck, residual_check
from models.histories import UNSEEN
from models.notebook_view import NotebookView

MOST_CLASSES = 24
"""Classes of a grouping beyond which its residuals are not looked at one by one."""


def by_condition(regression: Regression, log: EventLog) -> pd.DataFrame:
    """Observed rates of the conditions beside the fit's population-averaged probability.

    Parameters
    ----------
    regression : Regression
    log : EventLog
        The study it was fitted to.

    Returns
    -------
    DataFrame
        ``condition, responses, people, rate, low, high`` (`analysis.response_rates`), and ``predicted,
        predicted_low, predicted_high``: the average over the condition's rows, with a 95% interval by the delta
        method on the logit scale.
    """
    seen = log.response != UNSEEN
    observed = rates.response_rates(log, {"condition": log.condition_of_event}, LEVEL)
    of_row = pd.Series(log.condition_of_event[seen], index=regression.table.frame.index)
    frame = regression.table.frame
    parts = [average_probability(regression.main, frame[of_row == c]) for c in observed["condition"]]
    estimates = pd.DataFrame(parts, columns=["predicted", "predicted_low", "predicted_high"])
    return pd.concat([observed.reset_index(drop=True), estimates], axis=1)


@np.errstate(divide="ignore", invalid="ignore")
def average_probability(fit: Any, rows: pd.DataFrame) -> tuple[float, float, float]:
    """Mean over rows of the population-averaged probability, and its 95% interval."""
    bare = unwrapped(fit)
    design, _ = bare.design_of(rows)
    theta = np.asarray(bare.params)
    p, by_eta, by_sd = probability_and_slopes(design @ theta[:-1], theta[-1])
    mean = float(p.mean())
    slope = np.append(by_eta @ design, by_sd.sum()) / len(p)
    spread = np.sqrt(max(float(slope @ bare.cov_params() @ slope), 0.0))
    half = norm.ppf(0.5 + LEVEL / 2) * spread / (mean * (1 - mean))
    low, high = expit(logit(mean) + half * np.array([-1.0, 1.0]))
    return mean, float(low), float(high)


@dataclass(frozen=True)
class Residuals(NotebookView):
    """Randomised quantile residuals, together and by class.

    Attributes
    ----------
    check : ResidualCheck
    by : DataFrame
        ``grouping`` (round, condition, schedule), ``value``, ``rows``, ``mean`` of the normal residuals, ``z``,
        ``p``.
    """

    check: ResidualCheck
    by: pd.DataFrame

    @property
    def limit(self) -> float:
        """|z| that one of all classes exceeds with a probability of 5% if the model is right (Šidák)."""
        return float(norm.isf((1 - 0.95 ** (1 / max(len(self.by), 1))) / 2))

    @property
    def outside(self) -> pd.DataFrame:
        """Classes whose mean residual is beyond `limit`."""
        return self.by[self.by["z"].abs() > self.limit]

    @property
    def sentence(self) -> str:
        """What they say."""
        if not len(self.by):
            fits = "not " if self.check.p < 0.05 else ""
            return (
                f"Randomised quantile residuals are {fits}compatible with the model "
                f"(Kolmogorov-Smirnov p = {self.check.p:.2g})."
            )
        return self.check.verdict(self.by.set_index(self.by["grouping"] + " " + self.by["value"]))


def residuals(regression: Regression, log: EventLog, seed: int = 1) -> Residuals:
    """Residuals of the main model by round, condition and schedule.

    Parameters
    ----------
    regression : Regression
    log : EventLog
        The study it was fitted to.
    seed : int
    """
    check = residual_check(regression.main, seed)
    seen = log.response != UNSEEN
    groupings = {
        "round": log.k[seen], "condition": log.condition_of_event[seen],
        "schedule": log.schedules()[log.run_of_event][seen],
    }  # fmt: skip
    parts = []
    for name, values in groupings.items():
        if 1 < len(np.unique(values.astype(str))) <= MOST_CLASSES:
            part = check.by(values).reset_index(names="value")
            part["value"] = part["value"].astype(str)
            part.insert(0, "grouping", name)
            parts.append(part)
    columns = ["grouping", "value", "rows", "mean", "z", "p"]
    return Residuals(check, pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns))
