r"""The best plan of a cautious analyst, over randomised history policies, exactly: column generation.

The master problem (`models.robust.master`) mixes the plans found so far and names the draws that the mixture fares
worst in. One Bayes tree with these weights finds the plan that does best there. When no plan does better than the
mixture, the mixture is optimal. Both bounds are recomputed from values, outside the linear program: from below the
criterion of the mixture, from above :math:`\max_\pi \sum_i q_i X_i(\pi)` for weights `q` projected onto their set.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.errors import located
from models.notebook_view import NotebookView, View, frame_rows
from models.planning.exact import Decisions, responses_before
from models.planning.schedule import Array, Schedule
from models.robust.draw_groups import DrawGroups
from models.robust.master import mix
from models.robust.plan_table import PlanTable
from models.robust.risk import RiskSet

ITERATIONS = 500
"""Plans that are looked for at most."""

GAP = 1e-9
"""Gap at which the search stops, times the largest value (at least 1)."""

MOST_NAMED = 3
"""Histories that are named one by one where a plan is written out."""

SMALLEST_SHARE = 1e-12
"""Shares of plans below this are left out of a mixture, before its value is computed."""


@dataclass(frozen=True)
class CautiousPlan(NotebookView):
    r"""A mixture of plans: one is drawn before the first event and followed to the end.

    Attributes
    ----------
    schedule : Schedule
    groups : DrawGroups
        Rows of the schedule's draws that are kinds of people within one and the same draw: what is doubtful is the
        draw, not who comes next, so outcomes are means over kinds.
    risk : RiskSet
    reference : float64[u]
        What outcomes are counted from.
    plans : tuple of Decisions
    share : float64[p]
        How often each is drawn.
    values : float64[u]
        What the mixture is worth in each draw, :math:`\sum_p \lambda_p V_i(\pi_p)`.
    lower, upper : float
        The criterion of this mixture, and a bound that no policy exceeds.
    weight : float64[u]
        Weights of the draws that the bound was found with.
    iterations : int
        Bayes trees that were solved.
    table : PlanTable
        All plans looked at.
    tolerance : float
        Gap that was wanted.
    """

    schedule: Schedule
    groups: DrawGroups
    risk: RiskSet
    reference: Array
    plans: tuple[Decisions, ...]
    share: Array
    values: Array
    lower: float
    upper: float
    weight: Array
    iterations: int
    table: PlanTable
    tolerance: float

    @property
    def gap(self) -> float:
        """How much better another policy could be, at most."""
        return self.upper - self.lower

    @property
    def certified(self) -> bool:
        """Whether the gap is what was wanted."""
        return self.gap <= self.tolerance

    @property
    def mean(self) -> float:
        """Mean value of the mixture by what is believed."""
        return float(self.groups.weight @ self.values)

    @property
    def deterministic(self) -> bool:
        """Whether one plan is always followed."""
        return len(self.plans) == 1

    def rows(self) -> list[dict[str, Any]]:
        """The mixture readable: each plan's share, and what it does at each event after which responses."""
        mixed = sorted(zip(self.plans, self.share, strict=True), key=lambda x: -x[1])
        return [{"share": float(share), **plan_words(self.schedule, plan)} for plan, share in mixed]

    def _view(self) -> View:
        told = (
            f"{len(self.plans)} plan{'s' * (len(self.plans) != 1)}, one drawn before the first event: worth "
            f"{self.lower:.4g} by the criterion, no policy more than {self.upper:.4g}; mean over the "
            f"draws {self.mean:.4g}."
        )
        warnings = () if self.certified else (f"the gap of {self.gap:.3g} is wider than was asked for.",)
        return View("Cautious plan", "", warnings, (), (told,), (frame_rows(self.rows(), ".rows()"),))


def plan_words(schedule: Schedule, plan: Decisions) -> dict[str, str]:
    """What a plan does at each event, after which responses."""
    return {
        f"event {k + 1} ({schedule.mode(k).letter})": _level_words(schedule, k, level)
        for k, level in enumerate(plan)
    }


