"""A fitted mixed model on one screen."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from statsmodels.iolib import summary2

from models.glmm_data import Array

if TYPE_CHECKING:
    from models.glmm import LogisticMixedModel
    from models.glmm_results import LogisticMixedResults

WIDTH = 90
"""Characters of a line of notes."""


@dataclass(frozen=True)
class GroupSizes:
    """Trials of the groups, counted while the data are at hand.

    Attributes
    ----------
    least, most, mean : float
    constant : int
        Groups with one outcome only.
    """

    least: float
    most: float
    mean: float
    constant: int

    @classmethod
    def of(cls, model: LogisticMixedModel) -> GroupSizes:
        """Of a model's data."""
        trials = np.bincount(model.group_code, model.freq_weights * model.trials)
        hits = np.bincount(model.group_code, model.freq_weights * model.successes)
        constant = int(np.sum((hits == 0) | (hits == trials)))
        return cls(float(trials.min()), float(trials.max()), float(trials.mean()), constant)


def shown(value: float) -> str:
    """A number in a column: four decimals, three digits and an exponent where these would say nothing.

    Examples
    --------
    >>> [shown(v) for v in (0.25, -1.7e-12, 1.234e40, float("inf"), float("nan"), 0.0)]
    ['0.2500', '-1.70e-12', '1.23e+40', 'inf', '', '0.0000']
    """
    if np.isnan(value):
        return ""
    if np.isinf(value):
        return "inf" if value > 0 else "-inf"
    plain = value == 0 or 5e-5 <= abs(value) < 1e6
    return f"{value:.4f}" if plain else f"{value:.2e}"


def summary_of(results: LogisticMixedResults, alpha: float, method: str, title: str | None) -> Any:
    """Header, parameters with intervals, notes; statsmodels' ``Summary`` (text, HTML, LaTeX).

    BIC counts rows, as glmer's does. Odds ratios are for one and the same group. Of parameters that run off only
    the direction is shown.
    """
    model, best, sizes, escape = results.model, results.maximum, results.sizes, results.escape
    starts = ", ".join(f"{search.start:g}" for search in best.searches)
    criteria = [f"{value:.4f}" for value in (results.llf, results.aic, results.bic)]
    if escape.within_groups and escape.limit is not None:
        criteria = [f"rises to {escape.limit.value:.4f}", "none", "none"]
    elif results.node_check.wrong:
        criteria[0] += f" ({results.node_check.exact_text})"
    header = {
        "Model:": "Logistic mixed model",
        "Outcome:": model.outcome_name,
        "Rows:": f"{results.nobs}" + (f" ({model.n_dropped} dropped)" if model.n_dropped else ""),
        "Groups:": f"{model.n_groups} ({model.group_name})",
        "Trials per group:": f"{sizes.least:.0f} to {sizes.most:.0f}, mean {sizes.mean:.3g}",
        "Groups that never vary:": f"{sizes.constant}",
        "Log-likelihood:": criteria[0],
        "AIC:": criteria[1],
        "BIC (log of rows):": criteria[2],
        "Quadrature:": model.rule.name,
        "Converged:": f"{results.converged} (starts at sd {starts})",
        "Covariance:": results.cov_type,
    }
    ends, of_sd = _intervals(results, alpha, method)
    estimates = results.estimates
    with np.errstate(over="ignore"):
        ratios = np.append(np.exp(estimates[:-1]), np.nan)
    columns = {
        "Coef.": estimates, "Std.Err.": results.bse, "z": results.tvalues, "P>|z|": results.pvalues,
        f"[{alpha / 2:g}": ends[:, 0], f"{1 - alpha / 2:g}]": ends[:, 1], "exp(Coef.)": ratios,
    }  # fmt: skip
    table = pd.DataFrame(columns, index=model.data.param_names).map(shown)
    # A p below a twenty-thousandth is no more precise for an exponent.
    table["P>|z|"] = ["" if np.isnan(p) else f"{p:.4f}" for p in np.asarray(results.pvalues)]
    summary = summary2.Summary()
    summary.add_dict(header)
    summary.add_df(table)
    summary.add_title(title or "Logistic mixed model, random intercept")
    kinds = f"{_NAMES[method]} for coefficients and odds ratios, {of_sd} for the sd"
    summary.add_text(f"Intervals: {kinds}. exp(Coef.): odds ratios for one and the same group.")
    if not escape.within_groups:
        summary.add_text(f"Nodes: {results.node_check.text}.")
    for note in results.notes:
        for line in textwrap.wrap(f"{note.category.__name__}: {note.text}", WIDTH):
            summary.add_text(line)
    return summary


_NAMES = {"wald": "Wald", "profile": "profile likelihood"}


def _intervals(results: LogisticMixedResults, alpha: float, method: str) -> tuple[Array, str]:
    """Intervals of the table, and the kind of that of the sd, which is by profile wherever it can be."""
    ends = np.array(results.conf_int(alpha, method))
    if method == "profile" or results.model.patterns is None or results.escape.unbounded[-1]:
        return ends, _NAMES[method]
    ends[-1] = results.conf_int(alpha, "profile", which=[results.model.data.param_names[-1]])[-1]
    return ends, _NAMES["profile"]
