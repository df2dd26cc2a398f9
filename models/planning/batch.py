"""Many draws of one model solved in threads, each with its certificate."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.notebook_view import NotebookView
from models.planning.arrays import Array, Index
from models.planning.grid_run import GridRun, blind_slots, new_run, solve_run
from models.planning.grid_search import point_bytes
from models.planning.grid_solver import DONE
from models.planning.latent import LatentBatch
from models.planning.loading import load_kernels
from models.planning.precision import relative_gap
from models.planning.solution import TracePoint
from models.planning.solver import GRID_STATES, MEMORY, solve, tidied, touching
from models.spread_out import chunks, spread_out, threads_here
from models.work_clock import WorkClock

POINTS, SLOTS = 16_384, 4_096
"""Room for one draw at first; the few that need more are solved one by one."""

PORTION = 100
"""Draws that are sent to another process at a time."""

ROUNDS = 200
"""Rounds of the grid at most, before a draw is solved on its own."""


@dataclass(frozen=True)
class DrawSolution:
    """Policy graph and bounds of one draw: as in `models.planning.solution.Solution`, but `seconds` are of CPU."""

    lower: float
    upper: float
    status: str
    seconds: float
    alpha: Array
    mode: Index
    choice: Index
    follow: NDArray[np.int32]


@dataclass(frozen=True)
class BatchSolution(NotebookView):
    """Solutions of all draws.

    Attributes
    ----------
    batch : LatentBatch
    solutions : tuple of DrawSolution
    precision : float
        Relative gap that was asked for.
    seconds, compile_seconds : float
        Wall time of the work, and of compiling or loading kernels.
    """

    batch: LatentBatch
    solutions: tuple[DrawSolution, ...] = field(repr=False)
    precision: float
    seconds: float
    compile_seconds: float

    @property
    def lower(self) -> Array:
        """Lower bounds, shape ``[draw]``."""
        return np.array([s.lower for s in self.solutions])

    @property
    def upper(self) -> Array:
        """Upper bounds, shape ``[draw]``."""
        return np.array([s.upper for s in self.solutions])

    @property
    def draw_seconds(self) -> Array:
        """Seconds of CPU that each draw took, shape ``[draw]``."""
        return np.array([s.seconds for s in self.solutions])

    @property
    def relative_gap(self) -> Array:
        """Gaps as shares of the larger bound's size (`models.planning.precision`), shape ``[draw]``."""
        return np.array([
            relative_gap(s.lower, s.upper, least)
            for s, least in zip(self.solutions, self.batch.least_size, strict=True)
        ])  # fmt: skip

    @property
    def certified(self) -> NDArray[np.bool_]:
        """Which draws reached the gap asked for."""
        return np.array([s.status == "converged" for s in self.solutions])

    @property
    def sentence(self) -> str:
        """How many draws are certified, and how long that took."""
        ms = 1e3 * self.draw_seconds
        return (
            f"{int(self.certified.sum())} of {len(self.solutions)} draws solved to a relative gap of "
            f"{self.precision:g} (largest {self.relative_gap.max():.2g}); a draw took {np.median(ms):.2g} ms in "
            f"the median, {ms.mean():.2g} ms in the mean."
        )


