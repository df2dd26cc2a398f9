r"""How well people who were left out are predicted together: their log predictive as a group.

With :math:`F` the people left out and :math:`-F` the rest,

.. math:: \log p(y_F \mid y_{-F}) = \log \int p(y_F \mid \theta)\, p(\theta \mid y_{-F})\, d\theta.

The mean of :math:`p(y_F \mid \theta)` over posterior draws is that integral, but for a whole condition it rests on
the few draws that happen to lie where those people pull. So they are let in little by little,
:math:`\pi_u(\theta) \propto p(\theta)\,p(y_{-F} \mid \theta)\,p(y_F \mid \theta)^u`, :math:`u` from 0 to 1, with
particles reweighted, resampled and moved as in `models.smc`. Where one step is enough this is the plain mean.
Where people differ, each is let in whole: the offset that all their runs share is integrated out first, and the
power is taken of the person's likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from models.draw_kernels import constrained
from models.errors import located
from models.events import EventLog
from models.hmm_density import HmmDensity
from models.parameters import Array, DirichletPrior
from models.people_folds import unconstrained_draws
from models.person_offset import PersonOffset, reweighted
from models.smc import SmcSettings, moved, next_temperature, spread, systematic
from models.spread_out import threads_here
from models.study_density import ModelSpec, StudyDensity

STREAM = 7_108
"""First element of the spawn keys of runs."""

LETTING_IN = SmcSettings(particles=300, runs=4, moves=4)
"""Particles and proposals of a run; independent runs give the Monte Carlo error."""

FEWER = 1000
"""Draws behind each person's own log predictive where people differ: about as many, evenly spaced."""


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
    people: PersonOffset | None = None,
) -> LogPredictive:
    """Log predictive of the people of one log by the latent-state model that learned from another.

    Parameters
    ----------
    rest, held : EventLog
        Under one protocol, without common people.
    theta : float64[draw, p]
        Posterior draws given `rest`, in the layout's order, sigma last where people differ; their labels do not
        matter.
    prior, pins, n_states
        Of the model.
    settings : SmcSettings
        `particles`, `runs`, `moves`, `path`, `ess` and `seed` are used.
    people : PersonOffset, optional
        The hierarchical version: each person has an offset on the helping log-odds.

    Raises
    ------
    InputError
        If the protocols differ or a person is in both logs.
    """
    if rest.protocol != held.protocol:
        raise located("held-out people, protocol", held.protocol.name, repr(rest.protocol.name))
    common = np.intersect1d(rest.participant, held.participant)
    if len(common):
        raise located("held-out people, in both logs", int(common[0]), "people who are in one of them")
    together = _joined(rest, held)
    if people is not None:
        people = replace(people, nodes=people.points(together))  # the same rule for all of them
    spec = ModelSpec(n_states, prior, pins, None, people)
    study, left_out = StudyDensity(together, spec), StudyDensity(held, spec)
    inside = np.isin(np.unique(together.participant), held.participant)
    for density in (study.density, left_out.density):
        density.arrays, density.dimension  # noqa: B018  (cached before threads share them)
    stop = Event()

    def one(number: int) -> float:
        mine = theta[number :: settings.runs]
        kept = mine[np.linspace(0, len(mine) - 1, settings.particles).round().astype(np.int64)]
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(STREAM, number)))
        return _let_in(study, left_out, unconstrained_draws(study.density, kept), inside, settings, rng, stop)

    pool = ThreadPoolExecutor(max_workers=min(settings.runs, threads_here()))
    try:
        found = np.array(list(pool.map(one, range(settings.runs))))
    except BaseException:
        stop.set()  # running threads notice at their next proposal
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()
    joint = float(logsumexp(found) - np.log(len(found)))
    error = float(np.std(found, ddof=1) / np.sqrt(len(found))) if len(found) > 1 else float("nan")
    alone = theta if people is None else theta[:: max(1, len(theta) // FEWER)]
    by_person: Array = logsumexp(left_out.log_likelihoods(alone), axis=0) - np.log(len(alone))
    return LogPredictive(joint, error, by_person)


def _joined(rest: EventLog, held: EventLog) -> EventLog:
    """Runs of `rest`, then those of `held`; conditions do not matter here."""
    offsets = np.concatenate([rest.offsets, rest.offsets[-1] + held.offsets[1:]])
    participant, sequence, action, response = (
        np.concatenate([getattr(x, n) for x in (rest, held)])
        for n in ("participant", "sequence", "action", "response")
    )
    condition = np.zeros(len(participant), dtype=np.int32)
    return EventLog(
        rest.protocol, rest.study, offsets, participant, sequence, condition, ("all",), action, response
    )


def _let_in(
    study: StudyDensity, left_out: StudyDensity, x: Array, inside: NDArray[np.bool_], settings: SmcSettings,
    rng: np.random.Generator, stop: Event,
) -> float:  # fmt: skip
    """One estimate: particles without the people `inside` are carried to those with them."""
    density: HmmDensity = study.density
    total, share_in, step = 0.0, 0.0, 0.5
    while True:
        value = left_out.log_likelihoods(constrained(density, x)).sum(axis=-1)
        following = next_temperature(value, share_in, settings.ess)
        weight = (following - share_in) * value
        total += float(logsumexp(weight) - np.log(len(x)))
        if following >= 1.0:
            return total
        share = np.exp(weight - logsumexp(weight))
        scale = spread(x, share)  # before resampling makes particles coincide
        x = np.ascontiguousarray(x[systematic(share, rng.random())])
        share_in = following
        partly = reweighted(density, study.person, np.where(inside, share_in, 1.0))
        step, _ = moved(partly, x, np.zeros(len(x)), 1.0, scale, step, settings, rng, stop)
