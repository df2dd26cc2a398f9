"""What must be known before a fit is read, as sentences with a warning class each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.glmm_separation import ceiling_cells, find_separation
from models.glmm_warnings import (
    BoundaryWarning,
    CeilingWarning,
    ConvergenceWarning,
    MixedModelWarning,
    QuadratureWarning,
    SeparationWarning,
    SeveralMaximaWarning,
)

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults


@dataclass(frozen=True)
class Note:
    """A sentence and the warning it is raised as."""

    category: type[MixedModelWarning]
    text: str


def notes_of(results: LogisticMixedResults) -> tuple[Note, ...]:
    """All that apply to a fit, gravest first."""
    model, best = results.model, results.maximum
    names = [str(name) for name in model.exog_names]
    notes: list[Note] = []
    separation = find_separation(model.patterns, best.pooled_beta, names)
    if separation:
        every = "every row" if separation.complete else f"{separation.n_cells} covariate rows"
        shown = "; ".join(str(cell) for cell in separation.cells[:4])
        notes.append(
            Note(
                SeparationWarning,
                f"{' and '.join(separation.coefficients)}: no finite estimate, {every} predicted perfectly "
                f"({shown}); "
                "the coefficients are where the search stopped, their errors and tests mean nothing",
            )
        )
    else:
        cells = ceiling_cells(model.patterns, names)
        if cells:
            shown = "; ".join(str(cell) for cell in cells[:4])
            notes.append(
                Note(CeilingWarning, f"only one outcome in {shown}: what is said there rests on the other cells")
            )
        if not best.converged:
            notes.append(
                Note(ConvergenceWarning, f"no maximum found: the step left is {best.step:.1e} standard errors")
            )
    if separation or not best.converged:
        return tuple(notes)  # what follows is said of a maximum
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
    check = results.node_check
    if check.dependent or not np.isfinite(check.finer_sd):
        notes.append(Note(QuadratureWarning, f"the estimate depends on the number of nodes: {check.text}"))
    return tuple(notes)


def name_of_sd(results: LogisticMixedResults) -> str:
    """Name of the standard deviation, as in the table of parameters."""
    return str(results.model.data.param_names[-1])
