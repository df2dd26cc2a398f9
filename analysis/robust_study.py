"""What the robot should do over a schedule given everything that is believed: for command, report and notebook."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from models.errors import located
from models.planning.exact import ExactPlan, solve_schedule
from models.planning.schedule import Schedule
from models.robust.candidates import Candidate, Chosen, standard_candidates
from models.robust.cautious import CautiousPlan, cautious_plan
from models.robust.contested import Flip, contested
from models.robust.frontier import LEVELS, Frontier, frontier
from models.robust.information import PerfectInformation, perfect_information
from models.robust.own_plans import OwnPlans, own_plans
from models.robust.partial_information import PartialInformation, partial_information
from models.robust.people_draws import Personal, personalised
from models.robust.pricing import PriceList, price
from models.robust.sample_information import sample_information
from models.robust.stability import Stability, decision_stability
from models.robust.study_worth import SampleInformation

if TYPE_CHECKING:
    from analysis.next_studies import Asked
    from models.lspomdp import LatentStatePOMDP
    from models.robust.study_design import NextStudy

Criterion = Literal["bayes", "cvar", "regret", "regret-cvar"]
CRITERIA: tuple[Criterion, ...] = ("bayes", "cvar", "regret", "regret-cvar")

REPLICATES = 200
"""Simulated data sets a study."""


@dataclass(frozen=True)
class RobustStudy:
    """Plans under doubt over one schedule.

    Attributes
    ----------
    schedule : Schedule
    criterion : str
    alpha : float
        Share of the draws that the cautious criteria look at.
    plan : ExactPlan
        The Bayes-adaptive plan.
    chosen : CautiousPlan
        The plan of the criterion.
    own : OwnPlans
    prices : PriceList
    stability : Stability
        Of the Bayes-adaptive plan.
    perfect : PerfectInformation
    partial : PartialInformation
    samples : tuple of SampleInformation
        Of the studies that were asked for, those of the same sizes together.
    frontiers : dict of str to Frontier
        At the costs given and, where it was asked for, where the first decisions flip.
    flips : tuple of Flip
    personal : Personal or None
        Where people differ: what learning whom the robot faces is worth.
    """

    schedule: Schedule
    criterion: Criterion
    alpha: float
    plan: ExactPlan
    chosen: CautiousPlan
    own: OwnPlans
    prices: PriceList
    stability: Stability
    perfect: PerfectInformation
    partial: PartialInformation
    samples: tuple[SampleInformation, ...]
    frontiers: dict[str, Frontier]
    flips: tuple[Flip, ...]
    personal: Personal | None = None

    @property
    def value(self) -> float:
        """Of the chosen plan by its criterion; for regret, how large it is."""
        return -self.chosen.lower if self.criterion.startswith("regret") else self.chosen.lower

    @property
    def adaptivity(self) -> float:
        """What listening is worth: the Bayes-adaptive plan less the best fixed sequence of actions."""
        return max(0.0, self.plan.value - self.prices["fixed sequence"].mean)

    @property
    def learning(self) -> float:
        """What learning which draw it faces is worth: the Bayes-adaptive plan less the best plan for one model."""
        return max(0.0, self.plan.value - self.prices["best fixed model"].mean)

    @property
    def criterion_words(self) -> str:
        """The criterion in words."""
        share = f"the worst {self.alpha:.0%} of the draws"
        return {
            "bayes": "mean over the draws",
            "cvar": f"mean of {share}",
            "regret": "largest regret over the draws",
            "regret-cvar": f"mean regret of {share}",
        }[self.criterion]

    @property
    def sentence(self) -> str:
        """The answer in one sentence: how sure the first decision is, what doubt costs, what would reduce it."""
        first = self.stability.standings[0]
        text = (
            f"{first.action} first is right in {first.share[first.action]:.0%} of the draws, and being wrong costs "
            f"{first.loss[first.action]:.2g} on average; all doubt together costs {self.perfect.value:.3g} of "
            f"{self.plan.value:.4g} reward units a person"
        )
        enough = [row for s in self.samples for row in s.rows if row.enough and not row.silent]
        if not enough:
            return text + "."
        best = max(enough, key=lambda row: row.worth)
        share = best.worth / self.perfect.value if self.perfect.value > 0 else 0.0
        return f"{text}; {best.words} would take away {share:.0%} of that."


def robust_study(
    schedule: Schedule,
    *,
    criterion: str = "bayes",
    alpha: float = 0.1,
    mean_share: float = 0.0,
    plug_in: LatentStatePOMDP | None = None,
    asked: Sequence[Asked] = (),
    with_frontier: bool = False,
    chains: int | None = None,
    kinds: int = 1,
    replicates: int = REPLICATES,
    served: float | None = None,
    cost: float = 0.0,
    seed: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> RobustStudy:
    """Plan under doubt, price the shortcuts, and value what could be learned.

    Parameters
    ----------
    schedule : Schedule
    criterion : {"bayes", "cvar", "regret", "regret-cvar"}
    alpha : float
        In ``(0, 1]``.
    mean_share : float
        Share of the mean in the ``cvar`` criterion.
    plug_in : LatentStatePOMDP, optional
        The point estimate, to price planning with it.
    asked : sequence of Asked
        Studies to value.
    with_frontier : bool
        Also the frontier, here and at costs where the first decisions flip.
    chains, kinds : int
        Chains that the draws come from; kinds of people in each draw (`models.robust.people_draws`).
    replicates : int
        Simulated data sets a study.
    served : float, optional
        People whom the plan will serve.
    cost : float
        Of one participant, in reward units.
    seed : int
    progress : callable, optional
        Called with the step, pieces done and pieces in all.

    Raises
    ------
    InputError
        On an unknown criterion, or alpha outside (0, 1].
    """
    if criterion not in CRITERIA:
        raise located("criterion", criterion, f"one of {', '.join(CRITERIA)}")
    if not (np.isfinite(alpha) and 0 < alpha <= 1):
        raise located("alpha", alpha, "a share above 0 and up to 1")

    def told(step: str) -> Callable[[int, int], None] | None:
        return None if progress is None else lambda done, total: progress(step, done, total)

    own = own_plans(schedule)
    plan = solve_schedule(schedule)
    reference = own.values if criterion.startswith("regret") else None
    level = {"bayes": 1.0, "cvar": alpha, "regret": 0.0, "regret-cvar": alpha}[criterion]
    share = mean_share if criterion == "cvar" else 0.0
    chosen = cautious_plan(schedule, level, mean_share=share, reference=reference, start=[plan.decisions])
    more = () if criterion != "regret-cvar" else (_regret_tail(alpha),)
    candidates = standard_candidates(schedule, alpha=alpha, mean_share=mean_share, plug_in=plug_in, more=more)
    prices = price(schedule, candidates, alpha=alpha, seed=seed, own=own, progress=told("plans"))
    perfect = perfect_information(schedule, kinds=kinds, chains=chains)
    partial = partial_information(schedule, kinds=kinds, chains=chains, perfect=perfect, progress=told("blocks"))
    alike: dict[tuple[int, ...], list[NextStudy]] = {}
    for one in asked:
        alike.setdefault(one.sizes, []).append(one.study)
    samples = tuple(
        sample_information(
            schedule, studies, sizes, replicates=replicates, seed=seed, kinds=kinds, served=served, cost=cost,
            perfect=perfect, progress=told("further studies"),
        )
        for sizes, studies in alike.items()
    )  # fmt: skip
    frontiers: dict[str, Frontier] = {}
    flips: tuple[Flip, ...] = ()
    if with_frontier:
        frontiers["these costs"] = frontier(schedule, LEVELS, progress=told("frontier"))
        flipped, flips = contested(schedule)
        if any(f.multiple is not None for f in flips):
            frontiers["contested costs"] = frontier(flipped, LEVELS, progress=told("contested frontier"))
    return RobustStudy(
        schedule, criterion, alpha, plan, chosen, own, prices, decision_stability(schedule, plan), perfect, partial,
        samples, frontiers, flips, personalised(schedule, kinds) if kinds > 1 else None,
    )  # fmt: skip


def _regret_tail(alpha: float) -> Candidate:
    def choose(schedule: Schedule) -> Chosen:
        found = cautious_plan(schedule, alpha, reference=own_plans(schedule).values)
        return Chosen(found.plans, tuple(found.share.tolist()))

    return Candidate("small regret", f"smallest mean regret of the worst {alpha:.0%} of the draws", choose)


def robust_fields(study: RobustStudy) -> dict[str, Any]:
    """Fields of the command's JSON."""
    weight = study.schedule.draws.weight
    order = np.argsort(study.own.values, kind="stable")
    total = np.cumsum(weight[order])
    quantile = {
        f"q{p:02.0f}": float(study.own.values[order][min(int(np.searchsorted(total, p / 100)), len(order) - 1)])
        for p in (5, 50, 95)
    }
    return {
        "criterion": study.criterion, "alpha": study.alpha, "value": study.value, "gap": study.chosen.gap,
        "certified": study.chosen.certified, "bayes_value": study.plan.value,
        "first_action": study.plan.first_action, "first_action_shares": study.own.first_action_shares,
        "first_action_losses": study.own.first_action_losses,
        "optimal_values": {"mean": study.own.mean, **quantile},
        "plans": {p.name: p.to_dict() for p in study.prices.prices},
        "evpi": study.perfect.value,
        "evppi": {
            r.block: {"worth": r.worth, "se": r.se, "in_sample": r.in_sample} for r in study.partial.rows
        },
        "evsi": [
            {
                "study": r.study, "participants": r.people, "worth": r.worth, "se": r.se, "pathwise": r.pathwise,
                "pathwise_se": r.pathwise_se, "perfect": r.perfect, "effective_draws": r.effective, "net": r.net,
                "enough": r.enough,
            }
            for s in study.samples
            for r in s.rows
        ],
        "adaptivity": study.adaptivity, "learning": study.learning,
        "frontier": [
            {"setting": name, **row} for name, found in study.frontiers.items() for row in found.rows()
        ],
        "flips": [
            {"mode": f.mode, "action": f.action, "multiple": f.multiple, "costs": f.costs} for f in study.flips
        ],
        "personalising": None if study.personal is None else {
            "gain": study.personal.gain, "value": study.personal.value, "impersonal": study.personal.impersonal,
            "kinds": study.personal.kinds,
        },
        "mixture": study.chosen.rows(), "agreement": study.stability.agreement,
        "own_plans": len(study.own.plans), "sentence": study.sentence,
    }  # fmt: skip
