"""Parametric bootstrap of a Baum-Welch fit: intervals that respect the boundary of the simplex.

Each replicate draws new responses from the fitted model under the study's own design, refits it and puts the
states back into canonical order. Entries estimated at 0 or 1, where the information matrix says nothing, get
honest intervals this way; so do entries that the study cannot tell apart, whose intervals come out wide.
"""

from __future__ import annotations

import os
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from models.baum_welch import Progress, refine
from models.baum_welch_fit import BaumWelchFit
from models.errors import located
from models.events import EventLog
from models.labels import canonical_order, permute
from models.parameters import Array, Layout
from models.simulation import simulate_responses

STREAM = 7_001
"""First element of the spawn keys of bootstrap streams."""

START_INSIDE = 0.02
"""Share of the uniform distribution mixed into the warm start: EM cannot leave an exact zero."""


@dataclass(frozen=True)
class Bootstrap:
    """Refitted tables of every replicate, states in canonical order.

    Attributes
    ----------
    initial : float64[b, s]
    transition : float64[b, a, s, s']
    emission : float64[b, e, s, o]
    log_likelihood : float64[b]
    seed : int
    """

    initial: Array
    transition: Array
    emission: Array
    log_likelihood: Array
    seed: int

    @property
    def replicates(self) -> int:
        """Number of replicates."""
        return len(self.log_likelihood)

    def interval(self, table: str, level: float = 0.9) -> tuple[Array, Array]:
        """Percentile interval of every entry of `initial`, `transition` or `emission`."""
        if table not in ("initial", "transition", "emission"):
            raise located("bootstrap, table", table, "initial, transition or emission")
        if not 0 < level < 1:
            raise located("bootstrap, level", level, "between 0 and 1")
        low, high = np.quantile(getattr(self, table), [(1 - level) / 2, (1 + level) / 2], axis=0)
        return low, high


def parametric_bootstrap(
    fit: BaumWelchFit,
    log: EventLog,
    replicates: int = 200,
    *,
    extra_starts: int = 2,
    seed: int = 1,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Bootstrap:
    """Simulate, refit and relabel.

    Parameters
    ----------
    fit : BaumWelchFit
    log : EventLog
        Its design (actions, lengths, missing responses) is kept in every replicate.
    replicates : int
    extra_starts : int
        Random starts beside the warm start from the fit; the best ends the replicate.
    seed : int
    progress, executor
        As in `BaumWelch.fit`.
    """
    if replicates < 2:
        raise located("bootstrap, replicates", replicates, "at least 2")
    layout = Layout(log.protocol, fit.n_states)
    free = layout.free_entries(fit.pins)
    moves = free & layout.informed_entries(log)

    def one(index: int) -> tuple[Array, Array, Array, float]:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, fit.n_states, index)))
        study, _ = simulate_responses(fit.model, log, rng)
        m = fit.model
        warm = layout.pack(m.initial, m.transition, m.emission)
        starts = [np.where(moves, (1 - START_INSIDE) * warm + START_INSIDE * layout.uniform, warm)]
        s, a, e, o = layout.sizes
        for _ in range(extra_starts):
            random = layout.pack(
                np.full(s, 1 / s), rng.dirichlet(np.ones(s), (a, s)), rng.dirichlet(np.ones(o), (e, s))
            )
            starts.append(np.where(moves, random, warm))
        theta, value = max((refine(study, t, layout, free, fit.settings) for t in starts), key=lambda r: r[1])
        tables = layout.unpack(theta)
        order = canonical_order(tables[2], log.protocol.scores, fit.emission_weights)
        return (*permute(order, *tables), value)

    own = ThreadPoolExecutor(os.cpu_count()) if executor is None else None
    pool = executor or own
    assert pool is not None
    results = []
    try:
        for result in pool.map(one, range(replicates)):
            results.append(result)
            if progress is not None:
                progress(len(results), replicates)
    except BaseException:
        if own is not None:
            own.shutdown(wait=False, cancel_futures=True)
        raise
    if own is not None:
        own.shutdown()
    return Bootstrap(
        np.stack([r[0] for r in results]), np.stack([r[1] for r in results]), np.stack([r[2] for r in results]),
        np.array([r[3] for r in results]), seed,
    )  # fmt: skip
