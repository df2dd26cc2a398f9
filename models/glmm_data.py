"""The data of a mixed model, compressed: equal rows of a group in one, equal groups in one pattern.

Rows of a group with the same covariates and offset add up to one binomial row, and groups with the same binomial
rows share one likelihood. 540 people with two binary covariates make some thirty patterns, 50,000 hardly more; with
a continuous covariate nothing is shared and the patterns are the groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import gammaln

from models.glmm_kernel import marginal_likelihood

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MANY = 5_000
"""Patterns beyond which searches start on a part of them, and the Hessian is by forward differences."""


@dataclass(frozen=True)
class Rule:
    """A quadrature rule: probabilists' nodes, ascending, and log-weights; one node is Laplace's approximation.

    Attributes
    ----------
    nodes, log_weights : array [K]
    """

    nodes: Array
    log_weights: Array

    @classmethod
    def hermite(cls, n_nodes: int) -> Rule:
        """Gauss--Hermite rule for the standard normal density times sqrt(2 pi)."""
        return cls(*_hermite(n_nodes))

    @property
    def n_nodes(self) -> int:
        """Number of nodes K."""
        return len(self.nodes)

    @property
    def name(self) -> str:
        """In words."""
        return "Laplace" if self.n_nodes == 1 else f"adaptive Gauss-Hermite, {self.n_nodes} nodes"


@dataclass(frozen=True)
class Patterns:
    """Distinct groups.

    Attributes
    ----------
    design : array [rows, p]
        Rows of pattern ``i`` are ``start[i]:start[i + 1]``.
    offset, successes, trials : array [rows]
    start : array [patterns + 1]
    multiplicity : array [patterns]
        Groups that share the pattern.
    of_group : array [groups]
        Pattern of each group.
    constant : float
        Sum of the logarithms of the binomial coefficients of the rows as given: the part of the log-likelihood
        that no parameter touches.
    """

    design: Array
    offset: Array
    successes: Array
    trials: Array
    start: Integers
    multiplicity: Array
    of_group: Integers
    constant: float

    @classmethod
    def from_rows(
        cls,
        design: Array,
        offset: Array,
        successes: Array,
        trials: Array,
        weights: Array,
        group: Integers,
        compress: bool = True,
    ) -> Patterns:
        """Compress rows.

        Parameters
        ----------
        design : array [n, p]
        offset, successes, trials, weights : array [n]
            `weights` are whole numbers: how often the row was observed, 0 leaves it out.
        group : array [n]
            Code of each row's group, 0 to G - 1.
        compress : bool
            False keeps one pattern a group (rows are still merged), as a check.
        """
        n_groups = int(group.max()) + 1
        several = trials > 1
        coefficients = weights[several] * _log_binomial(successes[several], trials[several])
        cell, first_of_cell = _cells(np.column_stack([design, offset]))
        # Rows with equal group and cell are added up; the new rows are sorted by group, then cell.
        key = group * np.int64(len(first_of_cell)) + cell
        merged, at = np.unique(key, return_inverse=True)
        y = np.bincount(at, weights * successes, len(merged))
        m = np.bincount(at, weights * trials, len(merged))
        keep = m > 0
        merged, y, m = merged[keep], y[keep], m[keep]
        row_cell, row_group = merged % len(first_of_cell), merged // len(first_of_cell)
        start = np.searchsorted(row_group, np.arange(n_groups + 1)).astype(np.int64)
        if compress:
            of_group = _equal_sequences(_codes(row_cell, y, m), start)
        else:
            of_group = np.arange(n_groups, dtype=np.int64)
        n_patterns = int(of_group.max()) + 1
        example = np.full(n_patterns, -1, np.int64)
        example[of_group[::-1]] = np.arange(n_groups - 1, -1, -1)  # the first group of each pattern
        lengths = np.diff(start)[example]
        pattern_start = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        rows = np.repeat(start[example] - pattern_start[:-1], lengths) + np.arange(pattern_start[-1])
        original = first_of_cell[row_cell[rows]]
        return cls(
            np.ascontiguousarray(design[original], float),
            np.ascontiguousarray(offset[original], float),
            y[rows], m[rows], pattern_start,
            np.bincount(of_group, minlength=n_patterns).astype(float), of_group, float(coefficients.sum()),
        )  # fmt: skip

    @property
    def n_patterns(self) -> int:
        """Distinct groups."""
        return len(self.multiplicity)

    @property
    def n_groups(self) -> int:
        """Groups."""
        return len(self.of_group)

    @property
    def n_fixed(self) -> int:
        """Columns of the design."""
        return self.design.shape[1]

    def part(self, wanted: int) -> Patterns:
        """About `wanted` patterns, evenly spaced, standing for all: their multiplicities are scaled up."""
        chosen = np.linspace(0, self.n_patterns - 1, wanted).astype(np.int64)
        length = np.diff(self.start)[chosen]
        start = np.concatenate([[0], np.cumsum(length)]).astype(np.int64)
        rows = np.repeat(self.start[chosen] - start[:-1], length) + np.arange(start[-1])
        multiplicity = self.multiplicity[chosen]
        return Patterns(
            self.design[rows], self.offset[rows], self.successes[rows], self.trials[rows], start,
            multiplicity * (self.n_groups / multiplicity.sum()), np.arange(len(chosen)), self.constant,
        )  # fmt: skip

    def only(self, rows: NDArray[np.bool_], columns: Sequence[int]) -> Patterns:
        """Some rows and columns of the design; patterns that lose all their rows are left out."""
        length = np.add.reduceat(rows.astype(np.int64), self.start[:-1])
        kept = np.flatnonzero(length > 0)
        number = np.full(self.n_patterns, -1, np.int64)
        number[kept] = np.arange(len(kept))
        of_group = number[self.of_group]
        return Patterns(
            np.ascontiguousarray(self.design[rows][:, columns]), self.offset[rows], self.successes[rows],
            self.trials[rows], np.concatenate([[0], np.cumsum(length[kept])]).astype(np.int64),
            self.multiplicity[kept], of_group[of_group >= 0], self.constant,
        )  # fmt: skip

    @cached_property
    def cell_of_row(self) -> tuple[Integers, Integers]:
        """Number of every row's distinct covariates (offset included), and the first row of each number."""
        return _cells(np.column_stack([self.design, self.offset]))

    @cached_property
    def cells(self) -> tuple[Array, Array, Array, Array]:
        """Distinct covariate rows over all groups: design, offset, successes, trials."""
        code, first = self.cell_of_row
        times = np.repeat(self.multiplicity, np.diff(self.start))
        return (
            self.design[first],
            self.offset[first],
            np.bincount(code, times * self.successes),
            np.bincount(code, times * self.trials),
        )


