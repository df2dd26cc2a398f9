"""Power of the logistic mixed model by simulation, which is what a binary outcome needs.

Formulas for F tests know neither a bounded outcome nor two or three responses a person. So studies are drawn from
the mixed model itself with given coefficients and a given spread of people, under a design; each is fitted with and
without the covariates in question, and the share of studies with p below alpha is the power, of Wald's test and of
the likelihood-ratio test, with its Monte Carlo error. With an odds ratio of 1 the same share is the size of the
test.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError, Executor
from dataclasses import dataclass, field
from functools import partial
from threading import Event
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from analysis.design import StudyDesign, study1_design
from analysis.power_curves import Reached, reached, wilson_interval
from analysis.replicates import Progress, run_replicates
from models.errors import Phrase, located
from models.glmm import DEFAULT_NODES, LogisticMixedModel
from models.glmm_data import Patterns, Rule
from models.glmm_formula import split_groups
from models.glmm_optimise import maximise
from models.glmm_supremum import supremum
from models.notebook_view import NotebookView
from models.protocol import PUBLISHED

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

STREAM = 7_301
"""First element of the spawn keys: people and study follow."""

TESTS = ("wald", "likelihood_ratio")

TEST_NAMES = {"wald": "Wald", "likelihood_ratio": "likelihood ratio"}
"""The same in sentences and figures."""

ENGINE = ("models.glmm_optimise", "models.glmm_supremum")
"""What the result rests on: only kernels that this reaches make stored results stale."""

STUDY1_FORMULA = "o_help ~ signal + robot_help + (1|participant)"
"""The paper's regression."""

STUDY1_TRUTH = {"Intercept": 1.9, "signal": float(np.log(1.74)), "robot_help": float(np.log(10.42))}
"""Printed odds ratios; the intercept is chosen, so that about nine responses in ten are helping."""

STUDY1_SD = 1.387
"""Spread of people's intercepts, chosen with the intercept: the paper prints none."""


@dataclass(frozen=True)
class ResponseDesign:
    """Kinds of people, the rows each contributes, and how a study of N people is put together from them.

    Attributes
    ----------
    design : float64[row, column]
        Covariates of one person of every kind.
    columns : tuple of str
    kind_of_row : int64[row]
        Ascending.
    draw : callable
        ``(people, rng)`` to the kind of every person; of a module, not made on the spot, if studies are to run
        in other processes.
    words : str
    """

    design: Array
    columns: tuple[str, ...]
    kind_of_row: Integers
    draw: Callable[[int, np.random.Generator], Integers]
    words: str

    def study(self, people: int, rng: np.random.Generator) -> tuple[Array, Integers]:
        """Covariates of all rows of a study, and the person of each row."""
        kinds = self.draw(people, rng)
        size = np.bincount(self.kind_of_row)
        first = np.cumsum(size) - size
        person = np.repeat(np.arange(people), size[kinds])
        within = np.arange(len(person)) - np.repeat(np.cumsum(size[kinds]) - size[kinds], size[kinds])
        return self.design[np.repeat(first[kinds], size[kinds]) + within], person

    def respond(
        self, people: int, coefficients: Array, sd: float, rng: np.random.Generator
    ) -> tuple[Array, Array, Integers]:
        """Covariates of all rows of a study, responses drawn from the mixed model, and the person of each row."""
        exog, person = self.study(people, rng)
        eta = exog @ coefficients + sd * rng.standard_normal(people)[person]
        return exog, (rng.random(len(eta)) < special.expit(eta)).astype(float), person


@dataclass(frozen=True)
class MixedModelPower:
    """What to simulate.

    Attributes
    ----------
    design : ResponseDesign
    coefficients : mapping of str to float
        One a column of the design, on the logit scale.
    sd : float
        Standard deviation of people's intercepts.
    tested : tuple of str
        Columns whose coefficients are tested together.
    people : tuple of int
        Sizes of studies, ascending.
    studies : int
        Simulated studies of each size.
    alpha : float
    nodes : int
        Of the quadrature.
    seed : int
    """

    design: ResponseDesign
    coefficients: Mapping[str, float]
    sd: float
    tested: tuple[str, ...]
    people: tuple[int, ...]
    studies: int = 400
    alpha: float = 0.05
    nodes: int = DEFAULT_NODES
    seed: int = 1

    def __post_init__(self) -> None:
        columns = self.design.columns
        for name in (*self.tested, *self.coefficients):
            if name not in columns:
                raise located("coefficient", name, f"one of {', '.join(columns)}")
        absent = [name for name in columns if name not in self.coefficients]
        if absent:
            raise located(
                "coefficients", Phrase(", ".join(self.coefficients) or "none"), f"also {', '.join(absent)}"
            )
        if not self.tested:
            raise located("tested columns", Phrase("none"), f"some of {', '.join(columns)}")
        if set(self.tested) == set(columns):
            raise located("tested columns", Phrase("all columns"), "fewer: the model without them has none left")
        wrong = [value for value in (*self.coefficients.values(), self.sd) if not np.isfinite(value)]
        if wrong or self.sd < 0:
            raise located(
                "coefficients and sd", wrong[0] if wrong else self.sd, "finite numbers, the sd not negative"
            )
        if not self.people or min(self.people) < 3 or list(self.people) != sorted(set(self.people)):
            raise located("people", list(self.people), "different numbers of at least 3, ascending")
        if self.studies < 2:
            raise located("studies", self.studies, "at least 2")
        if not 0 < self.alpha < 1:
            raise located("alpha", self.alpha, "between 0 and 1")
        Rule.hermite(self.nodes)


