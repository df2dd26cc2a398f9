"""Cautions: why not to trust a model or its draws, carried on to everything that is made from them.

A posterior that failed its convergence gate says so, and so does a search that stopped before it converged. A plan
made from them looks like any other plan. So models and draws carry their cautions, schedules and problems have
those of what they are made of, and every result repeats them in one line (`models.notebook_view.NotebookView`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from typing import Any

from models.errors import located

BEGINS = "CAUTION: "
"""How the line begins."""

ENDS = (".", "!", "?", ":", ".)", "!)", "?)")
"""How a text ends that the line may follow as it is."""


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


def read_cautions(place: str, content: Mapping[str, Any]) -> tuple[str, ...]:
    """Cautions in the content of a file that others may have written; none where it does not say.

    Each is one line of letters that can be shown, since a terminal shows it.

    Raises
    ------
    InputError
        On anything but a list of such texts.

    Examples
    --------
    >>> read_cautions("policy.json", {}), read_cautions("policy.json", {"cautions": ["few draws"]})
    ((), ('few draws',))
    """
    given = content.get("cautions", [])
    good = isinstance(given, list) and all(isinstance(v, str) and v.strip() and v.isprintable() for v in given)
    if not good:
        raise located(f"{place}, key cautions", given, "a list of texts of one line")
    return tuple(given)


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

    A text without a full stop gets one, so that the line is a sentence of its own.

    Examples
    --------
    >>> cautioned("Worth 3. CAUTION: x; do not rely on these numbers. More.", ("x",))
    'Worth 3. More. CAUTION: x; do not rely on these numbers.'
    >>> cautioned("flips at 0.06", ("x",))
    'flips at 0.06. CAUTION: x; do not rely on these numbers.'
    """
    if not cautions or not text:
        return text
    own = uncautioned(text, cautions)
    return f"{own}{'' if own.endswith(ENDS) else '.'} {caution_line(cautions)}"


def uncautioned(text: str, cautions: Sequence[str]) -> str:
    """A text without the line, for where it stands beside already.

    A full stop that somebody put behind the line goes with it: the text before has its own.

    Examples
    --------
    >>> uncautioned(cautioned("flips at 0.06", ("x",)) + ".", ("x",))
    'flips at 0.06.'
    """
    line = caution_line(cautions)
    if not line:
        return text
    return text.replace(f". {line}.", ".").replace(f" {line}", "")


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
