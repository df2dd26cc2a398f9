"""Independent pieces of work over any executor: threads of this process, processes, a cluster.

The one home of what every such study needs: pieces sent in portions, results in the order of the pieces,
progress, errors that name the piece, cancellation, and a word for workers that died. No result may depend on any of
it: a piece has its own seed (``SeedSequence(seed, spawn_key=(..., index))``) and knows nothing of the others.

What is sent to other processes goes by name: `work` is a function of a module, or `functools.partial` of one.
"""

from __future__ import annotations

import os
import platform
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from functools import cache, partial
from importlib.metadata import version
from typing import Any

Told = Callable[[int, int], None]
"""Called with (pieces done, pieces in all)."""

Names = Callable[[int], str]
"""Index of a piece to what it is called in an error."""

DECISIVE = ("numpy", "numba", "scipy", "pandas")
"""Packages whose versions results may depend on, down to the last bit."""

_inside = threading.local()


class WorkersLostError(RuntimeError):
    """Workers died, or their cluster went away, and what they worked on was not done."""


class OtherWorkerError(RuntimeError):
    """A worker runs other code or versions than whoever sends it work: its results would not be the same."""


def spread_out(
    executor: Executor | None, work: Callable[[Any], Any], pieces: Sequence[Any], progress: Told | None = None, *,
    together: int = 1, names: Names | None = None, stop: Callable[[], None] | None = None,
) -> list[Any]:  # fmt: skip
    """Results of `work` on every piece, in the order of the pieces.

    Parameters
    ----------
    executor : concurrent.futures.Executor, optional
        As many threads as there are processors by default: compiled kernels do not hold the interpreter's lock.
        Work that came from somebody else's executor itself stays in the thread it is in.
    work : callable
        Of one piece. For other processes it has to be a function of a module, or `functools.partial` of one.
    pieces : sequence
    progress : callable, optional
        Called in this thread with pieces done and pieces in all.
    together : int
        Pieces that are sent together, so that what `work` holds travels once for all of them.
    names : callable, optional
        What a piece is called in an error, with the seed that repeats it; a number by default.
    stop : callable, optional
        Called after an error or Ctrl-C, so that pieces at work in threads of this process can give up.

    Raises
    ------
    WorkersLostError
        If workers died and nobody did their work, with the pieces that are missing.
    OtherWorkerError
        If a worker has other versions or compiled code than this process.
    Exception
        What a piece raised, with a note that names the piece.
    """
    called = names or (lambda i: f"piece {i + 1} of {len(pieces)}")
    if executor is None:
        workers = min(threads_here(), len(pieces))
        if workers <= 1:
            return _here(work, pieces, progress, called)
        stopped = threading.Event()

        def stop_all() -> None:
            stopped.set()
            if stop is not None:
                stop()

        own = ThreadPoolExecutor(workers)
        runner = partial(_in_own_thread, threads_here() // workers, stopped)
        try:
            return _gathered(own, runner, work, pieces, progress, 1, called, stop_all)
        finally:
            # Threads that were told to stop need a moment for it, and nobody has to wait for them.
            own.shutdown(wait=False, cancel_futures=True)
    return _gathered(executor, _in_worker, work, pieces, progress, max(1, together), called, stop)


def threads_here() -> int:
    """Threads that work may start: one a processor, and within a piece its share, which is one in a worker."""
    share: int = getattr(_inside, "threads", 0)
    return share or os.cpu_count() or 1


def chunks(n: int, size: int) -> Iterator[slice]:
    """Slices of at most `size` that cover ``range(n)``."""
    for begin in range(0, n, size):
        yield slice(begin, min(begin + size, n))


@cache
def what_runs_here(module: str) -> dict[str, str]:
    """What has to be the same wherever the work of a module is done.

    Parameters
    ----------
    module : str
        Dotted name; of somebody else's module all compiled code of the house counts.

    Returns
    -------
    dict of str to str
        Versions of Python and of what results depend on, and a digest of the compiled code that the module reaches.
    """
    from models.compiled import kernel_digest

    try:
        digest = kernel_digest(module)
    except ModuleNotFoundError:
        digest = kernel_digest()
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python, **{name: version(name) for name in DECISIVE}, "compiled code": digest}


def _module_of(work: Callable[..., Any]) -> str:
    while isinstance(work, partial):
        work = work.func
    return str(getattr(work, "__module__", None) or type(work).__module__)


