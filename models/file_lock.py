"""Keeping a file to one process: a lock that ends with the process, however it ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from models.errors import InputError


def hold(file: BinaryIO, path: str | Path, refusal: str) -> None:
    """Lock an open file until it is closed, or its process ends.

    On a system without such locks nothing is held: there, one process a file is up to whoever starts it.

    Parameters
    ----------
    file : binary file
        Open.
    path : path
        Where it was opened; whoever waited for a file that is gone meanwhile does not get it.
    refusal : str
        What to say if another process has it.

    Raises
    ------
    InputError
        If another process holds the file, or it is no longer at its place.
    """
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        current = os.path.samestat(os.fstat(file.fileno()), os.stat(path))
    except OSError:
        current = False
    if not current:
        raise InputError(refusal) from None


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Make a file that several processes or threads may want, one after the other: who comes later waits.

    Who waited looks first whether the file is there by now. Where locks cannot be had (no such system, a folder
    that nobody may write to) nobody waits, and the same work may be done twice.

    Parameters
    ----------
    path : Path
        The file to be made; the lock is a hidden file beside it, gone when nobody holds it.
    """
    held = None
    with suppress(ImportError, OSError):
        held = _waited_for(path.with_name(f".{path.name}.lock"))
    try:
        yield
    finally:
        if held is not None:
            with suppress(OSError):
                os.unlink(held.name)
            held.close()


def _waited_for(path: Path) -> Any:
    """The lock file, locked; waits for whoever has it.

    Raises
    ------
    ImportError, OSError
        If there are no such locks.
    """
    import fcntl

    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        file = open(path, "ab")  # noqa: SIM115 - closed by whoever holds it
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            with suppress(FileNotFoundError):
                # Whoever held it took it away at the end: then this is a lock on nothing.
                if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                    return file
        except BaseException:
            file.close()
            raise
        file.close()
