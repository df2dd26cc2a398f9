"""Processes of this machine as an executor that outlives the death of any of them.

The standard library's pool is broken for good once one of its processes dies: everything that was not done is lost.
Here the processes are started anew and what was lost is done again; since no piece of work knows of the others
(`models.spread_out`), results are the same as if nothing had happened. Only when processes die again and again
without anything getting done in between is there an error.
"""

from __future__ import annotations

import os
import queue
import signal
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, InvalidStateError, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from types import TracebackType
from typing import Any, Self

from models.errors import located

MOST_DEATHS = 3
"""Times that processes may die one after another with nothing done in between."""


@dataclass
class _Task:
    promise: Future[Any]
    work: Callable[..., Any]
    arguments: tuple[Any, ...]
    keywords: dict[str, Any]
    pool: ProcessPoolExecutor | None = None
    sent: Future[Any] | None = None


class WorkerProcesses(Executor):
    """Worker processes that are replaced when they die.

    Parameters
    ----------
    workers : int, optional
        As many as there are processors by default.

    Attributes
    ----------
    deaths : int
        Times that processes died and were started anew.

    Notes
    -----
    Processes are spawned, not forked: threads of this process and their locks are not copied. Ctrl-C is met by this
    process alone; leaving the ``with`` block by an error drops what was not begun.

    Examples
    --------
    >>> from models.worker_processes import WorkerProcesses
    >>> with WorkerProcesses(1) as pool:
    ...     pool.submit(pow, 2, 10).result()
    1024
    """

    def __init__(self, workers: int | None = None) -> None:
        if workers is not None and workers < 1:
            raise located("worker processes", workers, "at least 1")
        self.workers = workers or os.cpu_count() or 1
        self.deaths = 0
        self._in_a_row = 0
        self._closed = self._left = False
        self._waiting: set[Future[Any]] = set()
        self._pool = self._started()
        # A thread of its own: callbacks of a broken pool hold that pool's locks.
        self._lost: queue.SimpleQueue[_Task | None] = queue.SimpleQueue()
        self._keeper = threading.Thread(target=self._keep, name="worker processes", daemon=True)
        self._keeper.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a function called by a worker; it goes by name, its arguments are pickled."""
        if self._closed:
            raise RuntimeError("worker processes: closed, nothing more can be submitted")
        task = _Task(Future(), fn, args, kwargs)
        self._waiting.add(task.promise)
        task.promise.add_done_callback(partial(self._settled, task))
        self._send(task)
        return task.promise

    def pids(self) -> tuple[int, ...]:
        """Process numbers of the workers that live, as far as they were started; started by the first work."""
        return tuple(getattr(self._pool, "_processes", None) or ())

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after all work, or with `cancel_futures` at once."""
        self._closed = True
        if cancel_futures:
            for promise in list(self._waiting):
                promise.cancel()
            # Nobody wants what is under way, which may take minutes.
            processes = list((getattr(self._pool, "_processes", None) or {}).values())
            self._pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()
        elif wait:
            wait_for(list(self._waiting))
        self._left = True
        self._lost.put(None)
        self._pool.shutdown(wait=wait and not cancel_futures)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for all work, or after an error drop it."""
        self.shutdown(wait=True, cancel_futures=kind is not None)

    def _started(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self.workers, mp_context=get_context("spawn"), initializer=_leave_interrupts)

    def _send(self, task: _Task) -> None:
        task.pool = self._pool
        try:
            task.sent = task.pool.submit(task.work, *task.arguments, **task.keywords)
        except RuntimeError:  # broken, or already being replaced
            self._lost.put(task)
        else:
            task.sent.add_done_callback(partial(self._answered, task))

    def _answered(self, task: _Task, sent: Future[Any]) -> None:
        """Hand an answer on; what a death lost goes to the keeper. Called by threads of a pool."""
        if task.promise.cancelled():
            return
        if sent.cancelled():
            task.promise.cancel()
            return
        error = sent.exception()
        if isinstance(error, BrokenExecutor) and not self._left:
            self._lost.put(task)
            return
        self._in_a_row = 0
        with suppress(InvalidStateError):  # cancelled at this very moment
            if error is None:
                task.promise.set_result(sent.result())
            else:
                task.promise.set_exception(error)

    def _settled(self, task: _Task, promise: Future[Any]) -> None:
        self._waiting.discard(promise)
        if promise.cancelled() and task.sent is not None:
            task.sent.cancel()

    def _keep(self) -> None:
        """Start processes anew after a death, and send what it lost again."""
        while (task := self._lost.get()) is not None:
            if task.promise.done():
                continue
            if task.pool is self._pool:
                self.deaths += 1
                self._in_a_row += 1
                self._pool.shutdown(wait=False)
                self._pool = self._started()
            if self._in_a_row > MOST_DEATHS:
                died = BrokenExecutor(
                    f"worker processes died {self._in_a_row} times in a row and nothing was done in between "
                    "(killed from outside, out of memory, or a crash in what they were given)"
                )
                with suppress(InvalidStateError):
                    task.promise.set_exception(died)
                continue
            self._send(task)


def _leave_interrupts() -> None:
    """Ctrl-C reaches all processes of a terminal, and one of them has to answer it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
