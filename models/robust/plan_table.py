r"""Plans over a schedule and what each is worth in every draw: :math:`V_i(\pi)`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.errors import located
from models.planning.exact import Decisions, ExactPlan, walked
from models.planning.schedule import Array, Schedule
from models.planning.schedule_tree import schedule_tree, tree_tables
from models.robust.plan_kernel import plan_values


def unweighted(schedule: Schedule) -> Schedule:
    """The schedule with equal weights of its draws: what kernels work on that keep draws apart."""
    n = schedule.draws.n_draws
    return replace(schedule, draws=replace(schedule.draws, weight=np.full(n, 1.0 / n)))


class BestPlans:
    """Best plans of a schedule for any weights of its draws: Bayes trees of one layout.

    Parameters
    ----------
    schedule : Schedule
        Weights of its draws do not matter here.

    Raises
    ------
    InputError
        If there are too many histories to visit.
    """

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule
        self._tree = schedule_tree(unweighted(schedule))
        # Laid out now for all draws: whatever is asked of some of them then only cuts.
        _ = self._tree.tables, self._tree.leaf_vectors

    def plan(self, weight: Array) -> Decisions:
        """The best plan for weights ``[d]``; non-negative, and they need not sum to one."""
        return self.solved(weight).decisions

    def solved(self, weight: Array) -> ExactPlan:
        """The same with what it is worth: the weighted sum over the draws."""
        keep = np.flatnonzero(weight > 0)
        start = weight[keep, None] * self.schedule.draws.initial[keep]
        return walked(self._tree.some(keep, start))


class PlanEvaluator:
    """Values of plans in every draw of a schedule; the layout of the draws is made once.

    Parameters
    ----------
    schedule : Schedule
        Weights of its draws do not matter here.
    """

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule
        tables = tree_tables(schedule)
        self._tables = tables._replace(start=np.ascontiguousarray(schedule.draws.initial.T))
        self._terminal = np.zeros(schedule.n_states) if schedule.terminal is None else schedule.terminal
        sizes = [1]
        for k in range(schedule.n_events - 1):
            sizes.append(sizes[-1] * schedule.n_outcomes(k))
        self._sizes = sizes

    def values(self, decisions: Decisions) -> Array:
        """Value of one plan in every draw, shape ``[d]``.

        Raises
        ------
        InputError
            If the plan does not fit the schedule.
        """
        s = self.schedule
        for k, size in enumerate(self._sizes):
            level = decisions[k] if k < len(decisions) else np.zeros(0)
            top = len(s.mode(k).actions)
            if level.shape != (size,) or np.any(level < 0) or np.any(level >= top):
                raise located(f"plan, event {k + 1}, decisions", np.asarray(level).tolist(), f"{size} below {top}")
        out = np.empty(s.draws.n_draws)
        begins = np.concatenate([[0], np.cumsum(self._sizes)[:-1]]).astype(np.int64)
        plan_values(self._tables, self._terminal, begins, np.concatenate(decisions).astype(np.int8), out)
        return out


@dataclass(frozen=True)
class PlanTable:
    r"""Plans of one schedule side by side.

    Attributes
    ----------
    schedule : Schedule
        Its weights are what is believed of the draws.
    plans : tuple of Decisions
    values : float64[p, d]
        :math:`V_i(\pi_p)`.
    """

    schedule: Schedule
    plans: tuple[Decisions, ...]
    values: Array

    @classmethod
    def of(cls, schedule: Schedule, plans: Iterable[Decisions | ExactPlan]) -> PlanTable:
        """Evaluate plans in every draw; equal plans are kept once."""
        table = cls(schedule, (), np.zeros((0, schedule.draws.n_draws)))
        return table.with_plans([p.decisions if isinstance(p, ExactPlan) else p for p in plans])

    def with_plans(self, plans: Sequence[Decisions]) -> PlanTable:
        """The table with more plans, those it lacks."""
        known = {plan_key(p) for p in self.plans}
        new: dict[bytes, Decisions] = {}
        for plan in plans:
            key = plan_key(plan)
            if key not in known:
                new.setdefault(key, plan)
        if not new:
            return self
        rows = [self.evaluator.values(p) for p in new.values()]
        out = replace(self, plans=(*self.plans, *new.values()), values=np.vstack([self.values, *rows]))
        out.__dict__.update({k: v for k, v in self.__dict__.items() if k in ("evaluator", "best")})
        return out

    @cached_property
    def evaluator(self) -> PlanEvaluator:
        """What evaluates further plans."""
        return PlanEvaluator(self.schedule)

    @cached_property
    def best(self) -> BestPlans:
        """What finds best plans for other weights."""
        return BestPlans(self.schedule)

    def row(self, plan: Decisions) -> int:
        """Number of a plan in the table, -1 if it is not there."""
        key = plan_key(plan)
        return next((i for i, p in enumerate(self.plans) if plan_key(p) == key), -1)

    @property
    def means(self) -> Array:
        """Mean value of each plan by what is believed, shape ``[p]``."""
        return np.asarray(self.values @ self.schedule.draws.weight)


def plan_key(plan: Decisions) -> bytes:
    """What tells plans apart."""
    return b"".join(level.tobytes() for level in plan)
