r"""What work will cost: time and memory as functions of its sizes, fitted to measured curves, with intervals.

.. math:: y = a + \sum_t b_t \prod_d x_d^{p_{td}}, \qquad \log y_i = \log \hat y_i + \varepsilon_i

with non-negative `a` and `b` and exponents inside bounds, fitted by least squares of logarithms: every point counts
by its relative error. The drivers `x` are counts of what the kernels walk over (events of distinct histories, not
people), so that one model covers people who are all alike and people who are all different.

An interval holds the scatter around the curve, the doubt about its coefficients, and beyond what was measured an
allowance for exponents that change there (`DRIFT`): memory that no longer fits a cache, or a machine that swaps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from models.errors import Phrase, located

Array = NDArray[np.float64]
Bounds = tuple[float, float]

LEVEL = 0.95

DRIFT = 0.1
"""Standard deviation of an exponent's change beyond the measured range: caches alone move it by as much inside."""

LEAST_SCATTER = 0.03
"""Relative scatter of any measurement, however well the curve goes through its points."""

BEYOND = 1.1
"""A size may be so many times the largest measured before the prediction is called extrapolated."""


@dataclass(frozen=True)
class Term:
    """One summand: drivers and the bounds of their exponents (equal bounds: fixed)."""

    exponents: Mapping[str, Bounds]


ONE: Bounds = (1.0, 1.0)
SWEEP = (Term({"nodes": (0.9, 1.3), "states": (0.3, 2.0)}),)
HELD = (Term({"people": ONE}), Term({"nodes": ONE}), Term({"nodes": ONE, "states": ONE}))

FORMS: dict[str, dict[str, tuple[Term, ...]]] = {
    "compress": {
        "seconds": (Term({"events": ONE}), Term({"nodes": (1.0, 1.3), "people": (0.0, 0.6)})),
        "memory": (Term({"people": ONE}), Term({"events": ONE}), Term({"nodes": ONE})),
    },
    "forward": {"seconds": SWEEP, "memory": HELD},
    "em": {"seconds": SWEEP, "memory": HELD},
    "gradient": {"seconds": SWEEP, "memory": HELD},
    "plan": {
        "seconds": (
            Term({"draws": ONE, "states": (0.0, 2.0)}),
            Term({"branches": ONE, "draws": ONE}),
        ),
        "memory": (Term({"draws": ONE, "states": ONE}), Term({"branches": ONE})),
    },
    "game": {"seconds": (Term({"game_rounds": ONE}),), "memory": (Term({"game_rounds": ONE}),)},
}  # fmt: skip
"""Operations, what of them is predicted, and the form of the curve."""

WORDS = {
    "compress": "compressing coded events", "forward": "one forward pass", "em": "one EM iteration",
    "gradient": "one gradient of the Bayesian density", "plan": "the exact plan over draws",
    "game": "rounds of the token game, one thread",
}  # fmt: skip


@dataclass(frozen=True)
class Prediction:
    """A predicted cost with its interval.

    Attributes
    ----------
    value, low, high : float
        Seconds or bytes; the interval is central with probability `LEVEL`.
    beyond : tuple of str
        Drivers outside what was measured.
    """

    value: float
    low: float
    high: float
    beyond: tuple[str, ...]

    @property
    def words(self) -> str:
        """How far to trust it."""
        return (
            f"extrapolated beyond what was measured ({', '.join(self.beyond)})" if self.beyond else "interpolated"
        )


