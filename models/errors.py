"""The errors a user can mend: they name the place, the value found and what was wanted."""

from __future__ import annotations

from typing import Any


class InputError(ValueError):
    """Unusable input: a file, a table, an argument.

    The command line prints its message without a traceback and exits with status 2.
    """


class Phrase(str):
    """What was found, in words: shown without quotation marks, which are for the user's own text."""

    __slots__ = ()


def located(place: str, found: Any, wanted: str) -> InputError:
    """Build the house's standard error message.

    Parameters
    ----------
    place : str
        File, line, column, table or option at fault.
    found : object
        The offending value; strings are quoted, numbers are not.
    wanted : str
        What would have been right.

    Examples
    --------
    >>> raise located("events.csv, line 7, column k", 3, "2: events are numbered 0, 1, 2, ...")
    Traceback (most recent call last):
    models.errors.InputError: events.csv, line 7, column k: found 3, wanted 2: events are numbered 0, 1, 2, ...
    """
    shown = repr(found) if isinstance(found, str) and not isinstance(found, Phrase) else str(found)
    if len(shown) > 200:
        shown = shown[:197] + "..."
    return InputError(f"{place}: found {shown}, wanted {wanted}")