class Likelihood:
    """The log-likelihood of patterns under a rule, with workspace that is used again at every call.

    Attributes
    ----------
    values, modes, scales : array [patterns]
        Of the last call: log-likelihood of each pattern (without `Patterns.constant`), mode and scale of its
        intercept, for the standard normal u. The next call starts its searches where these modes point to.
    scores : array [patterns, p + 1]
        Of the last call: derivatives of `values` by (beta, s).
    calls : int
        Evaluations so far.
    """

    def __init__(self, patterns: Patterns, rule: Rule) -> None:
        self.patterns, self.rule, self.calls = patterns, rule, 0
        n = patterns.n_patterns
        # Fresh memory at every call costs as much as a fifth of the work.
        self.modes, self.scales, self.values = np.zeros(n), np.ones(n), np.empty(n)
        self.scores = np.empty((n, patterns.n_fixed + 1))
        # Where the last call was, and how its modes move with the predictors and the sd.
        n_rows = len(patterns.offset)
        self._covariates = np.ascontiguousarray(patterns.design.T)
        self._before, self._eta, self._drift, self._drift_in_s = (np.zeros(k) for k in (1, n_rows, n_rows, n))

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Log-likelihood, constant included, and gradient at ``theta = (beta, s)``; s may have either sign."""
        data = self.patterns
        self.calls += 1
        gradient = np.empty(self.patterns.n_fixed + 1)
        value = marginal_likelihood(
            np.ascontiguousarray(theta, float), self._covariates, data.offset, data.successes, data.trials,
            data.start, data.multiplicity, self.rule.nodes, self.rule.log_weights, self._before, self.modes,
            self._eta, self._drift, self._drift_in_s, self.scales, self.values, self.scores, gradient,
        )  # fmt: skip
        return value + data.constant, gradient

    def outer_product(self) -> Array:
        """Sum over groups of the outer products of their scores at the last call (Berndt et al. 1974)."""
        # Long rows are what einsum is quick with.
        columns = self.scores.T.copy()
        return np.asarray(np.einsum("ji,ki->jk", self.patterns.multiplicity * columns, columns))

    @cached_property
    def sizes(self) -> Array:
        """Root mean square of every column of the design, and 1 for the standard deviation.

        Differences in steps of their inverses are as good for seconds and metres as for standardised covariates.
        """
        columns = np.sqrt(np.mean(self.patterns.design**2, axis=0))
        return np.append(np.where(columns > 0, columns, 1.0), 1.0)

    def hessian(self, theta: Array) -> Array:
        """Second derivatives by differences of the exact gradient.

        Central differences, good to nine digits or more; with many patterns forward ones, good to six, for half the
        time.
        """
        theta = np.asarray(theta, float)
        hessian = np.empty((len(theta), len(theta)))
        forward = self.patterns.n_patterns > MANY
        steps = (1e-7 if forward else 6e-6) * np.maximum(1.0, np.abs(theta) * self.sizes) / self.sizes
        here = self(theta)[1] if forward else None
        for i, step in enumerate(steps):
            up, down = theta.copy(), theta.copy()
            up[i] += step
            if here is not None:
                hessian[i] = (self(up)[1] - here) / (up[i] - theta[i])
                continue
            down[i] -= step
            hessian[i] = (self(up)[1] - self(down)[1]) / (up[i] - down[i])
        return 0.5 * (hessian + hessian.T)


@cache
def _hermite(n_nodes: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.hermite_e.hermegauss(n_nodes)
    return nodes, np.log(weights)


def _log_binomial(successes: Array, trials: Array) -> Array:
    return gammaln(trials + 1) - gammaln(successes + 1) - gammaln(trials - successes + 1)


def _codes(*columns: NDArray[np.generic]) -> Integers:
    """One integer per distinct row of the columns, in order of appearance."""
    code = np.zeros(len(columns[0]), np.int64)
    count = 1
    for column in columns:
        if count == len(code):
            break  # every row is distinct already
        if column[0] == column[-1] and (column == column[0]).all():
            continue  # the intercept, no offset
        here, levels = pd.factorize(column)
        code, found = pd.factorize(code * np.int64(len(levels)) + here)
        count = len(found)
    return code.astype(np.int64)


def _cells(matrix: Array) -> tuple[Integers, Integers]:
    """Code of each row's distinct covariates, and the first row of each code."""
    code = _codes(*matrix.T)
    first = np.full(int(code.max()) + 1, -1, np.int64)
    first[code[::-1]] = np.arange(len(code) - 1, -1, -1)
    return code, first


def _equal_sequences(code: Integers, start: Integers) -> Integers:
    """Number of the distinct sequence ``code[start[g]:start[g + 1]]`` of every group, in order of appearance.

    Sequences are compared position by position, all groups at once; a group that has ended keeps its number.
    """
    length = np.diff(start)
    number, _ = pd.factorize(length)  # sequences of different lengths differ
    number = number.astype(np.int64)
    width = np.int64(code.max() + 1)
    for position in range(int(length.max())):
        more = np.flatnonzero(length > position)
        key = number * width
        key[more] += code[start[more] + position]
        number, found = pd.factorize(key)
        number = number.astype(np.int64)
        if len(found) == len(length):
            break
    return number
