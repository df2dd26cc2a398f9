"""Draws solved from more beliefs than the one they start with, to judge decisions all over the simplex.

A solution is driven to its gap at the start only. Where the start never leads its vectors may be poor, and an
action may look better than it is. Solving anew from the corners of the simplex, in every mode, and keeping all
vectors together mends that: each is a sound lower bound everywhere, wherever it came from.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from models.lspomdp import check_rows
from models.planning.arrays import Array
from models.planning.batch import BatchSolution, DrawSolution, solve_draws
from models.planning.latent import LatentBatch


@dataclass(frozen=True)
class WideSolution(BatchSolution):
    """Solutions that can be asked about decisions all over the simplex.

    Attributes
    ----------
    beliefs : float64[g, y]
        Where draws were solved from, beside their start.
    """

    beliefs: Array


def widened(
    solution: BatchSolution, beliefs: Array | None = None, *, time_limit: float = 60.0,
    executor: Executor | None = None, progress: Callable[[int, int], None] | None = None,
) -> WideSolution:  # fmt: skip
    """The solutions together with those from other beliefs; bounds and status remain those of the start.

    Parameters
    ----------
    solution : BatchSolution
    beliefs : float64[g, y], optional
        Where else to solve from, in every mode; certainty of each state by default. Each of them is as much work as
        the solution itself.
    time_limit : float
        Seconds for one draw that the first attempt leaves unsolved.
    executor : concurrent.futures.Executor, optional
        What draws are spread over; threads by default.
    progress : callable, optional
        Called with draws done and draws in all, over all beliefs.

    Raises
    ------
    InputError
        On beliefs that are none.
    """
    batch = solution.batch
    n = batch.draws.n_states
    points = np.eye(n) if beliefs is None else np.asarray(beliefs, dtype=np.float64)
    check_rows("belief", points, [(f"belief {i}",) for i in range(len(points))])
    modes = len(batch.process.start)
    process = replace(batch.process, start=np.full(modes, 1.0 / modes))
    found = [solution]
    for g, belief in enumerate(points):
        draws = replace(batch.draws, initial=np.tile(belief, (len(batch), 1)))
        told = None if progress is None else _shifted(progress, g, len(points))
        other = LatentBatch(draws, process, batch.discount)
        found.append(
            solve_draws(other, solution.precision, time_limit=time_limit, executor=executor, progress=told)
        )
    joined = tuple(_joined(parts) for parts in zip(*(s.solutions for s in found), strict=True))
    return WideSolution(
        batch, joined, solution.precision, sum(s.seconds for s in found), solution.compile_seconds, points
    )


def _shifted(progress: Callable[[int, int], None], before: int, count: int) -> Callable[[int, int], None]:
    """Progress of one of several equal pieces of work."""
    return lambda done, total: progress(before * total + done, count * total)


def _joined(parts: tuple[DrawSolution, ...]) -> DrawSolution:
    """Vectors of several solutions of one draw in one policy graph."""
    begins = np.cumsum([0, *(len(p.alpha) for p in parts[:-1])])
    return replace(
        parts[0], alpha=np.concatenate([p.alpha for p in parts]), mode=np.concatenate([p.mode for p in parts]),
        choice=np.concatenate([p.choice for p in parts]),
        follow=np.concatenate([p.follow + b for p, b in zip(parts, begins, strict=True)]).astype(np.int32),
    )  # fmt: skip
