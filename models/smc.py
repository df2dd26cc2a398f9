r"""Log marginal likelihood of a latent-state model by tempered sequential Monte Carlo.

Particles drawn from the prior are carried to the posterior along
:math:`\pi_\tau(\theta) \propto p(\theta)\,p(y \mid \theta)^\tau`, :math:`0 = \tau_0 < ... < \tau_T = 1`. Each
temperature is the largest at which the incremental weights :math:`w_i = p(y \mid \theta_i)^{\tau_t - \tau_{t-1}}`
keep a given effective sample size; then particles are resampled (systematically) and moved by Hamiltonian Monte
Carlo with the exact gradient. The estimate is

.. math:: \log \hat p(y) = \sum_t \log \frac{1}{N} \sum_i w_i^{(t)}

(Del Moral, Doucet & Jasra 2006). Its Monte Carlo error is taken from independent runs, not from theory: a single
run says nothing about its own error. Labels are free: the integral is over all labellings of the states, as the
prior is, and particles that start in the prior sit in all of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from models.compiled import kernel
from models.errors import located
from models.hmm_density import LOGIT, HmmDensity, log_density
from models.parameters import Array

STREAM = 7_103
"""First element of the spawn keys of runs."""

TARGET_ACCEPTANCE = 0.75
LONGEST_PATH = 40
"""Most leapfrog steps of one proposal."""


@dataclass(frozen=True)
class SmcSettings:
    """How the marginal likelihood is estimated.

    Attributes
    ----------
    particles : int
    runs : int
        Independent runs; their spread is the Monte Carlo error.
    ess : float
        Effective sample size of the incremental weights, as a share of the particles, at every temperature.
    moves : int
        Proposals a particle makes at every temperature.
    path : float
        Length of a proposal's path, in standard deviations of the particles.
    seed : int
    """

    particles: int = 600
    runs: int = 4
    ess: float = 0.5
    moves: int = 3
    path: float = 1.5
    seed: int = 1

    def __post_init__(self) -> None:
        for name, low in (("particles", 20), ("runs", 1), ("moves", 1), ("seed", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < low:
                raise located(f"marginal likelihood, {name}", value, f"an integer of at least {low}")
        if not 0.05 <= self.ess <= 0.99:
            raise located("marginal likelihood, ess", self.ess, "a share from .05 to .99")
        if not (np.isfinite(self.path) and self.path > 0):
            raise located("marginal likelihood, path", self.path, "a positive number")


@dataclass(frozen=True)
class MarginalLikelihood:
    """Estimate with its Monte Carlo error.

    Attributes
    ----------
    runs : float64[runs]
        Log estimates of the independent runs.
    temperatures : tuple of float64[stages]
        Of each run.
    acceptance : float64[runs]
        Smallest share of accepted proposals at any temperature.
    """

    runs: Array
    temperatures: tuple[Array, ...]
    acceptance: Array

    @property
    def estimate(self) -> float:
        """Logarithm of the mean of the runs' estimates, which are unbiased before the logarithm is taken."""
        return float(logsumexp(self.runs) - np.log(len(self.runs)))

    @property
    def error(self) -> float:
        """Standard error, ``sd(runs) / sqrt(runs)``; NaN for a single run."""
        n = len(self.runs)
        return float(np.std(self.runs, ddof=1) / np.sqrt(n)) if n > 1 else float("nan")


def log_marginal_likelihood(
    density: HmmDensity, settings: SmcSettings | None = None, *, progress: Callable[[int, int], None] | None = None
) -> MarginalLikelihood:
    """Estimate ``log p(y)``, runs in threads.

    Parameters
    ----------
    density : HmmDensity
        A study and its priors; pinned tables are held.
    settings : SmcSettings, optional
    progress : callable, optional
        Called with (done, total) runs.
    """
    settings = settings or SmcSettings()
    density.arrays, density.dimension  # noqa: B018  (cached before threads share them)
    streams = [np.random.SeedSequence(settings.seed, spawn_key=(STREAM, r)) for r in range(settings.runs)]
    found = []
    stop = Event()
    pool = ThreadPoolExecutor(max_workers=min(settings.runs, os.cpu_count() or 1))
    try:
        for result in pool.map(
            lambda stream: _run(density, settings, np.random.default_rng(stream), stop), streams
        ):
            found.append(result)
            if progress is not None:
                progress(len(found), settings.runs)
    except BaseException:
        stop.set()  # running threads notice at their next proposal
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()
    values, temperatures, acceptance = zip(*found, strict=True)
    return MarginalLikelihood(np.array(values), tuple(temperatures), np.array(acceptance))


def prior_particles(density: HmmDensity, n: int, rng: np.random.Generator) -> Array:
    """Exact draws from the prior, unconstrained; ``[n, coordinate]``."""
    x = np.empty((n, density.dimension))
    for start, width, kind, top, offset in zip(*density.plan, strict=True):
        logs = np.log(rng.gamma(density.arrays.alpha[start : start + width], size=(n, width)))
        if kind == LOGIT:
            x[:, offset] = logs[:, top - start] - logs[:, 1 - (top - start)]
        else:
            x[:, offset : offset + width - 1] = (logs - logs.mean(axis=1, keepdims=True))[:, :-1]
    if density.people_differ:
        x[:, -1] = np.log(density.people.prior_scale[0] * np.abs(rng.standard_normal(n)))
    return x


