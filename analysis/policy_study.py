"""Policies side by side: what each is worth over a schedule, whichever model it was made with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from models.lspomdp import LatentStatePOMDP
from models.planning.baselines import baselines, myopic
from models.planning.evaluation import ScheduleValue, evaluate_schedule
from models.planning.exact import ExactPlan, solve_schedule
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Policy
from models.planning.schedule import Schedule

STUDY2 = "HRHRHRHRH"
"""Rounds of the paper's second study."""

MYOPIC = "myopic"
OPTIMAL, LEARNED = "optimal", "optimal by the learned model"


@dataclass(frozen=True)
class PolicyStudy:
    """Policies over one schedule.

    Attributes
    ----------
    plan : ExactPlan
        The best plan where the truth is known.
    learned_plan : ExactPlan or None
        The best plan by the learned model.
    values : dict of str to ScheduleValue
        By policy, all evaluated under the truth.
    """

    plan: ExactPlan
    learned_plan: ExactPlan | None
    values: dict[str, ScheduleValue]

    @property
    def table(self) -> pd.DataFrame:
        """One row a policy, best first: value, what is lost to the optimum, help rate, costly actions, cost."""
        rows = [
            {
                "policy": name, "value": v.value, "lost": max(0.0, self.plan.value - v.value),
                "help_rate": v.help_rate, "costly_actions": v.costly_actions, "cost": v.cost,
            }
            for name, v in self.values.items()
        ]  # fmt: skip
        return pd.DataFrame(rows).sort_values("value", ascending=False, kind="stable", ignore_index=True)

    @property
    def sentence(self) -> str:
        """What the table says."""
        table = self.table
        others = table[~table["policy"].isin([OPTIMAL, LEARNED])]
        best, worst = others.iloc[0], others.iloc[-1]
        text = (
            f"{self.plan.sentence} The best baseline, {best['policy']}, is worth {best['value']:.4g}, the worst, "
            f"{worst['policy']}, {worst['value']:.4g}."
        )
        if LEARNED in self.values:
            lost = self.plan.value - self.values[LEARNED].value
            text += f" Planning with the learned model instead of the truth loses {lost:.3g}."
        return text


def policy_study(
    truth: LatentStatePOMDP, schedule: str | Sequence[str] = STUDY2, discount: float = 1.0, *,
    learned: LatentStatePOMDP | None = None, more: Sequence[Policy] = (),
) -> PolicyStudy:  # fmt: skip
    """Evaluate the best plan, the baselines and further policies over a schedule, exactly.

    Parameters
    ----------
    truth : LatentStatePOMDP
        What people are like; its reward counts.
    schedule : str or sequence of str
        Letters or mode names.
    discount : float
        From 0 to 1.
    learned : LatentStatePOMDP, optional
        The robot's model, with the same number of states or another one: its best plan, made with its own reward,
        is evaluated under the truth. Responses that it takes for impossible leave the robot's belief as it was.
    more : sequence of Policy
        Further policies.
    """
    plan = solve_schedule(Schedule.of(truth, schedule, discount))
    policies: list[Policy] = [PlanPolicy.of(plan, OPTIMAL)]
    learned_plan = None
    if learned is not None:
        learned_plan = solve_schedule(Schedule.of(learned, schedule, discount))
        policies.append(PlanPolicy.of(learned_plan, LEARNED))
    # A model fitted at the edge of what is possible meets people who do the impossible.
    policies += [myopic(learned or truth, impossible="keep") if p.name == MYOPIC else p for p in baselines(truth)]
    policies += more
    values = {p.name: evaluate_schedule(p, truth, schedule, discount) for p in policies}
    return PolicyStudy(plan, learned_plan, values)


def state_paths(study: PolicyStudy) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean index of the state before each event and after the last, by policy: events and values."""
    out = {}
    for name, value in study.values.items():
        path = value.state_path
        out[name] = (np.arange(len(path)), path @ np.arange(path.shape[1]))
    return out
