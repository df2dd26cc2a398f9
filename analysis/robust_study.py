"""What the robot should do over a schedule given everything that is believed: for command, report and notebook."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from models.errors import located
from models.notebook_view import NotebookView, View, table_rows
from models.planning.exact import Decisions, ExactPlan, solve_schedule
from models.planning.schedule import Schedule
from models.robust.candidates import standard_candidates
from models.robust.cautious import CautiousPlan, cautious_plan
from models.robust.contested import Flip, contested, flip_points
from models.robust.frontier import LEVELS, Frontier, frontier
from models.robust.information import (
    SAME,
    PerfectInformation,
    beyond_rounding,
    outcome_reference,
    perfect_information,
)
from models.robust.own_plans import OwnPlans, own_plans
from models.robust.partial_information import PartialInformation, partial_information
from models.robust.people_draws import Personal, personalised
from models.robust.pricing import PriceList, price
from models.robust.risk import Outcome, weighted_quantiles
from models.robust.sample_information import sample_information
from models.robust.single_plan import SinglePlan, best_single, decisions_of, pooled
from models.robust.stability import Stability, decision_stability
from models.robust.study_room import check_room
from models.robust.study_worth import SampleInformation

if TYPE_CHECKING:
    from analysis.next_studies import Asked
    from models.lspomdp import LatentStatePOMDP
    from models.robust.study_design import NextStudy

Criterion = Literal["bayes", "cvar", "gain-cvar", "regret", "regret-cvar"]
CRITERIA: tuple[Criterion, ...] = ("bayes", "cvar", "gain-cvar", "regret", "regret-cvar")

FEWEST_IN_TAIL = 10
"""Draws that a level of the frontier must look at."""

REPLICATES = 200
"""Simulated data sets a study."""

OWN_PLANS = 64
"""Own plans of draws, the most believed ones, that the best single plan is looked for among."""


@dataclass(frozen=True)
class RobustStudy(NotebookView):
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
    single : SinglePlan
        The best plan of the criterion that draws no lots; no plan in `prices` that draws none is better.
    own : OwnPlans
    prices : PriceList
    stability : Stability
        Of the Bayes-adaptive plan.
    perfect : PerfectInformation
    partial : PartialInformation
    samples : tuple of SampleInformation
        Of the studies that were asked for, those of the same sizes together.
    frontiers : dict of str to Frontier
        At the costs given and, where it was asked for, where the first decisions of all modes flip together.
    flips : tuple of Flip
        Where the first decision of each mode flips, the other costs as they are.
    together : tuple of Flip
        The same all at once: where the second frontier is.
    personal : Personal or None
        Where people differ: what learning whom the robot faces is worth.
    """

    schedule: Schedule
    criterion: Criterion
    alpha: float
    plan: ExactPlan
    chosen: CautiousPlan
    single: SinglePlan
    own: OwnPlans
    prices: PriceList
    stability: Stability
    perfect: PerfectInformation
    partial: PartialInformation
    samples: tuple[SampleInformation, ...]
    frontiers: dict[str, Frontier]
    flips: tuple[Flip, ...]
    together: tuple[Flip, ...] = ()
    personal: Personal | None = None

    @property
    def value(self) -> float:
        """Of the chosen plan by its criterion; for regret, how large it is."""
        return self.told(self.chosen.lower)

    def told(self, worth: float) -> float:
        """A number of the criterion as it is told: regret as what is lost, and rounding as nothing."""
        scale = max(1.0, float(np.abs(self.chosen.table.values).max()))
        if abs(worth) <= SAME * scale:
            return 0.0
        return -worth if self.criterion.startswith("regret") else worth

    @property
    def adaptivity(self) -> float:
        """What listening is worth: the Bayes-adaptive plan less the best fixed sequence of actions."""
        return self._more_than("fixed sequence")

    @property
    def learning(self) -> float:
        """What learning which draw it faces is worth at most: the best plan less the best found for one model."""
        return self._more_than("best fixed model")

    def _more_than(self, name: str) -> float:
        gain = self.plan.value - self.prices[name].mean
        return float(beyond_rounding(np.array(gain), max(1.0, abs(self.plan.value))))

    @property
    def criterion_words(self) -> str:
        """The criterion in words."""
        share = f"the worst {100 * self.alpha:.3g}% of the draws"
        return {
            "bayes": "mean over the draws",
            "cvar": f"mean of {share}",
            "gain-cvar": f"mean gain over never helping of {share}",
            "regret": "largest regret over the draws",
            "regret-cvar": f"mean regret of {share}",
        }[self.criterion]

    @property
    def sentence(self) -> str:
        """The answer in one sentence: how sure the first decision is, what doubt costs, what would reduce it."""
        text = (
            f"{self.stability.headline}; all doubt together costs {self.perfect.value:.3g} of "
            f"{self.plan.value:.4g} {self.schedule.unit} a person"
        )
        enough = [row for s in self.samples for row in s.rows if row.enough and not row.silent]
        if not enough:
            return text + "."
        best = max(enough, key=lambda row: (row.sure, row.worth))
        return f"{text}; {best.words} would take away {best.share_of(self.perfect.value)} of that."

    def _view(self) -> View:
        tables = (
            table_rows(self.prices.table, ".prices.table", "plans side by side"),
            table_rows(self.stability.table, ".stability.table", "how many draws agree"),
        )
        return View("Plans under doubt", "", (), (), (self.sentence,), tables)