@dataclass(frozen=True)
class MixedModelPowerResult(NotebookView):
    """Power by number of people.

    Attributes
    ----------
    table : DataFrame
        One row a number of people and test: ``people, test, power, low, high`` (Wilson interval of the simulation),
        ``monte_carlo_error``, ``without_maximum``: share of studies in which the test is not defined, which count
        as not significant (Wald's: where outcomes are separated; the likelihood ratio: where they are constant);
        ``rate``: share of successes.
    settings : MixedModelPower
    seconds : float
    """

    _whose = "simulated"

    table: pd.DataFrame
    settings: MixedModelPower
    seconds: float = field(compare=False)

    def reached(self, wanted: float, test: str = "likelihood_ratio") -> Reached:
        """The number of people at which a test has the power wanted."""
        rows = self.table[self.table["test"] == test]
        people, value, low, high = (rows[c].to_numpy(float) for c in ("people", "power", "low", "high"))
        return reached(people, value, low, high, wanted)

    def sentence(self, wanted: float) -> str:
        """The answer of both tests."""
        s = self.settings
        told = "; ".join(f"{TEST_NAMES[test]} {self.reached(wanted, test).words}" for test in TESTS)
        error = self.table["monte_carlo_error"].max()
        lost = self.table["without_maximum"].max()
        text = (
            f"Power {wanted:g} for {', '.join(s.tested)} ({s.design.words}; {s.studies} studies a size, largest "
            f"Monte Carlo error {error:.3f}): {told}."
        )
        if lost > 0:
            text += (
                f" In up to {lost:.1%} of studies a fit had no maximum: these count as not significant by Wald's "
                "test, and by the likelihood ratio with the values to which the likelihoods rise."
            )
        return text


def study1_rows(formula: str = STUDY1_FORMULA) -> ResponseDesign:
    """The published design of study 1: four conditions in the published proportions, six schedules at random.

    Parameters
    ----------
    formula : str
        With the columns ``signal, robot_help, participant``; the outcome's name is free.
    """
    plan = study1_design()
    rows = []
    for c, condition in enumerate(plan.conditions):
        for s, letters in enumerate(plan.schedules):
            modes = PUBLISHED.modes_from_letters(letters)
            responses = sum(m.name == "robot_needs_help" for m in modes)
            signal = condition.actions["robot_needs_help"] == "signal"
            helping = condition.actions["human_needs_help"] == "help"
            kind = c * len(plan.schedules) + s
            rows += [{"participant": kind, "signal": int(signal), "robot_help": int(helping)}] * responses
    words = f"study 1's {len(plan.conditions)} conditions and {len(plan.schedules)} schedules"
    return _design(pd.DataFrame(rows), formula, partial(_drawn_as_planned, plan), words)


def _drawn_as_planned(plan: StudyDesign, people: int, rng: np.random.Generator) -> Integers:
    condition = np.repeat(np.arange(len(plan.conditions)), plan.allocation(people))
    return condition * len(plan.schedules) + rng.integers(0, len(plan.schedules), people)


def rows_of_table(frame: pd.DataFrame, formula: str, name: str = "table") -> ResponseDesign:
    """A design given by example: everybody in a table is a kind of person, one row a response.

    A study of N people takes everybody equally often, and those left over at random.

    Parameters
    ----------
    frame : DataFrame
        The covariates and the person of each row; no outcome is needed.
    formula : str
        ``outcome ~ covariates + (1|person)``.
    name : str
        For messages.
    """
    _, group = split_groups(formula, None)
    if group not in frame.columns:
        raise located(f"{name}, columns", Phrase(", ".join(map(str, frame.columns))), f"also {group!r}")
    code = pd.factorize(frame[group])[0]
    if (code < 0).any():
        raise located(f"{name}, column {group}", Phrase("no value"), "a label in every row")
    order = np.argsort(code, kind="stable")
    kinds = int(code.max()) + 1

    ordered = frame.iloc[order].assign(**{str(group): code[order]}).reset_index(drop=True)
    return _design(ordered, formula, partial(_drawn_equally, kinds), f"the {kinds} people of {name} as kinds")


