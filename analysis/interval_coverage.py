"""Whether intervals of the mixed model hold the truth as often as they say, where the truth is the model itself.

Studies are drawn from a mixed model under a design, at rates of help up to near the ceiling. Each is fitted by
adaptive quadrature and by Laplace's approximation; of each fit come profile-likelihood and Wald intervals of every
parameter. Intervals that are exact hold the truth in a binomial number of studies: bounds of that number stand
beside what was counted.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import CancelledError, Executor
from dataclasses import dataclass, field
from threading import Event
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from analysis.power_simulation import STUDY1_SD, STUDY1_TRUTH, ResponseDesign, binary_patterns, study1_rows
from analysis.replicates import Progress, run_replicates
from models.errors import located
from models.glmm import DEFAULT_NODES
from models.glmm_data import Likelihood, Rule
from models.glmm_optimise import maximise
from models.glmm_profile import profile_intervals
from models.notebook_view import NotebookView

Array = NDArray[np.float64]

STREAM = 7_406
"""First element of the spawn keys; the study follows, so that every rate of help meets the same random numbers."""

KINDS = ("profile", "Wald")
SD = "sd of intercepts"

BOUNDS = 0.998
"""Probability that the count of an exact interval lies between its bounds."""

ENGINE = ("models.glmm_optimise", "models.glmm_profile")
"""What the result rests on: only kernels that these reach make it stale."""

KEPT = 20
"""Studies of every rate and rule that are kept one by one, to be compared when they are repeated."""


@dataclass(frozen=True)
class CoverageSettings:
    """What to simulate.

    Attributes
    ----------
    design : ResponseDesign
        With a column ``Intercept``.
    effects : mapping of str to float
        True coefficients of the other columns, on the logit scale.
    intercepts : tuple of float
        True intercepts, one a rate of help; ascending.
    sd : float
        True standard deviation of people's intercepts.
    people, studies : int
    level : float
        Of the intervals.
    nodes : int
        Of the quadrature.
    seed : int
    """

    design: ResponseDesign = field(default_factory=study1_rows)
    effects: Mapping[str, float] = field(
        default_factory=lambda: {name: b for name, b in STUDY1_TRUTH.items() if name != "Intercept"}
    )
    intercepts: tuple[float, ...] = (STUDY1_TRUTH["Intercept"], 3.0)
    sd: float = STUDY1_SD
    people: int = 540
    studies: int = 500
    level: float = 0.95
    nodes: int = DEFAULT_NODES
    seed: int = 1

    def __post_init__(self) -> None:
        if set(self.design.columns) != {"Intercept", *self.effects}:
            raise located("effects", ", ".join(self.effects), f"one for each of {', '.join(self.design.columns)}")
        if self.studies < 2:
            raise located("studies", self.studies, "at least 2")
        if self.people < 10:
            raise located("people", self.people, "at least 10")
        if not self.intercepts or list(self.intercepts) != sorted(set(self.intercepts)):
            raise located("intercepts", list(self.intercepts), "different numbers, ascending")
        if not 0 < self.level < 1:
            raise located("level", self.level, "between 0 and 1")
        if self.sd <= 0:
            raise located("sd", self.sd, "a positive number")
        Rule.hermite(self.nodes)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, the standard deviation last."""
        return (*self.design.columns, SD)

    @property
    def rules(self) -> dict[str, Rule]:
        """Quadrature rules by name."""
        return {"AGHQ": Rule.hermite(self.nodes), "Laplace": Rule.hermite(1)}

    def truth(self, intercept: float) -> Array:
        """Parameters in the order of `parameters`."""
        known = {"Intercept": intercept, **self.effects}
        return np.array([*(known[name] for name in self.design.columns), self.sd])


