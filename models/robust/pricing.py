r"""What plans are worth under doubt, and what the usual shortcuts cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.notebook_view import NotebookView
from models.planning.baselines import never
from models.planning.evaluation import evaluate_schedule
from models.planning.schedule import Array, Schedule
from models.robust.candidates import BASELINE, Candidate, Chosen
from models.robust.draw_error import check_chains
from models.robust.draw_groups import DrawGroups
from models.robust.information import SAME, beyond_rounding, own_optima
from models.robust.risk import RiskSet, cvar, weighted_quantiles
from models.spread_out import spread_out

NEVER = "never"
"""The baseline that gains are counted from."""


@dataclass(frozen=True)
class Price:
    """One plan under doubt; all a person, in the unit of the reward.

    Attributes
    ----------
    name, about : str
    mean, cvar, worst : float
        Mean value, mean of the worst `alpha` share of the draws, value in the worst draw.
    max_regret, mean_regret, cvar_regret : float
        Against each draw's own optimum: largest, mean, and mean of the largest `alpha` share.
    gain_mean, gain_q05, gain_q95, gain_probability, gain_cvar : float
        Of the gain over never helping in the same draw: mean, quantiles, probability of being above zero, mean of
        the worst `alpha` share.
    held_out_mean, held_out_cvar : float
        The same chosen on one half of the draws and scored on the other, both ways round.
    values : float64[u]
    chosen : Chosen
    """

    name: str
    about: str
    mean: float
    cvar: float
    worst: float
    max_regret: float
    mean_regret: float
    cvar_regret: float
    gain_mean: float
    gain_q05: float
    gain_q95: float
    gain_probability: float
    gain_cvar: float
    held_out_mean: float
    held_out_cvar: float
    values: Array = field(repr=False)
    chosen: Chosen = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Fields of the command's JSON."""
        gain = {"mean": self.gain_mean, "q05": self.gain_q05, "q95": self.gain_q95, "probability":
                self.gain_probability, "cvar": self.gain_cvar}  # fmt: skip
        return {
            "about": self.about, "mean": self.mean, "cvar": self.cvar, "worst": self.worst,
            "max_regret": self.max_regret, "mean_regret": self.mean_regret, "cvar_regret": self.cvar_regret,
            "gain": gain, "held_out": {"mean": self.held_out_mean, "cvar": self.held_out_cvar},
        }  # fmt: skip


@dataclass(frozen=True)
class PriceList(NotebookView):
    """Plans side by side.

    Attributes
    ----------
    schedule : Schedule
    groups : DrawGroups
        Rows of the schedule's draws that are kinds of people within one draw.
    alpha : float
    prices : tuple of Price
    optima : float64[u]
        Every draw's own optimum.
    never : float64[u]
        What never helping is worth in every draw.
    """

    schedule: Schedule
    groups: DrawGroups
    alpha: float
    prices: tuple[Price, ...]
    optima: Array
    never: Array

    def __getitem__(self, name: str) -> Price:
        """The price of a plan by name."""
        return next(p for p in self.prices if p.name == name)

    @property
    def table(self) -> Any:
        """One row a plan, best mean first, as a data frame."""
        import pandas as pd

        shown = [k for k in Price.__dataclass_fields__ if k not in ("values", "chosen", "about")]
        rows = [{k: getattr(p, k) for k in shown} for p in self.prices]
        return pd.DataFrame(rows).sort_values("mean", ascending=False, kind="stable", ignore_index=True)

    @property
    def best(self) -> Price:
        """The plan with the largest mean, the first of equals: the Bayes-adaptive one where it was priced."""
        return max(self.prices, key=lambda p: p.mean)

    @property
    def best_baseline(self) -> str:
        """The baseline that is worth in every draw what the best plan is; empty if none is.

        The best plan under doubt is then that simple rule, whatever a plan for one model begins with.
        """
        best = self.best
        scale = SAME * max(1.0, float(np.abs(best.values).max()))
        for p in self.prices:
            if p.about.startswith(BASELINE) and p is not best and np.allclose(p.values, best.values, 0.0, scale):
                return p.name
        return ""

    @property
    def sentence(self) -> str:
        """Best plan, and what the shortcuts lose."""
        best, same = self.best, self.best_baseline
        lost = {p.name: best.mean - p.mean for p in self.prices if p is not best and p.name != same}
        named = [
            n for n in ("plug-in estimate", "posterior mean", "fixed sequence", "always", "never") if n in lost
        ]
        worth = (
            f"{best.name} is worth {best.mean:.4g} {self.schedule.unit} a person on average and {best.cvar:.4g} in "
            f"the worst {100 * self.alpha:.3g}% of the draws"
        )
        gain = (
            f"against never helping it gains {best.gain_mean:.3g} (5% to 95% of the draws: {best.gain_q05:.3g} to "
            f"{best.gain_q95:.3g}; better in {best.gain_probability:.0%})"
        )
        if same:
            told = f"in every draw just what '{same}' is worth: under all this doubt the best plan is '{same}'"
            worth += f", {told}" if same == NEVER else f", {told}; {gain}"
        else:
            worth += f"; {gain}"
        losses = ", ".join(f"{n} {lost[n]:{'.2g' if lost[n] < 99.5 else ',.0f'}}" for n in named)
        return f"{worth}." + (f" Lost by {losses}." if losses else "")


