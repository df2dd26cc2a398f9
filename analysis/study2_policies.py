"""The policies of study 2, made from what the robot has learned: the paper's, and planners that it did not have.

Whatever a policy rests on is learned, not true, so people do what the robot takes for impossible; its belief then
stays as it was but for the time that passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from analysis.policy_study import STUDY2
from models.baum_welch_fit import BaumWelchFit
from models.errors import Phrase, located
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.alpha_policy import AlphaPolicy
from models.planning.baselines import Reciprocal, always, myopic, never
from models.planning.belief_model import BeliefModel
from models.planning.exact import solve_schedule
from models.planning.latent import DISCOUNT, latent_problem
from models.planning.mode_process import alternating, schedule_modes
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Policy
from models.planning.schedule import Schedule
from models.planning.solver import solve
from models.robust.cautious import cautious_plan

LS_POMDP, ALWAYS, NEVER, MYOPIC, REACTIVE = "ls-POMDP", "always", "never", "myopic", "reactive"
EXACT, BAYES, CAUTIOUS = "exact plan", "Bayes-adaptive", "cautious"

PAPER = (LS_POMDP, ALWAYS, NEVER, MYOPIC, REACTIVE)
"""Policies that the paper compares, its own first."""

MORE = (EXACT, BAYES, CAUTIOUS)
"""Planners that the paper did not have: for the nine rounds exactly, for all that is believed, and for its tail."""

FROM_DRAWS = (BAYES, CAUTIOUS)
"""Those of them that rest on a posterior."""

ALPHA = 0.1
"""Share of the draws that the cautious plan looks at."""

PRECISION, TIME_LIMIT = 1e-3, 60.0
"""Relative gap at which ls-POMDP is solved, as `prosocial plan --infinite` does, and when it gives up, in s."""


@dataclass(frozen=True)
class Learned:
    """What the robot has learned of people.

    Attributes
    ----------
    model : LatentStatePOMDP
        Its point estimate: what it plans with and makes its belief with.
    draws : ModelDraws or None
        Its posterior, where there is one.
    words : str
        Where both come from.
    notes : tuple of str
        What must be known before they are relied on.
    found : BaumWelchFit or None
        The search that the point estimate came from, where there was one.
    log : EventLog or None
        What was learned from.
    """

    model: LatentStatePOMDP
    draws: ModelDraws | None
    words: str
    notes: tuple[str, ...] = ()
    found: BaumWelchFit | None = field(default=None, repr=False)
    log: EventLog | None = field(default=None, repr=False)


@dataclass(frozen=True)
class PolicySet:
    """Policies by name, and what must be known of them."""

    policies: tuple[Policy, ...]
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names, in order."""
        return tuple(p.name for p in self.policies)


def make_policies(
    learned: Learned, names: Sequence[str] = PAPER, schedule: str = STUDY2, *, alpha: float = ALPHA
) -> PolicySet:
    """Make policies from what was learned.

    Parameters
    ----------
    learned : Learned
    names : sequence of str
        From `PAPER` and `MORE`, in the order wanted.
    schedule : str
        Letters of the rounds, which must take turns for `LS_POMDP`.
    alpha : float
        Share of the draws that the cautious plan looks at.

    Raises
    ------
    InputError
        On an unknown name or one that stands twice, a posterior that is wanted and not there, or a schedule that
        does not suit a policy.
    """
    check_names(names)
    policies: list[Policy] = []
    notes: list[str] = []
    for name in names:
        if name == LS_POMDP:
            policy, told = ls_pomdp(learned.model, schedule)
            policies.append(policy)
            notes += told
        else:
            policies.append(_simple(name, learned, schedule, alpha))
    return PolicySet(tuple(policies), tuple(notes))


def check_names(names: Sequence[str], fewest: int = 1) -> None:
    """Refuse names that are none, or stand twice, and fewer policies than are wanted.

    Raises
    ------
    InputError
        Naming the policy.
    """
    if len(names) < fewest:
        least = "two, to be compared" if fewest == 2 else fewest
        wanted = f"at least {least}, of {', '.join(PAPER + MORE)}"
        raise located("policies", Phrase(", ".join(names) or "none"), wanted)
    for i, name in enumerate(names):
        if name not in PAPER + MORE:
            raise located("policy", name, f"one of {', '.join(PAPER + MORE)}")
        if name in names[:i]:
            raise located("policies", Phrase(f"{name} twice"), "each once")


def _simple(name: str, learned: Learned, schedule: str, alpha: float) -> Policy:
    model = learned.model
    if name == ALWAYS:
        return always(model.protocol)
    if name == NEVER:
        return never(model.protocol)
    if name == MYOPIC:
        return myopic(model, impossible="keep")
    if name == REACTIVE:
        return Reciprocal(model.protocol)
    if name == EXACT:
        return PlanPolicy.of(solve_schedule(Schedule.of(model, schedule)), EXACT)
    if learned.draws is None:
        raise located(f"policy {name}, posterior", Phrase("none"), f"one: {learned.words} is a single model")
    believed = Schedule.of(learned.draws, schedule)
    if name == BAYES:
        return PlanPolicy.of(solve_schedule(believed), BAYES)
    from models.planning.mixed_policy import MixedPolicy

    chosen = cautious_plan(believed, alpha)
    return MixedPolicy.of(believed, chosen.plans, chosen.share, CAUTIOUS)


def ls_pomdp(model: LatentStatePOMDP, schedule: str = STUDY2) -> tuple[Policy, tuple[str, ...]]:
    """The paper's own policy: solved without horizon, modes taking turns.

    The paper prints neither discount nor horizon; that of `models.planning.latent.DISCOUNT` is taken.

    Returns
    -------
    Policy
        Its belief is one about the person alone, so that it can follow any history.
    tuple of str
        A note where the solver stopped before the gap was small enough.
    """
    schedule_modes(model.protocol, schedule)
    wanted = (schedule[:2] * len(schedule))[: len(schedule)]
    if schedule != wanted or len(set(schedule[:2])) < min(2, len(schedule)):
        raise located(f"policy {LS_POMDP}, schedule", schedule, "modes that take turns, as it is solved for")
    turns = alternating(model.protocol, schedule[0])
    found = solve(latent_problem(model, turns, DISCOUNT), PRECISION, time_limit=TIME_LIMIT)
    tracker = BeliefModel.of_latent(model, impossible="keep")
    policy = AlphaPolicy(
        found.problem, found.alpha, found.mode, found.choice, found.follow, LS_POMDP, tracker=tracker
    )
    return policy, () if found.status == "converged" else (f"{LS_POMDP}: {found.sentence}",)
