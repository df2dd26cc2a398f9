"""A fitted mixed model on one screen."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from statsmodels.iolib import summary2

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults


def summary_of(results: LogisticMixedResults, alpha: float, method: str, title: str | None) -> Any:
    """Header, parameters with intervals, notes; statsmodels' ``Summary`` (text, HTML, LaTeX).

    BIC counts rows, as glmer's does. Odds ratios are for one and the same group.
    """
    model, best = results.model, results.maximum
    sizes = np.bincount(model.group_code, model.freq_weights * model.trials)
    hits = np.bincount(model.group_code, model.freq_weights * model.successes)
    constant = int(np.sum((hits == 0) | (hits == sizes)))
    starts = ", ".join(f"{search.start:g}" for search in best.searches)
    header = {
        "Model:": "Logistic mixed model",
        "Outcome:": model.outcome_name,
        "Rows:": f"{results.nobs}" + (f" ({model.n_dropped} dropped)" if model.n_dropped else ""),
        "Groups:": f"{model.n_groups} ({model.group_name})",
        "Trials per group:": f"{sizes.min():.0f} to {sizes.max():.0f}, mean {sizes.mean():.3g}",
        "Groups that never vary:": f"{constant}",
        "Log-likelihood:": f"{results.llf:.4f}",
        "AIC:": f"{results.aic:.4f}",
        "BIC (log of rows):": f"{results.bic:.4f}",
        "Quadrature:": model.rule.name,
        "Converged:": f"{results.converged} (starts at sd {starts})",
        "Covariance:": results.cov_type,
    }
    ends = results.conf_int(alpha, method)
    with np.errstate(over="ignore"):
        ratios = np.append(np.exp(results.params[:-1]), np.nan)
    table = pd.DataFrame(
        {
            "Coef.": results.params,
            "Std.Err.": results.bse,
            "z": results.tvalues,
            "P>|z|": results.pvalues,
            f"[{alpha / 2:g}": ends[:, 0],
            f"{1 - alpha / 2:g}]": ends[:, 1],
            "exp(Coef.)": ratios,
        },
        index=model.data.param_names,
    )
    shown = table.map(lambda value: "" if np.isnan(value) else f"{value:.4f}")
    summary = summary2.Summary()
    summary.add_dict(header)
    summary.add_df(shown)
    summary.add_title(title or "Logistic mixed model, random intercept")
    summary.add_text(f"Intervals: {method}. exp(Coef.): odds ratios for one and the same group.")
    summary.add_text(f"Nodes: {results.node_check.text}.")
    for note in results.notes:
        for line in textwrap.wrap(f"{note.category.__name__}: {note.text}", 90):
            summary.add_text(line)
    return summary
