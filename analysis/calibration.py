"""Simulation-based calibration: whether posteriors are what they claim to be, at the published design.

Truths are drawn from the prior, a study is simulated from each under the published design, its posterior is
sampled, and the truth is ranked among (nearly independent) posterior draws. If model, likelihood, sampler and
relabelling are all right, ranks are uniform: `analysis.rank_uniformity` tests that.

Some studies have a posterior in several pieces between which chains do not move; their samples do not reach the
gate's effective sample size, which a user is told. They are counted and left out of the tests. That is no
cheating: given the data the truth is a draw from the posterior, so ranks stay uniform in any set of studies chosen
by data and sampler alone. Ranks of all studies are kept in the result.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field
from functools import cached_property
from threading import Event
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.calibration_statistics import quantities
from analysis.rank_uniformity import FAMILY_WISE, bonferroni, examine, p_values, ranks_of
from analysis.replicates import Progress, prior_draw, run_replicates, simulated_study
from models.draw_kernels import constrained
from models.errors import located
from models.events import EventLog
from models.gate import MIN_ESS, convergence_gate
from models.hmm_density import HmmDensity
from models.lspomdp import LatentStatePOMDP
from models.nuts import NutsSettings, sample_chain
from models.parameters import STICKY, DirichletPrior, Layout
from models.protocol import PUBLISHED

STREAM = 7_201
"""First element of the spawn keys of replicates; number of states and replicate follow."""

BLUR_STREAM = 7_202
"""First element of the spawn key that blurs ranks for the test."""

LARGEST_RANK = 99
"""Draws each truth is ranked among, thinned from the whole sample."""

MAX_DOUBLINGS = 4
"""How often a sample is made anew with twice the draws, while its smallest ESS is below the gate's."""

MAX_SHORT = 0.05
"""Largest share of samples that may stay too short."""


@dataclass(frozen=True)
class CalibrationSettings:
    """One calibration: how many truths at one number of states, and how each posterior is sampled.

    Attributes
    ----------
    states, replicates, participants : int
    prior : DirichletPrior
        Truths are drawn from it and posteriors start from it.
    sampler : NutsSettings
        Its seed is not used: every replicate has its own.
    seed : int
    """

    states: int
    replicates: int
    participants: int = 540
    prior: DirichletPrior = STICKY
    sampler: NutsSettings = field(default_factory=lambda: NutsSettings(draws=1000, tune=500, chains=2))
    seed: int = 1

    def __post_init__(self) -> None:
        for name, low in (("states", 1), ("replicates", 1), ("participants", 1), ("seed", 0)):
            if getattr(self, name) < low:
                raise located(f"calibration, {name}", getattr(self, name), f"an integer of at least {low}")


@dataclass(frozen=True)
class Replicate:
    """One truth among the draws of its posterior.

    Attributes
    ----------
    names : list of str
    ranks : int64[statistic]
        In 0..`LARGEST_RANK`.
    draws : int
        Draws a chain, after any doubling.
    min_ess, max_rhat : float
        Over the statistics.
    divergences : int
    """

    names: list[str]
    ranks: NDArray[np.int64]
    draws: int
    min_ess: float
    max_rhat: float
    divergences: int

    @property
    def long_enough(self) -> bool:
        """Whether the smallest effective sample size passes the gate."""
        return self.min_ess > MIN_ESS


def run_replicate(settings: CalibrationSettings, index: int, *, stop: Event | None = None) -> Replicate:
    """Draw a truth, simulate its study, sample the posterior, rank the truth. Depends on its arguments only."""
    key = (STREAM, settings.states, index)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=key))
    layout = Layout(PUBLISHED, settings.states)
    truth = prior_draw(layout, settings.prior, rng)
    log = simulated_study(truth, settings.participants, "simulated_calibration", rng)
    return rank_truth(truth, log, settings, rng, stop)


