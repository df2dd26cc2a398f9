r"""Predicting people who were held out: k-fold cross-validation without starting the sampler anew for every fold.

The posterior without fold `F` is reached from draws of the full posterior by taking the fold out little by little,
:math:`\pi_u(\theta) \propto p(\theta)\,p(y_{-F} \mid \theta)\,p(y_F \mid \theta)^{1-u}`, :math:`u` from 0 to 1:
reweight, resample and move as in `models.smc`. The tree of histories stays; only its counts change. The log
predictive of a held-out person is

.. math:: \log \frac{1}{N} \sum_n p(y_i \mid \theta_n), \qquad \theta_n \sim p(\theta \mid y_{-F}),

so it needs no labels, and people (not runs) are held out.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from threading import Event

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from models.draw_kernels import constrained, person_log_likelihoods
from models.errors import located
from models.events import EventLog
from models.hmm_density import LOGIT, HmmDensity
from models.parameters import Array
from models.people_kernel import PeopleArrays
from models.person_offset import each_person, person_of_run, reweighted
from models.smc import SmcSettings, moved, next_temperature, spread, systematic
from models.spread_out import spread_out

FOLD_STREAM, MOVE_STREAM = 7_105, 7_106
"""First elements of the spawn keys: who is in which fold, and the moves of each fold."""

MOVES = SmcSettings(particles=500, moves=5)
"""Particles a fold and proposals a particle makes at every step."""


def assign_folds(log: EventLog, folds: int, seed: int) -> NDArray[np.int64]:
    """Fold of each person, at random within the condition of their first run, sizes as equal as can be.

    Raises
    ------
    InputError
        On fewer than 2 folds or more folds than people.
    """
    people = log.n_participants
    if not 2 <= folds <= people:
        raise located("folds", folds, f"from 2 to the number of people, {people}")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FOLD_STREAM, folds)))
    first = np.unique(log.participant, return_index=True)[1]
    order = np.lexsort((rng.random(people), log.condition[first]))
    out = np.empty(people, dtype=np.int64)
    out[order] = np.arange(people) % folds
    return out


def held_out_log_predictive(
    log: EventLog,
    density: HmmDensity,
    theta: Array,
    fold: NDArray[np.int64],
    settings: SmcSettings = MOVES,
    *,
    progress: Callable[[int, int], None] | None = None,
    executor: Executor | None = None,
) -> Array:
    """Log predictive of every person by a model that has not seen their fold.

    Parameters
    ----------
    log : EventLog
    density : HmmDensity
        Of the whole log.
    theta : float64[draw, p]
        Draws of the posterior of the whole log, in the layout's order, sigma last where people differ; their
        labels do not matter.
    fold : int64[person]
        As from `assign_folds`.
    settings : SmcSettings
        `particles`, `moves`, `path`, `ess` and `seed` are used.
    progress : callable, optional
        Called with (done, total) folds.
    executor : concurrent.futures.Executor, optional
        What folds are spread over; threads of this process by default. The result does not depend on it.

    Returns
    -------
    float64[person]
    """
    density.arrays, density.dimension  # noqa: B018  (cached before threads share them)
    out = np.empty(len(fold))
    kept = theta[np.linspace(0, len(theta) - 1, settings.particles).round().astype(np.int64)]
    start = unconstrained_draws(density, kept)
    person = person_of_run(log)
    each = each_person(density.people, density.tree, person) if density.people_differ else None
    folds = np.unique(fold).tolist()
    stop = Event()
    job = _Job(density, start, fold, person, each, settings)
    # An event cannot be sent to processes; folds in somebody else's pool run to their end.
    one = partial(_one_fold, job) if executor is not None else partial(_one_fold, job, stop=stop)
    found = spread_out(
        executor, one, folds, progress, stop=stop.set, names=lambda i: f"fold {folds[i]} (seed {settings.seed})"
    )
    for number, values in zip(folds, found, strict=True):
        out[fold == number] = values
    return out


@dataclass(frozen=True)
class _Job:
    """What every fold needs, in any process."""

    density: HmmDensity
    start: Array
    fold: NDArray[np.int64]
    person: NDArray[np.int64]
    each: PeopleArrays | None
    settings: SmcSettings


def _one_fold(job: _Job, number: int, *, stop: Event | None = None) -> Array:
    """Log predictive of the people of one fold by a model that has not seen them."""
    inside = job.fold == number
    rng = np.random.default_rng(np.random.SeedSequence(job.settings.seed, spawn_key=(MOVE_STREAM, number)))
    x = _without(job.density, job.start, inside, job.person, job.each, job.settings, rng, stop or Event())
    theta = constrained(job.density, x)
    by_person = person_log_likelihoods(job.density, theta, job.person, job.each)[:, inside]
    return np.asarray(logsumexp(by_person, axis=0) - np.log(len(x)))


def unconstrained_draws(density: HmmDensity, theta: Array) -> Array:
    """Inverse of `constrained` for many draws; entries that rounded to zero count as the smallest number."""
    x = np.empty((len(theta), density.dimension))
    logs = np.log(np.maximum(theta, 1e-300))
    for start, width, kind, top, offset in zip(*density.plan, strict=True):
        row = logs[:, start : start + width]
        if kind == LOGIT:
            x[:, offset] = row[:, top - start] - row[:, 1 - (top - start)]
        else:
            x[:, offset : offset + width - 1] = (row - row.mean(axis=1, keepdims=True))[:, :-1]
    if density.people_differ:
        x[:, -1] = logs[:, -1]
    return x


def _without(
    density: HmmDensity, start: Array, inside: NDArray[np.bool_], person: NDArray[np.int64],
    each: PeopleArrays | None, settings: SmcSettings, rng: np.random.Generator, stop: Event,
) -> Array:  # fmt: skip
    """Particles of the full posterior carried to the posterior without the people `inside`."""
    n = len(start)
    x, out_share, step = start.copy(), 0.0, 0.5
    while out_share < 1.0:
        fold_value = person_log_likelihoods(density, constrained(density, x), person, each) @ inside
        following = next_temperature(-fold_value, out_share, settings.ess)
        weight = -(following - out_share) * fold_value
        share = np.exp(weight - logsumexp(weight))
        scale = spread(x, share)
        x = np.ascontiguousarray(x[systematic(share, rng.random())])
        out_share = following
        left = reweighted(density, person, np.where(inside, 1.0 - out_share, 1.0))
        step, _ = moved(left, x, np.zeros(n), 1.0, scale, step, settings, rng, stop)
    return x
