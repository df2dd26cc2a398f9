"""The first part of a `.pomdp` file: discount, kind of values, names of states and the like, start."""

from __future__ import annotations

import numpy as np

from models.errors import Phrase
from models.planning.formats.pomdp_lexer import Words, count_of
from models.planning.formats.written_reward import ANY
from models.planning.formats.written_table import EXACT, FILE_TOLERANCE
from models.planning.problem import Array

MOST_NAMES = 1_000_000
"""States, actions or observations a file may declare."""


class Preamble:
    """What is known before the first table.

    Attributes
    ----------
    discount : float or None
    costs : bool or None
    names : dict of tuple of str
        Of ``states``, ``actions``, ``observations``, as far as declared.
    index : dict of dict
        Index by word, for each of them.
    start : float64[s] or None
    closed : bool
        Whether tables have begun.
    has_reset : bool
        Whether the start distribution has been used.
    """

    def __init__(self, words: Words) -> None:
        self.words = words
        self.discount: float | None = None
        self.costs: bool | None = None
        self.names: dict[str, tuple[str, ...]] = {}
        self.index: dict[str, dict[str, int]] = {}
        self.start: Array | None = None
        self.closed = False
        self.has_reset = False

    def take(self, kind: str, *, wildcard: bool = True) -> int:
        """Take a state, action or observation by name, number or ``*`` (`ANY`).

        Raises
        ------
        InputError
            If there is none of that name.
        """
        word = self.words.take(f"one of the {kind}")
        found = self.index[kind].get(word)
        if found is None or (found == ANY and not wildcard):
            some = ", ".join(self.names[kind][:8]) + (", ..." if len(self.names[kind]) > 8 else "")
            raise self.words.error(word, f"one of the {kind}: {some}" + (" or *" if wildcard else ""))
        return found

    def read(self, head: str) -> None:
        """Read what follows `discount`, `values`, `states`, `actions` or `observations`, and its colon."""
        words = self.words
        if self.closed:
            raise words.error(head, f"{head!r} before the first T, O or R")
        if head == "discount":
            if self.discount is not None:
                raise words.error("discount", "one discount only")
            self.discount = words.number("a number from 0 to 1 (discount)")
            if not 0 <= self.discount <= 1:
                raise words.error(self.discount, "a discount from 0 to 1")
        elif head == "values":
            if self.costs is not None:
                raise words.error("values", "one statement on values only")
            kind = words.take("reward or cost")
            if kind not in ("reward", "cost"):
                raise words.error(kind, "reward or cost")
            self.costs = kind == "cost"
        else:
            if head in self.names:
                raise words.error(head, f"one statement on {head} only")
            self._names(head)

    def _names(self, kind: str) -> None:
        words = self.words
        found: list[str] = []
        while not words.begins_statement():
            name = words.take("a name")
            if not found and (count := count_of(name)) is not None:
                if not 1 <= count <= MOST_NAMES:
                    raise words.error(count, f"from 1 to {MOST_NAMES} {kind}")
                if not words.begins_statement():
                    raise words.error(words.take(""), f"a statement: {kind} are given by their number, {count}")
                found = [str(i) for i in range(count)]
                break
            if not (name[0].isalpha() or name[0] == "_") or not name.isprintable():
                counted = "" if found else f", or their number, from 1 to {MOST_NAMES}"
                raise words.error(name, f"a name of one of the {kind}, which begins with a letter{counted}")
            found.append(name)
        if not found:
            raise words.error(Phrase("nothing"), f"the number or the names of the {kind}")
        index = {name: i for i, name in enumerate(found)}
        if len(index) != len(found):
            seen: set[str] = set()
            twice = next(n for n in found if n in seen or seen.add(n))  # type: ignore[func-returns-value]
            raise words.error(twice, f"different names of {kind}")
        self.names[kind] = tuple(found)
        self.index[kind] = {str(i): i for i in range(len(found))} | index | {"*": ANY}

    def read_start(self) -> None:
        """Read what follows `start`."""
        words = self.words
        if "states" not in self.names:
            raise words.error("start", "'states' before 'start'")
        if self.start is not None:
            raise words.error("start", "one start only")
        if self.has_reset:
            raise words.error("start", "'start' before the first 'reset'")
        n = len(self.names["states"])
        head = words.take("':', include or exclude")
        if head in ("include", "exclude"):
            words.expect(":", f"after start {head}")
            chosen = np.zeros(n, dtype=bool)
            while not words.begins_statement():
                chosen[self.take("states", wildcard=False)] = True
            listed = chosen if head == "include" else ~chosen
            if not chosen.any() or not listed.any():
                raise words.error(Phrase(f"{int(chosen.sum())} of {n} states"), f"some states to {head}, not all")
            self.start = listed / listed.sum()
            return
        if head != ":":
            raise words.error(head, "':', include or exclude after start")
        word = words.peek()
        if word is None or words.begins_statement():
            raise words.error(Phrase("nothing"), "a distribution over the states, a state, or uniform")
        if word == "uniform":
            words.take("uniform")
            self.start = np.full(n, 1.0 / n)
        elif (word in self.names["states"] and count_of(word) is None) or (
            (n > 1 or word == "0") and count_of(word) is not None and self._alone()
        ):
            self.start = np.zeros(n)
            self.start[self.take("states", wildcard=False)] = 1.0
        elif word[0] in "+-." or word[0].isdigit():
            self.start = self._vector(n)
        else:
            words.take("")
            some = ", ".join(self.names["states"][:8]) + (", ..." if n > 8 else "")
            raise words.error(word, f"uniform, a probability for each state, or one of the states: {some}")

    def _alone(self) -> bool:
        """Whether the next word is the last of its statement."""
        after = self.words.peek(1)
        if after is None:
            return True
        further = self.words.peek(2)
        return after.isalpha() and (further == ":" or further in ("include", "exclude"))

    def _vector(self, n: int) -> Array:
        words = self.words
        vector = words.numbers(n, "a probability for each state")
        if (vector < 0).any():
            raise words.error(float(vector.min()), "probabilities from 0 to 1")
        total = float(vector.sum())
        if not abs(total - 1) <= FILE_TOLERANCE:
            raise words.error(Phrase(f"a start distribution of sum {total:.10g}"), "a sum of 1 within 1e-5")
        return vector if abs(total - 1) <= EXACT else vector / total