def rank_truth(
    truth: LatentStatePOMDP,
    log: EventLog,
    settings: CalibrationSettings,
    rng: np.random.Generator,
    stop: Event | None = None,
) -> Replicate:
    """Sample the posterior of a study and rank its truth; setting `stop` ends it with `CancelledError`."""
    layout = Layout(log.protocol, settings.states)
    alpha = 1.0 + settings.prior.pseudo_counts(layout)
    density = HmmDensity(log.tree(), layout, alpha, {})
    seed, own = int(rng.integers(2**31)), settings.sampler
    for doubling in range(MAX_DOUBLINGS + 1):
        sampler = NutsSettings(own.draws * 2**doubling, own.tune, own.chains, seed, own.target_accept)
        chains = [sample_chain(density, c, sampler, stop=stop) for c in range(sampler.chains)]
        theta = constrained(density, np.stack([c.x for c in chains]))
        names, values = quantities(log, layout, alpha, theta)
        divergences = int(sum(c.stats["diverging"].sum() for c in chains))
        gate = convergence_gate(values, names, divergences)
        if gate.min_ess_bulk > MIN_ESS:
            break
    pooled = values.reshape(-1, len(names))
    kept = np.linspace(0, len(pooled) - 1, LARGEST_RANK).round().astype(np.int64)
    at_truth = quantities(log, layout, alpha, layout.pack(truth.initial, truth.transition, truth.emission))[1]
    ranks = ranks_of(at_truth, pooled[kept], rng)
    return Replicate(names, ranks, sampler.draws, gate.min_ess_bulk, gate.max_rhat, gate.divergences)


@dataclass(frozen=True)
class CalibrationRun:
    """All replicates at one number of states."""

    settings: CalibrationSettings
    replicates: tuple[Replicate, ...]

    @cached_property
    def ranks(self) -> NDArray[np.int64]:
        """``[replicate, statistic]``, of all replicates."""
        return np.stack([r.ranks for r in self.replicates])

    def examine(self, long_enough_only: bool = True) -> pd.DataFrame:
        """Test every statistic (`analysis.rank_uniformity.examine`).

        Raises
        ------
        InputError
            If not one sample is long enough.
        """
        kept = np.array([r.long_enough or not long_enough_only for r in self.replicates])
        if not kept.any():
            raise located(f"calibration at {self.settings.states} states, samples that are long enough", 0, "some")
        key = (BLUR_STREAM, self.settings.states)
        rng = np.random.default_rng(np.random.SeedSequence(self.settings.seed, spawn_key=key))
        return examine(self.ranks[kept], LARGEST_RANK, self.replicates[0].names, rng)

    @cached_property
    def table(self) -> pd.DataFrame:
        """Tests of every statistic on the samples that are long enough."""
        return self.examine()

    @property
    def n_short(self) -> int:
        """Replicates whose smallest effective sample size stayed below the gate's after all doublings."""
        return sum(not r.long_enough for r in self.replicates)

    @property
    def sentence(self) -> str:
        """How the sampling went."""
        own = self.settings
        longer = sum(r.draws > own.sampler.draws for r in self.replicates)
        return (
            f"{own.states} states: {own.replicates} studies of {own.participants} people, {longer} sampled longer "
            f"to reach an effective sample size of {MIN_ESS:.0f}, {self.n_short} that did not reach it and are "
            f"left out, {sum(r.divergences for r in self.replicates)} divergent transitions in all."
        )


