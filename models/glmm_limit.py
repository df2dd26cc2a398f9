r"""Outcomes separated within every group, and what the likelihood comes to at infinity.

When some direction :math:`d` orders the rows of every group as their outcomes do, :math:`x_j'd > x_k'd` for every
success j and failure k of the group, coefficients and standard deviation can grow together, :math:`\beta = t d`,
:math:`\sigma = t`. A group's likelihood then does not vanish but tends to the probability that its intercept falls
between its thresholds,

.. math::

   \ell_\infty(d) = \sum_i \log[\Phi(b_i) - \Phi(a_i)], \qquad
   a_i = \max_{y_{ij} = 1} -x_{ij}'d, \quad b_i = \min_{y_{ij} = 0} -x_{ij}'d .

It is concave in :math:`d` (a marginal of a log-concave function; Prékopa 1973). Where its maximum is no lower than
any likelihood at finite parameters, there is no estimate. Groups whose outcome never varies ask nothing of
:math:`d`: if all are such, the standard deviation always runs off. Quadrature cannot see this, because its error at
large standard deviations makes maxima of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array, hstack
from scipy.special import expit, log_ndtr

from models.glmm_coordinates import Coordinates
from models.glmm_data import Array, Patterns

SOFTNESS = (0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4)
"""Widths, in units of u, of the smooth maxima by which thresholds are replaced, one after the other."""

FEW = 200
"""Patterns among which a contradiction is looked for first."""


@dataclass(frozen=True)
class Limit:
    """The likelihood at infinity.

    Attributes
    ----------
    value : float
        Its maximum over directions, constant included (from below, to some digits).
    direction : array [p]
        Where it is reached: coefficients over standard deviation, zero where there are only rounding and kinks.
    held : array [p]
        The maximum with each coefficient's part of the direction held at zero; -inf where nothing separates then.
    within : bool array [p]
        Whether a column varies within a group with both outcomes.
    constant_groups : bool
        No group has both outcomes.
    """

    value: float
    direction: Array
    held: Array
    within: NDArray[np.bool_]
    constant_groups: bool

    def endless(self, index: int, side: int, floor: float) -> bool:
        """Whether a profile never falls below a value on one side; `index` is that of the sd after all columns."""
        if index == len(self.direction):
            return side > 0 and self.value >= floor
        along = self.direction[index] * side > 0
        return bool((self.value if along else self.held[index]) >= floor)


def find_limit(patterns: Patterns, coordinates: Coordinates) -> Limit | None:
    """The likelihood at infinity; None where it is zero: no direction separates the outcomes within every group."""
    if np.any((patterns.successes > 0) & (patterns.successes < patterns.trials)):
        return None
    # Few groups are enough to show that nothing separates all, which is the rule.
    few = slice(patterns.start[min(FEW, patterns.n_patterns)])
    number = np.repeat(np.arange(patterns.n_patterns), np.diff(patterns.start))
    data = _Groups(
        coordinates.apply(patterns.design[few]), patterns.successes[few] > 0, number[few],
        patterns.multiplicity[:FEW],
    )  # fmt: skip
    if data.surely_mixed():
        return None
    data = _Groups(coordinates.apply(patterns.design), patterns.successes > 0, number, patterns.multiplicity)
    start = data.separating(data.design)
    if start is None:
        return None
    value, direction = data.ascend(data.design, start)
    held = np.full(patterns.n_fixed, -np.inf)
    for index in range(patterns.n_fixed):
        basis = np.linalg.svd(coordinates.matrix[index : index + 1, :-1])[2][1:].T
        inside = data.separating(data.design @ basis)
        if inside is not None:
            held[index] = data.ascend(data.design @ basis, inside)[0]
    # Where holding a coefficient at zero costs nothing it is at a kink.
    beta = coordinates.back(np.append(direction, 1.0))[:-1]
    beta[held >= value - 1e-6 * (1 + abs(value))] = 0.0
    value = max(value, float(held.max(initial=-np.inf)))
    constant = float(patterns.constant)
    spread = np.maximum.reduceat(patterns.design, patterns.start[:-1]) - np.minimum.reduceat(
        patterns.design, patterns.start[:-1]
    )
    within = (spread[data.varying] > 0).any(axis=0)
    return Limit(value + constant, beta, held + constant, within, not data.varying.any())


@dataclass(frozen=True)
class _Groups:
    """Rows, each all success or all failure, in working coordinates, with the number of their pattern."""

    design: Array
    hit: NDArray[np.bool_]
    number: NDArray[np.int64]
    multiplicity: Array

    @property
    def varying(self) -> NDArray[np.bool_]:
        """Patterns with both outcomes."""
        hits = np.bincount(self.number, self.hit, len(self.multiplicity))
        return np.asarray((hits > 0) & (hits < np.bincount(self.number, minlength=len(self.multiplicity))))

    def surely_mixed(self) -> bool:
        """Whether one pair of rows a group shows already that no direction separates.

        Logistic regression on the differences of a success and a failure: at a finite maximum they add up to
        nothing with positive weights, and no direction is on the right side of all (Gordan's theorem).
        """
        varying = np.flatnonzero(self.varying)
        if not len(varying):
            return False
        rows = np.arange(len(self.hit))
        first = np.full((2, len(self.multiplicity)), -1, np.int64)
        for outcome in (0, 1):
            mine = rows[self.hit == bool(outcome)][::-1]
            first[outcome, self.number[mine]] = mine
        apart = self.design[first[1, varying]] - self.design[first[0, varying]]
        size = np.abs(apart).max(axis=1)
        if (size == 0).any():
            return True
        apart = apart / size[:, None]
        direction = np.zeros(apart.shape[1])
        for _ in range(15):
            weight = expit(-(apart @ direction))
            pull = apart.T @ weight
            if np.linalg.norm(pull) <= 1e-9 * weight.sum():
                return True
            information = (apart * (weight * (1 - weight))[:, None]).T @ apart
            step = np.linalg.lstsq(information, pull, rcond=1e-12)[0]
            direction = direction + step / max(1.0, float(np.abs(apart @ step).max()) / 4)
        return False

    def separating(self, design: Array) -> Array | None:
        """A direction with a threshold in every group that its rows keep a distance of one from; None without."""
        rows = np.flatnonzero(self.varying[self.number])
        if not len(rows):
            return np.zeros(design.shape[1])
        if not design.shape[1]:
            return None
        groups, number = np.unique(self.number[rows], return_inverse=True)
        side = np.where(self.hit[rows], 1.0, -1.0)
        threshold = coo_array((side, (np.arange(len(rows)), number)), (len(rows), len(groups)))
        found = linprog(
            np.zeros(design.shape[1] + len(groups)),
            A_ub=hstack([csr_array(-side[:, None] * design[rows]), threshold], format="csr"),
            b_ub=-np.ones(len(rows)),
            bounds=(None, None),
        )
        return None if found.x is None else np.asarray(found.x[: design.shape[1]])

    def ascend(self, design: Array, start: Array) -> tuple[float, Array]:
        """Maximum of the likelihood at infinity, and the direction."""
        constant = np.ptp(design, axis=0) <= 1e-9 * np.abs(design).max(axis=0, initial=1e-300)
        best, at = -np.inf, start
        for scale in np.logspace(-3, 3, 13):
            for shift in np.linspace(-2, 2, 9) if constant.any() else (0.0,):
                trial = scale * start
                if constant.any():
                    column = np.flatnonzero(constant)[0]
                    middle = np.median(design @ trial)
                    trial[column] += (shift - middle) / design[0, column]
                value = self.value(design, trial)
                if value > best:
                    best, at = value, trial
        if not np.isfinite(best):
            return best, at
        for softness in SOFTNESS:
            found = _climb(lambda d, s=softness: self.smooth(design, d, s), at)
            value = self.value(design, found)
            if value > best:
                best, at = value, found
        return best, at

    def value(self, design: Array, direction: Array) -> float:
        """The likelihood at infinity in a direction."""
        eta = -(design @ direction)
        lower, upper = np.full(len(self.multiplicity), -np.inf), np.full(len(self.multiplicity), np.inf)
        np.maximum.at(lower, self.number[self.hit], eta[self.hit])
        np.minimum.at(upper, self.number[~self.hit], eta[~self.hit])
        if (lower >= upper).any():
            return -np.inf
        return float(self.multiplicity @ _log_between(lower, upper))

    def smooth(self, design: Array, direction: Array, softness: float) -> tuple[float, Array]:
        """A lower bound with smooth thresholds, and its gradient; -inf where thresholds cross."""
        eta = -(design @ direction)
        n, size = len(self.multiplicity), len(direction)
        ends, slopes = [], []
        for mine, sign in ((self.hit, 1.0), (~self.hit, -1.0)):
            number, value = self.number[mine], sign * eta[mine] / softness
            top = np.full(n, -np.inf)
            np.maximum.at(top, number, value)
            weight = np.exp(value - top[number])
            total = np.bincount(number, weight, n)
            with np.errstate(divide="ignore"):
                ends.append(sign * softness * (top + np.log(total)))
            slope = np.zeros((n, size))
            np.add.at(slope, number, -(weight / total[number])[:, None] * design[mine])
            slopes.append(slope)
        lower, upper = np.where(np.isnan(ends[0]), -np.inf, ends[0]), np.where(np.isnan(ends[1]), np.inf, ends[1])
        if (lower >= upper).any():
            return -np.inf, np.zeros(size)
        logs = _log_between(lower, upper)
        densities = [
            np.exp(-0.5 * np.minimum(x * x, 1e300) - 0.5 * np.log(2 * np.pi) - logs) for x in (lower, upper)
        ]
        gradient = (self.multiplicity * densities[1]) @ slopes[1] - (self.multiplicity * densities[0]) @ slopes[0]
        return float(self.multiplicity @ logs), gradient


def _log_between(lower: Array, upper: Array) -> Array:
    """Logarithm of the standard normal probability of intervals, also far out."""
    flip = lower > 0
    low, high = np.where(flip, -upper, lower), np.where(flip, -lower, upper)
    whole, part = log_ndtr(high), log_ndtr(low)
    return np.asarray(whole + np.log1p(-np.exp(np.minimum(part - whole, -1e-16))))


def _climb(function, x: Array, steps: int = 200) -> Array:  # type: ignore[no-untyped-def]
    """BFGS with backtracking on a concave function that may be -inf."""
    x = np.array(x, float)
    value, gradient = function(x)
    if not np.isfinite(value):
        return x
    inverse = np.eye(len(x)) / max(float(np.linalg.norm(gradient)), 1e-300)
    for _ in range(steps):
        move = inverse @ gradient
        slope = float(gradient @ move)
        if slope <= 1e-12:
            break
        length = 1.0
        while length > 1e-12:
            new_value, new_gradient = function(x + length * move)
            if new_value >= value + 1e-4 * length * slope:
                break
            length *= 0.3
        else:
            break
        s, y = length * move, gradient - new_gradient
        x, value, gradient = x + s, new_value, new_gradient
        sy = float(s @ y)
        if sy > 1e-12 * float(np.linalg.norm(s) * np.linalg.norm(y)):
            by = inverse @ y
            inverse += np.outer(s, s) * ((sy + y @ by) / sy**2) - (np.outer(by, s) + np.outer(s, by)) / sy
    return x
