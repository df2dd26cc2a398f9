"""With how many people, and which sequences, is a transition table known? The latent-state model's own power.

No null hypothesis is tested here; what a study of this kind is for is to move beliefs about the transition tables.
So studies are drawn from a known truth under a design, each is learned from like any other, and the contraction of
every table (median over its entries of ``1 - var(posterior)/var(prior)``, as everywhere in the workbench) is
averaged over studies. The answer is the number of people at which the expected contraction reaches a wanted value,
or that it does not. Other sequences may do more than more people: under strict alternation only products of two
tables enter the likelihood.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import CancelledError, Executor
from dataclasses import dataclass, field
from threading import Event

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from analysis.credible import LEVEL
from analysis.design import StudyDesign, study1_design
from analysis.power_curves import Reached, reached
from analysis.replicates import Progress, run_replicates
from analysis.uncertainty import contraction
from analysis.wording import counted
from models.bayesian_fit import fit
from models.errors import located
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView
from models.nuts import Chain, NutsSettings
from models.parameters import STICKY, DirichletPrior
from models.protocol import PUBLISHED
from models.simulation import simulate_responses

Array = NDArray[np.float64]

STREAM = 7_302
"""First element of the spawn keys; people and study follow, so that every design meets the same random numbers."""

ALL_MOVES = "all moves"
"""Name of the median over the entries of all transition tables together."""

FEW_DRAWS = NutsSettings(draws=250, tune=250, chains=2)
"""Enough for a variance to a tenth or two, and the average over studies does the rest."""

UNSETTLED = 1.1
"""r-hat above which a posterior is counted as unsettled."""


@dataclass(frozen=True)
class ContractionPower:
    """What to simulate.

    Attributes
    ----------
    truth : LatentStatePOMDP
        Under the published protocol; as many states are learned as it has, at least two.
    designs : mapping of str to StudyDesign
        By the name they are reported under.
    people : tuple of int
        Sizes of studies, ascending.
    studies : int
        Simulated studies of each size and design.
    prior : DirichletPrior
    sampler : NutsSettings
        Its seed is not used: every study has its own.
    seed : int
    """

    truth: LatentStatePOMDP
    designs: Mapping[str, StudyDesign]
    people: tuple[int, ...]
    studies: int = 5
    prior: DirichletPrior = STICKY
    sampler: NutsSettings = FEW_DRAWS
    seed: int = 1

    def __post_init__(self) -> None:
        if self.truth.protocol != PUBLISHED:
            raise located("truth, protocol", self.truth.protocol.name, repr(PUBLISHED.name))
        if self.truth.n_states < 2:
            raise located("truth, states", self.truth.n_states, "at least 2: one state cannot change")
        if not self.designs:
            raise located("designs", len(self.designs), "at least one")
        if not self.people or min(self.people) < 1 or list(self.people) != sorted(set(self.people)):
            raise located("people", list(self.people), "different positive numbers, ascending")
        if self.studies < 2:
            raise located("studies", self.studies, "at least 2, to know the error of the average")

    @property
    def plan(self) -> tuple[tuple[str, int, int], ...]:
        """Design, people and number of every study that is simulated."""
        return tuple((d, n, i) for d in self.designs for n in self.people for i in range(self.studies))


@dataclass(frozen=True)
class LearnedStudy:
    """Contraction of every table in one simulated study, and the largest r-hat of its posterior."""

    by_table: Mapping[str, float]
    max_rhat: float


@dataclass(frozen=True)
class ContractionPowerResult(NotebookView):
    """Expected contraction by design, number of people and table.

    Attributes
    ----------
    table : DataFrame
        One row a design, number of people and table: ``design, people, table, mean, error`` (of the mean), ``low,
        high`` (t interval of the mean over studies), ``sd`` (between studies).
    values : DataFrame
        One row a study: ``design, people, study, max_rhat``, and one column a table.
    settings : ContractionPower
    level : float
    seconds : float
    """

    _whose = "simulated"

    table: pd.DataFrame
    values: pd.DataFrame
    settings: ContractionPower
    level: float
    seconds: float = field(compare=False)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables."""
        return tuple(dict.fromkeys(self.table["table"]))

    @property
    def unsettled(self) -> int:
        """Posteriors whose chains disagree (r-hat above `UNSETTLED`)."""
        return int((self.values["max_rhat"] > UNSETTLED).sum())

    def reached(self, wanted: float, table: str = ALL_MOVES, design: str | None = None) -> Reached:
        """The number of people at which the expected contraction of a table reaches `wanted`."""
        design = next(iter(self.settings.designs)) if design is None else design
        rows = self.table[(self.table["design"] == design) & (self.table["table"] == table)]
        if not len(rows):
            raise located("table", table, f"one of {', '.join(self.tables)}")
        people, value, low, high = (rows[c].to_numpy(float) for c in ("people", "mean", "low", "high"))
        return reached(people, value, low, high, wanted)

    def share_above(self, wanted: float, table: str = ALL_MOVES) -> pd.DataFrame:
        """Share of studies whose own contraction is at least `wanted`: ``design, people, share``."""
        above = self.values.assign(share=self.values[table] >= wanted)
        return above.groupby(["design", "people"], sort=False)["share"].mean().reset_index()

    def sentence(self, wanted: float, table: str = ALL_MOVES) -> str:
        """The answer for every design."""
        told = "; ".join(f"{name}: {self.reached(wanted, table, name).words}" for name in self.settings.designs)
        s = self.settings
        text = (
            f"Expected contraction {wanted:g} of {table} at {counted(s.truth.n_states, 'state')} "
            f"({counted(s.studies, 'study', 'studies')} a size): {told}."
        )
        if self.unsettled:
            total = len(self.values)
            text += (
                f" In {self.unsettled} of {total} posteriors the chains disagree (r-hat above {UNSETTLED:g}); "
                "their contraction is that of all chains together."
            )
        return text


