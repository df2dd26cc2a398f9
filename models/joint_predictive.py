r"""How well people who were left out are predicted together: their log predictive as a group.

With :math:`F` the people left out and :math:`-F` the rest,

.. math:: \log p(y_F \mid y_{-F}) = \log \int p(y_F \mid \theta)\, p(\theta \mid y_{-F})\, d\theta.

The mean of :math:`p(y_F \mid \theta)` over posterior draws is that integral, but for a whole condition it rests on
the few draws that happen to lie where those people pull. So they are let in little by little,
:math:`\pi_u(\theta) \propto p(\theta)\,p(y_{-F} \mid \theta)\,p(y_F \mid \theta)^u`, :math:`u` from 0 to 1, with
particles reweighted, resampled and moved as in `models.smc`. Where one step is enough this is the plain mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from models.draw_kernels import constrained, history_log_likelihoods
from models.errors import located
from models.events import EventLog
from models.histories import HistoryTree
from models.hmm_density import HmmDensity
from models.parameters import Array, DirichletPrior, Layout
from models.people_folds import unconstrained_draws
from models.smc import SmcSettings, moved, next_temperature, spread, systematic

STREAM = 7_108
"""First element of the spawn keys of runs."""

LETTING_IN = SmcSettings(particles=300, runs=4, moves=4)
"""Particles and proposals of a run; independent runs give the Monte Carlo error."""


@dataclass(frozen=True)
class LogPredictive:
    """Log predictive of people who were left out.

    Attributes
    ----------
    joint : float
        Of all of them together.
    error : float
        Monte Carlo standard error of `joint`; 0 where it is exact.
    by_person : float64[person]
        Of each alone, given nobody else of those left out; they do not add up to `joint`.
    """

    joint: float
    error: float
    by_person: Array


def latent_log_predictive(
    rest: EventLog,
    held: EventLog,
    theta: Array,
    prior: DirichletPrior,
    pins: Mapping[str, Array | None],
    n_states: int,
    settings: SmcSettings = LETTING_IN,
) -> LogPredictive:
    """Log predictive of the people of one log by the latent-state model that learned from another.

    Parameters
    ----------
    rest, held : EventLog
        Under one protocol, without common people.
    theta : float64[draw, p]
        Posterior draws given `rest`, in the layout's order; their labels do not matter.
    prior, pins, n_states
        Of the model.
    settings : SmcSettings
        `particles`, `runs`, `moves`, `path`, `ess` and `seed` are used.

    Raises
    ------
    InputError
        If the protocols differ.
    """
    if rest.protocol != held.protocol:
        raise located("held-out people, protocol", held.protocol.name, repr(rest.protocol.name))
    layout = Layout(rest.protocol, n_states)
    tree = _joined(rest, held)
    density = HmmDensity(tree, layout, 1.0 + prior.pseudo_counts(layout), pins)
    inside = np.arange(tree.n_runs) >= rest.n_runs
    history = np.searchsorted(tree.terminals, tree.run_node)
    stop = Event()

    def one(number: int) -> float:
        mine = theta[number :: settings.runs]
        kept = mine[np.linspace(0, len(mine) - 1, settings.particles).round().astype(np.int64)]
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(STREAM, number)))
        return _let_in(density, unconstrained_draws(density, kept), inside, history, settings, rng, stop)

    pool = ThreadPoolExecutor(max_workers=settings.runs)
    try:
        found = np.array(list(pool.map(one, range(settings.runs))))
    except BaseException:
        stop.set()  # running threads notice at their next proposal
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()
    joint = float(logsumexp(found) - np.log(len(found)))
    error = float(np.std(found, ddof=1) / np.sqrt(len(found))) if len(found) > 1 else float("nan")
    return LogPredictive(joint, error, _by_person(held, layout, theta))


def _joined(rest: EventLog, held: EventLog) -> HistoryTree:
    """Tree of both logs, runs of `rest` first."""
    offsets = np.concatenate([rest.offsets, rest.offsets[-1] + held.offsets[1:]])
    action, response = (np.concatenate([getattr(x, n) for x in (rest, held)]) for n in ("action", "response"))
    return HistoryTree.build(offsets, action, response, rest.protocol.n_actions, rest.protocol.n_responses)


def _by_person(held: EventLog, layout: Layout, theta: Array) -> Array:
    tree = held.tree()
    by_history = history_log_likelihoods(tree, layout, theta)
    by_run = by_history[:, np.searchsorted(tree.terminals, tree.run_node)]
    starts = np.flatnonzero(np.append(True, np.diff(held.participant) != 0))  # runs are sorted by participant
    by_person: Array = logsumexp(np.add.reduceat(by_run, starts, axis=1), axis=0) - np.log(len(theta))
    return by_person


def _let_in(
    density: HmmDensity, x: Array, inside: NDArray[np.bool_], history: NDArray[np.int64], settings: SmcSettings,
    rng: np.random.Generator, stop: Event,
) -> float:  # fmt: skip
    """One estimate: particles without the runs `inside` are carried to those with them."""
    tree = density.tree
    counts = np.bincount(history[inside], minlength=tree.n_histories).astype(np.float64)
    total, share_in, step = 0.0, 0.0, 0.5
    while True:
        value = history_log_likelihoods(tree, density.layout, constrained(density, x)) @ counts
        following = next_temperature(value, share_in, settings.ess)
        weight = (following - share_in) * value
        total += float(logsumexp(weight) - np.log(len(x)))
        if following >= 1.0:
            return total
        share = np.exp(weight - logsumexp(weight))
        scale = spread(x, share)  # before resampling makes particles coincide
        x = np.ascontiguousarray(x[systematic(share, rng.random())])
        share_in = following
        partly = replace(density, tree=tree.with_runs(np.where(inside, share_in, 1.0)))
        step, _ = moved(partly, x, np.zeros(len(x)), 1.0, scale, step, settings, rng, stop)
