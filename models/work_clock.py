"""Time spent on the work itself, apart from the time that compilers take.

numba says when it begins and ends to compile, or to load from its cache, in any thread; whole blocks (PyTensor's
compilation, imports) can be counted in with `preparing`. One listener serves the whole process and only ever adds
up, so clocks may run in several threads; what one thread compiles counts for every clock that runs meanwhile.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock, local
from typing import Any

from numba.core import event


class _Preparation(event.Listener):
    """Seconds in which some thread was compiling, and the CPU time that took."""

    def __init__(self) -> None:
        self.wall, self.cpu = 0.0, 0.0
        self._lock, self._own = Lock(), local()
        self._threads, self._since = 0, 0.0

    def on_start(self, event: Any) -> None:
        self.begin()

    def on_end(self, event: Any) -> None:
        self.end()

    def begin(self) -> None:
        depth = getattr(self._own, "depth", 0)
        self._own.depth = depth + 1
        if depth == 0:
            self._own.cpu = time.thread_time()
            with self._lock:
                if self._threads == 0:
                    self._since = time.perf_counter()
                self._threads += 1

    def end(self) -> None:
        if getattr(self._own, "depth", 0) == 0:
            return  # it began before anybody listened
        self._own.depth -= 1
        if self._own.depth == 0:
            self._close()

    def forget(self) -> None:
        """Close what an interruption left open in this thread: nothing is being compiled now."""
        if getattr(self._own, "depth", 0) > 0:
            self._own.depth = 0
            self._close()

    def _close(self) -> None:
        with self._lock:
            self.cpu += time.thread_time() - self._own.cpu
            self._threads -= 1
            if self._threads == 0:
                self.wall += time.perf_counter() - self._since


_PREPARATION = _Preparation()
event.register("numba:compiler_lock", _PREPARATION)


class WorkClock:
    """Seconds since it was made, without those in which anything was compiled or loaded.

    Examples
    --------
    >>> clock = WorkClock()
    >>> with clock.preparing():
    ...     time.sleep(0.05)
    >>> clock.compile_seconds >= 0.05 > clock.wall()
    True
    """

    def __init__(self) -> None:
        self._of = _PREPARATION
        self._of.forget()
        self._start = (time.perf_counter(), _cpu(), self._of.wall, self._of.cpu)

    @property
    def compile_seconds(self) -> float:
        """Wall time in which something was compiled or loaded."""
        return self._of.wall - self._start[2]

    def wall(self) -> float:
        """Wall time of everything else."""
        return max(0.0, time.perf_counter() - self._start[0] - self.compile_seconds)

    def cpu(self) -> float:
        """CPU time of everything else, in all threads of the process and in the processes it waited for."""
        return max(0.0, _cpu() - self._start[1] - (self._of.cpu - self._start[3]))

    @contextmanager
    def preparing(self) -> Iterator[None]:
        """Count a whole block as compilation."""
        self._of.begin()
        try:
            yield
        finally:
            self._of.end()


def _cpu() -> float:
    children = os.times()
    return time.process_time() + children.children_user + children.children_system
