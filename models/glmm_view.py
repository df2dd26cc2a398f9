"""A fitted mixed model as it shows itself in a notebook."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from models.notebook_view import View, table_rows


def fit_view(results: Any, heading: str) -> View:
    """What is shown of a fit: its notes as warnings, its criteria, its parameters.

    Parameters
    ----------
    results : LogisticMixedResults or LogisticSlopeResults
    heading : str
    """
    model = results.model
    names = [str(name) for name in model.data.param_names]
    estimates = np.asarray(results.estimates)
    ends = np.asarray(results.conf_int())
    fixed = len(np.asarray(results.fe_params))
    with np.errstate(over="ignore"):
        ratio = np.where(np.arange(len(names)) < fixed, np.exp(estimates), np.nan)
    frame = pd.DataFrame(
        {"estimate": estimates, "standard_error": np.asarray(results.bse), "p": np.asarray(results.pvalues),
         "low": ends[:, 0], "high": ends[:, 1], "odds_ratio": ratio},
        index=pd.Index(names, name="term"),
    )  # fmt: skip
    groups = getattr(model, "fixed", model).n_groups
    ended = "converged" if results.converged else "no maximum was found"
    told = (
        f"{results.nobs:,} rows, {groups:,} groups ({model.group_name}); log-likelihood {results.llf:.2f}; "
        f"{ended}. Odds ratios are for one and the same group; intervals are 95% Wald intervals."
    )
    warnings = tuple(f"{note.category.__name__}: {note.text}." for note in results.notes)
    return View(heading, "", warnings, (), (told,), (table_rows(frame, ".summary()"),))
