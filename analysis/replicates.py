"""Replicates of a simulation study: truths, studies drawn from them, and a runner whose result knows no workers."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from functools import partial
from threading import Event
from typing import Protocol as Interface

import numpy as np

from analysis.design import study1_design
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.parameters import DirichletPrior, Layout
from models.simulation import simulate_responses

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


def simulated_study(truth: LatentStatePOMDP, participants: int, study: str, rng: np.random.Generator) -> EventLog:
    """Draw a study of the published design, and the responses of its people under a truth.

    Parameters
    ----------
    truth : LatentStatePOMDP
        Under the published protocol.
    participants : int
    study : str
        The study column, which should say that the people are simulated.
    rng : numpy.random.Generator
    """
    design = study1_design().draw(participants, study, rng)
    return simulate_responses(truth, design, rng)[0]


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
        Threads or processes; a pool of threads on all cores by default (the compiled parts hold no lock).
    progress : callable, optional
        Called with (label, done, total) as replicates finish.
    """
    stop = Event()
    own = ThreadPoolExecutor(os.cpu_count()) if executor is None else None
    pool = executor or own
    assert pool is not None
    # An event cannot be sent to processes; replicates in somebody else's pool run to their end.
    one = partial(run, settings) if own is None else partial(run, settings, stop=stop)
    futures: dict[Future[R], int] = {}
    done: dict[int, R] = {}
    try:
        futures = {pool.submit(one, index): index for index in range(replicates)}
        for future in as_completed(futures):
            done[futures[future]] = future.result()
            if progress is not None:
                progress(label, len(done), replicates)
    finally:
        # After an error or Ctrl-C nothing new is begun; somebody else's pool stays open.
        stop.set()
        for future in futures:
            future.cancel()
        if own is not None:
            own.shutdown(wait=False)
    return tuple(done[index] for index in sorted(done))
