r"""Plans that people would use, each with the way it is chosen, so that the choice can be repeated on other draws.

A plan chosen on the draws that score it looks better than it is (the optimiser's curse). A candidate therefore
keeps its recipe, and is also scored on draws that had no part in the choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.baselines import baselines
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import Decisions, solve_schedule
from models.planning.policies import Policy
from models.planning.schedule import Array, Schedule
from models.robust.cautious import cautious_plan
from models.robust.information import outcome_reference
from models.robust.open_loop import open_loop
from models.robust.own_plans import own_plans
from models.robust.plan_table import PlanEvaluator, PlanTable
from models.robust.risk import Outcome

MOST_OWN = 1024
"""Own plans of draws, the most believed ones, among which the best fixed model is looked for."""

SCREENED, KEPT = 512, 64
"""Draws by which they are looked through first, and how many of them are then valued in all draws."""

BASELINE = "baseline"
"""How the word on a plan begins that is a simple rule and was not looked for."""


@dataclass(frozen=True)
class Chosen:
    """What a recipe has chosen: plans with shares, or a policy."""

    plans: tuple[Decisions, ...] = ()
    share: tuple[float, ...] = ()
    policy: Policy | None = None

    def values(self, schedule: Schedule) -> Array:
        """What it is worth in every draw of a schedule, shape ``[d]``."""
        if self.policy is not None:
            return evaluate_schedule(self.policy, schedule).values
        evaluator = PlanEvaluator(schedule)
        return np.asarray(sum(s * evaluator.values(p) for p, s in zip(self.plans, self.share, strict=True)))


@dataclass(frozen=True)
class Candidate:
    """A way to choose a plan.

    Attributes
    ----------
    name : str
    about : str
        What it does, in a few words.
    choose : callable
        From a schedule with its draws to what is chosen.
    looks : bool
        Whether the choice depends on the draws.
    """

    name: str
    about: str
    choose: Callable[[Schedule], Chosen]
    looks: bool = True


def one(plan: Decisions) -> Chosen:
    """A single plan."""
    return Chosen((plan,), (1.0,))


def posterior_mean(draws: ModelDraws) -> LatentStatePOMDP:
    """The model whose tables are the means of the draws' tables."""
    w = draws.weight
    tables = [np.einsum("d,d...->...", w, t) for t in (draws.initial, draws.transition, draws.emission)]
    tables = [t / t.sum(axis=-1, keepdims=True) for t in tables]
    like = draws.model(0)
    return LatentStatePOMDP(
        tables[0], tables[1], tables[2], draws.protocol, like.state_names, like.reward, draws.cautions
    )  # fmt: skip


def _for_model(schedule: Schedule, model: LatentStatePOMDP) -> Decisions:
    """The best plan if one model were true."""
    own = Schedule(ModelDraws.from_models([model]), schedule.modes, schedule.discount, schedule.terminal)
    return solve_schedule(own).decisions


def _fixed_model(schedule: Schedule) -> Chosen:
    """The best of the own plans: looked through on some of the draws, those in front valued in all of them."""
    plans = own_plans(schedule).plans[:MOST_OWN]
    if len(plans) > KEPT and schedule.draws.n_draws > SCREENED:
        some = PlanTable.of(replace(schedule, draws=schedule.draws.thin(SCREENED)), plans)
        plans = tuple(some.plans[i] for i in np.argsort(-some.means, kind="stable")[:KEPT])
    table = PlanTable.of(schedule, [*plans, _for_model(schedule, posterior_mean(schedule.draws))])
    return one(table.plans[int(np.argmax(table.means))])


