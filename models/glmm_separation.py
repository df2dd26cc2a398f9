"""Separated data and cells at the ceiling, found and named.

Data are separated when some combination of covariates never speaks against the outcome: ``x'd >= 0`` wherever
there is a success and ``x'd <= 0`` wherever there is a failure, not all zero (Albert & Anderson 1984). The
likelihood then rises for ever along ``d``, with a random intercept as without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array, eye_array, hstack

from models.glmm_coordinates import Coordinates
from models.glmm_data import Array, Patterns
from models.glmm_input import redundant_columns

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
    """Directions in which the likelihood rises for ever, all together.

    Attributes
    ----------
    coefficients : tuple of str
        Names of the coefficients that run off.
    positions : tuple of int
        All coefficients without a finite estimate: these, and those for which no row is left to tell.
    signs : tuple of int
        Where the coefficients at `positions` run to: 1 and -1 for infinity, 0 where nothing is left to tell.
    cells : tuple of Cell
        Distinct covariate rows predicted perfectly, at most `MOST_CELLS`.
    n_cells : int
    complete : bool
        Every row is predicted perfectly.
    left : bool array [rows]
        Rows of the patterns that are not predicted perfectly: what other coefficients rest on.
    """

    coefficients: tuple[str, ...]
    positions: tuple[int, ...]
    signs: tuple[int, ...]
    cells: tuple[Cell, ...]
    n_cells: int
    complete: bool
    left: NDArray[np.bool_]

    def rest(self, patterns: Patterns) -> tuple[Patterns, list[int]]:
        """Data of the rows that are left, and the positions of their columns.

        The coefficients that have an estimate keep their column; of the others, as many as the rows can tell apart.
        """
        finite = [i for i in range(patterns.n_fixed) if i not in self.positions]
        rows = patterns.design[self.left]
        columns = list(finite)
        for i in self.positions:
            if len(rows) and len(columns) not in redundant_columns(rows[:, [*columns, i]]):
                columns.append(i)
        return patterns.only(self.left, columns), columns


def find_separation(patterns: Patterns, pooled_beta: Array, names: Sequence[str]) -> Separation | None:
    """All that separates the outcomes, by linear programming; None if nothing does.

    The programme asks for as many rows as possible on the right side by one, the others on the boundary: a cone
    has no scale, so it finds every row that any direction predicts. A coefficient has an estimate if the other rows
    determine it.
    """
    if np.abs(patterns.offset + patterns.design @ pooled_beta).max() < SUSPICIOUS:
        return None
    design, _, y, m = patterns.cells
    coordinates = Coordinates.of(patterns.design)
    x = coordinates.apply(design)
    x = x / np.maximum(np.abs(x).max(axis=0), 1e-300)
    size = x.shape[1]
    side = np.where(y == m, 1.0, np.where(y == 0, -1.0, 0.0))
    pure, mixed = side != 0, side == 0
    count = int(pure.sum())
    if not count:
        return None
    found = linprog(
        np.concatenate([np.zeros(size), -np.ones(count)]),
        A_ub=hstack([csr_array(-side[pure, None] * x[pure]), eye_array(count)], format="csr"),
        b_ub=np.zeros(count),
        A_eq=hstack([csr_array(x[mixed]), csr_array((int(mixed.sum()), count))], format="csr")
        if mixed.any()
        else None,
        b_eq=np.zeros(int(mixed.sum())) if mixed.any() else None,
        bounds=[(None, None)] * size + [(0.0, 1.0)] * count,
    )
    if found.x is None or -found.fun < 0.5:
        return None
    reach = np.zeros(len(y), bool)
    reach[pure] = found.x[size:] > 0.5
    # Coefficients that the other rows determine: unit vectors in the span of these rows.
    transform = coordinates.matrix[:-1, :-1] / np.maximum(np.abs(coordinates.apply(design)).max(axis=0), 1e-300)
    unit = transform / np.linalg.norm(transform, axis=1, keepdims=True)
    span = unit[:0]
    if not reach.all():
        _, values, span = np.linalg.svd(x[~reach], full_matrices=False)
        span = span[values > 1e-9 * max(1.0, values.max())]
    outside = np.linalg.norm(unit - unit @ span.T @ span, axis=1) > 1e-7
    along = unit @ _shortest(side[reach, None] * x[reach], x[~reach], unit, found.x[:size])
    signs = np.where(np.abs(along) > 1e-7 * np.abs(along).max(), np.sign(along), 0).astype(int)
    positions = tuple(int(i) for i in np.flatnonzero(outside | (signs != 0)))
    cells = _cells(design[reach], y[reach], m[reach], names)
    return Separation(
        tuple(names[i] for i in positions if signs[i]), positions, tuple(int(signs[i]) for i in positions),
        cells[:MOST_CELLS], int(reach.sum()), bool(reach.all()), ~reach[patterns.cell_of_row[0]],
    )  # fmt: skip


def _shortest(apart: Array, left: Array, unit: Array, otherwise: Array) -> Array:
    """The direction that separates the same rows with the smallest sum of coefficients: it moves few of them."""
    size = apart.shape[1]
    absolute = np.eye(size)
    found = linprog(
        np.concatenate([np.zeros(size), np.ones(size)]),
        A_ub=np.block(
            [[-apart, np.zeros((len(apart), size))], [unit, -absolute], [-unit, -absolute]],
        ),
        b_ub=np.concatenate([-np.ones(len(apart)), np.zeros(2 * size)]),
        A_eq=np.column_stack([left, np.zeros((len(left), size))]) if len(left) else None,
        b_eq=np.zeros(len(left)) if len(left) else None,
        bounds=(None, None),
    )
    return otherwise if found.x is None else np.asarray(found.x[:size])


def separated_without(patterns: Patterns, separation: Separation, index: int) -> bool:
    """Whether the same rows are separated as well by a direction in which one coefficient stays where it is."""
    design, _, y, m = patterns.cells
    coordinates = Coordinates.of(patterns.design)
    x = coordinates.apply(design)
    left = separation.left[patterns.cell_of_row[1]]
    held = np.vstack([x[left], coordinates.matrix[index : index + 1, :-1]])
    held = held / np.maximum(np.linalg.norm(held, axis=1, keepdims=True), 1e-300)
    _, values, basis = np.linalg.svd(held)
    free = basis[int(np.sum(values > 1e-9 * values.max())) :]
    if not len(free):
        return False
    apart = np.where(y == m, 1.0, -1.0)[~left, None] * (x[~left] @ free.T)
    size = np.maximum(np.abs(apart).max(axis=1, keepdims=True), 1e-300)
    return (
        linprog(np.zeros(len(free)), A_ub=-apart / size, b_ub=-np.ones(len(apart)), bounds=(None, None)).status == 0
    )


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