@dataclass(frozen=True)
class CoverageResult(NotebookView):
    """How often intervals hold the truth.

    Attributes
    ----------
    table : DataFrame
        One row an intercept, rule, parameter and kind of interval: ``intercept, rule, parameter, interval, truth,
        median`` (of the estimates), ``width`` (median of the intervals, on the scale of the parameter), ``covered``
        (studies whose interval holds the truth), ``studies, share, low, high`` (bounds of `covered` for exact
        intervals, `BOUNDS`), ``exact`` (whether it lies between them), ``below, above`` (studies whose whole
        interval does), ``without`` (studies without the interval, which do not hold the truth).
    rates : DataFrame
        One row an intercept: ``intercept, rate`` (share of helping responses), ``always`` (share of people).
    kept : mapping
        Estimates and intervals of the first studies (`KEPT`), rounded: ``intercept/rule`` to lists over studies of
        ``[estimate, profile low, high, Wald low, high]`` by parameter.
    settings : CoverageSettings
    seconds : float
    """

    _whose = "simulated"

    table: pd.DataFrame
    rates: pd.DataFrame
    kept: Mapping[str, Any]
    settings: CoverageSettings
    seconds: float = field(compare=False)

    def share(self, intercept: float, rule: str, interval: str, parameter: str) -> float:
        """Share of studies whose interval holds the truth."""
        t = self.table
        rows = t[(t["intercept"] == intercept) & (t["rule"] == rule) & (t["interval"] == interval)]
        return float(rows.set_index("parameter").loc[parameter, "share"])

    @property
    def sentence(self) -> str:
        """Coverage of the last effect and of the standard deviation, at every rate of help and by every rule."""
        s = self.settings
        effect = s.design.columns[-1]
        low, high = (int(self.table[end].iloc[0]) for end in ("low", "high"))
        parts = []
        for row in self.rates.itertuples():
            told = [
                f"of {name} "
                + ", ".join(
                    f"{rule} {self.share(row.intercept, rule, 'profile', name):.1%} (profile) and "
                    f"{self.share(row.intercept, rule, 'Wald', name):.1%} (Wald)"
                    for rule in s.rules
                )
                for name in (effect, SD)
            ]
            parts.append(f"where {row.rate:.0%} of responses are helping, {'; '.join(told)}")
        wrong = self.table[~self.table["exact"]]
        outside = " and ".join(
            f"{len(wrong[wrong['rule'] == rule])} of {len(self.table[self.table['rule'] == rule])} by {rule}"
            for rule in s.rules
        )
        return (
            f"Share of {s.studies} simulated studies of {s.people} people whose {s.level:.0%} interval holds the "
            f"truth: {'. '.join(p[0].upper() + p[1:] for p in parts)}. Of an interval that is exact the share lies "
            f"between {low / s.studies:.1%} and {high / s.studies:.1%} with probability {BOUNDS:.1%}; outside are "
            f"{outside}."
        )

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        s = self.settings
        return {
            "sentence": self.sentence,
            "settings": {
                "design": s.design.words, "effects": dict(s.effects), "intercepts": list(s.intercepts), "sd": s.sd,
                "people": s.people, "studies": s.studies, "level": s.level, "nodes": s.nodes, "seed": s.seed,
                "bounds": BOUNDS,
            },
            "table": self.table.to_dict("records"), "rates": self.rates.to_dict("records"),
            "first_studies": dict(self.kept), "seconds": self.seconds,
        }  # fmt: skip


