r"""Rewards of a `.pomdp` file: statements about :math:`R(s, a, s', o)`, averaged to :math:`R(s, a)`.

.. math:: R(s, a) = \sum_{s'} T(s' \mid s, a) \sum_o O(o \mid a, s')\, R(s, a, s', o)

A statement may leave the start state, the end state and the observation open; later ones override earlier ones
entry by entry. Statements that leave the start state open are laid over the entries of `O` once for an action,
each entry with the number of the statement that set it; statements about one start state are laid over them in
turn, and the higher number counts. So nothing is ever as large as the four-dimensional table.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]

ANY = -1
"""An index that is left open."""


@dataclass(frozen=True)
class Statement:
    """One statement on rewards.

    Attributes
    ----------
    number : int
        Its place in the file: higher ones count.
    end, observation : int
        `ANY` where left open.
    value : float or float64[o] or float64[s', o]
        A number, a row over observations, or a matrix.
    """

    number: int
    end: int
    observation: int
    value: float | Array

    @property
    def everywhere(self) -> bool:
        """Whether it sets every end state and observation to one number."""
        return self.end == ANY and self.observation == ANY and isinstance(self.value, float)


@dataclass
class WrittenReward:
    """Statements on rewards, by action and start state."""

    n_actions: int
    open_start: dict[int, list[Statement]] = field(default_factory=dict)
    of_start: dict[int, dict[int, list[Statement]]] = field(default_factory=dict)
    count: int = 0

    def put(self, action: int, start: int, end: int, observation: int, value: float | Array) -> None:
        """Write a statement; indices are `ANY` where left open."""
        self.count += 1
        statement = Statement(self.count, end, observation, value)
        for a in range(self.n_actions) if action == ANY else (action,):
            if start == ANY:
                known = self.open_start.setdefault(a, [])
                if statement.everywhere:
                    self.of_start.pop(a, None)
            else:
                known = self.of_start.setdefault(a, {}).setdefault(start, [])
            if statement.everywhere:
                known.clear()
            known.append(statement)

    def expected(self, transition: list[sparse.csr_array], emission: list[sparse.csr_array]) -> Array:
        """Expected rewards, shape ``[a, s]``.

        Parameters
        ----------
        transition : list of sparse float64[s, s']
        emission : list of sparse float64[s', o]
            One of each for an action.
        """
        tables = zip(transition, emission, strict=True)
        return np.stack([self._of_action(a, moves, seen) for a, (moves, seen) in enumerate(tables)])

    def _of_action(self, a: int, moves: sparse.csr_array, seen: sparse.csr_array) -> Array:
        entries = _Entries(seen)
        general = self.open_start.get(a, [])
        value, number = entries.lay(general)
        newest = general[-1].number if general else 0
        if len(general) == 1 and general[0].everywhere:
            reward = np.full(moves.shape[0], general[0].value)  # an average would lose the last digit
        else:
            reward = np.asarray(moves @ entries.average(value)).ravel()
        for start, statements in self.of_start.get(a, {}).items():
            if statements[-1].everywhere and statements[-1].number > newest:
                reward[start] = statements[-1].value
                continue
            span = slice(moves.indptr[start], moves.indptr[start + 1])
            ends, chance = moves.indices[span], moves.data[span]
            own, at = entries.lay(statements, ends)
            cells = entries.cells_of(ends)
            mixed = np.where(at > number[cells], own, value[cells])
            sizes = entries.start[ends + 1] - entries.start[ends]
            weights = np.repeat(chance, sizes) * entries.chance[cells]
            reward[start] = float(weights @ mixed)
        return reward


class _Entries:
    """The entries of an observation table, on which rewards are laid."""

    def __init__(self, seen: sparse.csr_array) -> None:
        self.start = seen.indptr.astype(np.int64)
        self.column = seen.indices
        self.chance = seen.data
        self.rows = np.repeat(np.arange(seen.shape[0]), np.diff(self.start))

    def cells_of(self, ends: NDArray) -> NDArray[np.int64]:
        """Places of the entries of some end states, in their order."""
        if len(ends) == 0:
            return np.zeros(0, dtype=np.int64)
        return np.concatenate([np.arange(self.start[t], self.start[t + 1]) for t in ends])

    def average(self, value: Array) -> Array:
        """Average over observations, by end state."""
        return np.bincount(self.rows, weights=value * self.chance, minlength=len(self.start) - 1)

    def lay(self, statements: list[Statement], ends: NDArray | None = None) -> tuple[Array, NDArray[np.int64]]:
        """Value of each entry and number of the statement that set it (0: none); of some end states, or of all."""
        if ends is None:
            rows, columns, places = self.rows, self.column, self.start
        else:
            cells = self.cells_of(ends)
            rows, columns = self.rows[cells], self.column[cells]
            places = np.concatenate([[0], np.cumsum(self.start[ends + 1] - self.start[ends])])
        where = None if ends is None else {int(t): i for i, t in enumerate(ends)}
        value = np.zeros(len(rows))
        number = np.zeros(len(rows), dtype=np.int64)
        for s in statements:
            if s.end == ANY:
                span = slice(0, len(rows))
            else:
                i = s.end if where is None else where.get(s.end, ANY)
                if i == ANY:
                    continue
                span = slice(int(places[i]), int(places[i + 1]))
            if isinstance(s.value, float):
                chosen = slice(None) if s.observation == ANY else columns[span] == s.observation
                value[span][chosen] = s.value
                number[span][chosen] = s.number
            else:
                table = s.value
                value[span] = table[columns[span]] if table.ndim == 1 else table[rows[span], columns[span]]
                number[span] = s.number
        return value, number
