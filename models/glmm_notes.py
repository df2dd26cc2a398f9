"""What must be known before a fit is read, as sentences with a warning class each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from models.glmm_separation import ceiling_cells
from models.glmm_warnings import (
    BoundaryWarning,
    CeilingWarning,
    ConvergenceWarning,
    DroppedRowsWarning,
    FlatLikelihoodWarning,
    MixedModelWarning,
    QuadratureWarning,
    SeparationWarning,
    SeveralMaximaWarning,
)

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults

REACH = 1.92
"""Fall of the log-likelihood that a 95% interval of one parameter allows (half the quantile of chi-square)."""


@dataclass(frozen=True)
class Note:
    """A sentence and the warning it is raised as."""

    category: type[MixedModelWarning]
    text: str


def notes_of(results: LogisticMixedResults) -> tuple[Note, ...]:
    """All that apply to a fit, gravest first."""
    model, best, escape = results.model, results.maximum, results.escape
    notes: list[Note] = []
    notes += dropped_notes(model)
    if escape.within_groups:
        notes.append(Note(SeparationWarning, within_groups(results)))
    if escape.separation:
        notes.append(Note(SeparationWarning, separated(results)))
    else:
        cells = ceiling_cells(model.patterns, [str(name) for name in model.exog_names])
        if cells:
            listed = "; ".join(str(cell) for cell in cells[:4])
            notes.append(
                Note(CeilingWarning, f"only one outcome in {listed}: what is said there rests on the other cells")
            )
        if not best.converged and not escape.within_groups:
            why = "every search was cut short, or ended where the curvature is that of no maximum"
            if results.node_check.elsewhere:
                why = "quadrature's error has moved it, as the next note says; a fit with more nodes comes closer"
            elif np.isfinite(best.step):
                why = f"the step left is {best.step:.1e} standard errors"
            notes.append(Note(ConvergenceWarning, f"no maximum found: {why}"))
    check = results.node_check
    if check.wrong and not escape.within_groups:
        notes.append(Note(QuadratureWarning, f"quadrature is not to be believed here: {check.text}"))
    if escape.any or not best.converged:
        return tuple(notes)  # what follows is said of a maximum
    if escape.limit is not None and escape.finite - escape.limit.value < REACH:
        notes.append(
            Note(
                FlatLikelihoodWarning,
                f"outcomes are separated within every group, and with {name_of_sd(results)} at infinity the "
                f"log-likelihood is still {escape.limit.value:.4f}, against {escape.finite:.4f} at best: profile "
                "intervals are open, and Wald's are too short",
            )
        )
    if best.boundary:
        notes.append(
            Note(
                BoundaryWarning,
                f"{name_of_sd(results)} is estimated at zero: "
                "the fit is that of a logistic regression without groups",
            )
        )
    if best.several_maxima:
        ends = sorted((s for s in best.searches if not s.joined), key=lambda s: -s.value)
        listed = ", ".join(f"sd {s.theta[-1]:.4g} (log-likelihood {s.value:.4f})" for s in ends)
        notes.append(
            Note(SeveralMaximaWarning, f"the likelihood has several maxima: {listed}; the first is reported")
        )
    if not check.wrong and (check.dependent or not np.isfinite(check.finer_sd)):
        notes.append(Note(QuadratureWarning, f"the estimate depends on the number of nodes: {check.text}"))
    return tuple(notes)


def dropped_notes(model: Any) -> list[Note]:
    """Rows left out though all their values were there."""
    if not model.dropped_by_terms:
        return []
    terms = " and ".join(f"{term} is no number in {n}" for term, n in model.dropped_by_terms.items())
    text = f"rows were left out in which all values are there: {terms} of {len(model.endog) + model.n_dropped}"
    return [Note(DroppedRowsWarning, text)]


PROFILED = ", and profile intervals have one end at most"
"""Said of fits that have profile intervals."""


def separated(results: Any, ends: str = PROFILED) -> str:
    """What the fixed effects predict perfectly, and which of them have no estimate."""
    separation = results.escape.separation
    assert separation is not None
    every = "every row" if separation.complete else f"{separation.n_cells} covariate rows"
    listed = "; ".join(str(cell) for cell in separation.cells[:4])
    columns = [str(name) for name in results.model.exog_names]
    others = [columns[i] for i, sign in zip(separation.positions, separation.signs, strict=True) if not sign]
    more = f"no row is left to estimate {' and '.join(others)} from; " if others else ""
    return (
        f"{' and '.join(separation.coefficients)}: no finite estimate, {every} predicted perfectly ({listed}); "
        f"{more}the numbers in params are where the search stopped, there are no errors or Wald tests and "
        f"intervals{ends}"
    )


def within_groups(results: Any, ends: str = PROFILED) -> str:
    """Why no parameter has an estimate where every group is separated within."""
    escape, sd = results.escape, name_of_sd(results)
    assert escape.limit is not None
    if escape.limit.constant_groups:
        why = f"every group is constant: {sd} runs to infinity, and the coefficients with it"
    else:
        columns = [str(name) for name in results.model.exog_names]
        columns = [columns[i] for i in escape.columns] if escape.columns else columns
        moving = [
            n for n, d, v in zip(columns, escape.limit.direction, escape.limit.within, strict=True) if d and v
        ]
        why = (
            f"the outcomes within every group that varies are separated by {' and '.join(moving)}, so that the "
            f"coefficients and {sd} run to infinity together"
        )
    return (
        f"{why}. No parameter has a finite estimate (the log-likelihood rises to {escape.limit.value:.4f}); the "
        "numbers in params are where the search stopped, there are no errors or Wald tests and "
        f"intervals{ends}"
    )


def name_of_sd(results: Any) -> str:
    """Name of the intercept's standard deviation, as in the table of parameters."""
    model = results.model
    return str(getattr(model, "fixed", model).data.param_names[-1])