@dataclass(frozen=True)
class CostModel:
    """A fitted curve.

    Attributes
    ----------
    terms : tuple of Term
    constant : float
        `a`.
    coefficients : float64[t]
        `b`, per unit of the drivers to their exponents.
    exponents : tuple of dict
        `p`, a mapping a term.
    covariance : float64[q, q]
        Of the parameters that were fitted: logarithms of `a` and `b`, then the free exponents.
    scatter : float
        Standard deviation of the residuals, which are logarithms.
    freedom : int
        Points less parameters.
    ranges : dict
        Smallest and largest measured value by driver.
    residuals : float64[n]
        Logarithms of measured over fitted.
    """

    terms: tuple[Term, ...]
    constant: float
    coefficients: Array
    exponents: tuple[dict[str, float], ...]
    covariance: Array
    scatter: float
    freedom: int
    ranges: dict[str, Bounds]
    residuals: Array

    def values(self, sizes: Mapping[str, float]) -> Array:
        """The constant and every term at one place."""
        parts = [
            b * math.prod(sizes[d] ** p for d, p in powers.items())
            for b, powers in zip(self.coefficients, self.exponents, strict=True)
        ]
        return np.array([self.constant, *parts])

    def predict(self, sizes: Mapping[str, float]) -> Prediction:
        """Cost at given sizes.

        Parameters
        ----------
        sizes : mapping of str to float
            A value above zero for every driver.

        Raises
        ------
        InputError
            If a driver is missing or not above zero.
        """
        for driver in self.ranges:
            if not sizes.get(driver, 0) > 0:
                raise located(f"cost, {driver}", sizes.get(driver), "a number above zero")
        parts = self.values(sizes)
        total = float(parts.sum())
        share = parts / total
        slope = list(share)
        for t, powers in enumerate(self.exponents):
            for d, _ in _free(self.terms[t]):
                slope.append(share[1 + t] * (math.log(sizes[d]) - _centre(self.ranges[d])))
                assert d in powers
        gradient = np.array(slope)
        variance = max(float(gradient @ self.covariance @ gradient), 0.0) + self.scatter**2
        beyond = []
        for driver, (low, high) in self.ranges.items():
            ratio = max(sizes[driver] / high, low / sizes[driver], 1.0)
            # Only as far as the total depends on it: what is a small part may change as it likes.
            weight = sum(s * powers.get(driver, 0.0) for s, powers in zip(share[1:], self.exponents, strict=True))
            variance += (DRIFT * min(weight, 1.0) * math.log(ratio)) ** 2
            if ratio > BEYOND:
                beyond.append(driver)
        half = float(student.ppf(0.5 + LEVEL / 2, max(self.freedom, 1))) * math.sqrt(variance)
        return Prediction(total, total * math.exp(-half), total * math.exp(half), tuple(beyond))

    @property
    def formula(self) -> str:
        """The curve in words, terms that came out as nothing left out."""
        parts = [f"{self.constant:.3g}"] if self.constant > 0 else []
        for b, powers in zip(self.coefficients, self.exponents, strict=True):
            if b > 0:
                parts.append(" ".join([f"{b:.3g}", *(f"{d}^{p:.3g}" for d, p in powers.items())]))
        return " + ".join(parts).replace("^1 ", " ").removesuffix("^1")


def _free(term: Term) -> list[tuple[str, Bounds]]:
    return [(d, bounds) for d, bounds in term.exponents.items() if bounds[0] < bounds[1]]


def _centre(span: Bounds) -> float:
    return 0.5 * (math.log(span[0]) + math.log(span[1]))