def schedules_design(schedules: Sequence[str]) -> StudyDesign:
    """Study 1's conditions with other schedules, letters as published (``H``: the human may help).

    Raises
    ------
    InputError
        For other letters, or a schedule in which no response shows.
    """
    for letters in schedules:
        modes = PUBLISHED.modes_from_letters(letters)
        if not any(mode.name == "robot_needs_help" for mode in modes):
            raise located("schedule", letters, "at least one H: without it no response shows")
    return StudyDesign(study1_design().conditions, tuple(schedules))


def contraction_power(
    settings: ContractionPower,
    *,
    level: float = LEVEL,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> ContractionPowerResult:
    """Simulate studies of every size and design, learn from each, average the contraction.

    Parameters
    ----------
    settings : ContractionPower
    level : float
        Of the intervals of averages.
    executor, progress
        As for `analysis.replicates.run_replicates`; the result does not depend on them.
    """
    started = time.perf_counter()
    plan = settings.plan
    found = run_replicates(
        _one_study, settings, len(plan), label="simulated studies", executor=executor, progress=progress
    )
    values = pd.DataFrame(
        [
            {"design": d, "people": n, "study": i, "max_rhat": study.max_rhat, **study.by_table}
            for (d, n, i), study in zip(plan, found, strict=True)
        ]
    )
    names = [c for c in values.columns if c not in ("design", "people", "study", "max_rhat")]
    reach = float(special.stdtrit(settings.studies - 1, (1 + level) / 2))
    rows = []
    for (design, people), part in values.groupby(["design", "people"], sort=False):
        for name in names:
            mean, sd = float(part[name].mean()), float(part[name].std(ddof=1))
            error = sd / np.sqrt(settings.studies)
            rows.append({"design": design, "people": people, "table": name, "mean": mean, "error": error,
                         "low": mean - reach * error, "high": mean + reach * error, "sd": sd})  # fmt: skip
    return ContractionPowerResult(pd.DataFrame(rows), values, settings, level, time.perf_counter() - started)


def _one_study(settings: ContractionPower, index: int, *, stop: Event | None = None) -> LearnedStudy:
    """Draw one study of the plan and learn from it; depends on its place in the design only, not in the plan."""

    def may_go_on(number: int = 0, chain: Chain | None = None) -> None:
        if stop is not None and stop.is_set():
            raise CancelledError

    may_go_on()
    design, people, study = settings.plan[index]
    stream = np.random.SeedSequence(settings.seed, spawn_key=(STREAM, people, study))
    for_data, for_chains = stream.spawn(2)
    rng = np.random.default_rng(for_data)
    log = settings.designs[design].draw(people, "simulated_power", rng)
    log, _ = simulate_responses(settings.truth, log, rng)
    own = settings.sampler
    sampler = NutsSettings(own.draws, own.tune, own.chains, int(for_chains.generate_state(1)[0]), own.target_accept)
    posterior = fit(log, settings.truth.n_states, prior=settings.prior, sampler=sampler, finished=may_go_on)
    learned = contraction(posterior)
    medians = {str(name): float(value) for name, value in learned.by_table["median"].items()}
    return LearnedStudy({ALL_MOVES: learned.median_of_moves, **medians}, posterior.gate.max_rhat)
