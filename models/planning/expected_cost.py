r"""The best that can be had when spending is limited in expectation: the value-cost frontier of a schedule.

A constrained POMDP (Altman 1999; Poupart et al. 2015) asks for

.. math:: \max_\pi V(\pi) \quad \text{such that} \quad C(\pi) = E \sum_k c_{a_k} \le L

over policies that may randomise. All pairs :math:`(C(\pi), V(\pi))` form a convex polygon whose upper left
boundary, the frontier, is concave; its corners are deterministic plans, each the best one for some *price*
:math:`\lambda` per unit of cost (the Lagrange multiplier): it maximises :math:`V - \lambda C`. Between two corners
the optimum draws one of two plans before the first event. Corners are found by asking for the best plan at the
price at which two neighbours are worth the same (dichotomic search), until that is no better than they are: all of
them, not a grid of prices.

A limit in expectation says nothing of a single run: that is `models.planning.budget_plan`. It is also a promise
made before the first event. Replanning on the way, with what is then left of the limit, would not keep it: nothing
tells how much the runs that turned out otherwise have spent.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from models.errors import located
from models.notebook_view import NotebookView
from models.planning.budget_tree import BudgetTree
from models.planning.charges import charges_of, checked_charges, in_units
from models.planning.exact import Decisions
from models.planning.schedule import Array, Schedule

if TYPE_CHECKING:
    from models.planning.mixed_policy import MixedPolicy

TIE = 1e-12
"""Plans whose worth differs by no more than that share of its size are equally good: the cheaper one is taken."""

CORNER = 1e-10
"""A plan is another corner only if it is above the line through its neighbours by more than that share."""


@dataclass(frozen=True)
class CostPoint:
    """A corner of the frontier: a plan that is best for some prices.

    Attributes
    ----------
    cost : float
        Expected sum of the charges, not discounted.
    value : float
        Expected reward, discounted as the schedule says; the charges are not taken off once more.
    lowest_price, highest_price : float
        Prices per unit of cost between which the plan is best.
    decisions : tuple of int8[r]
        The plan, as in `models.planning.exact.ExactPlan`.
    """

    cost: float
    value: float
    lowest_price: float
    highest_price: float
    decisions: Decisions = field(repr=False)


@dataclass(frozen=True)
class CostFrontier(NotebookView):
    """All corners of the value-cost frontier of a schedule, by rising cost.

    The first is the best plan that spends nothing, the last the cheapest of the best plans without a limit.

    Attributes
    ----------
    schedule : Schedule
    charges : float64[a]
    points : tuple of CostPoint
    """

    schedule: Schedule
    charges: Array
    points: tuple[CostPoint, ...]

    def value_at(self, limit: float) -> float:
        """Best value with an expected cost of at most `limit`.

        Raises
        ------
        InputError
            On a limit that is negative or no number.
        """
        low, high, share = self._between(limit)
        return (1 - share) * self.points[low].value + share * self.points[high].value

    def price_at(self, limit: float) -> float:
        """What one more unit of cost would be worth at `limit`; 0 where the limit does not bind."""
        low, high, share = self._between(limit)
        return self.points[high].highest_price if share > 0 and low != high else self.points[low].lowest_price

    def mixture(self, limit: float, name: str = "cost-limited") -> MixedPolicy:
        """The best policy with an expected cost of at most `limit`, met exactly where it binds.

        One of at most two plans is drawn before the first event. After an action that was overruled it goes on with
        what its plans say to the responses.

        Raises
        ------
        InputError
            On a limit that is negative or no number.
        """
        from models.planning.mixed_policy import MixedPolicy

        low, high, share = self._between(limit)
        plans = [(low, 1 - share), (high, share)] if 0 < share < 1 else [(high if share else low, 1.0)]
        return MixedPolicy.of(
            self.schedule, [self.points[i].decisions for i, _ in plans], [p for _, p in plans], name
        )  # fmt: skip

    def _between(self, limit: float) -> tuple[int, int, float]:
        """Corners around a limit, and the share of the dearer one."""
        return between([p.cost for p in self.points], limit)

    def rows(self) -> list[dict[str, Any]]:
        """One row a corner: cost, value, and between which prices its plan is best."""
        return [
            {"cost": p.cost, "value": p.value, "lowest_price": p.lowest_price, "highest_price": p.highest_price}
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
        if len(self.points) == 1:
            return (
                f"Over {self.schedule.letters} nothing worth its while costs anything: the best plan is worth "
                f"{free.value:.4g} {self.schedule.unit} and spends nothing."
            )
        first = self.points[1]
        return (
            f"Over {self.schedule.letters} spending {full.cost:.4g} in expectation raises the value from "
            f"{free.value:.4g} to {full.value:.4g} {self.schedule.unit}; the first unit brings "
            f"{first.highest_price:.3g}, the last {full.highest_price:.3g} ({len(self.points)} corners)."
        )


def between(costs: list[float], limit: float) -> tuple[int, int, float]:
    """Corners around a limit by their costs, and the share of the dearer one.

    Raises
    ------
    InputError
        On a limit that is negative or no number.
    """
    if isinstance(limit, bool | str) or not limit >= 0:
        raise located("limit of the expected cost", limit, "a number from 0 on")
    high = int(np.searchsorted(costs, limit, side="left"))
    if high == len(costs):
        return high - 1, high - 1, 1.0
    if high == 0 or costs[high] == limit:
        return high, high, 1.0
    return high - 1, high, float((limit - costs[high - 1]) / (costs[high] - costs[high - 1]))


def cost_frontier(schedule: Schedule, charges: ArrayLike | None = None) -> CostFrontier:
    """Find all corners of the value-cost frontier of a schedule.

    Parameters
    ----------
    schedule : Schedule
        Under one model, or many draws: expectations are over them too.
    charges : float64[a], optional
        What each action is charged (`models.planning.charges.charges_of`): its cost by default.

    Raises
    ------
    InputError
        On charges that are none, or too many histories to visit.

    Examples
    --------
    >>> from models.lspomdp import LatentStatePOMDP
    >>> drifts = [[.7, .3], [.3, .7]]
    >>> moved = [[.1, .9], [0, 1]]
    >>> model = LatentStatePOMDP([.5, .5], [drifts, moved, drifts, drifts], [[[.9, .1], [.2, .8]]] * 2)
    >>> frontier = cost_frontier(Schedule.of(model, "RHR"))
    >>> [(round(p.cost, 2), round(p.value, 2)) for p in frontier.points]
    [(0.0, 61.23), (15.0, 71.95)]
    """
    own = charges_of(schedule) if charges is None else checked_charges(schedule.protocol, charges)
    in_units(own)
    search = _Search(schedule, own)
    free, full = search.best(np.inf), search.best(0.0)
    found = [free]
    if full.value - free.value > CORNER * search.size and full.cost > free.cost:
        found += [*_corners(search, free, full), full]
    return CostFrontier(schedule, own, tuple(_priced(found)))


def _corners(search: _Search, low: CostPoint, high: CostPoint) -> list[CostPoint]:
    """Corners between two plans on the frontier."""
    price = (high.value - low.value) / (high.cost - low.cost)
    new = search.best(price)
    above = (new.value - low.value) - price * (new.cost - low.cost)
    if above <= CORNER * search.size or not low.cost < new.cost < high.cost:
        return []
    return [*_corners(search, low, new), new, *_corners(search, new, high)]


def _priced(points: list[CostPoint]) -> list[CostPoint]:
    """Corners with the prices between which they are best; points on a line between others left out."""
    kept: list[CostPoint] = []
    for p in points:
        while len(kept) > 1 and _slope(kept[-1], p) >= _slope(kept[-2], kept[-1]) * (1 - CORNER):
            kept.pop()
        kept.append(p)
    prices = [np.inf, *(_slope(a, b) for a, b in pairwise(kept)), 0.0]
    return [
        CostPoint(p.cost, p.value, float(prices[i + 1]), float(prices[i]), p.decisions) for i, p in enumerate(kept)
    ]


def _slope(a: CostPoint, b: CostPoint) -> float:
    return (b.value - a.value) / (b.cost - a.cost)


class _Search:
    """Best plans of a schedule at any price, from one walk over its histories."""

    def __init__(self, schedule: Schedule, charges: Array) -> None:
        self.schedule = schedule
        self.tree = BudgetTree.of(schedule, in_units(np.zeros(len(charges))))
        first = [schedule.first_action(k) for k in range(schedule.n_events)]
        self.charges = [charges[a : a + len(schedule.mode(k).actions)] for k, a in enumerate(first)]
        self.size = max(float(sum(np.abs(r).max(axis=1).sum() for r in self.tree.sums[0])), 1e-300)

    def best(self, price: float) -> CostPoint:
        """The best plan at a price; infinite: the best one that spends nothing. The cheapest of equals."""
        rewards, mass = self.tree.sums
        choices: list[Any] = []
        value = cost = None
        for k in range(self.schedule.n_events - 1, -1, -1):
            own, spent = rewards[k].copy(), mass[k][:, None] * self.charges[k]
            if value is not None and cost is not None:
                own += value[self.tree.child[k]].sum(axis=2)
                spent += cost[self.tree.child[k]].sum(axis=2)
            worth = np.where(self.charges[k] > 0, -np.inf, own) if np.isinf(price) else own - price * spent
            close = worth >= worth.max(axis=1, keepdims=True) - TIE * (np.abs(own) + np.abs(own - worth)).max(
                axis=1, keepdims=True, where=np.isfinite(worth), initial=0.0
            )
            choice = np.where(close, spent, np.inf).argmin(axis=1)
            choices.append(choice)
            rows = np.arange(len(choice))
            value, cost = own[rows, choice], spent[rows, choice]
        assert value is not None
        assert cost is not None
        choices.reverse()
        return CostPoint(float(cost[0]), float(value[0]), np.nan, np.nan, self._decisions(choices))

    def _decisions(self, choices: list[Any]) -> Decisions:
        history, out = np.zeros(1, dtype=np.int64), []
        for k, choice in enumerate(choices):
            out.append(choice[history].astype(np.int8))
            if k + 1 < len(choices):
                history = self.tree.child[k][history, choice[history]].ravel()
        return tuple(out)
