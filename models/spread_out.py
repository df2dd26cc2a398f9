"""Independent pieces of work over an executor: threads of this process, processes, a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any


def spread_out(
    executor: Executor | None, work: Callable[..., Any], pieces: Sequence[Any],
    progress: Callable[[int, int], None] | None = None,
) -> list[Any]:  # fmt: skip
    """Results of `work` on every piece, in the order of the pieces.

    Parameters
    ----------
    executor : concurrent.futures.Executor, optional
        As many threads as there are processors by default: compiled kernels do not hold the interpreter's lock.
    work : callable
        Of one piece; must be picklable for executors of other processes.
    pieces : sequence
    progress : callable, optional
        Called with pieces done and pieces in all.
    """
    if executor is None:
        if len(pieces) <= 1:
            own = [work(piece) for piece in pieces]
            if progress is not None and pieces:
                progress(1, 1)
            return own
        with ThreadPoolExecutor(os.cpu_count() or 1) as threads:
            return spread_out(threads, work, pieces, progress)
    futures = [executor.submit(work, piece) for piece in pieces]
    out = []
    try:
        for i, future in enumerate(futures):
            out.append(future.result())
            if progress is not None:
                progress(i + 1, len(futures))
    except BaseException:
        for future in futures:
            future.cancel()
        raise
    return out


def chunks(n: int, size: int) -> Iterator[slice]:
    """Slices of at most `size` that cover ``range(n)``."""
    for begin in range(0, n, size):
        yield slice(begin, min(begin + size, n))
