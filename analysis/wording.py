"""Numbers with their nouns, so that no sentence speaks of "1 states"."""

from __future__ import annotations


def counted(n: int, one: str, many: str | None = None) -> str:
    """Write a number with its noun in the right form.

    Examples
    --------
    >>> counted(1, "state"), counted(2_000, "event"), counted(3, "person", "people")
    ('1 state', '2,000 events', '3 people')
    """
    return f"{n:,} {one if n == 1 else many or one + 's'}"
