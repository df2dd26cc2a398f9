"""The errors a user can mend: they name the place, the value found and what was wanted."""

from __future__ import annotations

import re
from typing import Any

LONGEST_MESSAGE = 2_000
"""Characters of a line of a message; of a longer one the middle is left out."""

_UNPRINTABLE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


class InputError(ValueError):
    """Unusable input: a file, a table, an argument.

    The command line prints its message without a traceback and exits with status 2. What a file holds may stand in
    it: so no line of it is longer than `LONGEST_MESSAGE`, and it holds nothing that a terminal obeys (`printable`).
    """

    def __init__(self, message: str = "") -> None:
        super().__init__("\n".join(map(_short, printable(str(message)).split("\n"))))


def printable(text: str) -> str:
    r"""Text with control characters, marks that turn its direction and halves of characters as escapes.

    Examples
    --------
    >>> print(printable("a condition called \x1b[2J"))
    a condition called \x1b[2J
    """
    return _UNPRINTABLE.sub(lambda found: repr(found[0])[1:-1], text)


def _short(text: str) -> str:
    if len(text) <= LONGEST_MESSAGE:
        return text
    return f"{text[: LONGEST_MESSAGE - 500]} ... {text[-490:]}"


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
    return InputError(f"{place}: found {brief(shown)}, wanted {wanted}")


def brief(text: str) -> str:
    """A value as a message shows it: its first 200 characters."""
    return text if len(text) <= 200 else text[:197] + "..."
