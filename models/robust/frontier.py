"""What caution costs on average and buys in the lower tail."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.notebook_view import NotebookView
from models.planning.schedule import Array, Schedule
from models.robust.cautious import CautiousPlan, cautious_plan
from models.robust.plan_table import PlanTable
from models.robust.risk import cvar
from models.spread_out import chunks, spread_out

LEVELS = (1.0, 0.9, 0.75, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.01)
"""Shares of the draws that the frontier is drawn at."""

TOGETHER = 5
"""Neighbouring levels that are one piece of work: plans of one save most of the work on the next."""


@dataclass(frozen=True)
class Frontier(NotebookView):
    r"""Best plans from the mean to the tail.

    Attributes
    ----------
    schedule : Schedule
    plans : tuple of CautiousPlan
        One a level.
    bayes_tail : tuple of float
        :math:`\mathrm{CVaR}` of the Bayes-adaptive plan at each level.
    """

    schedule: Schedule
    plans: tuple[CautiousPlan, ...]
    bayes_tail: tuple[float, ...]

    def rows(self) -> list[dict[str, Any]]:
        """One row a level: criterion, gap, mean, tail (also of the Bayes-adaptive plan), size of the mixture."""
        return [
            {
                "alpha": p.risk.alpha, "mean_share": p.risk.mean_share, "criterion": p.lower, "gap": p.gap,
                "mean": p.mean, "cvar": tail(p), "bayes_cvar": bayes, "plans": len(p.plans),
                "iterations": p.iterations, "certified": p.certified,
            }
            for p, bayes in zip(self.plans, self.bayes_tail, strict=True)
        ]  # fmt: skip

    @property
    def table(self) -> Any:
        """`rows` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.rows())

    @property
    def largest_gain(self) -> tuple[float, CautiousPlan]:
        """Largest gain in the tail over the Bayes-adaptive plan, and the plan that has it."""
        gains = [tail(p) - bayes for p, bayes in zip(self.plans, self.bayes_tail, strict=True)]
        return max(gains), self.plans[int(np.argmax(gains))]

    @property
    def sentence(self) -> str:
        """Whether caution changes anything, and what it costs."""
        scale = max(1.0, abs(self.plans[0].mean))
        gain, at = self.largest_gain
        if gain <= 1e-9 * scale:
            return "The Bayes-adaptive plan is also the cautious plan at every level: caution changes nothing here."
        cost = max(p.mean for p in self.plans) - at.mean
        small = (
            " That is little: the spread of values comes from what people are like." if gain < 0.01 * scale else ""
        )
        return (
            f"Caution buys at most {gain:.2g} {self.schedule.unit} in the worst {100 * at.risk.alpha:.3g}% of the "
            f"draws and costs {cost:.2g} on average there.{small}"
        )


def tail(plan: CautiousPlan) -> float:
    r""":math:`\mathrm{CVaR}` of a cautious plan at its own level, without the share of the mean."""
    return cvar(plan.values - plan.reference, plan.risk.weight, plan.risk.alpha)


def frontier(
    schedule: Schedule,
    levels: Sequence[float] = LEVELS,
    *,
    mean_shares: Sequence[float] = (),
    reference: Array | None = None,
    kinds: int = 1,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Frontier:
    """Cautious plans from the mean to the tail; plans found at one level start its neighbours.

    Parameters
    ----------
    schedule : Schedule
    levels : sequence of float
        Shares of the draws that count.
    mean_shares : sequence of float, optional
        With one level: shares of the mean in the criterion, the classical frontier of mean against CVaR.
    reference : float64[u], optional
    kinds : int
        As in `models.robust.cautious.cautious_plan`.
    executor : concurrent.futures.Executor, optional
        What runs of neighbouring levels are spread over; threads by default. No result depends on it.
    progress : callable, optional
        Called with such runs done and in all.
    """
    settings = [(a, k) for a in levels for k in (mean_shares or (0.0,))]
    bayes = cautious_plan(schedule, 1.0, reference=reference, kinds=kinds)
    pieces = [(bayes.table, reference, kinds, settings[part]) for part in chunks(len(settings), TOGETHER)]
    plans = tuple(plan for part in spread_out(executor, _neighbours, pieces, progress) for plan in part)
    outcomes = bayes.values - bayes.reference
    return Frontier(schedule, plans, tuple(cvar(outcomes, bayes.risk.weight, a) for a, _ in settings))


def _neighbours(
    piece: tuple[PlanTable, Array | None, int, Sequence[tuple[float, float]]],
) -> list[CautiousPlan]:
    """Plans of some neighbouring settings, each search begun with what was found before."""
    table, reference, kinds, settings = piece
    out = []
    for alpha, kappa in settings:
        out.append(
            cautious_plan(table.schedule, alpha, mean_share=kappa, reference=reference, kinds=kinds, start=table)
        )
        table = out[-1].table
    return out
