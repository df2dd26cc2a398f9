"""Words of a `.pomdp` file, with their lines: names, numbers, colons and asterisks; ``#`` begins a comment."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, Phrase, located
from models.planning.formats.words import counted

KEYWORDS = frozenset(["discount", "values", "states", "actions", "observations", "start", "T", "O", "R"])
"""Words that begin a statement."""

END = Phrase("the end of the file")

_APART = KEYWORDS | {":", "+", "-"}
"""A line without any of these is all numbers, where numbers are wanted."""

# No part can match what the part before it gave up: the time is linear in the length of the word.
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_COUNT = re.compile(r"[0-9]{1,9}")


class Words:
    """The words of a file, one after the other.

    Parameters
    ----------
    lines : iterable of str
    place : str
        The file, for error messages.

    Attributes
    ----------
    row : list of str
        Words of the current line.
    at : int
        Next word of `row`.
    row_line : int
        Number of the line of `row`, from 1.
    line : int
        Line of the last word that was taken: where errors are.
    """

    def __init__(self, lines: Iterable[str], place: str) -> None:
        self.place = place
        self.row: list[str] = []
        self.at = 0
        self.row_line = 1
        self.line = 1
        self._ahead: deque[tuple[int, list[str]]] = deque()
        self._rows = self._read(lines)
        self._floats: dict[str, float] = {}

    @staticmethod
    def _read(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
        for number, line in enumerate(lines, 1):
            row = line.partition("#")[0].replace(":", " : ").replace("*", " * ").split()
            if row:
                yield number, row

    def more(self) -> bool:
        """Whether there is another word; moves on to its line."""
        while self.at >= len(self.row):
            following = self._ahead.popleft() if self._ahead else next(self._rows, None)
            if following is None:
                return False
            self.row_line, self.row = following
            self.at = 0
        return True

    def peek(self, ahead: int = 0) -> str | None:
        """The next word, or one further on; None after the last."""
        if not self.more():
            return None
        place = self.at + ahead
        if place < len(self.row):
            return self.row[place]
        place -= len(self.row)
        for _, row in self._ahead:
            if place < len(row):
                return row[place]
            place -= len(row)
        for following in self._rows:
            self._ahead.append(following)
            if place < len(following[1]):
                return following[1][place]
            place -= len(following[1])
        return None

    def take(self, wanted: str) -> str:
        """The next word.

        Raises
        ------
        InputError
            At the end of the file.
        """
        if not self.more():
            raise self.error(END, wanted)
        word = self.row[self.at]
        self.at += 1
        self.line = self.row_line
        return word

    def expect(self, word: str, what: str) -> None:
        """Take the next word, which must be `word`."""
        found = self.take(f"{word!r} {what}")
        if found != word:
            raise self.error(found, f"{word!r} {what}")

    def skip_row(self) -> None:
        """Leave the rest of the line."""
        self.at = len(self.row)
        self.line = self.row_line

    def begins_statement(self) -> bool:
        """Whether the next word begins a statement, or there is none."""
        word = self.peek()
        if word is None:
            return True
        if word not in KEYWORDS:
            return False
        after = self.peek(1)
        return after == ":" or (word == "start" and after in ("include", "exclude"))

    def error(self, found: Any, wanted: str) -> InputError:
        """Error at the last word."""
        return located(f"{self.place}, line {self.line}", found, wanted)

    # -- numbers -----------------------------------------------------------------------------------
    def number_of(self, word: str, wanted: str) -> float:
        """A word as a number.

        Raises
        ------
        InputError
            If it is none that a double can hold.
        """
        value = self._floats.get(word)
        if value is None:
            value = number_in(word)
            if value is None:
                raise self.error(word, wanted)
            if len(self._floats) < 100_000:
                self._floats[word] = value
        return value

    def number(self, wanted: str) -> float:
        """Take a number; its sign may stand apart."""
        word = self.take(wanted)
        if word in ("+", "-"):
            value = self.number_of(self.take(wanted), wanted)
            return -value if word == "-" else value
        return self.number_of(word, wanted)

    def numbers(self, count: int, what: str) -> NDArray[np.float64]:
        """Take all numbers up to the next statement, of which there must be `count`."""
        found: list[float] = []
        wanted = f"a number ({what})"
        while not self.begins_statement():
            words = self.row[self.at :]
            if _APART.isdisjoint(words):
                self.skip_row()
                found += [self.number_of(word, wanted) for word in words]
            else:
                found.append(self.number(wanted))
        if len(found) != count:
            raise self.error(Phrase(counted(len(found), "number")), f"{count}: {what}")
        return np.array(found)


def number_in(word: str) -> float | None:
    """A word as a finite number, None if it is none: unlike `float`, no names such as ``inf`` or ``nan``."""
    if _NUMBER.fullmatch(word) is None:
        return None
    value = float(word)
    return value if math.isfinite(value) else None


def count_of(word: str) -> int | None:
    """A word as a whole number from 0, None if it is none."""
    return int(word) if _COUNT.fullmatch(word) else None
