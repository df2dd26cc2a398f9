r"""The best plan that never spends more than a budget, on any path: exact, over a known schedule.

A *hard* budget holds for every run, not only in expectation as the constraint of a constrained (PO)MDP does (Altman
1999; Poupart et al. 2015; `models.planning.expected_cost`). What is left of it is known to everybody, so it joins
the observed mode, and the plan for the product is an ordinary one. Its values at different budgets need not be
concave: plans of two budgets cannot be mixed into one of a budget between them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from models.notebook_view import NotebookView
from models.planning.budget_tree import BudgetTree
from models.planning.charges import charges_of, check_budget, checked_charges, in_units
from models.planning.exact import Decisions, responses_before
from models.planning.schedule import Array, Schedule

if TYPE_CHECKING:
    from models.planning.product_policy import ProductPolicy


@dataclass(frozen=True)
class BudgetPlan(NotebookView):
    """The best plan of a schedule within a budget.

    Attributes
    ----------
    schedule : Schedule
    budget : float
        What may be spent at most, in the unit of the charges.
    charges : float64[a]
        What each action is charged.
    value : float
        What the plan is worth, in the unit of the reward, seen from the first event.
    first_values : float64[c]
        The same for each action at the first event, the best plan after it; nan where it cannot be paid for.
    decisions : tuple of int8[r]
        Action of each event by the responses so far, as in `models.planning.exact.ExactPlan`.
    most_spent : float
        Largest sum of charges over all paths that can come about.
    spent : tuple of float64[r]
        Spent before each event, by the responses so far.
    """

    schedule: Schedule
    budget: float
    charges: Array
    value: float
    first_values: Array
    decisions: Decisions
    most_spent: float
    spent: tuple[Array, ...] = field(repr=False)

    @property
    def first_action(self) -> str:
        """What to do at the first event."""
        return self.schedule.mode(0).actions[int(self.decisions[0][0])].name

    def rows(self) -> list[dict[str, Any]]:
        """The plan: event (from 1), mode, responses so far, spent, action; one row a history that can be met."""
        out = []
        for k, (level, spent) in enumerate(zip(self.decisions, self.spent, strict=True)):
            mode = self.schedule.mode(k)
            for r, (a, gone) in enumerate(zip(level.tolist(), spent.tolist(), strict=True)):
                row = {"event": k + 1, "mode": mode.name, "responses": responses_before(self.schedule, k, r)}
                out.append({**row, "spent": gone, "action": mode.actions[a].name})
        return out

    @property
    def table(self) -> Any:
        """`rows` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.rows())

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        s = self.schedule
        return (
            f"The best plan for {s.letters} that never spends more than {self.budget:g} is worth {self.value:.4g} "
            f"{s.unit} (discount {s.discount:g}), starts with {self.first_action} and spends at most "
            f"{self.most_spent:g}."
        )

    def policy(self, name: str = "budget plan", *, impossible: str = "error") -> ProductPolicy:
        """The plan as a policy that keeps the budget after any history.

        It goes by its belief and by what was really done: where an action was overruled or a response not recorded,
        it does what is best with what is left. An action done in its stead may exceed the budget; nothing is spent
        after that.
        """
        from models.planning.schedule_vectors import schedule_vectors

        return schedule_vectors(self.schedule, self.budget, self.charges, name=name, impossible=impossible)


def solve_with_budget(schedule: Schedule, budget: float, charges: ArrayLike | None = None) -> BudgetPlan:
    """Find the best plan of a schedule that never spends more than a budget.

    Parameters
    ----------
    schedule : Schedule
        Under one model or many draws.
    budget : float
        Non-negative, in the unit of the charges; ``inf`` is no limit.
    charges : float64[a], optional
        What each action is charged (`models.planning.charges.charges_of`): its cost by default.

    Raises
    ------
    InputError
        On a budget or charges that are none, or too many histories to visit.

    Examples
    --------
    >>> from models.lspomdp import LatentStatePOMDP
    >>> stays = LatentStatePOMDP([.5, .5], [[[1, 0], [0, 1]]] * 4, [[[.9, .1], [.2, .8]]] * 2)
    >>> solve_with_budget(Schedule.of(stays, "HRH"), 15).most_spent
    0.0
    """
    own = _charges(schedule, charges)
    tree = BudgetTree.of(schedule, in_units(own, budget))
    return _plan(tree, own, float(budget), len(tree.levels.left[0]) - 1)


