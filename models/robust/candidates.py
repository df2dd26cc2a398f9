r"""Plans that people would use, each with the way it is chosen, so that the choice can be repeated on other draws.

A plan chosen on the draws that score it looks better than it is (the optimiser's curse). A candidate therefore
keeps its recipe, and is also scored on draws that had no part in the choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.baselines import baselines
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import Decisions, solve_schedule
from models.planning.policies import Policy
from models.planning.schedule import Array, Schedule
from models.robust.cautious import cautious_plan
from models.robust.information import perfect_information
from models.robust.open_loop import open_loop
from models.robust.own_plans import own_plans
from models.robust.plan_table import PlanEvaluator, PlanTable

MOST_OWN = 1024
"""Own plans of draws, the most believed ones, among which the best fixed model is looked for."""


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
        tables[0], tables[1], tables[2], draws.protocol, like.state_names, like.reward
    )  # fmt: skip


def _for_model(schedule: Schedule, model: LatentStatePOMDP) -> Decisions:
    """The best plan if one model were true."""
    own = Schedule(ModelDraws.from_models([model]), schedule.modes, schedule.discount, schedule.terminal)
    return solve_schedule(own).decisions


def _fixed_model(schedule: Schedule) -> Chosen:
    own = own_plans(schedule)
    mean = _for_model(schedule, posterior_mean(schedule.draws))
    table = PlanTable.of(schedule, [*own.plans[:MOST_OWN], mean])
    return one(table.plans[int(np.argmax(table.means))])


def cautious_choice(
    alpha: float, mean_share: float = 0.0, *, regret: bool = False, kinds: int = 1
) -> Callable[[Schedule], Chosen]:
    """Recipe of a cautious plan, by value or by regret."""

    def choose(schedule: Schedule) -> Chosen:
        reference = perfect_information(schedule, kinds=kinds).optima if regret else None
        found = cautious_plan(schedule, alpha, mean_share=mean_share, reference=reference, kinds=kinds)
        return Chosen(found.plans, tuple(found.share.tolist()))

    return choose


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
        Of the cautious plan.
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`).
    plug_in : LatentStatePOMDP, optional
        The point estimate, of any number of states, with a reward of its own.
    more : sequence of Candidate
    """
    share = f"{100 * alpha:.3g}% of the draws" if alpha > 0 else "draw"
    mixed = f", {mean_share:.0%} mean" if mean_share else ""
    out = [
        Candidate("Bayes-adaptive", "best mean over the draws; learns which draw it faces",
                  lambda s: one(solve_schedule(s).decisions)),
        Candidate("cautious", f"best mean of the worst {share}{mixed}",
                  cautious_choice(alpha, mean_share, kinds=kinds)),
        Candidate("minimax regret", "smallest largest regret over the draws",
                  cautious_choice(0.0, regret=True, kinds=kinds)),
    ]  # fmt: skip
    if plug_in is not None:
        plan = one(_for_model(schedule, plug_in)) if _plans_alike(schedule, plug_in) else None
        if plan is not None:
            out.append(Candidate("plug-in estimate", "best plan if the point estimate were true",
                                 lambda s: plan, looks=False))  # fmt: skip
    out += [
        Candidate("posterior mean", "best plan if the mean tables were true",
                  lambda s: one(_for_model(s, posterior_mean(s.draws)))),
        Candidate("best fixed model", "best of the plans made for one draw or the mean tables",
                  _fixed_model),
        Candidate("most common plan", "own plan of more draws than any other",
                  lambda s: one(own_plans(s).plans[0])),
        Candidate("fixed sequence", "best sequence of actions that listens to nobody", lambda s: one(open_loop(s))),
    ]  # fmt: skip
    mean = posterior_mean(schedule.draws)
    names = [p.name for p in baselines(mean)]
    for i, name in enumerate(names):
        about = "baseline, belief by the mean tables" if name == "myopic" else "baseline"
        out.append(Candidate(name, about, _baseline(i), looks=name == "myopic"))
    return (*out, *more)


def _baseline(i: int) -> Callable[[Schedule], Chosen]:
    return lambda s: Chosen(policy=baselines(posterior_mean(s.draws))[i])


def _plans_alike(schedule: Schedule, model: LatentStatePOMDP) -> bool:
    """Whether a model's plans fit: same protocol, and a terminal reward by its own states or none."""
    same = model.protocol == schedule.protocol
    return same and (schedule.terminal is None or model.n_states == schedule.n_states)
