"""Who does the work of long commands: threads of this process, worker processes, the workers of a cluster.

All are executors of the standard library, so functions that take one (`models.spread_out`) know nothing of the
difference, and no result depends on it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Any

from models.errors import InputError, Phrase, located

PATIENCE = 10.0
"""Seconds within which a scheduler has to answer."""

_ADDRESS = re.compile(r"(?:tcp|tls|ucx|ws|wss)://\S+:\d+")


@contextmanager
def executor_of(
    workers: int | None = None, scheduler: str | None = None, *, patience: float = PATIENCE
) -> Iterator[Executor | None]:
    """Executor for ``--workers N`` or ``--scheduler ADDRESS``; None, which is threads of this process, for neither.

    Parameters
    ----------
    workers : int, optional
        Processes of this machine, replaced when they die (`models.worker_processes`).
    scheduler : str, optional
        Address of a dask scheduler such as ``tcp://10.0.0.5:8786``; its workers do the work.
    patience : float
        Seconds within which the scheduler has to answer.

    Raises
    ------
    InputError
        For both at once, an address that is none, a scheduler that does not answer, or without dask.distributed.
    """
    if workers is not None and scheduler is not None:
        raise located("--workers", workers, "nothing beside --scheduler, whose cluster has its own workers")
    if scheduler is not None:
        with cluster(scheduler, patience=patience) as executor:
            yield executor
    elif workers is not None:
        from models.worker_processes import WorkerProcesses

        with WorkerProcesses(workers) as pool:
            yield pool
    else:
        yield None


@contextmanager
def cluster(scheduler: str, *, patience: float = PATIENCE) -> Iterator[Executor]:
    """Executor of a dask cluster that runs already; the cluster stays when it is left.

    Parameters
    ----------
    scheduler : str
    patience : float
        Seconds within which the scheduler has to answer. Workers may come later: work waits for them.

    Raises
    ------
    InputError
        For an address that is none, a scheduler that does not answer, or without dask.distributed.
    """
    if not _ADDRESS.fullmatch(scheduler):
        raise located("--scheduler", scheduler, "the address of a dask scheduler, tcp://HOST:PORT")
    client_class = _client_class()
    try:
        # Workers may have been started by anyone: nothing of this process is kept there, nothing warned of here.
        client = client_class(scheduler, timeout=patience, set_as_default=False)
    except (OSError, TimeoutError) as error:
        words = Phrase(f"{scheduler}, where nobody answers ({type(error).__name__})")
        raise located("--scheduler", words, f"a dask scheduler that answers within {patience:g} s") from None
    executor = client.get_executor(pure=False)
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=False)
        raise
    finally:
        client.close()


def _client_class() -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError as error:
        raise InputError(
            f"--scheduler: {error.name} is not installed; wanted the optional extra cluster: pip install -e "
            "'.[cluster]'"
        ) from None
    return Client
