"""How much of a budget can still matter: the amounts left that differ in what they pay for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.errors import Phrase, located

Index = NDArray[np.int64]

MOST_LEVELS = 100_000
"""Amounts that are told apart before one event."""


class BudgetLevels(NamedTuple):
    """Amounts left that matter, before each event and after the last.

    With an amount between two of them no more can be paid for than with the lower one.

    Attributes
    ----------
    left : tuple of int64[i] or object[i]
        Units left, increasing from 0: all sums that the events to come can be charged, up to the budget. Whole
        numbers of Python's own where the charges are.
    after : int64[k, i, c]
        Level left by each choice of an event; -1 if it cannot be paid for.
    """

    left: tuple[Index, ...]
    after: Index

    def level(self, event: int, units: float) -> int:
        """Level of an amount: the highest that it covers; 0 where more was spent than there was."""
        return int(np.searchsorted(self.left[event], max(units, 0), side="right")) - 1


def budget_levels(charges: list[Index], budget: float) -> BudgetLevels:
    """Levels of a schedule.

    Parameters
    ----------
    charges : list of int64[c] or object[c]
        Of the choices of each event, in units; at least one of each event is free.
    budget : int or float
        Whole units, or infinite.

    Raises
    ------
    InputError
        If there are too many sums.
    """
    left = [np.zeros(1, dtype=np.result_type(np.int64, *charges))]
    for own in reversed(charges):
        sums = np.unique((left[-1][:, None] + own[own <= budget]).ravel())
        left.append(sums[sums <= budget])
        if len(left[-1]) > MOST_LEVELS:
            many = Phrase(f"{len(left[-1])} different sums")
            raise located("charges", many, f"at most {MOST_LEVELS}: choose charges with a coarser common unit")
    left.reverse()
    shape = len(charges), max(map(len, left)), max(map(len, charges))
    after = np.full(shape, -1, dtype=np.int64)
    for k, own in enumerate(charges):
        rest = left[k][:, None] - own
        found = np.searchsorted(left[k + 1], rest, side="right") - 1
        after[k, : len(rest), : len(own)] = np.where(rest >= 0, found, -1)
    return BudgetLevels(tuple(left), after)