def price(
    schedule: Schedule,
    candidates: Sequence[Candidate],
    *,
    alpha: float = 0.1,
    kinds: int = 1,
    chains: int | None = None,
    optima: Array | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PriceList:
    """Score plans on all draws, and on draws that had no part in choosing them.

    Parameters
    ----------
    schedule : Schedule
    candidates : sequence of Candidate
    alpha : float
        Share of the draws that counts as the lower tail.
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`). A plan is then worth the
        mean over them: what is doubtful is the draw, not who comes next.
    chains : int, optional
        Chains that the draws come from, one after the other and equally long: each is cut in half, so that
        neighbours stay together.
    optima : float64[u], optional
        Draws' optima (`models.robust.information.perfect_information`), if at hand.
    executor : concurrent.futures.Executor, optional
        What candidates are spread over; threads by default.
    progress : callable, optional
        Called with candidates done and candidates in all.

    Raises
    ------
    InputError
        If two candidates have the same name, or the draws cannot be cut into kinds or chains.
    """
    names = [c.name for c in candidates]
    if len(set(names)) < len(names):
        raise located("candidates, names", names, "different names")
    groups = DrawGroups.of(schedule.draws, kinds)
    check_chains(len(groups), chains)
    best = own_optima(schedule, groups, executor) if optima is None else optima
    weight = groups.weight
    RiskSet(weight, alpha)
    nothing = groups.mean(evaluate_schedule(never(schedule.protocol), schedule).values)
    half = groups.folds(2, chains)
    cut = len(groups) > 1 and all(weight[half == h].sum() > 0 for h in (0, 1))
    pieces = [(schedule, c, groups, half if c.looks and cut else None) for c in candidates]
    found = spread_out(executor, _scored, pieces, progress)
    out = []
    for candidate, (chosen, values, apart) in zip(candidates, found, strict=True):
        scale = max(1.0, float(np.abs(values).max()))
        regret, gain = beyond_rounding(best - values, scale), values - nothing
        gain = np.where(np.abs(gain) > SAME * scale, gain, 0.0)
        low, high = weighted_quantiles(gain, weight, (0.05, 0.95))
        out.append(
            Price(
                candidate.name, candidate.about, float(weight @ values), cvar(values, weight, alpha),
                float(values[weight > 0].min()), float(regret[weight > 0].max()), float(weight @ regret),
                -cvar(-regret, weight, alpha), float(weight @ gain), low, high, float(weight[gain > 0].sum()),
                cvar(gain, weight, alpha), float(weight @ apart), cvar(apart, weight, alpha), values, chosen,
            )
        )  # fmt: skip
    return PriceList(schedule, groups, alpha, tuple(out), best, nothing)


def _scored(
    piece: tuple[Schedule, Candidate, DrawGroups, NDArray[np.int64] | None],
) -> tuple[Chosen, Array, Array]:
    """What is chosen, its value in every draw, and that of what is chosen without the draw's half of the draws."""
    schedule, candidate, groups, half = piece
    chosen = candidate.choose(schedule)
    values = groups.mean(chosen.values(schedule))
    return chosen, values, values if half is None else _held_out(schedule, candidate, groups, half)


def _held_out(schedule: Schedule, candidate: Candidate, groups: DrawGroups, half: NDArray[np.int64]) -> Array:
    """Value in every draw of what was chosen on the half that the draw is not in."""
    out = np.empty(len(groups))
    row = np.repeat(half, groups.kinds)
    for h in (0, 1):
        own = replace(schedule, draws=schedule.draws.some(np.flatnonzero(row != h)))
        other = schedule.draws.some(np.flatnonzero(row == h))
        scored = candidate.choose(own).values(replace(schedule, draws=other))
        out[half == h] = DrawGroups(groups.weight[half == h], groups.share[half == h]).mean(scored)
    return out