def acting_words(schedule: Schedule, plan: Decisions) -> list[str]:
    """What a plan does at the events at which it may act, and nothing of those at which it never does."""
    words = plan_words(schedule, plan)
    idle = [schedule.mode(k).null_action for k in range(schedule.n_events)]
    acts = [f"{event} {w}" for (event, w), null in zip(words.items(), idle, strict=True) if w != null]
    return acts or ["never acts"]


def _level_words(s: Schedule, k: int, level: Any) -> str:
    """What a plan does at one event: what it mostly does, and after which responses something else."""
    names = [a.name for a in s.mode(k).actions]
    kinds, counts = np.unique(level, return_counts=True)
    usual = kinds[np.argmax(counts)]
    words = [names[int(usual)]]
    for a in kinds[kinds != usual]:
        after = np.flatnonzero(level == a)
        if len(after) > MOST_NAMED:
            words.append(f"{names[int(a)]} after {len(after)} of {len(level)} histories")
        else:
            told = " or ".join(f"({', '.join(responses_before(s, k, int(r)))})" for r in after)
            words.append(f"{names[int(a)]} after {told}")
    return "; ".join(words)


def cautious_plan(
    schedule: Schedule,
    alpha: float = 0.1,
    *,
    mean_share: float = 0.0,
    reference: Array | None = None,
    kinds: int = 1,
    start: Sequence[Decisions] | PlanTable = (),
    tolerance: float | None = None,
) -> CautiousPlan:
    r"""Maximise :math:`\kappa\,E[X] + (1 - \kappa)\,\mathrm{CVaR}_\alpha[X]` over randomised history policies.

    Parameters
    ----------
    schedule : Schedule
        With the draws and what is believed of them.
    alpha : float
        Share of the draws that counts; 1 is the mean, 0 the worst draw.
    mean_share : float
        `kappa`.
    reference : float64[u], optional
        What outcomes are counted from, one a draw: the draws' optima (``perfect_information(schedule).optima``) for
        regret, what never helping is worth for the gain; nothing by default.
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`).
    start : sequence of Decisions, or PlanTable
        Plans to begin with; those of an earlier search save most of the work.
    tolerance : float, optional
        Gap that is small enough; ``1e-9 max(1, largest |V|)`` by default.

    Raises
    ------
    InputError
        On a criterion that is none, a reference that does not fit, a schedule with too many histories.
    """
    groups = DrawGroups.of(schedule.draws, kinds)
    risk = RiskSet(groups.weight, alpha, mean_share)
    n = len(groups)
    against = np.zeros(n) if reference is None else np.asarray(reference, dtype=np.float64)
    if against.shape != (n,) or not np.isfinite(against).all():
        raise located("criterion, reference", against.shape, f"{n} finite numbers, one a draw")
    table = start if isinstance(start, PlanTable) else PlanTable.of(schedule, start)
    table = table.with_plans([table.best.plan(groups.expand(risk.weight))])
    wanted = GAP * max(1.0, float(np.abs(table.values).max())) if tolerance is None else tolerance
    lower, upper, iterations = -np.inf, np.inf, 1
    best: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
    bound_weight = risk.weight
    while True:
        outcomes = groups.mean(table.values)
        found = mix(outcomes - against, risk)
        share = np.where(found.share > SMALLEST_SHARE, found.share, 0.0)
        share /= share.sum()
        values = share @ outcomes
        worth, _ = risk.lowest(values - against)
        if worth > lower:
            lower, best = worth, (share, values)
        q = risk.project(found.weight)
        answer = table.best.plan(groups.expand(q))
        iterations += 1
        known = len(table.plans)
        table = table.with_plans([answer])
        bound = float(q @ (groups.mean(table.values[table.row(answer)]) - against))
        if bound < upper:
            upper, bound_weight = bound, q
        # Rounding may put the two a hair the wrong way round.
        upper = max(upper, lower)
        if upper - lower <= wanted or len(table.plans) == known or iterations >= ITERATIONS:
            break
    share, values = best
    kept = np.flatnonzero(share > 0)
    return CautiousPlan(
        schedule, groups, risk, against, tuple(table.plans[i] for i in kept), share[kept], values, lower, upper,
        bound_weight, iterations, table, wanted,
    )  # fmt: skip
