"""Checks that the model could fail: whether data drawn from it look like the data in ways the fit did not aim at.

*Posterior predictive*: for draws of the posterior, new people with new latent states respond under the study's own
design (actions, lengths, which records are missing), and statistics of their responses are compared with the
observed ones. The observed responses were used to learn and are used again to check, so p-values are conservative:
they gather around one half, and an extreme one weighs more than it says. *Prior predictive*: the same before any
data, to see what kappa takes for granted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis import response_rates as rates
from analysis.credible import LEVEL, as_probability, interval
from analysis.kappa_sensitivity import KAPPAS
from models.errors import located
from models.events import EventLog
from models.groups import Groups
from models.histories import UNSEEN
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.parameters import Array, DirichletPrior, Layout
from models.posterior import Posterior
from models.predictive import predictive_responses, tables_of
from models.simulation import simulate_responses

DRAWS = 300
"""Simulated studies of a check."""

MOST_CELLS = 30
"""Cells of condition and schedule up to which each is a check; beyond, conditions and rounds are."""

STREAM = 201
"""First number of the spawn keys here; the second is 0 for posterior and 1 for prior, the third the draw."""

CONDITIONED = (
    "Conditioned on: the study's design (who was in which condition and schedule, the robot's actions, which "
    "records are missing) and the posterior given these same responses. Not conditioned on: anybody's latent "
    "state; simulated people are new people"
)


@dataclass(frozen=True)
class Statistics:
    """Statistics of the responses of one design.

    Attributes
    ----------
    log : EventLog
    """

    log: EventLog

    @cached_property
    def _seen(self) -> NDArray[np.bool_]:
        return self.log.response != UNSEEN

    @cached_property
    def _run(self) -> NDArray[np.int64]:
        return np.unique(self.log.run_of_event[self._seen], return_inverse=True)[1]

    @cached_property
    def _person(self) -> NDArray[np.int64]:
        return np.unique(self.log.participant[self.log.run_of_event[self._seen]], return_inverse=True)[1]

    @cached_property
    def _cells(self) -> list[tuple[NDArray[np.int64], list[str]]]:
        """Groupings whose cells are counted: codes of the recorded responses, and the names of the cells."""
        log = self.log
        run = log.run_of_event[self._seen]
        schedules, schedule = np.unique(log.schedules().astype(str), return_inverse=True)
        both = log.condition[run].astype(np.int64) * len(schedules) + schedule[run]
        used, code = np.unique(both, return_inverse=True)
        if len(used) <= MOST_CELLS:
            return [
                (code, [f"{log.conditions[c // len(schedules)]}, {schedules[c % len(schedules)]}" for c in used])
            ]
        rounds, by_round = np.unique(log.k[self._seen], return_inverse=True)
        return [
            (log.condition[run].astype(np.int64), [f"condition {c}" for c in log.conditions]),
            (by_round, [f"round {k}" for k in rounds]),
        ]

    @cached_property
    def names(self) -> list[tuple[str, str]]:
        """Family and name of every statistic, in the order of `of`."""
        noun = "sum of scores" if not rates.is_share(self.log.protocol) else (
            f"{rates.high_response(self.log.protocol).replace('_', ' ')} count"
        )  # fmt: skip
        names = [(noun, cell) for _, cells in self._cells for cell in cells]
        high = rates.high_response(self.log.protocol).replace("_", " ")
        names += [("runs", "mean run of equal responses"), ("runs", "longest run of equal responses")]
        names += [("first and last", n) for n in ("first response", "last response", "last less first response")]
        names += [("people", f"variance of {noun}"), ("people", f"always {high}"), ("people", f"never {high}")]
        return names

    def of(self, response: NDArray[np.integer]) -> Array:
        """Every statistic of one set of responses, ``response[event]``."""
        value = rates.value_of_response(self.log.protocol)[response[self._seen]]
        out = [np.bincount(code, value, minlength=len(cells)) for code, cells in self._cells]
        new_run = np.append(True, np.diff(self._run) != 0)
        starts = new_run | np.append(True, np.diff(value) != 0)
        first = np.flatnonzero(starts)
        length = np.diff(np.append(first, len(value)))
        longest = np.maximum.reduceat(length, np.flatnonzero(new_run[first]))
        opening, closing = value[new_run], value[np.append(np.flatnonzero(new_run)[1:] - 1, len(value) - 1)]
        several = np.bincount(self._run) > 1
        change = (closing - opening)[several].mean() if several.any() else 0.0
        total = np.bincount(self._person, value)
        highest = value == max(rates.measure_range(self.log.protocol))
        high = np.bincount(self._person, highest) / np.bincount(self._person)
        out.append(
            np.array(
                [length.mean(), longest.mean(), opening.mean(), closing.mean(), change,
                 total.var(ddof=1) if len(total) > 1 else 0.0, (high == 1).mean(), (high == 0).mean()]
            )
        )  # fmt: skip
        return np.concatenate(out)


@dataclass(frozen=True)
class PredictiveChecks(NotebookView):
    """Observed statistics among those of simulated studies.

    Attributes
    ----------
    table : DataFrame
        One row a check: ``family, check, observed``, predictive ``mean, sd, low, high``, ``p`` (share of simulated
        studies above the observed value, ties counting half), ``outside`` (of the predictive interval).
    draws : int
    level : float
    n_states : int
    cautions : tuple of str
        Why not to trust the posterior (`models.cautions`).
    """

    table: pd.DataFrame
    draws: int
    level: float
    n_states: int
    cautions: tuple[str, ...] = ()

    @property
    def failed(self) -> pd.DataFrame:
        """Checks that fail: observed values beyond what chance leaves for the most extreme of all checks.

        Two-sided p below 1% over the number of checks (Bonferroni), or no simulated study as extreme.
        """
        p = 2 * np.minimum(self.table["p"], 1 - self.table["p"])
        return self.table[p <= max(0.01 / len(self.table), 0.5 / self.draws)]

    @property
    def sentence(self) -> str:
        """How many checks lie outside, which fail, and what was conditioned on."""
        outside, n = int(self.table["outside"].sum()), len(self.table)
        worst = self.table.loc[(self.table["p"] - 0.5).abs().idxmax()]
        text = (
            f"{outside} of {n} checks lie outside their {self.level:.0%} predictive interval (by chance about "
            f"{n * (1 - self.level):.0f} or fewer). Most extreme: {worst['check']} "
            f"(observed {worst['observed']:.3g}, predicted {worst['low']:.3g} to {worst['high']:.3g}, "
            f"p {as_probability(worst['p'])})"
        )
        bad = self.failed
        if len(bad):
            told = "; ".join(bad["check"])
            return f"The model FAILS {len(bad)} of {n} checks: {told}. {text}. {CONDITIONED}."
        return f"No check fails. {text}. {CONDITIONED}."


def posterior_checks(
    posterior: Posterior, log: EventLog, *, draws: int = DRAWS, seed: int = 1, level: float = LEVEL,
    groups: Groups | None = None,
) -> PredictiveChecks:  # fmt: skip
    """Simulate the study from draws of the posterior and compare.

    Parameters
    ----------
    posterior : Posterior
    log : EventLog
        What it was learned from, or held-out people.
    draws : int
        Simulated studies, each from a draw of its own.
    seed : int
    level : float
    groups : Groups, optional
        Group of each run of the log, where tables differ.
    """
    statistics = Statistics(log)
    tables = tables_of(posterior, draws)
    streams = [np.random.SeedSequence(seed, spawn_key=(STREAM, 0, i)) for i in range(len(tables.initial))]
    responses = predictive_responses(tables, log, streams, groups)
    simulated = np.stack([statistics.of(r) for r in responses])
    return _compared(statistics, simulated, posterior.n_states, level, posterior.draws_cautions)


def prior_draws(layout: Layout, prior: DirichletPrior, draws: int, rng: np.random.Generator) -> ModelDraws:
    """Models drawn from the prior; states in no particular order."""
    shape = 1.0 + prior.pseudo_counts(layout)
    gamma = rng.gamma(shape, size=(draws, layout.size)) + 1e-300
    for row in layout.rows:
        gamma[:, row] /= gamma[:, row].sum(axis=1, keepdims=True)
    tables = [layout.unpack(theta) for theta in gamma]
    initial, transition, emission = (np.stack([t[i] for t in tables]) for i in range(3))
    return ModelDraws(layout.protocol, initial, transition, emission, np.full(draws, 1.0 / draws))


def prior_predictive(
    log: EventLog, states: int, kappas: Sequence[float] = KAPPAS, *, draws: int = DRAWS, seed: int = 1,
    level: float = LEVEL,
) -> pd.DataFrame:  # fmt: skip
    """What kappa implies for the responses of this design before any data.

    Returns
    -------
    DataFrame
        One row a statistic and kappa: ``check, kappa, mean, low, high, observed``; the overall rate, and the checks
        on runs of equal responses, first and last response, and differences between people.
    """
    if len(kappas) == 0:
        raise located("prior predictive, kappas", list(kappas), "at least one")
    statistics = Statistics(log)
    cells = sum(len(c) for _, c in statistics._cells[:1])
    skip = sum(len(c) for _, c in statistics._cells)
    layout = Layout(log.protocol, states)
    observed = statistics.of(log.response)
    names = [rates.measure_name(log.protocol), *(c for _, c in statistics.names[skip:])]

    def chosen(values: Array) -> Array:
        rate = values[..., :cells].sum(axis=-1, keepdims=True) / log.n_responses_recorded
        return np.concatenate([rate, values[..., skip:]], axis=-1)

    parts = []
    for i, kappa in enumerate(kappas):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, 1, i)))
        models = prior_draws(layout, DirichletPrior(stay=kappa), draws, rng)
        values = chosen(_simulated(models, statistics, seed, 2 + i))
        low, high = interval(values, level)
        parts.append(
            pd.DataFrame(
                {"check": names, "kappa": kappa, "mean": values.mean(axis=0), "low": low, "high": high,
                 "observed": chosen(observed)}
            )
        )  # fmt: skip
    frame = pd.concat(parts, ignore_index=True)
    return frame.sort_values("check", key=lambda c: c.map(names.index), kind="stable").reset_index(drop=True)


def prior_sentence(table: pd.DataFrame) -> str:
    """What every kappa of `prior_predictive` takes for granted about the overall rate and runs of responses."""
    rate = table[table["check"] == table["check"].iloc[0]]
    runs = table[table["check"] == "mean run of equal responses"]
    parts = [
        f"kappa {a.kappa:g}: {a.check} {a.low:.2f} to {a.high:.2f}, mean run of equal responses {b.low:.2f} to "
        f"{b.high:.2f}"
        for a, b in zip(rate.itertuples(), runs.itertuples(), strict=True)
    ]
    text = (
        f"Before any data the model expects {'; '.join(parts)} (observed {rate['observed'].iloc[0]:.2f} and "
        f"{runs['observed'].iloc[0]:.2f})"
    )
    missed = rate[(rate["observed"] < rate["low"]) | (rate["observed"] > rate["high"])]["kappa"]
    if len(missed):
        text += (
            f". The observed {rate['check'].iloc[0]} lies outside at kappa {', '.join(f'{k:g}' for k in missed)}: "
            "the average of independent uniform response probabilities is narrower than it sounds"
        )
    return f"{text}."


def _simulated(models: ModelDraws, statistics: Statistics, seed: int, task: int) -> Array:
    out = []
    for i, model in enumerate(models):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, task, i)))
        study, _ = simulate_responses(model, statistics.log, rng)
        out.append(statistics.of(study.response))
    return np.stack(out)


def _compared(
    statistics: Statistics, simulated: Array, n_states: int, level: float, cautions: tuple[str, ...]
) -> PredictiveChecks:
    observed = statistics.of(statistics.log.response)
    low, high = interval(simulated, level)
    p = (simulated > observed).mean(axis=0) + 0.5 * np.isclose(simulated, observed, rtol=1e-12).mean(axis=0)
    frame = pd.DataFrame(statistics.names, columns=["family", "check"]).assign(
        observed=observed, mean=simulated.mean(axis=0), sd=simulated.std(axis=0, ddof=1), low=low, high=high, p=p,
        outside=(observed < low - 1e-12) | (observed > high + 1e-12),
    )  # fmt: skip
    return PredictiveChecks(frame, len(simulated), level, n_states, cautions)