@dataclass(frozen=True)
class Calibration:
    """Calibration at one or several numbers of states, judged together.

    Attributes
    ----------
    runs : tuple of CalibrationRun
    seconds : float
        Wall time.
    """

    runs: tuple[CalibrationRun, ...]
    seconds: float

    @cached_property
    def table(self) -> pd.DataFrame:
        """Tests of every statistic at every number of states."""
        parts = {run.settings.states: run.table for run in self.runs}
        return pd.concat(parts, names=["states"])

    @cached_property
    def p_values(self) -> pd.DataFrame:
        """The p-values of the table."""
        return p_values(self.table)

    @property
    def adjusted_p(self) -> float:
        """Smallest p-value of all tests times their number (Bonferroni), at most 1."""
        return bonferroni(self.table)

    @property
    def adjusted_p_of_all(self) -> float:
        """The same with the samples that were too short."""
        return bonferroni(pd.concat([run.examine(long_enough_only=False) for run in self.runs]))

    @property
    def short_share(self) -> float:
        """Share of samples too short, where it is largest."""
        return max(run.n_short / run.settings.replicates for run in self.runs)

    @property
    def passed(self) -> bool:
        """Whether no test rejects at the family-wise 1%, and hardly any sample was too short."""
        return self.adjusted_p >= FAMILY_WISE and self.short_share <= MAX_SHORT

    @property
    def worst(self) -> str:
        """The statistic with the smallest p-value, with the test."""
        p = self.p_values.to_numpy()
        row, column = np.unravel_index(np.argmin(p), p.shape)
        states, name = self.table.index[int(row)]
        return f"{name} at {states} states, {self.p_values.columns[int(column)][2:].replace('_', ' ')}"

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        p = self.p_values
        short = sum(run.n_short for run in self.runs)
        studies = sum(run.settings.replicates for run in self.runs) - short
        tests = (
            f"smallest p-value of {p.size} tests {p.to_numpy().min():.2g} ({self.worst}), {self.adjusted_p:.2g} "
            f"after Bonferroni; coverage of 50% intervals {self.table['coverage_50'].mean():.1%}, "
            f"of 90% intervals {self.table['coverage_90'].mean():.1%}"
        )
        aside = f"; in {short} more the sampler did not converge, which the gate reports" if short else ""
        if self.passed:
            verdict = f"Calibrated as far as {studies} studies can tell: ranks of the truths are uniform"
            return f"{verdict} ({tests}){aside}."
        if self.adjusted_p >= FAMILY_WISE:
            return f"NOT settled by {studies} studies ({tests}){aside}: too many."
        return f"NOT calibrated: ranks of the truths in {studies} studies are not uniform ({tests}){aside}."

    def to_dict(self) -> dict[str, Any]:
        """Everything, ranks included, for a JSON file."""
        return {
            "sentence": self.sentence,
            "passed": self.passed,
            "family_wise": FAMILY_WISE,
            "adjusted_p": self.adjusted_p,
            "adjusted_p_with_short_samples": self.adjusted_p_of_all,
            "wall_seconds": self.seconds,
            "largest_rank": LARGEST_RANK,
            "runs": [
                {
                    "settings": asdict(run.settings), "sentence": run.sentence,
                    "statistics": [{"statistic": name, **row} for name, row in run.table.to_dict("index").items()],
                    "ranks": {n: run.ranks[:, i] for i, n in enumerate(run.replicates[0].names)},
                    "draws": [r.draws for r in run.replicates], "min_ess": [r.min_ess for r in run.replicates],
                    "max_rhat": [r.max_rhat for r in run.replicates],
                    "divergences": [r.divergences for r in run.replicates],
                }
                for run in self.runs
            ],
        }  # fmt: skip


def calibrate(
    settings: Sequence[CalibrationSettings],
    *,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Run all replicates.

    Parameters
    ----------
    settings : sequence of CalibrationSettings
        One for each number of states.
    executor : concurrent.futures.Executor, optional
        Threads or processes; a pool of threads by default (sampling holds no lock). The result does not depend
        on it.
    progress : callable, optional
        Called with (label, done, total).
    """
    if len({s.states for s in settings}) != len(settings) or not settings:
        raise located(
            "calibration, states", [s.states for s in settings], "different numbers of states, at least one"
        )
    started = time.perf_counter()
    runs = [
        CalibrationRun(
            setting,
            run_replicates(
                run_replicate, setting, setting.replicates, label=f"calibrating {setting.states} states",
                executor=executor, progress=progress,
            ),
        )
        for setting in settings
    ]  # fmt: skip
    return Calibration(tuple(runs), time.perf_counter() - started)
