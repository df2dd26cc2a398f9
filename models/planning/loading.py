"""Kernels compiled, or loaded from the cache, before anything is timed, and so that Ctrl-C does no damage.

An interruption in the middle of the compiler leaves functions behind that are there but cannot be called. So
kernels are made by a thread, which signals do not reach; after Ctrl-C it stops where the compiler is about to begin
with the next function.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, Literal

import numpy as np
from numba.core import event

from models.planning.arrays import arrays_of
from models.planning.belief_tree import grown_tree, note_risen
from models.planning.graph_value import solve_reachable
from models.planning.grid_bounds import grown_grid
from models.planning.grid_run import blind_slots, first_vectors, new_run, solve_run
from models.planning.grid_search import GridSearch
from models.planning.sarsop_trial import sweep
from models.planning.textbook import textbook_problem
from models.planning.tree_tidying import tidy_points, tidy_vectors
from models.planning.trial_search import TrialSearch
from models.planning.vectors import empty_vectors, evaluate_closed, evaluate_graph, keep_useful

Kind = Literal["grid", "trials", "run"]

_READY: set[Kind] = set()
_LOCK = threading.Lock()


class _Cancelled(BaseException):
    """Nobody waits for the kernels any longer."""


class _Canceller(event.Listener):
    """Stops one thread where the compiler is about to begin with a function."""

    def __init__(self) -> None:
        self.thread: int | None = None
        self.cancelled = False

    def on_start(self, event: Any) -> None:
        if self.cancelled and threading.get_ident() == self.thread:
            raise _Cancelled

    def on_end(self, event: Any) -> None:
        """Nothing to do."""


def load_kernels(kind: Kind) -> None:
    """Have the kernels of a search ready; returns at once if they are.

    Parameters
    ----------
    kind : {"grid", "trials", "run"}
        `GridSearch`, `TrialSearch`, or `models.planning.grid_run.solve_run`.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C; compiled code is as it was, and the next call goes on from there.
    """
    if kind in _READY:
        return
    with _LOCK:
        if kind not in _READY:
            _apart(_STEPS[kind])
            _READY.add(kind)


def _apart(steps: Callable[[], Iterator[None]]) -> None:
    """Go through steps in a thread; an interruption waits for the end of what it is at."""
    canceller, done, failed = _Canceller(), threading.Event(), []

    def work() -> None:
        canceller.thread = threading.get_ident()
        try:
            with suppress(_Cancelled), event.install_listener("numba:compile", canceller):
                left = steps()
                while not canceller.cancelled and next(left, done) is not done:
                    pass
        except BaseException as error:
            failed.append(error)
        finally:
            done.set()

    thread = threading.Thread(target=work, name="kernels", daemon=True)
    try:
        thread.start()
        _wait(done)
    except KeyboardInterrupt:
        canceller.cancelled = True
        if thread.ident is not None:
            _wait(done)
        raise
    if failed:
        raise failed[0]


def _wait(done: threading.Event) -> None:
    while not done.wait(0.1):  # signals are not noticed on every system while one waits for ever
        pass


def _example() -> tuple[Any, ...]:
    """A problem as kernels see it, and where it starts."""
    even, sign = np.full((2, 2, 2), 0.5), np.array([1.0, -1.0])
    problem = textbook_problem(even, [np.eye(2), np.ones((2, 2)) / 2], np.stack([sign, -sign]), 0.5)
    return arrays_of(problem), np.zeros(1, dtype=np.int64), np.full((1, 2), 0.5), np.ones(1)


def _grid() -> Iterator[None]:
    arrays, modes, beliefs, weight = _example()
    yield from _shared()
    grid = GridSearch(arrays, modes, beliefs, weight, 10**8)
    yield
    grid.step(0.0, True)
    yield
    grown_grid(grid.run.grid, arrays, 2 * len(grid.run.grid.mode))
    yield


def _trials() -> Iterator[None]:
    arrays, modes, beliefs, weight = _example()
    yield from _shared()
    trials = TrialSearch(arrays, modes, beliefs, weight, 10**8)
    yield
    trials.step(0.0, True)
    yield
    tree, vectors = trials.tree, trials.vectors
    solve_reachable(arrays, vectors, int(tree.best[0]))
    note_risen(tree, arrays, vectors)
    yield
    sweep(tree, arrays, vectors, 0, 0.0, 1, trials.room)
    yield
    tidy_points(tree, arrays)
    tidy_vectors(tree, arrays, vectors)
    yield
    grown_tree(tree, arrays, 2 * len(tree.mode))
    yield


def _shared() -> Iterator[None]:
    """What the solver itself does with vectors."""
    arrays = _example()[0]
    vectors = empty_vectors(arrays, blind_slots(arrays))
    first_vectors(arrays, vectors, 0)
    yield
    evaluate_graph(arrays, vectors, 0.0, 1)
    evaluate_closed(arrays, vectors, 0, 0.0, 1)
    yield
    keep_useful(vectors, arrays, np.ones(int(vectors.counts[0]), dtype=np.bool_))
    yield


def _run() -> Iterator[None]:
    arrays, modes, beliefs, weight = _example()
    yield from _shared()
    solve_run(arrays, new_run(arrays, 64, 64), modes, beliefs, weight, 1.0, True, 1, 0)
    yield


_STEPS: dict[Kind, Callable[[], Iterator[None]]] = {"grid": _grid, "trials": _trials, "run": _run}
