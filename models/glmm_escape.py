"""Which parameters of a fit have no finite estimate, and what the data say of the others.

Three things can run off: coefficients, where covariates predict rows perfectly (`models.glmm_separation`);
coefficients and the standard deviation together, where every group is separated within (`models.glmm_limit`); and
the second in what the first leaves. A parameter that runs off has no standard error, z, p or interval. The others
have those of the rows that are not predicted perfectly, exactly as if the fit had gone all the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from models.glmm_data import Array, Likelihood, Patterns, Rule
from models.glmm_exact import exact_log_likelihood
from models.glmm_exact_maximum import exact_maximum
from models.glmm_limit import Limit, find_limit
from models.glmm_optimise import Maximum, maximise
from models.glmm_profile import profile_intervals
from models.glmm_robust import sandwich
from models.glmm_separation import Separation, find_separation

NO_LOWER = 1e-3
"""A likelihood at infinity this close below every finite one, or above it, leaves no estimate."""


@dataclass(frozen=True)
class Escape:
    """What runs off in a fit.

    Attributes
    ----------
    unbounded : bool array [p + 1]
        Parameters without a finite estimate.
    signs : int array [p + 1]
        Where they run to: 1 and -1 for infinity, 0 for finite ones and where it depends on the way.
    separation : Separation or None
    limit : Limit or None
        The likelihood at infinity where every group is separated within.
    within_groups : bool
        No finite parameters have a higher likelihood than `limit`.
    finite : float
        Highest exact log-likelihood at finite parameters; NaN where there is no `limit`.
    rest : Maximum or None
        Of the rows that are not predicted perfectly, over `columns`; None where all or nothing runs off.
    patterns : Patterns or None
        These rows.
    columns : tuple of int
        Of the design, as `rest` and `limit` know them.
    """

    unbounded: NDArray[np.bool_]
    signs: NDArray[np.int64]
    separation: Separation | None = None
    limit: Limit | None = None
    within_groups: bool = False
    finite: float = np.nan
    rest: Maximum | None = None
    patterns: Patterns | None = None
    columns: tuple[int, ...] = ()

    @property
    def any(self) -> bool:
        """Whether anything runs off."""
        return bool(self.unbounded.any())

    @property
    def positions(self) -> list[int]:
        """Parameters of `rest` that are parameters of the fit, as positions there (the sd last)."""
        return [i for i, c in enumerate(self.columns) if not self.unbounded[c]] + [len(self.columns)]

    def supremum(self, best: Maximum) -> float:
        """What the log-likelihood rises to, or is at its maximum; NaN where the search for that did not end."""
        if self.within_groups and self.limit is not None:
            return self.limit.value
        if self.separation is not None and self.rest is None:
            return best.value  # rows that are left tell nothing of a variance, and the search has come close
        source = best if self.rest is None else self.rest
        return source.value if source.converged else np.nan

    def without_data(self) -> Escape:
        """The same without anything of the size of the data."""
        separation = self.separation and replace(self.separation, left=np.zeros(0, bool))
        return replace(self, separation=separation, patterns=None)

    def covariance(self, best: Maximum, rule: Rule, patterns: Patterns, kind: str) -> Array:
        """Covariance of the parameters, "model" or "robust"; NaN in rows and columns of those that run off."""
        size = len(best.theta)
        source, data = (best, patterns) if self.rest is None else (self.rest, self.patterns or patterns)
        inverse = source.working_covariance
        if kind == "robust":
            inverse = sandwich(Likelihood(source.coordinates.patterns(data), rule), source.top, inverse)
        found = source.coordinates.covariance(inverse)
        if not self.any:
            return found
        out = np.full((size, size), np.nan)
        if self.rest is not None:
            finite = np.flatnonzero(~self.unbounded)
            out[np.ix_(finite, finite)] = found[np.ix_(self.positions, self.positions)]
        return out

    def combinations(self, covariance: Array, rows: Any, others: Any = None) -> Array:
        """Covariance of linear combinations; NaN belongs to those with a parameter that runs off."""
        left, right = (np.atleast_2d(np.asarray(rows if m is None else m, float)) for m in (rows, others))
        out = left @ np.nan_to_num(covariance) @ right.T
        out[(left[:, self.unbounded] != 0).any(axis=1)] = np.nan
        out[:, (right[:, self.unbounded] != 0).any(axis=1)] = np.nan
        return np.asarray(out)

    def profile(self, best: Maximum, rule: Rule, patterns: Patterns, which: Sequence[int], alpha: float) -> Array:
        """Profile intervals of some parameters ``[len(which), 2]``; NaN for those that run off."""
        ends = np.full((len(which), 2), np.nan)
        finite = [row for row, index in enumerate(which) if not self.unbounded[index]]
        if self.rest is None:
            likelihood, source, inside = Likelihood(patterns, rule), best, [which[row] for row in finite]
        else:
            likelihood, source = Likelihood(self.patterns or patterns, rule), self.rest
            place = dict(zip(map(int, np.flatnonzero(~self.unbounded)), self.positions, strict=True))
            inside = [place[which[row]] for row in finite]
        if not finite:
            return ends
        ends[finite] = profile_intervals(likelihood, source, inside, alpha)
        if self.limit is not None and source.converged:
            # Quadrature does not see that a profile never falls far enough; the limit does.
            floor = self.finite - 0.5 * float(chi2.ppf(1 - alpha, 1))
            for row, index in zip(finite, inside, strict=True):
                for side in (-1, 1):
                    if self.limit.endless(index, side, floor):
                        ends[row, (side + 1) // 2] = side * np.inf
        return ends


def find_escape(patterns: Patterns, rule: Rule, best: Maximum, names: Sequence[str]) -> Escape:
    """What runs off in a fit with this maximum; `names` are those of the columns."""
    size = patterns.n_fixed + 1
    nothing = Escape(np.zeros(size, bool), np.zeros(size, np.int64))
    everything = replace(nothing, unbounded=np.ones(size, bool))
    separation = find_separation(patterns, best.pooled_beta, names)
    found, rest, data = nothing, best, patterns
    if separation is not None:
        signs = nothing.signs.copy()
        signs[list(separation.positions)] = separation.signs
        everything = replace(everything, separation=separation, signs=signs)
        left, columns = separation.rest(patterns) if separation.left.any() else (patterns, [])
        if not columns or not _tells_variance(left):
            return everything
        unbounded = nothing.unbounded.copy()
        unbounded[list(separation.positions)] = True
        data, rest = left, maximise(left, rule)
        found = Escape(unbounded, signs, separation, rest=rest, patterns=left, columns=tuple(columns))
    limit = find_limit(data, rest.coordinates)
    if limit is None:
        return found
    finite = _highest_finite(data, rest)
    if limit.value < finite - NO_LOWER:
        return replace(found, limit=limit, finite=finite)
    signs = everything.signs.copy()
    columns = list(found.columns) or list(range(patterns.n_fixed))
    for position, along in zip(columns, limit.direction, strict=True):
        if not found.unbounded[position]:
            signs[position] = int(np.sign(along))
    signs[-1] = 1
    return replace(everything, limit=limit, within_groups=True, finite=finite, signs=signs, columns=tuple(columns))


def _highest_finite(patterns: Patterns, best: Maximum) -> float:
    """Highest exact log-likelihood at finite parameters.

    Maximised, not only evaluated where searches ended: quadrature's own maxima may draw all of them away from it.
    """
    working = best.coordinates.patterns(patterns)
    return max(best.pooled_value, exact_log_likelihood(working, best.top), exact_maximum(working, best).value)


def _tells_variance(patterns: Patterns) -> bool:
    """Whether there are two groups, and one with several trials."""
    trials = np.add.reduceat(patterns.trials, patterns.start[:-1])
    return bool(patterns.multiplicity.sum() > 1 and trials.max() > 1)
