r"""What plans are worth under doubt, and what the usual shortcuts cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.model_draws import ModelDraws
from models.planning.baselines import never
from models.planning.evaluation import evaluate_schedule
from models.planning.schedule import Array, Schedule
from models.robust.candidates import Candidate, Chosen
from models.robust.own_plans import OwnPlans, own_plans
from models.robust.risk import RiskSet, cvar


@dataclass(frozen=True)
class Price:
    """One plan under doubt; all in reward units a person.

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
    values : float64[d]
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
class PriceList:
    """Plans side by side.

    Attributes
    ----------
    schedule : Schedule
    alpha : float
    prices : tuple of Price
    own : OwnPlans
        Every draw's own optimum.
    never : float64[d]
        What never helping is worth in every draw.
    """

    schedule: Schedule
    alpha: float
    prices: tuple[Price, ...]
    own: OwnPlans
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
    def sentence(self) -> str:
        """Best plan, and what the shortcuts lose."""
        best = max(self.prices, key=lambda p: p.mean)
        lost = {p.name: best.mean - p.mean for p in self.prices if p is not best}
        named = [
            n for n in ("plug-in estimate", "posterior mean", "fixed sequence", "always", "never") if n in lost
        ]
        return (
            f"{best.name} is worth {best.mean:.4g} reward units a person on average and {best.cvar:.4g} in the "
            f"worst {self.alpha:.0%} of the draws; against never helping it gains {best.gain_mean:.3g} (5% to "
            f"95% of the draws: {best.gain_q05:.3g} to {best.gain_q95:.3g}; better in "
            f"{best.gain_probability:.0%}). "
            "Lost by " + ", ".join(f"{n} {lost[n]:.2g}" for n in named) + "."
        )  # fmt: skip


def price(
    schedule: Schedule,
    candidates: Sequence[Candidate],
    *,
    alpha: float = 0.1,
    seed: int = 1,
    own: OwnPlans | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PriceList:
    """Score plans on all draws, and on draws that had no part in choosing them.

    Parameters
    ----------
    schedule : Schedule
    candidates : sequence of Candidate
    alpha : float
        Share of the draws that counts as the lower tail.
    seed : int
        Of the split into halves.
    own : OwnPlans, optional
        If at hand.
    progress : callable, optional
        Called with candidates done and candidates in all.

    Raises
    ------
    InputError
        If two candidates have the same name.
    """
    names = [c.name for c in candidates]
    if len(set(names)) < len(names):
        raise located("candidates, names", names, "different names")
    own = own or own_plans(schedule)
    weight = schedule.draws.weight
    RiskSet(weight, alpha)
    nothing = evaluate_schedule(never(schedule.protocol), schedule).values
    halves = _halves(schedule, seed)
    out = []
    for i, candidate in enumerate(candidates):
        chosen = candidate.choose(schedule)
        values = chosen.values(schedule)
        apart = values if not candidate.looks or halves is None else _held_out(schedule, candidate, halves)
        regret, gain = own.values - values, values - nothing
        low, high = weighted_quantiles(gain, weight, (0.05, 0.95))
        out.append(
            Price(
                candidate.name, candidate.about, float(weight @ values), cvar(values, weight, alpha),
                float(values[weight > 0].min()), float(regret[weight > 0].max()), float(weight @ regret),
                -cvar(-regret, weight, alpha), float(weight @ gain), low, high,
                float(weight[gain > 1e-9 * np.abs(values).max()].sum()), cvar(gain, weight, alpha),
                float(weight @ apart), cvar(apart, weight, alpha), values, chosen,
            )
        )  # fmt: skip
        if progress is not None:
            progress(i + 1, len(candidates))
    return PriceList(schedule, alpha, tuple(out), own, nothing)


def _halves(schedule: Schedule, seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Two halves of the draws at random; None where one would have no weight."""
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,))).permutation(schedule.draws.n_draws)
    half = len(order) // 2
    first, second = np.sort(order[:half]), np.sort(order[half:])
    weight = schedule.draws.weight
    if half == 0 or weight[first].sum() <= 0 or weight[second].sum() <= 0:
        return None
    return first, second


def _held_out(
    schedule: Schedule, candidate: Candidate, halves: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> Array:  # fmt: skip
    """Value in every draw of what was chosen on the half that the draw is not in."""
    out = np.empty(schedule.draws.n_draws)
    for own, other in (halves, halves[::-1]):
        chosen = candidate.choose(replace(schedule, draws=some_draws(schedule.draws, own)))
        out[other] = chosen.values(replace(schedule, draws=some_draws(schedule.draws, other)))
    return out


def some_draws(draws: ModelDraws, keep: NDArray[np.int64]) -> ModelDraws:
    """Some of the draws, weights renormalised."""
    weight = draws.weight[keep]
    return replace(
        draws, initial=draws.initial[keep], transition=draws.transition[keep], emission=draws.emission[keep],
        weight=weight / weight.sum(),
    )  # fmt: skip


def weighted_quantiles(values: Array, weight: Array, levels: Sequence[float]) -> list[float]:
    """Quantiles of weighted draws: the smallest value at which the cumulated weight reaches the level."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weight[order])
    places = np.minimum(np.searchsorted(total, np.asarray(levels) - 1e-12), len(order) - 1)
    return np.asarray(values[order][places]).tolist()
