"""Bootstrap of a Baum-Welch fit: intervals that respect the boundary of the simplex.

*Parametric*, where every person has one run: each replicate draws new responses from the fitted model under the
study's own design. *By participant*, where people have several runs: whole people are drawn with replacement,
since runs of one person are more alike than the model says and intervals that ignore it are too narrow.
Each replicate is refitted and its states put back into canonical order.

What the intervals are not: on the boundary of the simplex no bootstrap is consistent, and a replicate is refitted
from the estimate and a few random starts, so the spread is that of good local optima. Where the study hardly
informs an entry its interval is wide and says just that.
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
    by_participant : bool
        Whole people were resampled; otherwise responses were drawn from the fitted model.
    """

    initial: Array
    transition: Array
    emission: Array
    log_likelihood: Array
    seed: int
    by_participant: bool = False

    @property
    def kind(self) -> str:
        """How replicates were made, in words."""
        return "bootstrap by participant" if self.by_participant else "parametric bootstrap"

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


def bootstrap_fit(
    fit: BaumWelchFit,
    log: EventLog,
    replicates: int = 200,
    *,
    extra_starts: int = 2,
    seed: int = 1,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Bootstrap:
    """Make replicates, refit and relabel; by participant where people have several runs.

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

    by_participant = log.n_runs > log.n_participants
    tree = log.tree()
    people, person = np.unique(log.participant, return_inverse=True)
    stop = np.zeros(1, dtype=np.uint8)

    def one(index: int) -> tuple[Array, Array, Array, float]:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, fit.n_states, index)))
        if by_participant:
            drawn = np.bincount((rng.random(len(people)) * len(people)).astype(int), minlength=len(people))
            study = tree.with_runs(drawn[person].astype(np.float64))
        else:
            study = simulate_responses(fit.model, log, rng)[0].tree()
        m = fit.model
        warm = layout.pack(m.initial, m.transition, m.emission)
        starts = [np.where(moves, (1 - START_INSIDE) * warm + START_INSIDE * layout.uniform, warm)]
        s, a, e, o = layout.sizes
        for _ in range(extra_starts):
            random = layout.pack(
                np.full(s, 1 / s), rng.dirichlet(np.ones(s), (a, s)), rng.dirichlet(np.ones(o), (e, s))
            )
            starts.append(np.where(moves, random, warm))
        refined = [refine(study, start, layout, free, fit.settings, stop) for start in starts]
        theta, value, _ = max(refined, key=lambda run: run[2])
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
        stop[0] = 1
        if own is not None:
            own.shutdown(cancel_futures=True)
        raise
    if own is not None:
        own.shutdown()
    return Bootstrap(
        np.stack([r[0] for r in results]), np.stack([r[1] for r in results]), np.stack([r[2] for r in results]),
        np.array([r[3] for r in results]), seed, by_participant,
    )  # fmt: skip
