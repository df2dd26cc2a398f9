"""A fit with random slopes on one screen, and what must be known before it is read."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from statsmodels.iolib import summary2

from models.glmm_notes import Note, dropped_notes, separated, within_groups
from models.glmm_summary import WIDTH, shown
from models.glmm_warnings import BoundaryWarning, ConvergenceWarning, SeparationWarning, SeveralMaximaWarning

if TYPE_CHECKING:
    from models.glmm_slope_results import LogisticSlopeResults


def slope_notes(results: LogisticSlopeResults) -> tuple[Note, ...]:
    """All that applies to a fit, gravest first."""
    notes: list[Note] = dropped_notes(results.model)
    if results.escape.within_groups:
        notes.append(Note(SeparationWarning, within_groups(results, "")))
    if results.escape.separation is not None:
        notes.append(Note(SeparationWarning, separated(results, "")))
    if not results.converged:
        text = "no maximum found: the curvature where the searches ended is that of no maximum"
        if results.maximum.flat:
            text = (
                "no maximum found: the likelihood is flat where the searches ended, as where it rises for ever "
                f"(standard error {results.maximum.unknown:.1e} of a row's linear predictor)"
            )
        elif results.maximum.runs_off:
            text = (
                f"no maximum found: groups differ by a standard deviation of {results.maximum.spread:.0f} logits "
                "where the searches ended, as where the outcomes within every group are separated and it rises "
                "for ever"
            )
        explained = results.maximum.converged or results.escape.unbounded.all()
        return (*notes,) if explained else (*notes, Note(ConvergenceWarning, text))
    if results.singular:
        effects = ", ".join(results.model.names[len(results.fe_params) :])
        text = (
            f"singular fit: some combination of the random effects of {results.model.group_name} has no variance "
            f"({effects}): {', '.join(shown(v) for v in results.params[len(results.fe_params) :])}"
        )
        notes.append(Note(BoundaryWarning, text))
    if max(results.maximum.ends) - min(results.maximum.ends) > 1e-4:
        ends = ", ".join(f"{value:.4f}" for value in sorted(results.maximum.ends, reverse=True))
        text = f"searches ended at log-likelihoods {ends}; the first is reported"
        notes.append(Note(SeveralMaximaWarning, text))
    return tuple(notes)


def slope_summary(results: LogisticSlopeResults, alpha: float, method: str, title: str | None) -> Any:
    """The fit on a screen, with its notes."""
    model, ends = results.model, results.conf_int(alpha, method)
    with np.errstate(over="ignore"):  # separated data: infinity is what is meant
        ratios = np.exp(results.estimates[: len(results.fe_params)])
    effects = "; ".join(", ".join(model.effects[i] for i in block) for block in model.blocks)
    header = {
        "Model:": "Logistic mixed model", "Outcome:": model.outcome_name,
        "Rows:": f"{results.nobs}" + (f" ({model.n_dropped} dropped)" if model.n_dropped else ""),
        "Groups:": f"{model.fixed.n_groups} ({model.group_name})", "Random effects:": effects,
        "Log-likelihood:": f"{results.llf:.4f}", "AIC:": f"{results.aic:.4f}",
        "BIC (log of rows):": f"{results.bic:.4f}",
        "Quadrature:": "Laplace", "Converged:": str(results.converged) + (", singular" if results.singular else ""),
    }  # fmt: skip
    p = len(results.fe_params)
    columns = {
        "Coef.": results.params, "Std.Err.": results.bse, "z": results.tvalues, "P>|z|": results.pvalues,
        f"[{alpha / 2:g}": ends[:, 0], f"{1 - alpha / 2:g}]": ends[:, 1],
        "exp(Coef.)": np.append(ratios, np.full(len(results.params) - p, np.nan)),
    }  # fmt: skip
    table = pd.DataFrame(columns, index=model.names).map(shown)
    table["P>|z|"] = ["" if np.isnan(p) else f"{p:.4f}" for p in results.pvalues]
    summary = summary2.Summary()
    summary.add_dict(header)
    summary.add_df(table)
    summary.add_title(title or "Logistic mixed model, random slopes")
    summary.add_text("Intervals: Wald. exp(Coef.): odds ratios for one and the same group.")
    summary.add_text("Laplace's approximation: with few binary outcomes a group it can be badly wrong.")
    for note in results.notes:
        for line in textwrap.wrap(f"{note.category.__name__}: {note.text}", WIDTH):
            summary.add_text(line)
    return summary