def _run(
    density: HmmDensity, settings: SmcSettings, rng: np.random.Generator, stop: Event
) -> tuple[float, Array, float]:
    """One run: log estimate, temperatures, smallest acceptance."""
    n = settings.particles
    x = prior_particles(density, n, rng)
    log_likelihood = np.empty(n)
    _likelihoods(x, density.arrays, log_likelihood)
    total, temperature, step, worst = 0.0, 0.0, 0.5, 1.0
    temperatures = [0.0]
    while temperature < 1.0:
        following = next_temperature(log_likelihood, temperature, settings.ess)
        weight = (following - temperature) * log_likelihood
        total += float(logsumexp(weight) - np.log(n))
        share = np.exp(weight - logsumexp(weight))
        scale = spread(x, share)  # before resampling makes particles coincide
        kept = systematic(share, rng.random())
        x, log_likelihood = np.ascontiguousarray(x[kept]), log_likelihood[kept]
        temperature = following
        temperatures.append(temperature)
        step, rate = moved(density, x, log_likelihood, temperature, scale, step, settings, rng, stop)
        worst = min(worst, rate)
    return total, np.array(temperatures), worst


def moved(
    density: HmmDensity, x: Array, log_likelihood: Array, temperature: float, scale: Array, step: float,
    settings: SmcSettings, rng: np.random.Generator, stop: Event | None = None,
) -> tuple[float, float]:  # fmt: skip
    """Let every particle make its proposals, in place.

    Parameters
    ----------
    density : HmmDensity
    x : float64[n, coordinate]
        Particles, distributed by the tempered posterior; they still are afterwards.
    log_likelihood : float64[n]
        At the particles; kept up to date.
    temperature : float
        Above 0.
    scale : float64[coordinate]
        Standard deviations of the particles.
    step : float
        Leapfrog step in units of `scale`.
    settings : SmcSettings
    rng : numpy.random.Generator
    stop : threading.Event, optional
        Setting it from another thread ends the work with `CancelledError`.

    Returns
    -------
    step : float
        Adapted to `TARGET_ACCEPTANCE`.
    rate : float
        Smallest share of accepted proposals.
    """
    n, dimension = x.shape
    worst = 1.0
    for _ in range(settings.moves if dimension else 0):
        if stop is not None and stop.is_set():
            raise CancelledError
        steps = int(np.clip(np.ceil(settings.path / step), 1, LONGEST_PATH))
        lengths = rng.integers(max(1, steps // 2), steps + 1, n)
        momentum = rng.standard_normal((n, dimension))
        accepted = _move(
            x, log_likelihood, density.arrays, temperature, step * scale, momentum, np.log(rng.random(n)), lengths
        )
        worst = min(worst, accepted / n)
        step = float(np.clip(step * np.exp(accepted / n - TARGET_ACCEPTANCE), 1e-3, 2.0))
    return step, worst


def next_temperature(log_likelihood: Array, temperature: float, ess: float) -> float:
    """Largest temperature up to 1 at which the incremental weights keep their effective sample size."""
    best = float(np.max(log_likelihood))
    if not np.isfinite(best):
        raise located("marginal likelihood, log-likelihood of the particles", best, "a finite number")

    def share(to: float) -> float:
        w = np.exp((to - temperature) * (log_likelihood - best))
        return float(w.sum() ** 2 / (w @ w) / len(w))

    if share(1.0) >= ess:
        return 1.0
    low, high = temperature, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if share(middle) >= ess else (low, middle)
    return max(low, temperature + 1e-9 * (1.0 - temperature))


def spread(x: Array, share: Array) -> Array:
    """Weighted standard deviation of every coordinate."""
    return np.sqrt(np.maximum(share @ (x - share @ x) ** 2, 1e-12))


def systematic(share: Array, uniform: float) -> NDArray[np.int64]:
    """Systematic resampling: indices drawn with expected numbers ``n share``."""
    n = len(share)
    edges = np.cumsum(share)
    return np.minimum(np.searchsorted(edges, (np.arange(n) + uniform) / n * edges[-1], side="right"), n - 1)


@kernel
def _likelihoods(x, study, out):  # type: ignore[no-untyped-def]
    gradient = np.empty(x.shape[1])
    for i in range(len(x)):
        both = log_density(x[i], gradient, study, 1.0)
        out[i] = both - log_density(x[i], gradient, study, 0.0)


@kernel
def _move(  # type: ignore[no-untyped-def]
    x, log_likelihood, study, temperature, step, momentum, log_uniform, lengths
):
    """One Hamiltonian proposal a particle, in place; `step` holds a step a coordinate. Returns how many moved."""
    accepted = 0
    dimension = x.shape[1]
    gradient = np.empty(dimension)
    place = np.empty(dimension)
    for i in range(len(x)):
        place[:] = x[i]
        p = momentum[i]
        start = log_density(place, gradient, study, temperature)
        before = start - 0.5 * np.sum(p * p)
        value = start
        for _ in range(lengths[i]):
            for d in range(dimension):
                p[d] += 0.5 * step[d] * gradient[d]
                place[d] += step[d] * p[d]
            value = log_density(place, gradient, study, temperature)
            if not np.isfinite(value):
                break
            for d in range(dimension):
                p[d] += 0.5 * step[d] * gradient[d]
        after = value - 0.5 * np.sum(p * p)
        if np.isfinite(after) and log_uniform[i] < after - before:
            x[i] = place
            prior = log_density(place, gradient, study, 0.0)
            log_likelihood[i] = (value - prior) / temperature
            accepted += 1
    return accepted
