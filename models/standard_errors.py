"""Asymptotic standard errors from the observed information.

Valid where the estimate is interior and identified. Entries closer to zero than `BOUNDARY` are held fixed and
get no standard error, and a singular information matrix gives none at all: use the parametric bootstrap there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.baum_welch_fit import BaumWelchFit
from models.events import EventLog
from models.forward_backward import log_likelihood_and_gradient
from models.notebook_view import NotebookView, View, frame_rows
from models.parameters import Array, Layout, on_boundary

BOUNDARY = 1e-4
STEP = 1e-5


@dataclass(frozen=True)
class StandardErrors(NotebookView):
    """Standard errors in the shapes of the tables; NaN where there is none.

    Attributes
    ----------
    initial, transition, emission : arrays
    on_boundary : int
        Entries held fixed because the estimate lies within 1e-4 of zero.
    condition : float
        Condition number of the scaled information matrix; above 1e10 nothing is reported.
    """

    initial: Array
    transition: Array
    emission: Array
    on_boundary: int
    condition: float

    @property
    def largest(self) -> float:
        """Largest standard error of any entry; NaN where there is none at all."""
        every = np.concatenate([t.ravel() for t in (self.initial, self.transition, self.emission)])
        return float(np.nanmax(every)) if np.isfinite(every).any() else float("nan")

    def _view(self) -> View:
        warnings = []
        if not np.isfinite(self.largest):
            warnings.append(
                f"no standard errors: the information matrix is singular (condition number {self.condition:.3g})."
            )
        if self.on_boundary:
            warnings.append(f"{self.on_boundary} entries at 0 were held fixed and have no standard error.")
        rows = [
            {"entry": f"{name}[{', '.join(map(str, at))}]", "standard_error": float(error)}
            for name in ("initial", "transition", "emission")
            for at, error in np.ndenumerate(getattr(self, name))
            if np.isfinite(error)
        ]
        said = () if warnings and not rows else (f"Largest standard error of an entry: {self.largest:.3g}.",)
        return View("Standard errors", "", tuple(warnings), (), said, (frame_rows(rows),) if rows else ())


def standard_errors(fit: BaumWelchFit, log: EventLog) -> StandardErrors:
    """Invert the observed information (central differences of the exact gradient, step 1e-5).

    Each free probability row with evidence is parametrised by all its entries but the largest, which is one
    minus the others.
    """
    model = fit.model
    layout = Layout(model.protocol, model.n_states)
    tree = log.tree()
    theta = layout.pack(model.initial, model.transition, model.emission)
    free = layout.free_entries(fit.pins)
    informed = layout.informed_rows(log)
    entries: list[int] = []
    reference: list[int] = []
    boundary = 0
    for row, used in zip(layout.rows, informed, strict=True):
        if not used or not free[row.start]:
            continue
        top = row.start + int(np.argmax(theta[row]))
        inside = [i for i in range(row.start, row.stop) if i != top and theta[i] > BOUNDARY]
        boundary += on_boundary(theta[row], BOUNDARY)
        entries += inside
        reference += [top] * len(inside)
    to, off = np.array(entries, dtype=int), np.array(reference, dtype=int)
    n = len(to)
    information = np.empty((n, n))
    for j in range(n):
        columns = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[to[j]] += sign * STEP
            moved[off[j]] -= sign * STEP
            result = log_likelihood_and_gradient(tree, *layout.unpack(moved), layout.emission_index)
            gradient = layout.pack(result.initial, result.transition, result.emission)
            columns.append(gradient[to] - gradient[off])
        information[:, j] = -(columns[0] - columns[1]) / (2 * STEP)
    information = (information + information.T) / 2
    out = np.full(layout.size, np.nan)
    condition = np.inf
    diagonal = np.diag(information)
    if n and np.all(diagonal > 0):
        scale = 1 / np.sqrt(diagonal)
        scaled = information * np.outer(scale, scale)
        eigenvalues = np.linalg.eigvalsh(scaled)
        if eigenvalues[0] > 0:
            condition = float(eigenvalues[-1] / eigenvalues[0])
        if condition < 1e10:
            covariance = np.linalg.inv(scaled) * np.outer(scale, scale)
            out[to] = np.sqrt(np.diag(covariance))
            for top in np.unique(off):
                block = off == top
                out[top] = np.sqrt(covariance[np.ix_(block, block)].sum())
    return StandardErrors(*layout.unpack(out), boundary, condition)
