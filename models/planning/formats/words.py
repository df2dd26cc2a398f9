"""How names and numbers are written in problem files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_ALLOWED = re.compile(r"[^A-Za-z0-9_-]")


def number(value: float) -> str:
    """A number with every digit it has, in the notation old readers know: a digit on each side of the point.

    Examples
    --------
    >>> number(1e-05), number(-2.0), number(-0.0)
    ('1.0e-05', '-2.0', '0.0')
    """
    text = repr(float(value) + 0.0)
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa}.0{e}{exponent}" if e and "." not in mantissa else text


def legal_names(names: Sequence[str], letter: str, reserved: Sequence[str] = ()) -> list[str]:
    """Names of letters, digits, underscores and hyphens that begin with a letter, all different.

    Parameters
    ----------
    names : sequence of str
    letter : str
        Put before a name that begins otherwise.
    reserved : sequence of str
        Words that may not be used.

    Examples
    --------
    >>> legal_names(["(0, 1)", "left", "left"], "s")
    ['s_0__1_', 'left', 'left_2']
    """
    out: list[str] = []
    taken = set(reserved)
    later: Counter[str] = Counter()
    for name in names:
        base = _ALLOWED.sub("_", name)
        if not base[:1].isascii() or not base[:1].isalpha():
            base = letter + base
        unique = base
        while unique in taken:
            later[base] += 1
            unique = f"{base}_{later[base] + 1}"
        taken.add(unique)
        out.append(unique)
    return out


def counted(count: int, word: str) -> str:
    """A number of things in words.

    Examples
    --------
    >>> counted(1, "number"), counted(3, "number")
    ('1 number', '3 numbers')
    """
    return f"{count} {word}{'' if count == 1 else 's'}"


def usual(values: NDArray[np.float64]) -> float:
    """The value most entries have, 0 if none has more than half of them."""
    found, counts = np.unique(values, return_counts=True)
    best = int(counts.argmax())
    return float(found[best]) if 2 * counts[best] > len(values) else 0.0
