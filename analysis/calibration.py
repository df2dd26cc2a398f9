"""Simulation-based calibration: whether posteriors are what they claim to be, at the published design.

Truths are drawn from the prior, a study is simulated from each under the published design, its posterior is
sampled, and the truth is ranked among (nearly independent) posterior draws. If model, likelihood, sampler and
relabelling are all right, ranks are uniform: `analysis.rank_uniformity` tests that.

Some studies have a posterior in several pieces between which chains do not move; their samples do not reach the
gate's effective sample size, which a user is told. They are counted and left out of the tests. That is no
cheating: given the data the truth is a draw from the posterior, so ranks stay uniform in any set of studies chosen
by data and sampler alone. Ranks of all studies are kept in the result.

Where people differ (`CalibrationSettings.people`) truths have a sigma too, and each person several runs: a person
of the published design shows three responses, which hardly tell one who helps much from one in a helping state.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.calibration_replicate import LARGEST_RANK, CalibrationSettings, Replicate, run_replicate
from analysis.rank_uniformity import FAMILY_WISE, bonferroni, examine, p_values
from analysis.replicates import Progress, run_replicates
from analysis.wording import counted
from models.errors import located
from models.gate import MIN_ESS
from models.notebook_view import NotebookView, View, table_rows

BLUR_STREAM = 7_202
"""First element of the spawn key that blurs ranks for the test."""

MAX_SHORT = 0.05
"""Largest share of samples that may stay too short."""


@dataclass(frozen=True)
class CalibrationRun(NotebookView):
    """All replicates at one number of states."""

    _whose = "simulated"

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
        people, nodes = counted(own.participants, "person", "people"), ""
        if own.people is not None:
            people += f" who differ, {counted(own.runs_per_person, 'run')} each"
            worst = max(r.node_check for r in self.replicates)
            nodes = f"; twice the quadrature nodes change no study's log-likelihood by more than {worst:.2g} nats"
        return (
            f"{counted(own.states, 'state')}: {own.replicates} studies of {people}, {longer} sampled longer "
            f"to reach an effective sample size of {MIN_ESS:.0f}, {self.n_short} that did not reach it and are "
            f"left out, {sum(r.divergences for r in self.replicates)} divergent transitions in all{nodes}."
        )


@dataclass(frozen=True)
class Calibration(NotebookView):
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
        return f"{name} at {counted(states, 'state')}, {self.p_values.columns[int(column)][2:].replace('_', ' ')}"

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
                    "node_check": [r.node_check for r in run.replicates],
                }
                for run in self.runs
            ],
        }  # fmt: skip

    def _view(self) -> View:
        warnings = () if self.passed else ("ranks of the truths are not uniform: the posterior is not calibrated.",)
        return View("Calibration", "simulated", warnings, (), (self.sentence,), (table_rows(self.table, ".table"),))


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
