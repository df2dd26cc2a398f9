"""Cautions: why not to trust a model or its draws, carried on to everything that is made from them.

A posterior that failed its convergence gate says so, and so does a search that stopped before it converged. A plan
made from them looks like any other plan. So models and draws carry their cautions, schedules and problems have
those of what they are made of, and every result repeats them in one line (`models.notebook_view.NotebookView`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from typing import Any

BEGINS = "CAUTION: "
"""How the line begins."""


def cautions_of(source: Any) -> tuple[str, ...]:
    """Cautions of anything; none where it knows of none.

    Examples
    --------
    >>> cautions_of("no model")
    ()
    """
    found = getattr(source, "cautions", ())
    return found if isinstance(found, tuple) else ()


def together(*sources: Iterable[str]) -> tuple[str, ...]:
    """Cautions of several sources, each once.

    Examples
    --------
    >>> together(("a", "b"), (), ("b", "c"))
    ('a', 'b', 'c')
    """
    return tuple(dict.fromkeys(text for source in sources for text in source))


def caution_line(cautions: Sequence[str]) -> str:
    """Cautions in one line; empty if there are none.

    Examples
    --------
    >>> caution_line(("the posterior failed its convergence gate",))
    'CAUTION: the posterior failed its convergence gate; do not rely on these numbers.'
    """
    return f"{BEGINS}{' and '.join(cautions)}; do not rely on these numbers." if cautions else ""


def cautioned(text: str, cautions: Sequence[str]) -> str:
    """A text that ends with the line of its cautions, wherever the line stood before.

    Examples
    --------
    >>> cautioned("Worth 3. CAUTION: x; do not rely on these numbers. More.", ("x",))
    'Worth 3. More. CAUTION: x; do not rely on these numbers.'
    """
    return f"{uncautioned(text, cautions)} {caution_line(cautions)}" if cautions and text else text


def uncautioned(text: str, cautions: Sequence[str]) -> str:
    """A text without the line, for where it stands beside already."""
    line = caution_line(cautions)
    return text.replace(f" {line}", "") if line else text


def repeating(sentence: Callable[[Any], str]) -> Callable[[Any], str]:
    """A sentence of a result that ends with the line of the result's `cautions`."""

    @wraps(sentence)
    def said(result: Any) -> str:
        return cautioned(sentence(result), result.cautions)

    return said


def told_once(texts: Iterable[str], cautions: Sequence[str]) -> list[str]:
    """Texts of one result below each other: the line stays in the first that has it."""
    line, out, told = caution_line(cautions), [], False
    for text in texts:
        out.append(uncautioned(text, cautions) if told else text)
        told = told or (bool(line) and line in text)
    return out
