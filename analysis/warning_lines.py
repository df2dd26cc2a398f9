"""Warnings to a person at the command line: one line each, as errors are told."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def warnings_told(quiet: bool = False) -> Iterator[None]:
    """Print every warning meant for users as ``prosocial: ...`` on standard error, without a place in the code.

    Parameters
    ----------
    quiet : bool
        Nothing but errors is wanted: these warnings are not shown.
    """
    before = warnings.showwarning

    def show(message: Any, category: type[Warning], *place: Any, **more: Any) -> None:
        if not issubclass(category, UserWarning):
            before(message, category, *place, **more)
        elif not quiet:
            print(f"prosocial: {' '.join(str(message).split())}", file=sys.stderr)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = before
