"""Keeping a file to one process: a lock that ends with the process, however it ends."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

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
