"""Warnings of libraries silenced, one thread at a time.

`warnings.catch_warnings` swaps filters of the whole process: two threads inside it at once restore each other's,
and a warning that was to be silent gets out (or stays silent for good).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock

_LOCK = RLock()


@contextmanager
def without_warnings() -> Iterator[None]:
    """Ignore every warning inside; other threads wait before their own."""
    with _LOCK, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