def robust_study(
    schedule: Schedule,
    *,
    criterion: str = "bayes",
    alpha: float = 0.1,
    mean_share: float = 0.0,
    lots: bool = True,
    plug_in: LatentStatePOMDP | None = None,
    asked: Sequence[Asked] = (),
    with_frontier: bool = False,
    chains: int | None = None,
    kinds: int = 1,
    sampled: bool = True,
    replicates: int = REPLICATES,
    served: float | None = None,
    cost: float = 0.0,
    seed: int = 1,
    executor: Executor | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> RobustStudy:
    """Plan under doubt, price the shortcuts, and value what could be learned.

    Parameters
    ----------
    schedule : Schedule
    criterion : {"bayes", "cvar", "gain-cvar", "regret", "regret-cvar"}
    alpha : float
        In ``(0, 1]``.
    mean_share : float
        Share of the mean in the ``cvar`` criterion; no other takes one.
    lots : bool
        Whether the plan of the criterion may draw one of several plans; otherwise it is the best single one
        (`models.robust.single_plan`).
    plug_in : LatentStatePOMDP, optional
        The point estimate, to price planning with it.
    asked : sequence of Asked
        Studies to value.
    with_frontier : bool
        Also the frontier, here and at costs where the first decisions flip.
    chains, kinds : int
        Chains that the draws come from; kinds of people in each draw (`models.robust.people_draws`).
    sampled : bool
        False if the draws are a list of weighted models, and no sample of what is believed.
    replicates : int
        Simulated data sets a study.
    served : float, optional
        People whom the plan will serve.
    cost : float
        Of one participant, in the unit of the reward.
    seed : int
    executor : concurrent.futures.Executor, optional
        What draws, plans, levels of caution, blocks and simulated data sets are spread over; threads by default.
    progress : callable, optional
        Called with the step, pieces done and pieces in all.

    Raises
    ------
    InputError
        On an unknown criterion, alpha outside (0, 1], a share of the mean that the criterion does not take, nobody
        served, a cost of participants without the people served, or studies with more histories than there is time
        and memory for.
    """
    if criterion not in CRITERIA:
        raise located("criterion", criterion, f"one of {', '.join(CRITERIA)}")
    if not (np.isfinite(alpha) and 0 < alpha <= 1):
        raise located("alpha", alpha, "a share above 0 and up to 1")
    if mean_share and criterion != "cvar":
        raise located("share of the mean", mean_share, f"none with criterion {criterion}: only cvar takes one")
    if served is not None and not (np.isfinite(served) and served > 0):
        raise located("people served", served, "a positive number")
    if not (np.isfinite(cost) and cost >= 0):
        raise located("cost of a participant", cost, "a number of at least 0")
    if cost and served is None:
        raise located("people served", None, "a number: what participants cost is set against what people gain")

    def told(step: str) -> Callable[[int, int], None] | None:
        return None if progress is None else lambda done, total: progress(step, done, total)

    alike: dict[tuple[int, ...], list[NextStudy]] = {}
    for one in asked:
        alike.setdefault(one.sizes, []).append(one.study)
    # Before minutes have gone into the plans.
    for sizes, studies in alike.items():
        check_room(studies, schedule.draws.n_draws, sizes, replicates)
    own = own_plans(schedule, executor)
    plan = solve_schedule(schedule)
    perfect = perfect_information(schedule, kinds=kinds, chains=chains, sampled=sampled, executor=executor)
    outcome: Outcome = {"regret": "regret", "gain": "gain"}.get(criterion.split("-")[0], "value")  # type: ignore[assignment]
    reference = perfect.optima if outcome == "regret" else outcome_reference(schedule, outcome, kinds=kinds)
    level = {"bayes": 1.0, "regret": 0.0}.get(criterion, alpha)
    mixture = cautious_plan(
        schedule, level, mean_share=mean_share, reference=reference, kinds=kinds, start=[plan.decisions]
    )
    candidates = standard_candidates(schedule, alpha=alpha, mean_share=mean_share, kinds=kinds, plug_in=plug_in)
    prices = price(
        schedule, candidates, alpha=alpha, kinds=kinds, chains=chains, optima=perfect.optima, executor=executor,
        progress=told("plans"),
    )  # fmt: skip
    single = best_single(mixture, _single_plans(schedule, prices, own))
    # A search for mixtures that had to stop early may have missed even the best single plan.
    chosen = single.cautious if not lots or single.worth > mixture.lower + mixture.tolerance else mixture
    partial = partial_information(
        schedule, kinds=kinds, chains=chains, perfect=perfect, executor=executor, progress=told("blocks")
    )
    samples = tuple(
        sample_information(
            schedule, studies, sizes, replicates=replicates, seed=seed, kinds=kinds, served=served, cost=cost,
            perfect=perfect, executor=executor, progress=told("further studies"),
        )
        for sizes, studies in alike.items()
    )  # fmt: skip
    # A tail of fewer than ten draws says more about these draws than about what is believed.
    levels = tuple(a for a in LEVELS if a * len(perfect.groups) >= FEWEST_IN_TAIL) if sampled else LEVELS
    frontiers: dict[str, Frontier] = {}
    flips: tuple[Flip, ...] = ()
    together: tuple[Flip, ...] = ()
    if with_frontier:
        frontiers["these costs"] = frontier(
            schedule, levels or (1.0,), kinds=kinds, executor=executor, progress=told("frontier")
        )
        flips = flip_points(schedule)
        flipped, together = contested(schedule)
        costs = {a: c for f in together if f.multiple is not None for a, c in f.costs.items() if c}
        if costs:
            name = f"contested costs ({', '.join(f'{a} {c:.3g}' for a, c in costs.items())})"
            frontiers[name] = frontier(
                flipped, levels or (1.0,), kinds=kinds, executor=executor, progress=told("contested frontier")
            )
    stability = decision_stability(schedule, plan, executor=executor, kinds=kinds)
    personal = personalised(schedule, kinds) if kinds > 1 else None
    return RobustStudy(
        schedule, criterion, alpha, plan, chosen, single, own, prices, stability, perfect, partial, samples,
        frontiers, flips, together, personal,
    )  # fmt: skip


def _single_plans(schedule: Schedule, prices: PriceList, own: OwnPlans) -> tuple[Decisions, ...]:
    """Plans that are priced, each one of a mixture, what policies without chance do, and the draws' own plans."""
    chosen = [p.chosen for p in prices.prices]
    policies = [decisions_of(c.policy, schedule) for c in chosen if c.policy is not None]
    return pooled([*(plan for c in chosen for plan in c.plans), *policies, *own.plans[:OWN_PLANS]])


def robust_fields(study: RobustStudy) -> dict[str, Any]:
    """Fields of the command's JSON."""
    weight, optima = study.perfect.groups.weight, study.perfect.optima
    quantiles = dict(zip(("q05", "q50", "q95"), weighted_quantiles(optima, weight, (0.05, 0.5, 0.95)), strict=True))
    first = study.stability.standings[0]
    return {
        "criterion": study.criterion, "alpha": study.alpha, "value": study.value, "gap": study.chosen.gap,
        "certified": study.chosen.certified, "bayes_value": study.plan.value,
        "first_action": study.plan.first_action, "first_action_shares": first.share,
        "first_action_losses": first.loss,
        "optimal_values": {"mean": float(weight @ optima), **quantiles},
        "plans": {p.name: p.to_dict() for p in study.prices.prices},
        "evpi": study.perfect.value,
        "evppi": {
            r.block: {"worth": r.worth, "se": r.se, "in_sample": r.in_sample} for r in study.partial.rows
        },
        "evppi_enough": study.partial.enough,
        "evsi": [
            {
                "study": r.study, "participants": r.people, "worth": r.worth, "se": r.se,
                "held_out": r.held_out, "held_out_se": r.held_out_se, "pathwise": r.pathwise,
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
        "mixture": study.chosen.rows(),
        "without_lots": study.told(study.single.worth),
        "without_lots_proven": study.single.proven, "without_lots_plans": study.single.looked,
        "agreement": study.stability.agreement, "stability": study.stability.rows(),
        "beliefs": study.stability.beliefs,
        "own_plans": len(study.own.plans), "sentence": study.sentence,
    }  # fmt: skip