def _here(work: Callable[[Any], Any], pieces: Sequence[Any], progress: Told | None, called: Names) -> list[Any]:
    out = []
    stopped: threading.Event | None = getattr(_inside, "stopped", None)
    for i, piece in enumerate(pieces):
        if stopped is not None and stopped.is_set():
            raise CancelledError  # the piece that this is a part of is no longer wanted
        out.append(_one(work, piece, called(i)))
        if progress is not None:
            progress(i + 1, len(pieces))
    return out


def _gathered(
    executor: Executor, runner: Callable[..., list[Any]], work: Callable[[Any], Any], pieces: Sequence[Any],
    progress: Told | None, together: int, called: Names, stop: Callable[[], None] | None,
) -> list[Any]:  # fmt: skip
    spans = list(chunks(len(pieces), together))
    sender = what_runs_here(_module_of(work)) if runner is _in_worker else {}
    futures: dict[Future[list[Any]], int] = {}
    found: dict[int, list[Any]] = {}
    done = 0
    try:
        for k, span in enumerate(spans):
            words = [called(i) for i in range(span.start, span.stop)]
            futures[executor.submit(runner, work, list(pieces[span]), words, sender)] = k
        for future in as_completed(futures):
            k = futures[future]
            if future.cancelled():
                raise WorkersLostError("the executor, or the scheduler of the cluster, gave up work")
            found[k] = future.result()
            done += len(found[k])
            if progress is not None:
                progress(done, len(pieces))
    except BaseException as error:
        if stop is not None:
            stop()
        for future in futures:
            future.cancel()
        # Of several that are done at once the failed one may come first.
        whole = {k for f, k in futures.items() if f.done() and not f.cancelled() and f.exception() is None}
        missing = [i for k, span in enumerate(spans) if k not in whole for i in range(span.start, span.stop)]
        lost = _lost(error)
        if lost:
            raise WorkersLostError(f"{lost}; {_listed(missing, len(pieces), called)}") from error
        raise
    return [result for k in range(len(spans)) for result in found[k]]


def _lost(error: BaseException) -> str:
    """Why workers are gone, in words; empty if the error is of another kind."""
    if isinstance(error, WorkersLostError):
        return str(error)
    if isinstance(error, BrokenExecutor):
        return (
            "a worker process died (killed, or out of memory), and this kind of executor does not replace it: "
            "models.worker_processes.WorkerProcesses does"
        )
    # Not imported: a cluster is optional.
    if type(error).__name__ == "KilledWorker":
        return f"workers of the cluster died again and again on the same work ({error})"
    return ""


def _listed(missing: Sequence[int], total: int, called: Names) -> str:
    shown = ", ".join(called(i) for i in missing[:3])
    more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
    return f"{total - len(missing)} of {total} pieces were done, without {shown}{more}"


def _one(work: Callable[[Any], Any], piece: Any, name: str) -> Any:
    try:
        return work(piece)
    except Exception as error:
        error.add_note(f"This happened in {name}.")
        raise


def _in_own_thread(
    threads: int, stopped: threading.Event, work: Callable[[Any], Any], pieces: list[Any], names: list[str],
    sender: dict[str, str],
) -> list[Any]:  # fmt: skip
    with _sharing(threads, stopped):
        return [_one(work, piece, name) for piece, name in zip(pieces, names, strict=True)]


def _in_worker(
    work: Callable[[Any], Any], pieces: list[Any], names: list[str], sender: dict[str, str]
) -> list[Any]:
    """Some pieces in a worker, which has to run what the sender runs."""
    here = what_runs_here(_module_of(work))
    apart = [
        f"{name} {here.get(name)}, wanted {wanted}" for name, wanted in sender.items() if here.get(name) != wanted
    ]
    if apart:
        raise OtherWorkerError(
            f"a worker runs other code or versions than this process: found {'; '.join(apart)} "
            "(install the same environment everywhere, and start workers anew after an update)"
        )
    with _sharing(1, None):
        return [_one(work, piece, name) for piece, name in zip(pieces, names, strict=True)]


@contextmanager
def _sharing(threads: int, stopped: threading.Event | None) -> Iterator[None]:
    before = dict(vars(_inside))
    vars(_inside).update(threads=threads, stopped=stopped)
    try:
        yield
    finally:
        vars(_inside).clear()
        vars(_inside).update(before)
