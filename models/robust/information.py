r"""The value of perfect information: what today's doubt costs.

.. math:: \mathrm{EVPI} = \sum_i w_i \max_\pi V_i(\pi) - \max_\pi \sum_i w_i V_i(\pi)

The first term is what could be had if the truth were told before the first event, the second the Bayes-adaptive
optimum, which learns only by acting (Raiffa & Schlaifer 1961). Both are exact on the draws.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from models.errors import located
from models.notebook_view import NotebookView
from models.planning.baselines import never
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import ExactPlan, solve_schedule
from models.planning.schedule import Array, Schedule
from models.robust.draw_error import DrawMean, draw_mean
from models.robust.draw_groups import DrawGroups
from models.robust.many_weights import ManyWeights
from models.robust.own_plans import own_plans
from models.robust.plan_table import PlanEvaluator
from models.robust.risk import Outcome

SAME = 1e-12
"""Losses below this, times the largest value, are rounding."""


@dataclass(frozen=True)
class PerfectInformation(NotebookView):
    """What it would be worth to know the dynamics for certain.

    Attributes
    ----------
    schedule : Schedule
    groups : DrawGroups
        Which rows of the schedule's draws are kinds of people under one and the same draw.
    plan : ExactPlan
        Today's plan: the best for everything believed.
    optima : float64[u]
        What the best plan for each draw is worth if that draw is true.
    values : float64[u]
        What today's plan is worth there.
    chains : int or None
        As in `models.robust.draw_error`.
    sampled : bool
        Whether the draws are a sample of what is believed. If not they are all of it, and no mean over them has an
        error.
    """

    schedule: Schedule
    groups: DrawGroups
    plan: ExactPlan
    optima: Array
    values: Array
    chains: int | None = None
    sampled: bool = True

    @property
    def losses(self) -> Array:
        """What today's plan misses in each draw, shape ``[u]``; never negative."""
        return beyond_rounding(self.optima - self.values, max(1.0, float(np.abs(self.optima).max())))

    @property
    def error(self) -> DrawMean:
        """The mean loss with its standard error as a mean over draws of a sampler."""
        found = draw_mean(self.losses, self.groups.weight, self.chains)
        return found if self.sampled else found._replace(se=float("nan"))

    @property
    def value(self) -> float:
        """EVPI a person, in the unit of the reward."""
        return float(self.groups.weight @ self.losses)

    @property
    def right(self) -> float:
        """Share of the draws, by weight, in which no other plan would be better."""
        return float(self.groups.weight[self.losses == 0].sum())

    @property
    def table(self) -> Any:
        """What can be had now and with perfect knowledge, as a data frame with one row."""
        import pandas as pd

        row = {
            "known": float(self.groups.weight @ self.optima), "today": float(self.groups.weight @ self.values),
            "worth": self.value, "se": self.error.se, "plan_right": self.right,
        }  # fmt: skip
        return pd.DataFrame([row])

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if self.value == 0:
            return "Perfect knowledge would be worth nothing: today's plan is the best one in every draw."
        known = "of how people react" + (" (not of who comes next)" if self.groups.kinds > 1 else "")
        error = self.error
        sure = "" if np.isnan(error.se) else f" (standard error {error.se:.2g})"
        return (
            f"Perfect knowledge {known} would be worth {self.value:.3g} {self.schedule.unit} a person{sure}; "
            f"today's plan is already the best one in {100 * self.right:.0f}% of the draws, and misses "
            f"{self.value / (1 - self.right):.3g} on average where it is not."
        )


def beyond_rounding(gains: Array, scale: float) -> Array:
    """Differences that cannot be negative, with zero for those that are rounding of values of such a size."""
    return np.where(gains > SAME * scale, gains, 0.0)


def perfect_information(
    schedule: Schedule, *, kinds: int = 1, chains: int | None = None, sampled: bool = True,
    executor: Executor | None = None,
) -> PerfectInformation:  # fmt: skip
    """What perfect knowledge of the dynamics would be worth, exactly.

    Parameters
    ----------
    schedule : Schedule
    kinds : int
        Where people differ: how many kinds of people each draw holds (`models.robust.people_draws`). Knowledge is
        then of the draw, and not of the person.
    chains : int, optional
        How many chains the draws come from, one after the other; for the standard error only.
    sampled : bool
        False if the draws are all that is believed, a list of weighted models, and no sample of it.
    executor : concurrent.futures.Executor, optional
        What draws are spread over; threads by default.

    Raises
    ------
    InputError
        If there are too many histories, or the draws cannot be cut into kinds or chains.

    Examples
    --------
    >>> from models.lspomdp import LatentStatePOMDP
    >>> from models.model_draws import ModelDraws
    >>> moved = [[.1, .9], [.1, .9]]
    >>> stays, moves = (
    ...     LatentStatePOMDP([.5, .5], [np.eye(2), help_, np.eye(2), np.eye(2)], [[[.9, .1], [.2, .8]]] * 2)
    ...     for help_ in (np.eye(2), moved)
    ... )
    >>> doubt = Schedule.of(ModelDraws.from_models([stays, moves]), "RH")
    >>> round(perfect_information(doubt).value, 6)
    0.664275
    """
    groups = DrawGroups.of(schedule.draws, kinds)
    plan = solve_schedule(schedule)
    values = groups.mean(PlanEvaluator(schedule).values(plan.decisions))
    optima = own_optima(schedule, groups, executor)
    found = PerfectInformation(schedule, groups, plan, optima, values, chains, sampled)
    _ = found.error  # a wrong number of chains is told now
    return found


def own_optima(schedule: Schedule, groups: DrawGroups, executor: Executor | None = None) -> Array:
    """What the best plan for each draw is worth if that draw is true, shape ``[u]``."""
    if groups.kinds == 1:
        return own_plans(schedule, executor).values
    return ManyWeights(schedule).group_optima(groups.share).values


def outcome_reference(
    schedule: Schedule, outcome: Outcome, *, kinds: int = 1, executor: Executor | None = None
) -> Array | None:
    """What the outcomes of a criterion are counted from, shape ``[u]``; None where that is nothing.

    Parameters
    ----------
    schedule : Schedule
    outcome : {"value", "regret", "gain"}
        For ``regret`` each draw's own optimum, for ``gain`` what never helping is worth there.
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`).
    executor : concurrent.futures.Executor, optional

    Raises
    ------
    InputError
        On another outcome.
    """
    if outcome not in get_args(Outcome):
        raise located("outcome", outcome, "value, regret or gain")
    if outcome == "value":
        return None
    groups = DrawGroups.of(schedule.draws, kinds)
    if outcome == "regret":
        return own_optima(schedule, groups, executor)
    return groups.mean(evaluate_schedule(never(schedule.protocol), schedule).values)
