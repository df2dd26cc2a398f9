"""One replicate of the recovery study: a truth, a study drawn from it, and what the learners make of the study."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from threading import Event

import numpy as np

from analysis.model_criteria import HIGH_K, alike, loo_by_person
from analysis.recovery_quantities import (
    Name,
    effects,
    entries,
    of_bootstrap,
    of_posterior,
    of_truth,
)
from analysis.replicates import prior_draw, simulated_study
from models.baum_welch import BaumWelch
from models.baum_welch_fit import BaumWelchFit
from models.bayesian_fit import fit
from models.bootstrap import bootstrap_fit
from models.errors import located
from models.events import EventLog
from models.gate import Gate
from models.hmm_density import HmmDensity
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.nuts import Chain, NutsSettings
from models.parameters import STICKY, Array, DirichletPrior, Layout
from models.posterior import Posterior
from models.protocol import PUBLISHED
from models.smc import SmcSettings, log_marginal_likelihood

STREAM = 7_203
"""First element of the spawn keys: true number of states and replicate follow, then the number of states fitted."""

LEVELS = (0.5, 0.9)
"""Of the equal-tailed intervals whose coverage is counted."""

Quantities = Callable[[ModelDraws], tuple[list[Name], Array]]
"""Names, and values ``[draw, quantity]``."""


@dataclass(frozen=True)
class RecoverySettings:
    """One recovery study.

    Attributes
    ----------
    states : tuple of int
        Numbers of states that are fitted; entries are compared where the number is the true one.
    replicates, participants : int
    truth : LatentStatePOMDP or None
        Under the published protocol; None draws a fresh truth from `prior` for every replicate.
    true_states : int
        Number of states of the truth; that of `truth` where one is given.
    prior : DirichletPrior
    sampler : NutsSettings
        Its seed is not used: every fit has its own.
    restarts, finalists : int
        Of Baum-Welch.
    bootstrap : int
        Bootstrap replicates of the EM estimate with the true number of states; 0 for none.
    select : bool
        Also compute what chooses a number of states.
    evidence : SmcSettings
        For the marginal likelihood; its seed is not used.
    seed : int
    """

    states: tuple[int, ...]
    replicates: int = 20
    participants: int = 540
    truth: LatentStatePOMDP | None = None
    true_states: int = 3
    prior: DirichletPrior = STICKY
    sampler: NutsSettings = field(default_factory=NutsSettings)
    restarts: int = 60
    finalists: int = 10
    bootstrap: int = 0
    select: bool = False
    evidence: SmcSettings = field(default_factory=lambda: SmcSettings(200, 2, moves=2))
    seed: int = 1

    def __post_init__(self) -> None:
        for name, low in (("replicates", 1), ("participants", 1), ("true_states", 1), ("seed", 0)):
            if getattr(self, name) < low:
                raise located(f"recovery, {name}", getattr(self, name), f"an integer of at least {low}")
        if not self.states or min(self.states) < 1 or len(set(self.states)) < len(self.states):
            raise located("recovery, states", list(self.states), "different numbers of states, at least one")
        if self.select and len(self.states) < 2:
            raise located("recovery, states to select from", list(self.states), "at least two numbers of states")
        if self.bootstrap == 1 or self.bootstrap < 0:
            raise located("recovery, bootstrap", self.bootstrap, "0 for none, or at least 2 replicates")
        if self.truth is not None:
            if self.truth.protocol != PUBLISHED:
                raise located("recovery, protocol of the truth", self.truth.protocol.name, repr(PUBLISHED.name))
            if self.truth.n_states != self.true_states:
                raise located("recovery, true_states", self.true_states, f"{self.truth.n_states}, as the truth has")


@dataclass(frozen=True)
class Recovered:
    """What one study says with one number of states, beside its truth.

    Attributes
    ----------
    names : tuple of (table, entry)
        Entries where the number of states is the true one, then effects.
    truth, em, mean, prior_mean, contraction : float64[n]
        Posterior mean, and the mean of the prior relabelled the same way: a guess without data.
    interval : float64[level, end, n]
        Posterior intervals at `LEVELS`.
    boot : float64[level, end, n] or None
        Percentile intervals of the EM bootstrap; NaN for effects.
    gate : Gate
    converged : bool
        Of EM.
    criteria : mapping
        ``log_likelihood, aic, bic, elpd, log_marginal`` and ``high_k``, if they were asked for.
    """

    names: tuple[Name, ...]
    truth: Array
    em: Array
    mean: Array
    prior_mean: Array
    contraction: Array
    interval: Array
    boot: Array | None
    gate: Gate
    converged: bool
    criteria: Mapping[str, float]

    @property
    def covered(self) -> Array:
        """Whether each posterior interval holds the truth, ``[level, n]``."""
        return _holds(self.interval, self.truth)

    @property
    def boot_covered(self) -> Array | None:
        """The same of the bootstrap intervals; NaN where there are none."""
        return None if self.boot is None else _holds(self.boot, self.truth)


Study = dict[int, Recovered]
"""One replicate, by number of states fitted."""


def run_study(settings: RecoverySettings, index: int, *, stop: Event | None = None) -> Study:
    """Draw a truth and its study, learn from it with every number of states. Depends on its arguments only."""
    key = (STREAM, settings.true_states, index)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=key))
    truth = settings.truth or prior_draw(Layout(PUBLISHED, settings.true_states), settings.prior, rng)
    log = simulated_study(truth, settings.participants, "simulated_recovery", rng)
    known = of_truth(truth, log)
    out = {}
    for k in settings.states:
        stream = np.random.SeedSequence(settings.seed, spawn_key=(*key, k))
        out[k] = _recover(settings, log, known, k, int(stream.generate_state(1)[0]), stop)
    return out


def _recover(
    settings: RecoverySettings, log: EventLog, truth: ModelDraws, k: int, seed: int, stop: Event | None
) -> Recovered:
    def may_go_on(number: int = 0, chain: Chain | None = None) -> None:
        if stop is not None and stop.is_set():
            raise CancelledError

    may_go_on()
    em = BaumWelch(k, restarts=settings.restarts, finalists=settings.finalists, rounds=1, seed=seed).fit(log)
    may_go_on()
    own = settings.sampler
    sampler = NutsSettings(own.draws, own.tune, own.chains, seed, own.target_accept)
    posterior = fit(log, k, prior=settings.prior, sampler=sampler, finished=may_go_on)
    compared: list[Quantities] = [lambda models: effects(models, log)]
    if k == truth.n_states:
        compared.insert(0, entries)
    names: list[Name] = []
    rows = []
    for quantities in compared:
        own_names, known = quantities(truth)
        names += own_names
        after = _summary(quantities(of_posterior(posterior))[1])
        before = _summary(quantities(of_posterior(posterior, "prior"))[1])
        rows.append(np.vstack([known, quantities(em.draws())[1], before[:2], after]))
    known, at_em, guess, guess_variance, mean, variance, *ends = np.concatenate(rows, axis=1)
    boot = None
    if settings.bootstrap and k == truth.n_states:
        made = bootstrap_fit(em, log, settings.bootstrap, seed=seed)
        values = entries(of_bootstrap(made, log.protocol))[1]
        boot = np.full((len(LEVELS), 2, len(names)), np.nan)
        boot[..., : values.shape[1]] = _intervals(values)
    may_go_on()
    with np.errstate(invalid="ignore", divide="ignore"):
        contraction = np.where(guess_variance > 1e-20, 1 - variance / guess_variance, np.nan)
    criteria = _criteria(settings, log, em, posterior, seed) if settings.select else {}
    return Recovered(
        tuple(names), known, at_em, mean, guess, contraction, np.reshape(ends, (len(LEVELS), 2, -1)), boot,
        posterior.gate, em.converged, criteria,
    )  # fmt: skip


def _summary(draws: Array) -> Array:
    """Mean, variance, then low and high of the intervals at `LEVELS`; ``[row, quantity]``."""
    ends = _intervals(draws).reshape(2 * len(LEVELS), -1)
    return np.concatenate([draws.mean(axis=0)[None], draws.var(axis=0, ddof=1)[None], ends])


def _intervals(draws: Array) -> Array:
    """Equal-tailed intervals, ``[level, end, quantity]``."""
    probabilities = [p for level in LEVELS for p in ((1 - level) / 2, (1 + level) / 2)]
    return np.quantile(draws, probabilities, axis=0).reshape(len(LEVELS), 2, -1)


def _holds(ends: Array, truth: Array) -> Array:
    """Whether intervals hold the truth: 1, 0, or NaN where there is no interval."""
    low, high = ends[:, 0], ends[:, 1]
    return np.where(np.isnan(low), np.nan, (low <= truth) & (truth <= high))


def _criteria(
    settings: RecoverySettings, log: EventLog, em: BaumWelchFit, posterior: Posterior, seed: int
) -> dict[str, float]:
    layout = Layout(log.protocol, posterior.n_states)
    density = HmmDensity(log.tree(), layout, 1.0 + settings.prior.pseudo_counts(layout), {})
    own = settings.evidence
    marginal = log_marginal_likelihood(
        density, SmcSettings(own.particles, own.runs, own.ess, own.moves, own.path, seed)
    )
    loo = loo_by_person(posterior.person_log_likelihoods(), alike(log))
    return {
        "log_likelihood": em.log_likelihood, "aic": em.aic, "bic": em.bic, "elpd": float(loo.elpd),
        "log_marginal": marginal.estimate, "high_k": int(np.count_nonzero(loo.pareto_k.values > HIGH_K)),
    }  # fmt: skip
