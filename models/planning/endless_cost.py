r"""Spending limited in expectation without a horizon: the frontier of value and discounted cost, from both sides.

As `models.planning.expected_cost`, with :math:`C(\pi) = E \sum_k \gamma^k c_{a_k}`. The best policy at a price is
found with a gap only, so there are two frontiers:

- *lower*: policies found, compiled to finite-state controllers and evaluated exactly, and mixtures of them;
- *upper*: by weak duality, with the upper bound :math:`\bar V_\lambda` of the solver at a price :math:`\lambda`,
  :math:`\max_{C(\pi) \le L} V(\pi) \le \min_\lambda \bar V_\lambda + \lambda L`.

Prices are searched as there, until no mixture is off by more than the precision asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from models.errors import located
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView
from models.planning.charges import charges_of, checked_charges, in_units
from models.planning.controller import FiniteStateController, controller_of
from models.planning.expected_cost import between
from models.planning.finite_memory import infinite_value
from models.planning.latent import DISCOUNT, latent_problem
from models.planning.mixture import Mixture
from models.planning.mode_process import ModeProcess
from models.planning.policies import Policy, Vocabulary
from models.planning.problem import Problem
from models.planning.schedule import Array
from models.planning.solver import solve

MOST_PRICES = 100
"""Prices at which the problem is solved, at most."""


@dataclass(frozen=True)
class EndlessPoint:
    """A corner of the lower frontier: expected discounted cost, value, the controller that has them, exactly."""

    cost: float
    value: float
    policy: FiniteStateController


@dataclass(frozen=True)
class PricedBound:
    r"""Upper bound of :math:`V - \lambda C`; at an infinite price, of policies that spend nothing."""

    price: float
    upper: float


@dataclass(frozen=True)
class EndlessCostFrontier(NotebookView):
    """Value against expected discounted cost without a horizon, from below and from above.

    Attributes
    ----------
    problem : Problem
    charges : float64[a]
    points : tuple of EndlessPoint
        Corners of the lower frontier, by rising cost; the first spends nothing.
    bounds : tuple of PricedBound
        By falling price.
    precision : float
        Largest distance between both frontiers that was asked for, as a share of the largest value.
    status : str
        ``converged``, or why the distance may be larger: ``solver gap``, ``prices`` (too many were needed).
    """

    problem: Problem
    charges: Array
    points: tuple[EndlessPoint, ...]
    bounds: tuple[PricedBound, ...]
    precision: float
    status: str

    def value_at(self, limit: float) -> float:
        """Value of the best mixture found with an expected discounted cost of at most `limit`.

        Raises
        ------
        InputError
            On a limit that is negative or no number.
        """
        low, high, share = between([p.cost for p in self.points], limit)
        return (1 - share) * self.points[low].value + share * self.points[high].value

    def upper_at(self, limit: float) -> float:
        """No policy with an expected discounted cost of at most `limit` is worth more.

        Raises
        ------
        InputError
            On a limit that is negative or no number.
        """
        between([0.0], limit)
        if limit == 0:
            return min(b.upper for b in self.bounds)
        return self._lines_at(limit)

    def _lines_at(self, limit: float) -> float:
        """The same by finite prices alone, which is what the upper frontier comes to next to a limit of zero."""
        return min(b.upper + b.price * limit for b in self.bounds if np.isfinite(b.price))

    def gap_between(self, low: float, high: float) -> float:
        """Largest distance between both frontiers over limits from `low` to `high`."""
        lines = [b for b in self.bounds if np.isfinite(b.price)]
        crossings = [
            (b.upper - a.upper) / (a.price - b.price)
            for i, a in enumerate(lines)
            for b in lines[i + 1 :]
            if a.price != b.price
        ]
        limits = [low, high, *(p.cost for p in self.points), *crossings]
        return max(self._lines_at(c) - self.value_at(c) for c in limits if low <= c <= high)

    @property
    def gap(self) -> float:
        """Largest distance between both frontiers."""
        return self.gap_between(0.0, self.points[-1].cost)

    def policy(self, limit: float, name: str = "cost-limited") -> Policy:
        """A mixture of two controllers with an expected discounted cost of at most `limit`, worth `value_at`.

        Raises
        ------
        InputError
            On a limit that is negative or no number.
        """
        low, high, share = between([p.cost for p in self.points], limit)
        pair = [(self.points[low].policy, 1 - share), (self.points[high].policy, share)]
        kept = pair if 0 < share < 1 else [(self.points[high if share else low].policy, 1.0)]
        return Mixture([p for p, _ in kept], [s for _, s in kept], name)

    def rows(self) -> list[dict[str, Any]]:
        """One row a corner: cost, value, upper bound at that cost, nodes of its controller."""
        return [
            {"cost": p.cost, "value": p.value, "upper": self.upper_at(p.cost), "nodes": p.policy.n_nodes}
            for p in self.points
        ]

    @property
    def table(self) -> Any:
        """`rows` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.rows())

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        free, full = self.points[0], self.points[-1]
        return (
            f"Without horizon (discount {self.problem.discount:g}) an expected discounted cost of {full.cost:.4g} "
            f"raises the value from {free.value:.4g} to {full.value:.4g} {self.problem.unit}; no policy of equal "
            f"cost is worth {self.gap:.3g} more than the mixtures found ({len(self.points)} corners)."
        )


