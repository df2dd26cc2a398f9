"""Policies side by side: what each is worth and where it takes people, whichever model it was made with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView
from models.planning.baselines import baselines, myopic, never
from models.planning.belief_model import BeliefModel
from models.planning.belief_policy import BeliefPolicy
from models.planning.evaluation import ScheduleValue, evaluate_schedule
from models.planning.exact import ExactPlan, solve_schedule
from models.planning.finite_memory import infinite_value
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Array, Policy
from models.planning.problem import Problem
from models.planning.rollouts import beside, simulate_policies
from models.planning.schedule import Schedule

STUDY2 = "HRHRHRHRH"
"""Rounds of the paper's second study."""

SIMULATED_RUNS = 10_000
"""Runs for policies whose value without horizon is no finite sum."""

LARGEST_SIMULATED = 0.995
"""Discounts above leave runs too long to simulate while somebody waits: thousands of steps each."""

MYOPIC = "myopic"
OPTIMAL, LEARNED = "optimal", "optimal by the learned model"


@dataclass(frozen=True)
class PolicyStudy(NotebookView):
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
        # Values that differ by rounding only keep their order.
        return pd.DataFrame(rows).sort_values(
            "value", ascending=False, kind="stable", ignore_index=True, key=lambda v: v.round(9)
        )

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


def belief_paths(
    policy: Policy, truth: LatentStatePOMDP, robot: LatentStatePOMDP, schedule: str | Sequence[str] = STUDY2
) -> tuple[Array, Array]:
    """Where a policy takes people, and what the robot believes of them meanwhile, both on average.

    Parameters
    ----------
    policy : Policy
    truth : LatentStatePOMDP
        What people are like.
    robot : LatentStatePOMDP
        The model the robot's belief is made with, whatever the policy acts on. Responses that it takes for
        impossible leave the belief as it was.
    schedule : str or sequence of str

    Returns
    -------
    states : float64[k + 1, s]
        Share of people in each state before each event, and after the last.
    believed : float64[k + 1, y]
        Mean belief, by the robot's states. Equal to `states` where the robot's model is true.
    """
    s = Schedule.of(truth, schedule)
    tracker = BeliefModel.of_latent(robot, impossible="keep")
    states, believed = np.zeros((s.n_events + 1, s.n_states)), np.zeros((s.n_events + 1, robot.n_states))
    holds = [(policy.begin(s.modes[0]), robot.initial, s.start())]
    for k in range(s.n_events + 1):
        for _, belief, joint in holds:
            states[k] += joint.sum(axis=0)
            believed[k] += joint.sum() * belief
        if k == s.n_events:
            break
        first, shows, mode = s.first_action(k), s.mode(k).shows_response, s.modes[k]
        # After the last event no mode follows; the policy is not asked any more.
        following = s.modes[k + 1] if k + 1 < s.n_events else mode
        after = []
        for memory, belief, joint in holds:
            for c, share in enumerate(policy.probabilities(memory)):
                for o in range(s.n_outcomes(k)) if share > 0 else ():
                    reached = s.after(share * joint, first + c, o if shows else None)
                    if reached.any():
                        seen = o + 1 if shows else 0
                        moved = tracker.update(mode, belief, c, seen, following)
                        after.append((policy.observe(memory, c, seen, following), moved, reached))
        holds = after
    return states, believed


def infinite_baselines(
    model: LatentStatePOMDP, problem: Problem, seed: int, runs: int = SIMULATED_RUNS
) -> dict[str, dict[str, float]]:
    """Value of every baseline without horizon: exact where its memory is finite, else simulated.

    Parameters
    ----------
    model : LatentStatePOMDP
    problem : Problem
        The model as a problem: mode process and discount.
    seed : int
    runs : int
        Simulated, each beside never helping on the same luck.

    Returns
    -------
    dict of str to dict
        By policy ``value``, ``low`` and ``high``: a 95% interval where it was simulated, else the value itself.
        Not a number where it would have to be simulated and the discount is above `LARGEST_SIMULATED`.
    """
    out = {}
    control = never(model.protocol)
    for policy in baselines(model):
        if isinstance(policy, BeliefPolicy) and problem.discount > LARGEST_SIMULATED:
            out[policy.name] = dict.fromkeys(("value", "low", "high"), float("nan"))
        elif isinstance(policy, BeliefPolicy):
            own, known = simulate_policies([policy, control], problem, runs=runs, seed=seed)
            simulated = beside(own, known, infinite_value(control, problem).value)
            out[policy.name] = {"value": simulated.value, "low": simulated.low, "high": simulated.high}
        else:
            exact = infinite_value(policy, problem)
            out[policy.name] = {"value": exact.value, "low": exact.value, "high": exact.value}
    return out
