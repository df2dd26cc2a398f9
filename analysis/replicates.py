"""Replicates of a simulation study: truths, studies drawn from them, and a runner whose result knows no workers."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from threading import Event
from typing import Protocol as Interface

import numpy as np

from analysis.design import study1_design
from models.events import EventLog
from models.histories import UNSEEN
from models.lspomdp import LatentStatePOMDP
from models.parameters import DirichletPrior, Layout
from models.person_offset import PersonOffset
from models.predictive import FullTables, predictive_responses
from models.simulation import simulate_responses
from models.spread_out import spread_out

Progress = Callable[[str, int, int], None]


class Run[S, R](Interface):
    """One replicate: depends on settings and index only, and may give up when `stop` is set."""

    def __call__(self, settings: S, index: int, *, stop: Event | None = None) -> R:
        """Run it."""
        ...


def prior_draw(layout: Layout, prior: DirichletPrior, rng: np.random.Generator) -> LatentStatePOMDP:
    """Draw a truth from the prior, row by row."""
    alpha = 1.0 + prior.pseudo_counts(layout)
    theta = np.concatenate([rng.dirichlet(alpha[row]) for row in layout.rows])
    return LatentStatePOMDP(*layout.unpack(theta), layout.protocol)


def prior_spread(people: PersonOffset, rng: np.random.Generator) -> float:
    """Draw sigma, the standard deviation of people's offsets, from its half-normal prior; in log-odds."""
    return float(people.scale * np.abs(rng.standard_normal()))


def simulated_study(
    truth: LatentStatePOMDP,
    participants: int,
    study: str,
    rng: np.random.Generator,
    *,
    runs: int = 1,
    spread: float | None = None,
) -> EventLog:
    """Draw a study of the published design, and the responses of its people under a truth.

    Parameters
    ----------
    truth : LatentStatePOMDP
        Under the published protocol.
    participants : int
    study : str
        The study column, which should say that the people are simulated.
    rng : numpy.random.Generator
    runs : int
        Of each person (`several_runs`).
    spread : float, optional
        Sigma: each person has an offset on the helping log-odds, the same in all runs. None: people do not differ.
    """
    design = several_runs(participants, runs, study, rng)
    if spread is None:
        return simulate_responses(truth, design, rng)[0]
    tables = FullTables(truth.initial[None, None], truth.transition[None], truth.emission[None], np.array([spread]))
    stream = np.random.SeedSequence(int(rng.integers(2**63)))
    return design.with_responses(predictive_responses(tables, design, [stream])[0])


def several_runs(participants: int, runs: int, study: str, rng: np.random.Generator) -> EventLog:
    """Draw the published design with several runs a person: one condition each, a schedule anew for every run.

    Returns
    -------
    EventLog
        Participants 1..n with sequences 0..runs - 1; responses are placeholders. With one run it is the published
        design itself.
    """
    drawn = [study1_design().draw(participants, study, rng) for _ in range(runs)]
    first = drawn[0]
    if runs == 1:
        return first
    # Conditions have the same sizes in every draw, so the nth person of a condition can take over the run of the
    # nth person of that condition in every other draw.
    order = [np.argsort(log.condition, kind="stable") for log in drawn]
    place = np.argsort(order[0])
    pieces = [
        log.action[log.offsets[run] : log.offsets[run + 1]]
        for person in range(participants)
        for log, run in ((log, own[place[person]]) for log, own in zip(drawn, order, strict=True))
    ]
    action = np.concatenate(pieces)
    shows = np.asarray(first.protocol.emission_index)[action] >= 0
    return EventLog(
        first.protocol,
        study,
        np.append(0, np.cumsum([len(piece) for piece in pieces])).astype(np.int64),
        np.repeat(first.participant, runs),
        np.tile(np.arange(runs, dtype=np.int64), participants),
        np.repeat(first.condition, runs),
        first.conditions,
        action,
        np.where(shows, 0, UNSEEN).astype(np.int8),
    )


def run_replicates[S, R](
    run: Run[S, R],
    settings: S,
    replicates: int,
    *,
    label: str,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> tuple[R, ...]:
    """Run replicates 0, 1, ... and return them in that order, whoever finishes first.

    Parameters
    ----------
    run : callable
    settings
        Handed to every replicate.
    replicates : int
    label : str
        Said to `progress`.
    executor : concurrent.futures.Executor, optional
        Threads, processes or a cluster; a pool of threads on all cores by default (the compiled parts hold no
        lock). The result does not depend on it.
    progress : callable, optional
        Called with (label, done, total) as replicates finish.

    Raises
    ------
    WorkersLostError
        If workers died and nobody did their work.
    Exception
        What a replicate raised, with a note that names it and the seed.
    """
    stop = Event()
    # An event cannot be sent to processes; replicates in somebody else's pool run to their end.
    one = partial(run, settings) if executor is not None else partial(run, settings, stop=stop)
    seed = getattr(settings, "seed", None)
    told = "" if seed is None else f" (seed {seed})"
    found = spread_out(
        executor, one, range(replicates),
        None if progress is None else partial(progress, label),
        names=lambda index: f"{label}, replicate {index} of 0 to {replicates - 1}{told}", stop=stop.set,
    )  # fmt: skip
    return tuple(found)