def solve_draws(
    batch: LatentBatch,
    precision: float = 1e-3,
    *,
    threads: int | None = None,
    executor: Executor | None = None,
    time_limit: float = 60.0,
    memory_limit: int = MEMORY,
    progress: Callable[[int, int], None] | None = None,
) -> BatchSolution:
    """Solve every draw of a model.

    Draws are independent: results do not depend on who solves them. The interpreter's lock is not held.

    Parameters
    ----------
    batch : LatentBatch
    precision : float
        Relative gap wanted.
    threads : int, optional
        As many as there are processors by default.
    executor : concurrent.futures.Executor, optional
        Somebody else's processes, or a cluster, instead of threads: draws are sent in portions.
    time_limit : float
        Seconds for one draw that the first attempt leaves unsolved.
    memory_limit : int
        Bytes for one draw: every thread takes as much at most, so that results do not depend on their number.
    progress : callable, optional
        Called with draws done and draws in all.

    Raises
    ------
    InputError
        On a discount of 1 or a precision that makes no sense.
    """
    if not 0 <= batch.discount < 1:
        raise located("discount of the batch", batch.discount, "from 0 to below 1: there is no horizon")
    if not (np.isfinite(precision) and precision > 0):
        raise located("precision", precision, "a number above 0")
    if not time_limit > 0:
        raise located("time limit", time_limit, "above 0 seconds")
    if not memory_limit > 0:
        raise located("memory limit", memory_limit, "above 0 bytes")
    if threads is not None and threads < 1:
        raise located("threads", threads, "at least 1")
    clock = WorkClock()
    if executor is not None:
        # A portion may hold draws without weight only, and weights do not matter here.
        even = replace(batch.draws, weight=np.full(len(batch), 1.0 / len(batch)))
        pieces = [
            (replace(batch, draws=even.some(span)), precision, time_limit, memory_limit)
            for span in chunks(len(batch), PORTION)
        ]
        parts = spread_out(
            executor, _portion, pieces, progress,
            names=lambda i: f"draws {i * PORTION} to {min((i + 1) * PORTION, len(batch)) - 1}",
        )  # fmt: skip
        return BatchSolution(batch, sum(parts, ()), precision, clock.wall(), clock.compile_seconds)
    local = threading.local()
    first = batch.problem(0)
    modes = np.array([x for x, _, _ in first.starts()], dtype=np.int64)
    # Not from the first draw's beliefs, whose sum may miss one by rounding: no draw depends on another.
    weight = np.asarray(batch.process.start, dtype=np.float64)[modes]
    small = batch.draws.n_states <= GRID_STATES
    done, lock, stopped = [0], threading.Lock(), threading.Event()
    runs: list[GridRun] = []
    points = max(64, min(POINTS, memory_limit // (2 * point_bytes(batch.template)))) if small else 0
    if small and len(batch):
        with clock.preparing():
            load_kernels("run")  # before the clock of any draw starts

    def go_on(_: TracePoint) -> None:
        # Signals reach the main thread only; the others are told here, between steps.
        if stopped.is_set():
            raise KeyboardInterrupt

    def one(d: int) -> DrawSolution:
        began = time.thread_time()
        solution = None
        if small:
            if not hasattr(local, "run"):
                local.run = new_run(batch.template, points, min(SLOTS, points) + blind_slots(batch.template))
                runs.append(local.run)
            solution = _attempt(batch, d, local.run, modes, weight, precision, ROUNDS)
        if solution is None:
            full = solve(
                batch.problem(d), precision, time_limit=time_limit, memory_limit=memory_limit, progress=go_on
            )
            solution = DrawSolution(
                full.lower, full.upper, full.status, 0.0, full.alpha, full.mode, full.choice, full.follow
            )
        object.__setattr__(solution, "seconds", time.thread_time() - began)
        if progress is not None:
            with lock:
                done[0] += 1
                progress(done[0], len(batch))
        return solution

    workers = threads or threads_here()
    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(one, d) for d in range(len(batch))]
        try:
            solutions = tuple(future.result() for future in futures)
        except BaseException:
            stopped.set()
            for run in runs:
                run.rounds[0] = ROUNDS  # a compiled call looks at it before every round
            for future in futures:
                future.cancel()
            raise
    return BatchSolution(batch, solutions, precision, clock.wall(), clock.compile_seconds)


def _portion(piece: tuple[LatentBatch, float, float, int]) -> tuple[DrawSolution, ...]:
    """Some draws on one thread of another process."""
    batch, precision, time_limit, memory_limit = piece
    return solve_draws(batch, precision, threads=1, time_limit=time_limit, memory_limit=memory_limit).solutions


def _attempt(
    batch: LatentBatch, d: int, run: GridRun, modes: Index, weight: Array, precision: float, rounds: int
) -> DrawSolution | None:
    """One draw by the grid in one compiled call; None if that does not certify it."""
    arrays = batch.arrays(d)
    # A copy even of one row: a view that may not be written to would have the kernels compiled once more.
    beliefs = np.tile(batch.draws.initial[d], (len(modes), 1))
    status = solve_run(arrays, run, modes, beliefs, weight, precision, True, rounds, 0)
    if status != DONE:
        return None
    lower, upper = map(float, run.bounds)
    if lower > upper:
        upper = touching(f"draw {d}", lower, upper, arrays.largest)
    return DrawSolution(lower, upper, "converged", 0.0, *tidied(arrays, run.vectors))
