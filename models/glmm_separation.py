"""Separated data and cells at the ceiling, found and named.

Data are separated when some combination of covariates never speaks against the outcome: ``x'd >= 0`` wherever
there is a success and ``x'd <= 0`` wherever there is a failure, not all zero (Albert & Anderson 1984). The
likelihood then rises for ever along ``d``, with a random intercept as without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from models.glmm_data import Array, Patterns

SUSPICIOUS = 15.0
"""Linear predictor of the pooled fit beyond which separation is looked for; separated fits always go beyond it."""

CEILING_TRIALS = 10
"""Trials from which a cell with one outcome only is named."""

MOST_CELLS = 64
"""Distinct covariate rows up to which cells are looked at one by one."""


@dataclass(frozen=True)
class Cell:
    """A distinct row of covariates with one outcome only.

    Attributes
    ----------
    covariates : tuple of (name, value)
    successes, trials : int
    """

    covariates: tuple[tuple[str, float], ...]
    successes: int
    trials: int

    def __str__(self) -> str:
        where = ", ".join(f"{name} = {value:g}" for name, value in self.covariates) or "all rows"
        return f"{where}: {self.successes} of {self.trials}"


@dataclass(frozen=True)
class Separation:
    """A direction in which the likelihood rises for ever.

    Attributes
    ----------
    coefficients : tuple of str
        Names of the coefficients that run off.
    cells : tuple of Cell
        Distinct covariate rows predicted perfectly, at most `MOST_CELLS`.
    n_cells : int
    complete : bool
        Every row is predicted perfectly.
    """

    coefficients: tuple[str, ...]
    cells: tuple[Cell, ...]
    n_cells: int
    complete: bool


def find_separation(patterns: Patterns, pooled_beta: Array, names: Sequence[str]) -> Separation | None:
    """The separating direction with the largest reach, by linear programming; None if there is none."""
    if np.abs(patterns.offset + patterns.design @ pooled_beta).max() < SUSPICIOUS:
        return None
    design, _, y, m = patterns.cells
    scale = np.maximum(np.abs(design).max(axis=0), 1e-300)
    x = design / scale
    only_hits, only_misses = y == m, y == 0
    mixed = ~(only_hits | only_misses)
    signed = np.vstack([x[only_hits], -x[only_misses]])
    found = linprog(
        -signed.sum(axis=0),
        A_ub=-signed,
        b_ub=np.zeros(len(signed)),
        A_eq=x[mixed] if mixed.any() else None,
        b_eq=np.zeros(mixed.sum()) if mixed.any() else None,
        bounds=(-1.0, 1.0),
    )
    if found.x is None or -found.fun < 1e-7:
        return None
    reach = np.abs(x @ found.x) > 1e-7
    if not mixed.any():
        # The direction of the largest sum may leave rows undecided that another one decides.
        strict = linprog(
            np.append(np.zeros(x.shape[1]), -1.0),
            A_ub=np.column_stack([-signed, np.ones(len(signed))]),
            b_ub=np.zeros(len(signed)),
            bounds=[(-1.0, 1.0)] * x.shape[1] + [(None, 1.0)],
        )
        if strict.x is not None and strict.x[-1] > 1e-7:
            found, reach = strict, np.ones(len(y), bool)
            found.x = strict.x[:-1]
    cells = _cells(design[reach], y[reach], m[reach], names)
    running = tuple(name for name, d in zip(names, found.x, strict=True) if abs(d) > 1e-7)
    return Separation(running, cells[:MOST_CELLS], int(reach.sum()), bool(reach.all()))


def ceiling_cells(patterns: Patterns, names: Sequence[str]) -> tuple[Cell, ...]:
    """Cells with at least ten trials, all with the same outcome; none where covariates are continuous."""
    # One continuous covariate is seen at once; rows have to be compared only where there is none.
    if any(len(np.unique(column)) > MOST_CELLS for column in patterns.design[:1000].T):
        return ()
    if len(patterns.cells[3]) > MOST_CELLS:
        return ()
    design, _, y, m = patterns.cells
    flat = ((y == 0) | (y == m)) & (m >= CEILING_TRIALS)
    return _cells(design[flat], y[flat], m[flat], names)


def _cells(design: Array, y: Array, m: Array, names: Sequence[str]) -> tuple[Cell, ...]:
    shown = [i for i, name in enumerate(names) if name not in ("Intercept", "const")]
    return tuple(
        Cell(tuple((str(names[i]), float(row[i])) for i in shown), int(hits), int(trials))
        for row, hits, trials in zip(design, y, m, strict=True)
    )