@dataclass(frozen=True)
class CautiousChoice:
    """Recipe of a cautious plan.

    Attributes
    ----------
    alpha, mean_share : float
        As in `models.robust.cautious.cautious_plan`.
    outcome : {"value", "regret", "gain"}
        What the criterion is about.
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`).
    """

    alpha: float
    mean_share: float = 0.0
    outcome: Outcome = "value"
    kinds: int = 1

    def __call__(self, schedule: Schedule) -> Chosen:
        """The plan for the draws of a schedule."""
        reference = outcome_reference(schedule, self.outcome, kinds=self.kinds)
        found = cautious_plan(
            schedule, self.alpha, mean_share=self.mean_share, reference=reference, kinds=self.kinds
        )  # fmt: skip
        return Chosen(found.plans, tuple(found.share.tolist()))


def standard_candidates(
    schedule: Schedule,
    *,
    alpha: float = 0.1,
    mean_share: float = 0.0,
    kinds: int = 1,
    plug_in: LatentStatePOMDP | None = None,
    more: Sequence[Candidate] = (),
) -> tuple[Candidate, ...]:
    """The plans that are compared: exact ones under doubt, usual shortcuts, baselines.

    Parameters
    ----------
    schedule : Schedule
    alpha, mean_share : float
        Of the cautious plan; those by gain and by regret have the same `alpha`.
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`).
    plug_in : LatentStatePOMDP, optional
        The point estimate, of any number of states, with a reward of its own.
    more : sequence of Candidate
    """
    share = f"in the worst {100 * alpha:.3g}% of the draws" if alpha > 0 else "in the worst draw"
    mixed = f", {mean_share:.0%} mean" if mean_share else ""
    out = [
        Candidate("Bayes-adaptive", "best mean over the draws; learns which draw it faces", _bayes),
        Candidate("cautious", f"best mean {share}{mixed}", CautiousChoice(alpha, mean_share, kinds=kinds)),
        Candidate("cautious gain", f"best mean gain over never helping {share}",
                  CautiousChoice(alpha, outcome="gain", kinds=kinds)),
        Candidate("cautious regret", f"smallest mean regret {share}",
                  CautiousChoice(alpha, outcome="regret", kinds=kinds)),
        Candidate("minimax regret", "smallest largest regret over the draws",
                  CautiousChoice(0.0, outcome="regret", kinds=kinds)),
    ]  # fmt: skip
    if plug_in is not None and _plans_alike(schedule, plug_in):
        recipe = partial(_given, one(_for_model(schedule, plug_in)))
        out.append(Candidate("plug-in estimate", "best plan if the point estimate were true", recipe, looks=False))
    out += [
        Candidate("posterior mean", "best plan if the mean tables were true", _mean_model),
        Candidate("best fixed model", "best of the plans made for one draw or the mean tables", _fixed_model),
        Candidate("most common plan", "own plan of more draws than any other", _most_common),
        Candidate("fixed sequence", "best sequence of actions that listens to nobody", _sequence),
    ]  # fmt: skip
    names = [p.name for p in baselines(posterior_mean(schedule.draws))]
    for i, name in enumerate(names):
        about = f"{BASELINE}, belief by the mean tables" if name == "myopic" else BASELINE
        out.append(Candidate(name, about, partial(_baseline, i), looks=name == "myopic"))
    return (*out, *more)


# Recipes are functions of a module, so that they can be sent to other processes.
def _bayes(schedule: Schedule) -> Chosen:
    return one(solve_schedule(schedule).decisions)


def _given(chosen: Chosen, _schedule: Schedule) -> Chosen:
    return chosen


def _mean_model(schedule: Schedule) -> Chosen:
    return one(_for_model(schedule, posterior_mean(schedule.draws)))


def _most_common(schedule: Schedule) -> Chosen:
    return one(own_plans(schedule).plans[0])


def _sequence(schedule: Schedule) -> Chosen:
    return one(open_loop(schedule))


def _baseline(i: int, schedule: Schedule) -> Chosen:
    return Chosen(policy=baselines(posterior_mean(schedule.draws))[i])


def _plans_alike(schedule: Schedule, model: LatentStatePOMDP) -> bool:
    """Whether a model's plans fit: same protocol, and a terminal reward by its own states or none."""
    same = model.protocol == schedule.protocol
    return same and (schedule.terminal is None or model.n_states == schedule.n_states)
