"""Modes joined with something else that everybody sees: the event of a schedule, the budget left.

What is observed may as well be part of the mode, and a plan for the product is an ordinary plan (a
mixed-observability POMDP) that knows how far the schedule has come and what it may still spend.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import Phrase, located
from models.planning.belief_check import TOLERANCE
from models.planning.policies import Vocabulary

Array = NDArray[np.float64]
Index = NDArray[np.int64]

OVER = -1
"""Plain mode of a product mode in which nothing is left to decide."""


@dataclass(frozen=True, eq=False)
class ProductModes:
    r"""Observed modes of a product, and how they move.

    Attributes
    ----------
    names : tuple of str
    mode : int64[x]
        Plain mode of each; `OVER` (-1) where nothing is left to decide.
    follow : int64[x, c, m]
        Product mode that follows a choice and the next plain mode; -1 where that mode cannot follow. Also for
        choices that are not allowed: they may be done all the same, by somebody else.
    chance : float64[x, m]
        :math:`P(m' \mid x)` of the next plain mode.
    allowed : bool[x, c]
        Whether a choice can be paid for; False beyond the choices of the mode.
    start : int64[m]
        Product mode to start from, by the first plain mode; -1 where it cannot be the first.
    left : float64[x], optional
        Budget left; None without a budget.
    """

    names: tuple[str, ...]
    mode: Index
    follow: Index
    chance: Array
    allowed: NDArray[np.bool_]
    start: Index
    left: Array | None = None

    def __len__(self) -> int:
        return len(self.names)

    def check(self, place: str, words: Vocabulary) -> None:
        """Refuse arrays that do not fit together, or the vocabulary.

        Raises
        ------
        InputError
            Names the array and the entry.
        """
        n, modes, choices = len(self.names), len(words.modes), max(map(len, words.actions))
        shapes = {
            "mode": (n,), "follow": (n, choices, modes), "chance": (n, modes), "allowed": (n, choices),
            "start": (modes,), **({} if self.left is None else {"left": (n,)}),
        }  # fmt: skip
        for key, shape in shapes.items():
            if getattr(self, key).shape != shape:
                raise located(f"{place}, shape of {key}", getattr(self, key).shape, str(shape))
        for key, low, high in (("mode", OVER, modes), ("follow", -1, n), ("start", -1, n)):
            own = getattr(self, key)
            if np.any((own < low) | (own >= high)):
                bad = int(own[(own < low) | (own >= high)][0])
                raise located(f"{place}, {key}", bad, f"{low} to {high - 1}")
        if not (np.isfinite(self.chance).all() and np.all(self.chance >= 0)):
            raise located(f"{place}, chance", Phrase("other numbers"), "probabilities")
        if self.left is not None and not np.all(self.left >= 0):
            raise located(f"{place}, left", Phrase("negative amounts"), "numbers from 0 on")
        for x in range(n):
            self._check_one(f"{place}, product mode {self.names[x]}", x, words)
        for m, x in enumerate(self.start.tolist()):
            if x >= 0 and self.mode[x] != m:
                raise located(f"{place}, start in mode {words.modes[m]}", self.names[x], "a product mode of it")
        if np.all(self.start < 0):
            raise located(f"{place}, start", self.start.tolist(), "at least one mode to start in")

    def _check_one(self, place: str, x: int, words: Vocabulary) -> None:
        m = int(self.mode[x])
        if m == OVER:
            return
        n = len(words.actions[m])
        if np.any(self.allowed[x, n:]) or not np.any(self.allowed[x]):
            raise located(f"{place}, allowed", self.allowed[x].tolist(), f"some of its {n} choices")
        if abs(self.chance[x].sum() - 1) > TOLERANCE:
            raise located(f"{place}, chance, sum", f"{self.chance[x].sum():.10g}", "1 within 1e-9")
        for c in range(n):
            for after, chance in enumerate(self.chance[x].tolist()):
                y = int(self.follow[x, c, after])
                if y < 0 and chance > 0:
                    where = f"{place}, choice {c}, next mode {words.modes[after]}"
                    raise located(f"{where}, followed by", y, "a product mode: it is possible")
                if y >= 0 and self.mode[y] not in (OVER, after):
                    where = f"{place}, choice {c}, next mode {words.modes[after]}"
                    raise located(f"{where}, followed by", self.names[y], "a product mode of it")

    def to_dict(self) -> dict[str, Any]:
        """Plain content, for files."""
        return {
            "names": list(self.names), "mode": self.mode.tolist(), "follow": self.follow.tolist(),
            "chance": self.chance.tolist(), "allowed": self.allowed.tolist(), "start": self.start.tolist(),
            "left": None if self.left is None else self.left.tolist(),
        }  # fmt: skip


def product_modes(place: str, content: Any, words: Vocabulary) -> ProductModes:
    """Read what `ProductModes.to_dict` wrote, everything checked.

    Raises
    ------
    InputError
        Names the entry, what was found and what was wanted.
    """
    if not isinstance(content, Mapping):
        raise located(place, Phrase(type(content).__name__), "an object")
    names = content.get("names")
    if not isinstance(names, list) or not names or not all(isinstance(v, str) for v in names):
        raise located(f"{place}, names", Phrase("something else"), "a list of names")
    if len(set(names)) != len(names):
        raise located(f"{place}, names", Phrase("names twice"), "a list of different names")
    left = content.get("left")
    out = ProductModes(
        tuple(names), whole_numbers(f"{place}, mode", content.get("mode"), 1),
        whole_numbers(f"{place}, follow", content.get("follow"), 3),
        numbers(f"{place}, chance", content.get("chance"), 2),
        numbers(f"{place}, allowed", content.get("allowed"), 2, "b").astype(bool),
        whole_numbers(f"{place}, start", content.get("start"), 1),
        None if left is None else numbers(f"{place}, left", left, 1),
    )  # fmt: skip
    out.check(place, words)
    return out


def numbers(place: str, value: Any, ndim: int, kinds: str = "iuf") -> NDArray[Any]:
    """A nested list of a file as an array.

    Raises
    ------
    InputError
        On anything but finite numbers (or truth values, with `kinds` "b") in lists of equal length.
    """
    what = "true or false" if kinds == "b" else "finite numbers"
    wanted = f"{what}, {ndim} levels of lists of equal length"
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise located(place, value, wanted)
    try:
        given = np.asarray(value)
    except ValueError:
        raise located(place, Phrase("lists of unequal length"), wanted) from None
    if given.size == 0 and given.ndim <= ndim:
        given = np.zeros((0,) * ndim, dtype=bool if kinds == "b" else np.float64)
    if given.dtype.kind not in kinds or given.ndim != ndim:
        raise located(place, value, wanted)
    if kinds == "b":
        return given
    out = given.astype(np.float64)
    if not np.isfinite(out).all():
        raise located(place, value, wanted)
    return out


def whole_numbers(place: str, value: Any, ndim: int) -> Index:
    """The same of whole numbers, within 2^31."""
    out = numbers(place, value, ndim)
    odd = (out != np.floor(out)) | (np.abs(out) > 2**31)
    if np.any(odd):
        raise located(place, float(out[odd].flat[0]), "whole numbers")
    return out.astype(np.int64)