def interval_coverage(
    settings: CoverageSettings, *, executor: Executor | None = None, progress: Progress | None = None
) -> CoverageResult:
    """Simulate studies at every rate of help, fit each by both rules, count the intervals that hold the truth.

    Parameters
    ----------
    settings : CoverageSettings
    executor, progress
        As for `analysis.replicates.run_replicates`; the result does not depend on them.
    """
    started = time.perf_counter()
    total = len(settings.intercepts) * settings.studies
    found = run_replicates(
        one_study, settings, total, label="simulated studies", executor=executor, progress=progress
    )
    shape = (len(settings.intercepts), settings.studies)
    fits = np.array([study[0] for study in found]).reshape(*shape, *found[0][0].shape)
    rates = np.array([study[1] for study in found]).reshape(*shape, 2)
    low, high = stats.binom.interval(BOUNDS, settings.studies, settings.level)
    rows, kept = [], {}
    for i, intercept in enumerate(settings.intercepts):
        truth = settings.truth(intercept)
        for r, rule in enumerate(settings.rules):
            kept[f"{intercept:g}/{rule}"] = np.round(fits[i, :KEPT, r], 5).tolist()
            for p, parameter in enumerate(settings.parameters):
                estimate = fits[i, :, r, p, 0]
                for k, kind in enumerate(KINDS):
                    ends = fits[i, :, r, p, 1 + 2 * k : 3 + 2 * k]
                    below, above = ends[:, 1] < truth[p], ends[:, 0] > truth[p]
                    without = np.isnan(ends).any(axis=1)
                    covered = int(np.sum(~(below | above | without)))
                    rows.append(
                        {
                            "intercept": intercept, "rule": rule, "parameter": parameter, "interval": kind,
                            "truth": truth[p], "median": _median(estimate),
                            "width": _median(ends[:, 1] - ends[:, 0]), "covered": covered,
                            "studies": settings.studies, "share": covered / settings.studies, "low": int(low),
                            "high": int(high), "exact": bool(low <= covered <= high), "below": int(below.sum()),
                            "above": int(above.sum()), "without": int(without.sum()),
                        }
                    )  # fmt: skip
    shares = pd.DataFrame(
        [
            {"intercept": b, "rate": float(part[:, 0].mean()), "always": float(part[:, 1].mean())}
            for b, part in zip(settings.intercepts, rates, strict=True)
        ]
    )
    return CoverageResult(pd.DataFrame(rows), shares, kept, settings, time.perf_counter() - started)


def _median(values: Array) -> float:
    known = values[~np.isnan(values)]
    return float(np.median(known)) if len(known) else np.nan


def one_study(
    settings: CoverageSettings, index: int, *, stop: Event | None = None
) -> tuple[Array, tuple[float, float]]:
    """Fit one simulated study by every rule.

    Returns
    -------
    fits : float64[rule, parameter, 5]
        Estimate, profile interval, Wald interval; NaN where there is none.
    rates : tuple of float
        Share of helping responses, and of people who always help.
    """
    if stop is not None and stop.is_set():
        raise CancelledError
    which, study = divmod(index, settings.studies)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(STREAM, study)))
    truth = settings.truth(settings.intercepts[which])
    exog, y, person = settings.design.respond(settings.people, truth[:-1], settings.sd, rng)
    rates = float(y.mean()), float(np.mean(np.bincount(person, y) == np.bincount(person)))
    fits = np.full((len(settings.rules), len(truth), 5), np.nan)
    if 0 < rates[0] < 1:
        patterns = binary_patterns(exog, y, person)
        for row, rule in zip(fits, settings.rules.values(), strict=True):
            row[:] = _intervals(Likelihood(patterns, rule), settings.level)
    return fits, rates


def _intervals(likelihood: Likelihood, level: float) -> Array:
    """Estimate, profile and Wald interval of every parameter, as `LogisticMixedResults.conf_int` has them."""
    best = maximise(likelihood.patterns, likelihood.rule)
    size = len(best.theta)
    out = np.full((size, 5), np.nan)
    if not best.converged:
        return out
    out[:, 0] = best.theta
    out[:, 1:3] = profile_intervals(likelihood, best, range(size), 1 - level)
    # On the boundary the standard deviation is no free parameter, and has no Wald interval.
    free = size - 1 if best.boundary else size
    variance = np.diag(np.linalg.inv(-best.hessian[:free, :free]))
    half = stats.norm.ppf((1 + level) / 2) * np.sqrt(np.maximum(variance, 0.0))
    out[:free, 3], out[:free, 4] = best.theta[:free] - half, best.theta[:free] + half
    out[-1, 3] = np.maximum(out[-1, 3], 0.0)
    return out
