"""How much work a report puts into its fits, full or quick: stated in the report, never dependent on a clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from analysis.comparison import CompareSettings
from models.baum_welch import BaumWelch
from models.baum_welch_fit import BaumWelchFit
from models.events import EventLog
from models.nuts import NutsSettings
from models.parameters import Array
from models.smc import SmcSettings

BOOTSTRAP_WORK = 6_400_000
"""Bound on replicates x histories' nodes x states squared: about a minute on two cores."""


@dataclass(frozen=True)
class Effort:
    """Settings of the fits of a report.

    Attributes
    ----------
    quick : bool
    restarts, finalists : int
        Of the longer search.
    replicates : int
        Most bootstrap replicates of a shown model.
    bootstrap_maps : int
        Cap on EM maps of a replicate.
    bootstrap_tolerance : float
        Looser than the search's: the interval is far wider than what is left to gain.
    draws, tune, chains : int
        Of the posterior.
    refit_draws : int
        Of its refits under other priors, tuned for as many.
    simulated_studies : int
        Of a predictive check.
    fold_particles, fold_moves : int
        Particles that are carried to the posterior without a fold of people, and proposals each makes at a step.
    evidence_particles, evidence_runs, evidence_moves : int
        The same of the marginal likelihood, with the independent runs that its Monte Carlo error comes from.
    """

    quick: bool
    restarts: int
    finalists: int
    replicates: int
    bootstrap_maps: int = 2000
    bootstrap_tolerance: float = 1e-6
    draws: int = 1000
    tune: int = 1000
    chains: int = 4
    refit_draws: int = 1000
    simulated_studies: int = 400
    fold_particles: int = 300
    fold_moves: int = 3
    evidence_particles: int = 300
    evidence_runs: int = 2
    evidence_moves: int = 2

    @classmethod
    def of(cls, quick: bool) -> Effort:
        """Effort of a full or a quick report."""
        if not quick:
            return cls(False, 200, 30, 200)
        return cls(
            True, 100, 20, 20, draws=300, tune=300, chains=2, refit_draws=200, simulated_studies=200,
            fold_particles=200, fold_moves=3, evidence_particles=200, evidence_runs=2, evidence_moves=2,
        )  # fmt: skip

    def sampler(self, seed: int, main: bool = True) -> NutsSettings:
        """Settings of the sampler, for the posterior itself or for a refit under another prior."""
        if main:
            return NutsSettings(self.draws, self.tune, self.chains, seed)
        return NutsSettings(self.refit_draws, self.refit_draws, self.chains, seed)

    def comparison(self, seed: int, folds: int) -> CompareSettings:
        """Settings of the comparison of models, whose posteriors are those of the report."""
        return CompareSettings(
            self.restarts, self.finalists, self.sampler(seed),
            SmcSettings(self.evidence_particles, self.evidence_runs, moves=self.evidence_moves, seed=seed),
            SmcSettings(self.fold_particles, moves=self.fold_moves, seed=seed), folds, seed=seed,
        )  # fmt: skip

    def search(self, n_states: int, pins: Mapping[str, Array | None], seed: int) -> BaumWelch:
        """Settings of the longer search."""
        return BaumWelch(n_states, restarts=self.restarts, finalists=self.finalists, pins=pins, seed=seed)

    def for_bootstrap(self, fit: BaumWelchFit) -> BaumWelchFit:
        """Same fit with the settings its replicates are refitted with."""
        settings = replace(fit.settings, max_maps=self.bootstrap_maps, tolerance=self.bootstrap_tolerance)
        return replace(fit, settings=settings)

    def replicates_for(self, log: EventLog, n_states: int) -> int:
        """Bootstrap replicates that stay within `BOOTSTRAP_WORK`: tens, at least 20."""
        affordable = BOOTSTRAP_WORK // (log.tree().n_nodes * n_states**2)
        return max(20, min(self.replicates, affordable // 10 * 10))
