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

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from models.baum_welch import BaumWelch, Progress, refine
from models.baum_welch_fit import BaumWelchFit
from models.errors import located
from models.events import EventLog
from models.histories import HistoryTree
from models.labels import canonical_order, permute
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView, View, frame_rows
from models.parameters import Array, Layout
from models.simulation import simulate_responses
from models.spread_out import spread_out

STREAM = 7_001
"""First element of the spawn keys of bootstrap streams."""

START_INSIDE = 0.02
"""Share of the uniform distribution mixed into the warm start: EM cannot leave an exact zero."""

TOGETHER = 8
"""Replicates that are sent to another process together: each takes milliseconds, and the study travels along."""


@dataclass(frozen=True)
class Bootstrap(NotebookView):
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

    def _view(self) -> View:
        rows = []
        for name in ("initial", "transition", "emission"):
            low, high = self.interval(name)
            mean = getattr(self, name).mean(axis=0)
            rows += [
                {"entry": f"{name}[{', '.join(map(str, at))}]", "mean": mean[at], "q05": low[at], "q95": high[at]}
                for at in np.ndindex(mean.shape)
            ]
        told = f"{self.replicates:,} replicates, {self.kind}, seed {self.seed}; 90% percentile intervals."
        warnings = ("fewer than 100 replicates: ends of intervals are rough.",) if self.replicates < 100 else ()
        return View("Bootstrap", "", warnings, (), (told,), (frame_rows(rows, ".interval(table)"),))


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
    by_participant = log.n_runs > log.n_participants
    people, person = np.unique(log.participant, return_inverse=True)
    job = _Job(
        fit.model, fit.settings, fit.emission_weights, log, log.tree(), layout, free,
        free & layout.informed_entries(log), person if by_participant else None, len(people), extra_starts, seed,
    )  # fmt: skip
    stop = np.zeros(1, dtype=np.uint8)
    results = spread_out(
        executor, partial(_replicate, job, stop), range(replicates), progress, together=TOGETHER,
        names=lambda index: f"replicate {index} of the bootstrap (seed {seed})", stop=lambda: stop.fill(1),
    )  # fmt: skip
    return Bootstrap(
        np.stack([r[0] for r in results]), np.stack([r[1] for r in results]), np.stack([r[2] for r in results]),
        np.array([r[3] for r in results]), seed, by_participant,
    )  # fmt: skip


@dataclass(frozen=True)
class _Job:
    """What every replicate needs, in any process; `person` of each run where whole people are resampled."""

    model: LatentStatePOMDP
    settings: BaumWelch
    emission_weights: Array
    log: EventLog
    tree: HistoryTree
    layout: Layout
    free: NDArray[np.bool_]
    moves: NDArray[np.bool_]
    person: NDArray[np.intp] | None
    people: int
    extra_starts: int
    seed: int


def _replicate(job: _Job, stop: NDArray[np.uint8], index: int) -> tuple[Array, Array, Array, float]:
    """Tables and log-likelihood of one replicate; `stop` is heeded in threads of the same process."""
    model, layout = job.model, job.layout
    rng = np.random.default_rng(np.random.SeedSequence(job.seed, spawn_key=(STREAM, model.n_states, index)))
    if job.person is not None:
        drawn = np.bincount((rng.random(job.people) * job.people).astype(int), minlength=job.people)
        study = job.tree.with_runs(drawn[job.person].astype(np.float64))
    else:
        study = simulate_responses(model, job.log, rng)[0].tree()
    warm = layout.pack(model.initial, model.transition, model.emission)
    starts = [np.where(job.moves, (1 - START_INSIDE) * warm + START_INSIDE * layout.uniform, warm)]
    s, a, e, o = layout.sizes
    for _ in range(job.extra_starts):
        random = layout.pack(
            np.full(s, 1 / s), rng.dirichlet(np.ones(s), (a, s)), rng.dirichlet(np.ones(o), (e, s))
        )
        starts.append(np.where(job.moves, random, warm))
    refined = [refine(study, start, layout, job.free, job.settings, stop) for start in starts]
    theta, value, _ = max(refined, key=lambda run: run[2])
    tables = layout.unpack(theta)
    order = canonical_order(tables[2], model.protocol.scores, job.emission_weights)
    return (*permute(order, *tables), value)
