"""One replicate of simulation-based calibration: a truth, its study, its posterior, and the rank of the truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from threading import Event

import numpy as np
from numpy.typing import NDArray

from analysis.calibration_statistics import quantities
from analysis.rank_uniformity import ranks_of
from analysis.replicates import prior_draw, prior_spread, simulated_study
from models.draw_kernels import constrained
from models.errors import located
from models.events import EventLog
from models.gate import MIN_ESS, convergence_gate
from models.nuts import NutsSettings, sample_chain
from models.parameters import STICKY, Array, DirichletPrior, Layout
from models.person_offset import PersonOffset
from models.protocol import PUBLISHED
from models.study_density import ModelSpec, StudyDensity

STREAM, PEOPLE_STREAM = 7_201, 7_204
"""First elements of the spawn keys of replicates, people alike and different; states and replicate follow."""

LARGEST_RANK = 99
"""Draws each truth is ranked among, thinned from the whole sample."""

MAX_DOUBLINGS = 4
"""How often a sample is made anew with twice the draws, while its smallest ESS is below the gate's."""


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
    people : PersonOffset, optional
        The hierarchical version: sigma is drawn from its prior too, and each person has an offset.
    runs_per_person : int
        Several let the data tell people from states; offsets are the same in all of them.
    """

    states: int
    replicates: int
    participants: int = 540
    prior: DirichletPrior = STICKY
    sampler: NutsSettings = field(default_factory=lambda: NutsSettings(draws=1000, tune=500, chains=2))
    seed: int = 1
    people: PersonOffset | None = None
    runs_per_person: int = 1

    def __post_init__(self) -> None:
        for name, low in (
            ("states", 1), ("replicates", 1), ("participants", 1), ("runs_per_person", 1), ("seed", 0),
        ):  # fmt: skip
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
    node_check : float
        Change of the log-likelihood with twice the quadrature nodes, in nats; 0 where people do not differ.
    """

    names: list[str]
    ranks: NDArray[np.int64]
    draws: int
    min_ess: float
    max_rhat: float
    divergences: int
    node_check: float = 0.0

    @property
    def long_enough(self) -> bool:
        """Whether the smallest effective sample size passes the gate."""
        return self.min_ess > MIN_ESS


def run_replicate(settings: CalibrationSettings, index: int, *, stop: Event | None = None) -> Replicate:
    """Draw a truth, simulate its study, sample the posterior, rank the truth. Depends on its arguments only."""
    key = (STREAM if settings.people is None else PEOPLE_STREAM, settings.states, index)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=key))
    layout = Layout(PUBLISHED, settings.states)
    truth = prior_draw(layout, settings.prior, rng)
    theta = layout.pack(truth.initial, truth.transition, truth.emission)
    spread = None
    if settings.people is not None:
        spread = prior_spread(settings.people, rng)
        theta = np.append(theta, spread)
    log = simulated_study(
        truth, settings.participants, "simulated_calibration", rng, runs=settings.runs_per_person, spread=spread
    )
    return rank_truth(theta, log, settings, rng, stop)


def rank_truth(
    truth: Array,
    log: EventLog,
    settings: CalibrationSettings,
    rng: np.random.Generator,
    stop: Event | None = None,
) -> Replicate:
    """Sample the posterior of a study and rank its truth.

    Parameters
    ----------
    truth : float64[theta]
        Sigma last where people differ.
    log : EventLog
    settings : CalibrationSettings
    rng : numpy.random.Generator
    stop : threading.Event, optional
        Setting it from another thread ends the work with `CancelledError`.
    """
    study = StudyDensity(log, ModelSpec(settings.states, settings.prior, people=settings.people))
    density = study.density
    seed, own = int(rng.integers(2**31)), settings.sampler
    for doubling in range(MAX_DOUBLINGS + 1):
        sampler = NutsSettings(own.draws * 2**doubling, own.tune, own.chains, seed, own.target_accept)
        chains = [sample_chain(density, c, sampler, stop=stop) for c in range(sampler.chains)]
        theta = constrained(density, np.stack([c.x for c in chains]))
        names, values = quantities(study, theta)
        divergences = int(sum(c.stats["diverging"].sum() for c in chains))
        gate = convergence_gate(values, names, divergences)
        if gate.min_ess_bulk > MIN_ESS:
            break
    ranks = ranks_of(quantities(study, truth)[1], thinned(values), rng)
    some = theta[:, :: max(1, sampler.draws // 5)].reshape(-1, theta.shape[-1])
    return Replicate(
        names, ranks, sampler.draws, gate.min_ess_bulk, gate.max_rhat, divergences, study.node_check(some)
    )


def thinned(values: Array) -> Array:
    """`LARGEST_RANK` draws, evenly spaced over all chains; ``[chain, draw, quantity]`` to ``[draw, quantity]``.

    Where the effective sample size is the gate's or more they are all but independent, as uniform ranks need.
    """
    pooled = values.reshape(-1, values.shape[-1])
    return pooled[np.linspace(0, len(pooled) - 1, LARGEST_RANK).round().astype(np.int64)]