def endless_cost_frontier(
    model: LatentStatePOMDP, process: ModeProcess | None = None, discount: float = DISCOUNT,
    charges: ArrayLike | None = None, *, precision: float = 1e-3, time_limit: float = 60.0,
) -> EndlessCostFrontier:  # fmt: skip
    """Find the frontier of value and expected discounted cost.

    Parameters
    ----------
    model : LatentStatePOMDP
    process : ModeProcess, optional
        Alternating modes from the protocol's first by default.
    discount : float
        Below 1.
    charges : float64[a], optional
        What each action is charged (`models.planning.charges.charges_of`): its cost by default.
    precision : float
        Distance between both frontiers to be content with, as a share of the largest value found.
    time_limit : float
        Seconds for each price.

    Raises
    ------
    InputError
        On a discount of 1, or charges that are none.
    """
    own = charges_of(model) if charges is None else checked_charges(model.protocol, charges)
    in_units(own)
    if not precision > 0:
        raise located("precision", precision, "a number above 0")
    search = _Search(latent_problem(model, process, discount), own, precision, time_limit)
    free, full = search.at(np.inf), search.at(0.0)
    points = {p.cost: p for p in (full, free)}
    status = "converged"
    asked = {np.inf, 0.0}
    while True:
        corners = _hull(list(points.values()))
        frontier = EndlessCostFrontier(
            search.problem, own, corners, tuple(sorted(search.bounds, key=lambda b: -b.price)), precision, status
        )  # fmt: skip
        wanted = precision * max(abs(p.value) for p in corners)
        open_edges = [
            (gap, price) for a, b in pairwise(corners) for gap, price in [_edge(frontier, a, b)] if gap > wanted
        ]
        fresh = [(gap, price) for gap, price in open_edges if price not in asked]
        if not fresh or len(asked) > MOST_PRICES:
            if open_edges:
                frontier = replace(frontier, status="prices" if fresh else "solver gap")
            return frontier
        price = max(fresh)[1]
        asked.add(price)
        new = search.at(price)
        points.setdefault(new.cost, new)
        if new.value > points[new.cost].value:
            points[new.cost] = new


def _edge(frontier: EndlessCostFrontier, a: EndlessPoint, b: EndlessPoint) -> tuple[float, float]:
    """Largest distance of the upper frontier from the line between two corners, and the line's price."""
    return frontier.gap_between(a.cost, b.cost), (b.value - a.value) / (b.cost - a.cost)


def _hull(points: list[EndlessPoint]) -> tuple[EndlessPoint, ...]:
    """Corners of the upper left boundary, by rising cost and value."""
    kept: list[EndlessPoint] = []
    for p in sorted(points, key=lambda p: (p.cost, -p.value)):
        if kept and p.value <= kept[-1].value:
            continue
        while len(kept) > 1 and _slope(kept[-1], p) >= _slope(kept[-2], kept[-1]):
            kept.pop()
        kept.append(p)
    return tuple(kept)


def _slope(a: EndlessPoint, b: EndlessPoint) -> float:
    return (b.value - a.value) / (b.cost - a.cost)


class _Search:
    """Solves the problem at prices and keeps the upper bounds."""

    def __init__(self, problem: Problem, charges: Array, precision: float, time_limit: float) -> None:
        self.problem, self.time_limit = problem, time_limit
        self.precision = precision / 4
        names = [c.action for offered in problem.choices for c in offered]
        self.charge = dict(zip(names, charges.tolist(), strict=True))
        self.bounds: list[PricedBound] = []

    def at(self, price: float) -> EndlessPoint:
        """The policy found at a price; infinite: among those that spend nothing."""
        solution = solve(self._priced(price), self.precision, time_limit=self.time_limit)
        self.bounds.append(PricedBound(float(price), solution.upper))
        policy = controller_of(solution.policy, name=f"price {price:.4g}").merged()
        if np.isinf(price):
            policy = self._renumbered(policy)
        found = infinite_value(policy, self.problem)
        spent = sum(share * self.charge[a] for a, share in found.frequencies.items())
        return EndlessPoint(float(spent / (1 - self.problem.discount)), found.value, policy)

    def _priced(self, price: float) -> Problem:
        choices = []
        for offered in self.problem.choices:
            own = offered
            if np.isinf(price):
                own = tuple(c for c in offered if self.charge[c.action] == 0)
            elif price > 0:
                own = tuple(replace(c, reward=c.reward - price * self.charge[c.action]) for c in offered)
            choices.append(own)
        return replace(self.problem, choices=tuple(choices), name=f"interaction at price {price:.4g}")

    def _renumbered(self, policy: FiniteStateController) -> FiniteStateController:
        """A controller of the free actions as one of all actions."""
        words = self.problem
        number = [[i for i, c in enumerate(own) if self.charge[c.action] == 0] for own in words.choices]
        choice = np.array([number[m][c] for m, c in zip(policy.mode, policy.choice, strict=True)])
        return FiniteStateController(
            Vocabulary.of(words), policy.mode, choice, policy.follow, policy.start, policy.impossible, policy.name
        )  # fmt: skip
