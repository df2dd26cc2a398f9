"""What safeguards change, cost and protect over one schedule: for command, report and notebook."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from models.errors import located
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView, View, table_rows
from models.planning.baselines import ModePolicy, baselines
from models.planning.belief_model import BeliefModel
from models.planning.budget_plan import BudgetValues, budget_values, solve_with_budget
from models.planning.charges import charges_of
from models.planning.expected_cost import CostFrontier, cost_frontier
from models.planning.latent import DISCOUNT, latent_problem
from models.planning.mode_process import alternating
from models.planning.policies import Array, Policy
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from models.planning.solver import solve
from models.robust.candidates import posterior_mean
from models.safeguards.budget import CostBudget
from models.safeguards.confidence import Confidence
from models.safeguards.consent import fallback_of
from models.safeguards.guarded import Guarded
from models.safeguards.influence import MinimumInfluence
from models.safeguards.influence_report import ALL, InfluenceReport, Watched, influence_report
from models.safeguards.safeguard import Safeguard
from models.safeguards.schedule_worth import ScheduleWorth
from models.safeguards.steps import Steps, threshold_steps, tolerance_steps

BUDGET, TOLERANCE, CONFIDENCE = 30.0, 5.0, 0.9
"""What is shown where nothing is asked for: two acts of help, a third of one, nine draws in ten."""

BUDGET_IN_ACTIONS = 2.0
"""The budget where actions are counted."""

PRECISION = 1e-3
"""Relative gap at which the policy without horizon counts as solved here."""

OPTIMAL, ADAPTIVE, WITHIN, IN_EXPECTATION = "optimal plan", "Bayes-adaptive plan", "budget plan", "cost-limited"
LS_POMDP, MEAN_PLAN = "ls-POMDP", "plan for the mean model"

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Wanted:
    """Safeguards that are asked for; those that are None are left out.

    Attributes
    ----------
    budget : float, optional
        Hard limit on what is spent on one person.
    expected_cost : float, optional
        Limit on what is spent on average.
    tolerance : float, optional
        Of minimum influence, in the unit of the reward.
    confidence : float, optional
        Threshold of the probability that an action pays.
    margin : float
        By how much it must pay.
    fallback : mapping of str to str
        Action by mode without consent; null actions where nothing is said.
    count : bool
        Count actions other than null actions instead of adding up their costs.
    """

    budget: float | None = None
    expected_cost: float | None = None
    tolerance: float | None = None
    confidence: float | None = None
    margin: float = 0.0
    fallback: Mapping[str, str] = field(default_factory=dict)
    count: bool = False

    @property
    def any(self) -> bool:
        """Whether some safeguard is asked for."""
        return any(x is not None for x in (self.budget, self.expected_cost, self.tolerance, self.confidence))


@dataclass(frozen=True)
class SafeguardStudy(NotebookView):
    """Safeguards over one schedule.

    Attributes
    ----------
    schedule : Schedule
    wanted : Wanted
    charges : float64[a]
    report : InfluenceReport
        By policy; the best plan comes first.
    frontier : CostFrontier
        Best values under limits on the expected cost.
    budgets : BudgetValues
        Best values under hard budgets.
    tolerance, threshold : Steps or None
        The best plan under minimum influence, and under confidence where there are several draws.
    guarded : Guarded
        The policy for the robot, with all safeguards: the best one within the expected cost if that is limited,
        else within the budget. Where both are limited it does not plan for the budget, which stops it.
    """

    schedule: Schedule
    wanted: Wanted
    charges: Array
    report: InfluenceReport
    frontier: CostFrontier
    budgets: BudgetValues
    tolerance: Steps
    threshold: Steps | None
    guarded: Guarded

    @property
    def best(self) -> str:
        """Name of the best plan."""
        return self.report.policies[0]

    @property
    def drawn(self) -> tuple[str, ...]:
        """Policies that figures show."""
        return tuple(p for p in (self.best, LS_POMDP, "reactive", "always") if p in self.report.policies)

    @property
    def sentences(self) -> list[str]:
        """The study in sentences."""
        out = [_capital(self.report.sentence)]
        out += self._belt()
        out += [self.frontier.sentence, self.budgets.sentence]
        if self.wanted.expected_cost is not None:
            limit, worth = self.wanted.expected_cost, self.frontier.value_at(self.wanted.expected_cost)
            out.append(f"With an expected cost of at most {limit:g} the best value is {worth:.4g}.")
            if self.wanted.budget is not None:
                out.append(
                    f"The robot's policy is the best one within the expected cost; the budget of "
                    f"{self.wanted.budget:g} stops it and is not planned for."
                )
        out += [_capital(s.sentence) for s in (self.tolerance, self.threshold) if s is not None]
        return out

    def _belt(self) -> list[str]:
        """The plan that knows of the budget beside the one that runs into it."""
        if self.wanted.budget is None:
            return []
        knows, runs_into = self.budgets.value_at(self.wanted.budget), self.report.run(self.best, "budget").value
        more = knows - runs_into
        text = (
            f"Within a budget of {self.wanted.budget:g} the best plan is worth {knows:.4g}; the {self.best}, "
            f"stopped by the safeguard, {runs_into:.4g}"
        )
        return [text + (f", {more:.3g} less." if more > 1e-9 * max(1.0, abs(knows)) else ", no less.")]

    def _view(self) -> View:
        tables = (table_rows(self.report.table, ".report.table"),)
        return View("Safeguards", "", (), (), tuple(self.sentences), tables)


def safeguard_study(
    schedule: Schedule, wanted: Wanted | None = None, *, progress: Progress | None = None
) -> SafeguardStudy:
    """Follow policies over a schedule with each safeguard alone and with all of them.

    Parameters
    ----------
    schedule : Schedule
        Under one model or many draws.
    wanted : Wanted, optional
        By default a budget, minimum influence and confidence at `BUDGET`, `TOLERANCE` and `CONFIDENCE`.
    progress : callable, optional
        Called with the step, pieces done and pieces in all.

    Raises
    ------
    InputError
        On limits that are none, an unknown mode or action, or more histories than can be followed.
    """
    own = wanted or Wanted()
    if not own.any:
        limit = BUDGET_IN_ACTIONS if own.count else BUDGET
        own = Wanted(limit, None, TOLERANCE, CONFIDENCE, own.margin, own.fallback, own.count)
    draws, protocol = schedule.draws, schedule.protocol
    charges = charges_of(schedule, "count" if own.count else "cost")
    fallback = fallback_of(protocol, own.fallback)
    guards = _safeguards(own, draws, dict(zip(protocol.action_names, charges.tolist(), strict=True)))
    if own.expected_cost is not None and not own.expected_cost >= 0:
        raise located("--expected-cost", own.expected_cost, "a number from 0 on")

    def tell(done: int) -> None:
        if progress is not None:
            progress("safeguards", done, 4)

    tell(0)
    best = schedule_vectors(schedule, name=OPTIMAL if draws.n_draws == 1 else ADAPTIVE, impossible="keep")
    watched = [Watched(best), *_others(schedule, best.name)]
    tell(1)
    frontier, budgets = cost_frontier(schedule, charges), budget_values(schedule, charges)
    limited = _limited(schedule, own, charges, frontier)
    watched[1:1] = limited
    tell(2)
    sets: dict[str, list[Safeguard]] = {g.name: [g] for g in guards}
    if len(guards) > 1:
        sets[ALL] = guards
    report = influence_report(watched, sets, fallback, schedule, charges)
    tell(3)
    lenient = tolerance_steps(watched[0], fallback, schedule)
    doubtful = threshold_steps(watched[0], fallback, schedule, own.margin) if draws.n_draws > 1 else None
    tell(4)
    base = limited[-1] if limited else watched[0]
    guarded = Guarded(base.policy, guards, fallback, base.worth)
    return SafeguardStudy(schedule, own, charges, report, frontier, budgets, lenient, doubtful, guarded)


def _safeguards(wanted: Wanted, draws: ModelDraws, charges: Mapping[str, float]) -> list[Safeguard]:
    out: list[Safeguard] = []
    if wanted.tolerance is not None:
        out.append(MinimumInfluence.of(draws, wanted.tolerance))
    if wanted.confidence is not None:
        out.append(Confidence.of(draws.protocol, wanted.confidence, wanted.margin))
    if wanted.budget is not None:
        out.append(CostBudget.of(draws.protocol, wanted.budget, charges))
    return out


def _limited(schedule: Schedule, wanted: Wanted, charges: Array, frontier: CostFrontier) -> list[Watched]:
    """The best plans that know of the limits."""
    out = []
    if wanted.budget is not None:
        plan = solve_with_budget(schedule, wanted.budget, charges)
        out.append(Watched(plan.policy(WITHIN, impossible="keep")))
    if wanted.expected_cost is not None:
        mixture = frontier.mixture(wanted.expected_cost, IN_EXPECTATION)
        out.append(Watched(mixture, ScheduleWorth(mixture, schedule)))
    return out


def _others(schedule: Schedule, best: str) -> list[Watched]:
    """Policies beside the best plan, with what their actions are worth in all draws."""
    mean = posterior_mean(schedule.draws)
    policies: list[Policy] = []
    if best != OPTIMAL:
        alone = Schedule(ModelDraws.from_models([mean]), schedule.modes, schedule.discount, schedule.terminal)
        policies.append(schedule_vectors(alone, name=MEAN_PLAN, impossible="keep"))
    policies.append(ls_pomdp(mean_of=schedule))
    policies += [p for p in baselines(mean) if p.name != "random"]
    return [Watched(p, ScheduleWorth(p, schedule)) for p in policies]


def ls_pomdp(mean_of: Schedule) -> Policy:
    """The paper's policy: made without horizon for the mean model, modes taking turns; it follows any schedule."""
    from models.planning.alpha_policy import AlphaPolicy

    model = posterior_mean(mean_of.draws)
    process = alternating(model.protocol, mean_of.mode(0).name)
    discount = mean_of.discount if mean_of.discount < 1 else DISCOUNT
    found = solve(latent_problem(model, process, discount), precision=PRECISION).policy
    tracker = BeliefModel.of_latent(model, discount, impossible="keep")
    return AlphaPolicy(
        found.model, found.alpha, found.mode, found.choice, found.follow, LS_POMDP, tracker=tracker,
        outcomes=found.keys,
    )  # fmt: skip


