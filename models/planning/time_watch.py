"""Time that is up while a kernel works: somebody else looks at the clock, and tells it to come back."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from models.planning.arrays import Index
from models.work_clock import WorkClock

AGAIN = 0.02
"""Seconds after which the clock is looked at once more: while kernels are compiled it runs ahead, and then back."""


class TimeWatch:
    """Keeps a flag set while more time has passed than there was, from a thread of its own.

    Kernels do not hold the interpreter's lock, and looking at a clock from within them is not the same on every
    system; a flag in memory is.

    Parameters
    ----------
    clock : WorkClock
    limit : float
        Seconds.
    halt : int64[1]
        The flag; cleared at the end.
    """

    def __init__(self, clock: WorkClock, limit: float, halt: Index) -> None:
        self._clock, self._limit, self._halt = clock, limit, halt
        self._over, self._resting = threading.Event(), False
        self._thread = threading.Thread(target=self._watch, name="time limit", daemon=True)

    def __enter__(self) -> TimeWatch:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        self._halt[0] = 0

    @contextmanager
    def preparing(self) -> Iterator[None]:
        """Count a block as compilation, during which no time is up."""
        self._resting = True
        try:
            with self._clock.preparing():
                yield
        finally:
            self._halt[0], self._resting = 0, False

    def _watch(self) -> None:
        left = self._limit - self._clock.wall()
        while not self._over.wait(min(max(left, AGAIN), threading.TIMEOUT_MAX)):
            resting = self._resting
            left = self._limit - self._clock.wall()
            if not resting:
                self._halt[0] = left <= 0
