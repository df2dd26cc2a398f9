"""What Laplace's approximation does to a regression near the ceiling, by simulation from known truths.

The design is that of study 1: people with a few binary responses, half of them with a robot that helps. The
higher the rate of help without it, the more people always help; their responses say nothing of the spread
between people but "large", and one node cannot describe what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from models.errors import located
from models.glmm import DEFAULT_NODES, LogisticMixedModel
from models.glmm_data import Rule
from models.glmm_optimise import maximise
from models.glmm_simulation import patterns_of, simulate_successes
from models.notebook_view import NotebookView
from models.spread_out import spread_out

STREAM = 7_405
"""First element of the spawn keys used here."""

TOGETHER = 8
"""Studies that are sent to another process together."""

CEILING = (0.0, 1.0, 2.0, 2.5, 3.0, 3.5)
"""Intercepts from where a third of the people always help to where nearly all do."""


@dataclass(frozen=True)
class QuadratureStudy(NotebookView):
    """Estimates under both rules, one row a simulated study.

    Attributes
    ----------
    table : DataFrame
        ``intercept`` (log-odds of help without the robot's), ``replicate``, ``rule`` (``Laplace``, ``AGHQ``),
        ``sd``, ``effect`` (log odds ratio), ``always`` (share of people who always help), ``converged``.
    sd, effect : float
        True values.
    people, responses : int
    seed : int
    """

    _whose = "simulated"

    table: pd.DataFrame
    sd: float
    effect: float
    people: int
    responses: int
    seed: int

    @property
    def summary(self) -> pd.DataFrame:
        """One row an intercept and rule: ``always``, and median and quartiles of ``sd`` and ``odds_ratio``."""
        good = self.table[self.table["converged"]].assign(odds_ratio=np.exp(self.table["effect"]))
        rows = []
        for (intercept, rule), part in good.groupby(["intercept", "rule"], sort=True):
            row = {"intercept": intercept, "rule": rule, "studies": len(part), "always": part["always"].mean()}
            for name in ("sd", "odds_ratio"):
                low, middle, high = np.quantile(part[name], [0.25, 0.5, 0.75])
                row |= {f"{name}_low": low, name: middle, f"{name}_high": high}
            rows.append(row)
        return pd.DataFrame(rows)

    @property
    def sentence(self) -> str:
        """Where each rule ends up at the highest rate of help."""
        last = self.summary[self.summary["intercept"] == self.summary["intercept"].max()].set_index("rule")
        told = " and ".join(
            f"{row['sd']:.2f} by {rule} ({row['sd_low']:.2f} to {row['sd_high']:.2f} in half of the studies)"
            for rule, row in last.iterrows()
        )
        lost = len(self.table) - int(self.table["converged"].sum())
        text = (
            f"Where {last['always'].iloc[0]:.0%} of the people always help, the standard deviation of "
            f"{self.sd:g} is estimated as {told}; the odds ratio of {np.exp(self.effect):.1f} as "
            + " and ".join(f"{row['odds_ratio']:.1f} by {rule}" for rule, row in last.iterrows())
        )
        return text + (f". {lost} of {len(self.table)} fits found no maximum and are left out." if lost else ".")

    def to_dict(self) -> dict[str, Any]:
        """For JSON: the summary, not every study."""
        return {
            "sentence": self.sentence, "summary": self.summary.to_dict("records"), "sd": self.sd,
            "effect": self.effect, "people": self.people, "responses": self.responses, "seed": self.seed,
        }  # fmt: skip


def quadrature_study(
    intercepts: Sequence[float] = (0.0, 1.0, 2.0, 3.0), *, effect: float = 1.5, sd: float = 1.5, people: int = 540,
    responses: int = 3, replicates: int = 40, nodes: int = DEFAULT_NODES, seed: int = 1,
    progress: Callable[[int, int], None] | None = None, executor: Executor | None = None,
) -> QuadratureStudy:  # fmt: skip
    """Simulate studies from a mixed model and fit each by Laplace's approximation and by quadrature.

    Parameters
    ----------
    intercepts : sequence of float
        Log-odds of help for the average person whose robot does not help.
    effect, sd : float
        True log odds ratio, and standard deviation of the intercepts.
    people, responses : int
        Of each study; every other person's robot helps.
    replicates : int
        Studies an intercept; replicate r of each uses the same stream, so that rates are compared on like luck.
    nodes : int
        Of the quadrature.
    seed : int
    progress : callable, optional
        Called with (done, total).
    executor : concurrent.futures.Executor, optional
        Threads of this process by default. The result does not depend on it.

    Raises
    ------
    InputError
        With fewer than ten people.
    """
    if people < 10:
        raise located("quadrature study, people", people, "at least 10")
    person = np.repeat(np.arange(people), responses)
    helped = (person % 2).astype(np.float64)
    design = np.column_stack([np.ones(len(person)), helped])
    outcome = (np.arange(len(person)) % 2).astype(np.float64)  # placeholder: every study brings its own
    model = LogisticMixedModel(outcome, design, groups=person)
    job = _Job(model, person, responses, effect, sd, nodes, seed)
    asked = [(float(intercept), replicate) for intercept in intercepts for replicate in range(replicates)]
    found = spread_out(
        executor, partial(_one_study, job), asked, progress, together=TOGETHER,
        names=lambda i: f"study {asked[i][1]} at intercept {asked[i][0]:g} (seed {seed})",
    )  # fmt: skip
    table = pd.DataFrame([row for rows in found for row in rows])
    return QuadratureStudy(table, sd, effect, people, responses, seed)


@dataclass(frozen=True)
class _Job:
    model: LogisticMixedModel
    person: NDArray[np.int64]
    responses: int
    effect: float
    sd: float
    nodes: int
    seed: int


def _one_study(job: _Job, asked: tuple[float, int]) -> list[dict[str, Any]]:
    """Rows of one simulated study, one a rule."""
    intercept, replicate = asked
    rng = np.random.default_rng(np.random.SeedSequence(job.seed, spawn_key=(STREAM, replicate)))
    successes = simulate_successes(job.model, np.array([intercept, job.effect, job.sd]), rng)
    always = float((np.bincount(job.person, successes) == job.responses).mean())
    patterns = patterns_of(job.model, successes)
    rows: list[dict[str, Any]] = []
    for name, rule in {"Laplace": Rule.hermite(1), "AGHQ": Rule.hermite(job.nodes)}.items():
        best = maximise(patterns, rule)
        rows.append(
            {"intercept": intercept, "replicate": replicate, "rule": name, "sd": best.theta[-1],
             "effect": best.theta[1], "always": always, "converged": bool(best.converged)}
        )  # fmt: skip
    return rows
