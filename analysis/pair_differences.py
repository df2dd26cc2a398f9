"""What differs between two sides: responses, predictions, plans, each with the doubt of both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from analysis.response_rates import response_rates
from analysis.side_by_side import Side
from analysis.wording import counted
from models.baum_welch import BaumWelch
from models.errors import located
from models.events import EventLog
from models.inference import run_log_likelihoods
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.parameters import Array
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.simulation import simulate_responses
from models.spread_out import spread_out

LEVEL = 0.95
STREAM_TEST = 7_302
"""First element of the spawn key of the simulated pairs."""


def rate_differences(a: EventLog, b: EventLog) -> pd.DataFrame:
    """Response rates by round and action, and B less A.

    The interval of a difference puts the two intervals together (MOVER, Zou & Donner 2008), so it knows whatever
    they know: Wilson's for shares, and that people repeat.

    Returns
    -------
    DataFrame
        ``k, action``, then of each side ``responses_a, rate_a, low_a, high_a`` (and b), ``difference, low, high``.
    """
    tables = []
    for log in (a, b):
        names = np.asarray(log.protocol.action_names)
        tables.append(response_rates(log, {"k": log.k, "action": names[log.action]}, LEVEL))
    own = ["responses", "rate", "low", "high"]
    left, right = (
        t[["k", "action", *own]].rename(columns={c: f"{c}_{side}" for c in own})
        for t, side in zip(tables, "ab", strict=True)
    )
    both = left.merge(right, on=["k", "action"], how="inner").sort_values(["k", "action"], ignore_index=True)
    d = both["rate_b"] - both["rate_a"]
    low = d - np.hypot(both["rate_b"] - both["low_b"], both["high_a"] - both["rate_a"])
    high = d + np.hypot(both["high_b"] - both["rate_b"], both["rate_a"] - both["low_a"])
    return both.assign(difference=d, low=low, high=high)


def cross_prediction(a: Side, b: Side, states: int) -> pd.DataFrame:
    """How well each side's model predicts the people of both.

    Returns
    -------
    DataFrame
        ``people`` (whose), ``model`` (of which side), ``per_response`` (log score a response), ``loss`` (what the
        other side's model loses a response against the own one), with ``low, high`` (95%, over people), and
        ``no_chance`` (people whose responses the model holds impossible; the loss is infinite if there are any, and
        has no interval). The own model has seen its people, so a small loss is expected even where nothing differs.

    Raises
    ------
    InputError
        If a side has no data.
    """
    rows = []
    for whose, other in ((a, b), (b, a)):
        if whose.log is None:
            raise located(f"side {whose.label}", whose.name, "a data set: a fit has nobody to predict")
        log, n = whose.log, whose.log.n_responses_recorded
        scores = {s.label: run_log_likelihoods(s.estimates[states], log) for s in (whose, other)}
        _, person = np.unique(log.participant, return_inverse=True)
        lost = np.bincount(person, scores[whose.label] - scores[other.label])
        known = len(lost) > 1 and bool(np.isfinite(lost).all())
        half = 1.96 * lost.std(ddof=1) * np.sqrt(len(lost)) if known else np.nan
        for side in (whose, other):
            own = side is whose
            rows.append({
                "people": whose.label, "model": side.label, "per_response": scores[side.label].sum() / n,
                "loss": 0.0 if own else lost.sum() / n, "low": np.nan if own else (lost.sum() - half) / n,
                "high": np.nan if own else (lost.sum() + half) / n,
                "no_chance": len(np.unique(person[np.isneginf(scores[side.label])])),
            })  # fmt: skip
    return pd.DataFrame(rows)


@dataclass(frozen=True)
class SameModelTest(NotebookView):
    """Whether one model for both sides does as well as one each.

    Attributes
    ----------
    states, free : int
        Number of states; how many more parameters two models have.
    statistic : float
        Twice the log-likelihood of two models less that of one.
    null : float64[replicates]
        The statistic where one model is true: both studies simulated from it and fitted again.
    p_value : float
        Share of the replicates, the data themselves counted in, that reach the statistic.
    """

    states: int
    free: int
    statistic: float
    null: Array
    p_value: float

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        return (
            f"Two models of {counted(self.states, 'state')} instead of one for both gain {self.statistic:.1f} in "
            f"twice the log-likelihood; where one model is true they gain {np.median(self.null):.1f} in the median "
            f"and {np.quantile(self.null, 0.95):.1f} in one study of twenty ({len(self.null)} simulated pairs; "
            f"p = {self.p_value:.3f}, parametric bootstrap)."
        )


def same_model_test(
    a: EventLog, b: EventLog, states: int, settings: BaumWelch, replicates: int = 99, *,
    progress: Callable[[int, int], None] | None = None, executor: Executor | None = None,
) -> SameModelTest:  # fmt: skip
    """Likelihood-ratio test of one model for both data sets, by parametric bootstrap.

    The chi-squared limit does not hold: entries sit on the boundary of the simplex and states can coincide.

    Parameters
    ----------
    a, b : EventLog
    states : int
    settings : BaumWelch
        Of every fit; its seed is that of the simulated pairs, too.
    replicates : int
    progress : callable, optional
        Called with (pairs done, pairs in all).
    executor : concurrent.futures.Executor, optional
        What simulated pairs are spread over; threads of this process by default. The result does not depend on it.
    """
    both = pooled(a, b)
    pooled_fit = settings.fit(both)
    separate = sum(settings.fit(log).log_likelihood for log in (a, b))
    statistic = max(0.0, 2 * (separate - pooled_fit.log_likelihood))
    one = partial(_simulated_gain, pooled_fit.model, a, b, settings, states)
    gains = spread_out(
        executor, one, range(replicates), progress,
        names=lambda i: f"simulated pair {i} at {counted(states, 'state')} (seed {settings.seed})",
    )  # fmt: skip
    null = np.array(gains)
    p = (1 + int((null >= statistic).sum())) / (replicates + 1)
    return SameModelTest(states, pooled_fit.n_parameters, statistic, null, p)


def _simulated_gain(
    model: LatentStatePOMDP, a: EventLog, b: EventLog, settings: BaumWelch, states: int, index: int
) -> float:
    """Twice the log-likelihood that two models gain where one is true."""
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(STREAM_TEST, states, index)))
    pair = [simulate_responses(model, log, rng)[0] for log in (a, b)]
    apart = sum(settings.fit(log).log_likelihood for log in pair)
    return max(0.0, 2 * (apart - settings.fit(pooled(*pair)).log_likelihood))


def pooled(a: EventLog, b: EventLog) -> EventLog:
    """Both data sets as one; people of B are other people than those of A.

    Raises
    ------
    InputError
        If they follow different protocols.
    """
    if a.protocol != b.protocol:
        raise located("pooled data, protocol", b.protocol.name, a.protocol.name)
    frames = [log.to_frame().assign(study="both") for log in (a, b)]
    frames[1]["participant"] += int(frames[0]["participant"].max()) + 1 - int(frames[1]["participant"].min())
    shared = [c for c in frames[0].columns if c in frames[1].columns]
    joined = pd.concat([f[shared] for f in frames], ignore_index=True)
    return EventLog.from_frame(joined, a.protocol, "both data sets")


def plan_exchange(a: Side, b: Side, states: int, schedule: str | Sequence[str]) -> pd.DataFrame:
    """What the best plan of each side is worth in the models of both.

    Returns
    -------
    DataFrame
        ``plan`` (of which side's estimate), ``world`` (whose estimate and draws it is valued in), ``value`` in
        the estimate, ``low, high`` (95% over the draws), ``loss`` against the world's own plan in the estimate,
        with ``loss_low, loss_high`` (paired over the draws), ``first_action``, ``help_rate``, ``costly_actions``.
    """
    plans = {s.label: solve_schedule(Schedule.of(s.estimates[states], schedule)) for s in (a, b)}
    rows = []
    for world in (a, b):
        truth: dict[str, LatentStatePOMDP | ModelDraws] = {
            "point": world.estimates[states], "draws": world.draws[states]
        }  # fmt: skip
        valued = {
            (label, kind): evaluate_schedule(PlanPolicy.of(plan, f"plan of {label}"), model, schedule)
            for label, plan in plans.items() for kind, model in truth.items()
        }  # fmt: skip
        own = valued[world.label, "point"].value
        weight = world.draws[states].weight
        for label, plan in plans.items():
            value, drawn = valued[label, "point"], valued[label, "draws"].values
            low, high = _weighted(drawn, weight)
            loss_low, loss_high = _weighted(valued[world.label, "draws"].values - drawn, weight)
            rows.append({
                "plan": label, "world": world.label, "value": value.value, "low": low, "high": high,
                "loss": own - value.value, "loss_low": loss_low, "loss_high": loss_high,
                "first_action": plan.first_action, "help_rate": value.help_rate,
                "costly_actions": value.costly_actions,
            })  # fmt: skip
    return pd.DataFrame(rows)


def _weighted(values: Array, weight: Array) -> tuple[float, float]:
    """95% interval of weighted draws."""
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    ends = np.searchsorted(share, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    low, high = values[order][np.minimum(ends, len(values) - 1)]
    return float(low), float(high)