def study_fields(study: SafeguardStudy) -> dict[str, Any]:
    """The study as plain content, for ``--json``; prices may be infinite."""
    wanted = study.wanted
    limits = {
        "budget": wanted.budget, "expected_cost": wanted.expected_cost, "influence": wanted.tolerance,
        "confidence": wanted.confidence,
    }  # fmt: skip
    steps = [s for s in (study.tolerance, study.threshold) if s is not None]
    return {
        "policies": list(study.report.policies),
        "safeguards": [{"name": name, "limit": limit} for name, limit in limits.items() if limit is not None],
        "fallback": fallback_actions(study.guarded.fallback),
        "charges": dict(zip(study.schedule.protocol.action_names, study.charges.tolist(), strict=True)),
        "curve": study.frontier.rows(),
        "budgets": study.budgets.rows(),
        "influence": study.report.rows(),
        "who": study.report.who_rows(),
        "steps": [{"safeguard": s.safeguard, "complete": s.complete, "rows": s.rows()} for s in steps],
        "sentences": study.sentences,
    }


def fallback_actions(fallback: ModePolicy) -> dict[str, str]:
    """What the fallback does in each mode."""
    words = fallback.vocabulary
    return {
        mode: actions[int(np.argmax(share))]
        for mode, actions, share in zip(words.modes, words.actions, fallback.shares, strict=True)
    }


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]
