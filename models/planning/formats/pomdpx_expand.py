"""Joint distributions of a factored model: every combination that is possible, with its probability.

A model in factors says how each variable depends on others. Starting from rows in which some variables are known,
one variable after the other is added: each row becomes as many as that variable has possible values there. What is
impossible is never listed, so the tables of thousands of joint states stay as sparse as they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from models.errors import Phrase, located
from models.planning.formats.pomdpx_table import Axis, Function
from models.planning.formats.written_table import MOST_ENTRIES, Array, Index

Known = dict[str, Index]


@dataclass(frozen=True)
class Factor:
    """A conditional distribution, rows summing to one: ``[values of the parents, values of the variables]``."""

    parents: tuple[Axis, ...]
    variables: tuple[Axis, ...]
    table: sparse.csr_array
    place: str

    @classmethod
    def of(cls, function: Function) -> Factor:
        """A function whose rows are checked to be distributions."""
        table = function.table.probabilities(function.words_of, function.node.last_line)
        return cls(function.parents, function.variables, table, f"{function.node.place}, line {function.node.line}")


@dataclass(frozen=True)
class Rows:
    """Combinations: where each came from, what is known in it, and how probable it is."""

    origin: Index
    known: Known
    probability: Array


def cell(axes: Sequence[Axis], known: Mapping[str, Index], size: int) -> Index:
    """Flat place of each row's values on some axes, shape ``[row]``."""
    flat = np.zeros(size, dtype=np.int64)
    for axis in axes:
        flat = flat * len(axis.values) + known[axis.name]
    return flat


def digits(axes: Sequence[Axis], flat: Index) -> Known:
    """Values on each axis of flat places: the reverse of `cell`."""
    found: Known = {}
    for axis in reversed(axes):
        flat, found[axis.name] = np.divmod(flat, len(axis.values))
    return found


def expand(known: Known, size: int, factors: Sequence[Factor]) -> Rows:
    """Add the variables of some factors to rows.

    Parameters
    ----------
    known : dict of int64[row]
        Values of the variables known so far.
    size : int
        Number of rows.
    factors : sequence of Factor
        In an order in which parents come first (`ordered`).
    """
    origin = np.arange(size)
    probability = np.ones(size)
    known = dict(known)
    for factor in factors:
        row = cell(factor.parents, known, len(origin))
        start, count = factor.table.indptr[row].astype(np.int64), np.diff(factor.table.indptr)[row]
        total = int(count.sum())
        if total > MOST_ENTRIES:
            raise located(factor.place, Phrase(f"{total} combinations"), f"at most {MOST_ENTRIES}")
        again = np.repeat(np.arange(len(origin)), count)
        within = np.arange(total) - np.repeat(np.cumsum(count) - count, count)
        place = start[again] + within
        known = {name: value[again] for name, value in known.items()}
        known |= digits(factor.variables, factor.table.indices[place].astype(np.int64))
        origin = origin[again]
        probability = probability[again] * factor.table.data[place]
    return Rows(origin, known, probability)


def ordered(factors: Sequence[Factor], given: set[str]) -> list[Factor]:
    """Factors in an order in which parents come first.

    Raises
    ------
    InputError
        If they depend on each other in a circle.
    """
    left, out, known = list(factors), [], set(given)
    while left:
        ready = [f for f in left if all(a.name in known for a in f.parents)]
        if not ready:
            names = ", ".join(a.name for f in left for a in f.variables)
            raise located(
                left[0].place, Phrase(f"a circle among {names}"), "parents that do not depend on children"
            )
        out += ready
        known |= {a.name for f in ready for a in f.variables}
        left = [f for f in left if f not in ready]
    return out


def joint_size(axes: Sequence[Axis], what: str, place: str, most: int) -> int:
    """Number of combinations of the values of some variables.

    Raises
    ------
    InputError
        If there are more than `most`.
    """
    size = math.prod(len(a.values) for a in axes)
    if size > most:
        raise located(place, Phrase(f"{size} {what}"), f"at most {most}")
    return size


def joint_names(axes: Sequence[Axis], alone: str) -> tuple[str, ...]:
    """Names of the combinations of the values of some variables, the last changing fastest; `alone` of none."""
    names = [""]
    for axis in axes:
        names = [f"{left},{value}" if left else value for left in names for value in axis.values]
    return tuple(names) if axes else (alone,)