def _drawn_equally(kinds: int, people: int, rng: np.random.Generator) -> Integers:
    left = rng.permutation(kinds)[: people % kinds]
    return np.sort(np.concatenate([np.tile(np.arange(kinds), people // kinds), left])).astype(np.int64)


def _design(
    frame: pd.DataFrame, formula: str, draw: Callable[[int, np.random.Generator], Integers], words: str
) -> ResponseDesign:
    """Let the formula engine make the covariates; its outcome is a stand-in that only has to vary."""
    left, _, _ = formula.partition("~")
    outcome = left.strip()
    if not outcome.isidentifier():
        raise located("formula", formula, "a single name of an outcome to the left of ~")
    if len(frame) < 2:
        raise located("design", Phrase(f"{len(frame)} rows"), "at least 2 rows")
    _, group = split_groups(formula, None)
    full = frame.assign(**{outcome: np.arange(len(frame)) % 2})
    model = LogisticMixedModel.from_formula(formula, full, missing="raise")
    kind = frame[str(group)].to_numpy(dtype=np.int64)
    return ResponseDesign(model.exog, tuple(str(name) for name in model.exog_names), kind, draw, words)


def mixed_model_power(
    settings: MixedModelPower, *, executor: Executor | None = None, progress: Progress | None = None
) -> MixedModelPowerResult:
    """Simulate studies of every size and count how often the tests are significant.

    Parameters
    ----------
    settings : MixedModelPower
    executor, progress
        As for `analysis.replicates.run_replicates`; the result does not depend on them.
    """
    started = time.perf_counter()
    rows: list[dict[str, Any]] = []
    for people in settings.people:
        found = run_replicates(
            partial(_one_study, people), settings, settings.studies, label=f"{people} people", executor=executor,
            progress=progress,
        )  # fmt: skip
        p = np.array([study[:2] for study in found])
        rate = float(np.mean([study[2] for study in found]))
        hits = np.count_nonzero(p < settings.alpha, axis=0).astype(float)  # NaN is not below alpha
        low, high = wilson_interval(hits, settings.studies)
        share = hits / settings.studies
        for i, test in enumerate(TESTS):
            rows.append(
                {
                    "people": people, "test": test, "power": share[i], "low": low[i], "high": high[i],
                    "monte_carlo_error": float(np.sqrt(share[i] * (1 - share[i]) / settings.studies)),
                    "without_maximum": float(np.isnan(p[:, i]).mean()), "rate": rate,
                }
            )  # fmt: skip
    return MixedModelPowerResult(pd.DataFrame(rows), settings, time.perf_counter() - started)


def _one_study(
    people: int, settings: MixedModelPower, index: int, *, stop: Event | None = None
) -> tuple[float, float, float]:
    """Compute p of both tests and the share of successes, for one simulated study.

    Without a maximum p is NaN by Wald's test; the likelihood ratio is by what the likelihood rises to.
    """
    if stop is not None and stop.is_set():
        raise CancelledError
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(STREAM, people, index)))
    beta = np.array([settings.coefficients[name] for name in settings.design.columns])
    exog, y, person = settings.design.respond(people, beta, settings.sd, rng)
    rate = float(y.mean())
    if rate in (0.0, 1.0):
        return np.nan, np.nan, rate
    tested = np.array([name in settings.tested for name in settings.design.columns])
    rule = Rule.hermite(settings.nodes)
    data = [binary_patterns(x, y, person) for x in (exog, exog[:, ~tested])]
    full, restricted = (maximise(patterns, rule) for patterns in data)
    top, under = (supremum(patterns, rule, best) for patterns, best in zip(data, (full, restricted), strict=True))
    ratio = max(0.0, 2 * (top.value - under.value))
    at = np.flatnonzero(tested)
    by_ratio = float(special.chdtrc(len(at), ratio))
    if not top.attained:
        return np.nan, by_ratio, rate
    # On the boundary the standard deviation is no free parameter.
    size = len(beta) if full.boundary else len(beta) + 1
    covariance = np.linalg.inv(-full.hessian[:size, :size])[np.ix_(at, at)]
    wald = float(full.theta[at] @ np.linalg.solve(covariance, full.theta[at]))
    return float(special.chdtrc(len(at), wald)), by_ratio, rate


def binary_patterns(exog: Array, y: Array, person: Integers) -> Patterns:
    """Rows of responses of 0 and 1 as the likelihood sees them."""
    n = len(y)
    return Patterns.from_rows(exog, np.zeros(n), y, np.ones(n), np.ones(n), person)


def coefficients_from(
    columns: Sequence[str], odds_ratios: Mapping[str, float], intercept: float | None = None
) -> dict[str, float]:
    """Coefficients from odds ratios; the intercept is a log-odds."""
    for name, ratio in odds_ratios.items():
        if name not in columns:
            raise located("odds ratio", name, f"one of {', '.join(columns)}")
        if not (np.isfinite(ratio) and ratio > 0):
            raise located(f"odds ratio of {name}", ratio, "a positive number")
    out = {name: float(np.log(ratio)) for name, ratio in odds_ratios.items()}
    return out if intercept is None else {"Intercept": float(intercept), **out}