def fit_cost(
    terms: Sequence[Term], points: Sequence[Mapping[str, Any]], quantity: str, least: float = LEAST_SCATTER
) -> CostModel:
    """Fit a curve to measured points.

    Parameters
    ----------
    terms : sequence of Term
    points : sequence of mapping
        Each with its drivers and `quantity`.
    quantity : str
    least : float
        Scatter that is assumed at the least.

    Raises
    ------
    InputError
        With fewer points than parameters, or values that are not above zero.
    """
    drivers = sorted({d for term in terms for d in term.exponents})
    y = np.array([float(p[quantity]) for p in points])
    x = {d: np.array([float(p[d]) for p in points]) for d in drivers}
    free = [(t, d, bounds) for t, term in enumerate(terms) for d, bounds in _free(term)]
    n_parameters = 1 + len(terms) + len(free)
    if len(y) <= n_parameters:
        raise located(f"cost of {quantity}, points", len(y), f"more than the {n_parameters} parameters")
    for name, values in {quantity: y, **x}.items():
        if not (np.isfinite(values).all() and (values > 0).all()):
            raise located(f"cost, {name}", Phrase("a value that is not above zero"), "numbers above zero")
    ranges = {d: (float(v.min()), float(v.max())) for d, v in x.items()}
    log_y = np.log(y)
    log_x = {d: np.log(v) - _centre(ranges[d]) for d, v in x.items()}

    def exponent(theta: Array, t: int, d: str) -> float:
        low, high = terms[t].exponents[d]
        if low == high:
            return low
        return float(theta[1 + len(terms) + next(i for i, f in enumerate(free) if f[:2] == (t, d))])

    def parts(theta: Array) -> Array:
        rows = [np.full(len(y), theta[0])]
        for t, term in enumerate(terms):
            rows.append(theta[1 + t] + sum(exponent(theta, t, d) * log_x[d] for d in term.exponents))
        return np.array(rows)

    def residual(theta: Array) -> Array:
        return np.asarray(np.logaddexp.reduce(parts(theta), axis=0) - log_y)

    def jacobian(theta: Array) -> Array:
        rows = parts(theta)
        share = np.exp(rows - np.logaddexp.reduce(rows, axis=0))
        return np.stack([*share, *(share[1 + t] * log_x[d] for t, d, _ in free)], axis=1)

    floor = float(log_y.min()) - 25.0
    lower = np.array([floor] * (1 + len(terms)) + [b[0] for *_, b in free])
    upper = np.array([float(log_y.max()) + 25.0] * (1 + len(terms)) + [b[1] for *_, b in free])
    best = None
    middle = float(np.median(log_y))
    for high, place in product(range(len(terms)), (0.1, 0.5, 0.9)):
        start = [float(log_y.min()) - 1.0, *(middle if t == high else middle - 3.0 for t in range(len(terms)))]
        start += [b[0] + place * (b[1] - b[0]) for *_, b in free]
        found = least_squares(
            residual, np.clip(start, lower + 1e-6, upper - 1e-6), jacobian, bounds=(lower, upper), x_scale=1.0,
            ftol=1e-15, xtol=1e-15, gtol=1e-15, max_nfev=2_000,
        )  # fmt: skip
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    theta = np.asarray(best.x)
    freedom = len(y) - n_parameters
    scatter = max(math.sqrt(2 * best.cost / freedom), least)
    slope = jacobian(theta)
    # An exponent is known to lie inside its bounds, whatever the points say; coefficients get next to no prior.
    prior = np.array([1 / 25.0] * (1 + len(terms)) + [16.0 / (b[1] - b[0]) ** 2 for *_, b in free])
    covariance = np.linalg.inv(slope.T @ slope / scatter**2 + np.diag(prior))
    exponents = tuple({d: exponent(theta, t, d) for d in term.exponents} for t, term in enumerate(terms))
    gone = theta[: 1 + len(terms)] <= floor + 1.0
    shift = [sum(p * _centre(ranges[d]) for d, p in powers.items()) for powers in exponents]
    coefficients = np.where(gone[1:], 0.0, np.exp(theta[1 : 1 + len(terms)] - shift))
    return CostModel(
        tuple(terms), 0.0 if gone[0] else float(np.exp(theta[0])), coefficients, exponents, covariance, scatter,
        freedom, ranges, -residual(theta),
    )  # fmt: skip


def fit_all(points: Sequence[Mapping[str, Any]], least: float = LEAST_SCATTER) -> dict[str, dict[str, CostModel]]:
    """Curves of time and memory for every operation that was measured."""
    out: dict[str, dict[str, CostModel]] = {}
    for operation, forms in FORMS.items():
        own = [p for p in points if p["operation"] == operation]
        if own:
            out[operation] = {quantity: fit_cost(terms, own, quantity, least) for quantity, terms in forms.items()}
    return out
