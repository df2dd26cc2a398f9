"""Options of long commands that say who does the work, and what to say when workers are gone."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from models.errors import InputError

if TYPE_CHECKING:
    from concurrent.futures import Executor

WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--workers", metavar="N", min=1, help="Processes that do the work; threads of this one by default."
    ),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="tcp://HOST:PORT",
        help="Dask scheduler whose workers do the work (needs the extra `cluster`).",
    ),
]  # fmt: skip


@contextmanager
def workers_of(workers: int | None, scheduler: str | None) -> Iterator[Executor | None]:
    """Executor that the options ask for; workers that are gone end the command with exit status 1 and one line.

    Raises
    ------
    InputError
        If the options do not go together, nobody answers, or workers run other versions.
    """
    from analysis.executors import executor_of
    from models.spread_out import OtherWorkerError, WorkersLostError

    try:
        with executor_of(workers, scheduler) as executor:
            yield executor
    except OtherWorkerError as error:
        raise InputError(str(error)) from None
    except WorkersLostError as error:
        print(f"prosocial: {error}", file=sys.stderr)
        raise typer.Exit(1) from None