@dataclass(frozen=True)
class BudgetValues(NotebookView):
    """What the best plan is worth at every budget that may make a difference.

    Attributes
    ----------
    schedule : Schedule
    charges : float64[a]
    budgets : float64[l]
        All sums that the events can be charged, increasing from 0: between two of them nothing changes.
    values : float64[l]
        What the best plan within each is worth, in the unit of the reward.
    """

    schedule: Schedule
    charges: Array
    budgets: Array
    values: Array
    tree: BudgetTree = field(repr=False)

    def value_at(self, budget: float) -> float:
        """Value at any budget.

        Raises
        ------
        InputError
            On a budget that is none.
        """
        check_budget(budget)
        return float(self.values[np.searchsorted(self.budgets, budget, side="right") - 1])

    def plan(self, budget: float) -> BudgetPlan:
        """The best plan within a budget.

        Raises
        ------
        InputError
            On a budget that is none.
        """
        return _plan(self.tree, self.charges, float(budget), self.tree.level(self.tree.units.within(budget)))

    def rows(self) -> list[dict[str, Any]]:
        """One row a budget.

        Value, gain over spending nothing, gain per unit since the budget before, the most that the plan spends on
        any path, and its first action.
        """
        plans = [self.plan(b) for b in self.budgets.tolist()]
        rates = [float("nan"), *self._rates().tolist()]
        return [
            {"budget": p.budget, "value": p.value, "gain": p.value - plans[0].value, "gain_per_unit": rate,
             "most_spent": p.most_spent, "first_action": p.first_action}
            for p, rate in zip(plans, rates, strict=True)
        ]  # fmt: skip

    @property
    def table(self) -> Any:
        """`rows` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.rows())

    def _rates(self) -> Array:
        return np.diff(self.values) / np.diff(self.budgets)

    @property
    def concave(self) -> bool:
        """Whether no step to the next budget brings more per unit than an earlier one; this need not be so."""
        rates = self._rates()
        return bool(np.all(np.diff(rates) <= 1e-9 * np.maximum(1.0, np.abs(rates[:-1]))))

    @property
    def enough(self) -> float:
        """The smallest budget with which the best plan is worth as much as without any limit."""
        slack = 1e-12 * max(1.0, float(np.abs(self.values).max()))
        return float(self.budgets[np.argmax(self.values >= self.values[-1] - slack)])

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        free, gain = self.values[0], self.values[-1] - self.values[0]
        shape = "no step brings more per unit than the one before" if self.concave else (
            "some steps bring more per unit than earlier ones"
        )  # fmt: skip
        return (
            f"Over {self.schedule.letters} the best plan is worth {free:.4g} {self.schedule.unit} without spending "
            f"and {gain:.4g} more with a budget of {self.enough:g}, beyond which no budget helps; {shape}."
        )


def budget_values(schedule: Schedule, charges: ArrayLike | None = None) -> BudgetValues:
    """Value of the best plan at every hard budget that matters: exact, all from one walk over the histories.

    Parameters
    ----------
    schedule : Schedule
    charges : float64[a], optional
        As in `solve_with_budget`.

    Raises
    ------
    InputError
        As `solve_with_budget`.
    """
    own = _charges(schedule, charges)
    tree = BudgetTree.of(schedule, in_units(own, np.inf))
    budgets = np.array([tree.units.amount(int(left)) for left in tree.levels.left[0]])
    # Sums of the same nearest number are one budget, which pays for the largest of them.
    kept = np.append(np.diff(budgets) > 0, True)
    return BudgetValues(schedule, own, budgets[kept], tree.best[0][0][0][kept], tree)


def _charges(schedule: Schedule, charges: ArrayLike | None) -> Array:
    return charges_of(schedule) if charges is None else checked_charges(schedule.protocol, charges)


def _plan(tree: BudgetTree, charges: Array, budget: float, level: int) -> BudgetPlan:
    s = tree.schedule
    rewards, mass = tree.sums
    following = tree.best[1][0] if s.n_events > 1 else None
    first = tree.worth(0, rewards[0], following)[0, level]
    decisions, spent = [], []
    gone, most = np.zeros(1, dtype=np.int64), 0
    for k, history, _, choice in tree.followed(level):
        decisions.append(choice.astype(np.int8))
        spent.append(np.array([tree.units.amount(int(g)) for g in gone]))
        gone = gone + tree.units.charge[s.first_action(k) + choice]
        possible = mass[k][history] > 0
        most = max(most, int(gone[possible].max()))
        gone = np.repeat(gone, s.n_outcomes(k))
    value = float(first.max())
    first = np.where(np.isfinite(first), first, np.nan)
    return BudgetPlan(s, budget, charges, value, first, tuple(decisions), tree.units.amount(most), tuple(spent))
