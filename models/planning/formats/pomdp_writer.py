"""Writing Cassandra's `.pomdp` files.

The format knows one set of states and observations of the end state: the problem is brought into that form first
(`models.planning.formats.end_state`), which leaves its values as they are. Numbers keep every digit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import sparse

from models.planning.formats.end_state import flat
from models.planning.formats.pomdp_lexer import KEYWORDS
from models.planning.formats.words import legal_names, number, usual
from models.planning.problem import Array, Problem

_RESERVED = (*KEYWORDS, "uniform", "identity", "reset", "include", "exclude", "reward", "cost")


def pomdp_text(problem: Problem, *, hide_start: bool = False) -> str:
    """A problem in the `.pomdp` format.

    Names that the format does not allow are changed to ones that it does. Entries that are zero are left out; what
    is the same for every state or action is written once with ``*``.

    Parameters
    ----------
    problem : Problem
    hide_start : bool
        See `models.planning.formats.end_state.flat`.

    Raises
    ------
    InputError
        If the problem may start in several modes and `hide_start` is not set.
    """
    problem = flat(problem, hide_start=hide_start)
    return "\n".join(_lines(problem)) + "\n"


def _lines(problem: Problem) -> Iterator[str]:
    choices = problem.choices[0]
    n = len(problem.states[0])
    yield f"# {''.join(c if c.isprintable() else ' ' for c in problem.name)}"
    yield f"discount: {number(problem.discount)}"
    yield f"values: {'cost' if problem.costs else 'reward'}"
    states, declared = _declared("states", problem.states[0], "s")
    yield declared
    actions, declared = _declared("actions", [c.action for c in choices], "a")
    yield declared
    observations, declared = _declared("observations", problem.observations, "o")
    yield declared
    yield _start(problem.initial[0], states)
    moves = [c.branches[0].transition for c in choices]
    seen = [
        sparse.csr_array(np.ones((n, 1))) if c.branches[0].emission is None else c.branches[0].emission
        for c in choices
    ]
    yield from _tables("T", moves, actions, states, states)
    yield from _tables("O", seen, actions, states, observations)
    yield from _rewards(np.stack([c.reward for c in choices]), actions, states, -1.0 if problem.costs else 1.0)


def _declared(kind: str, names: Sequence[str], letter: str) -> tuple[list[str], str]:
    """Words for the members of a set, and the line that declares it."""
    if all(name == str(i) for i, name in enumerate(names)):
        return list(names), f"{kind}: {len(names)}"
    legal = legal_names(names, letter, _RESERVED)
    return legal, f"{kind}: {' '.join(legal)}"


def _start(initial: Array, states: Sequence[str]) -> str:
    if np.all(initial == 1.0 / len(initial)):
        return "start: uniform"
    if np.count_nonzero(initial) == 1 and initial.max() == 1:
        return f"start include: {states[int(initial.argmax())]}"
    return "start: " + " ".join(number(v) for v in initial)


def _tables(
    head: str, tables: list[sparse.csr_array], actions: Sequence[str], rows: Sequence[str], columns: Sequence[str]
) -> Iterator[str]:
    for a, table in enumerate(tables):
        if a and all(_same(table, other) for other in tables):
            return
        action = "*" if a == 0 and len(tables) > 1 and all(_same(table, other) for other in tables) else actions[a]
        yield ""
        yield from _table(f"{head}: {action}", head == "T", table, rows, columns)


def _same(one: sparse.csr_array, other: sparse.csr_array) -> bool:
    return one.nnz == other.nnz and all(
        np.array_equal(getattr(one, part), getattr(other, part)) for part in ("indptr", "indices", "data")
    )


def _table(
    head: str, square: bool, table: sparse.csr_array, rows: Sequence[str], columns: Sequence[str]
) -> Iterator[str]:
    n, width = table.shape
    if table.nnz == n * width and np.all(table.data == 1.0 / width):
        yield f"{head}\nuniform"
        return
    if square and table.nnz == n and np.all(table.data == 1) and np.array_equal(table.indices, np.arange(n)):
        yield f"{head}\nidentity"
        return
    starts = table.indptr
    first = slice(starts[0], starts[1])
    alike = n > 1 and np.all(np.diff(starts) == starts[1]) and (
        np.array_equal(np.tile(table.indices[first], n), table.indices)
        and np.array_equal(np.tile(table.data[first], n), table.data)
    )  # fmt: skip
    for r in range(1 if alike else n):
        word = "*" if alike else rows[r]
        for k in range(starts[r], starts[r + 1]):
            yield f"{head} : {word} : {columns[table.indices[k]]} {number(table.data[k])}"


def _rewards(reward: Array, actions: Sequence[str], states: Sequence[str], sign: float) -> Iterator[str]:
    yield ""
    for a, action in enumerate(actions):
        base = usual(reward[a])
        if base:
            yield f"R: {action} : * : * : * {number(sign * base)}"
        for s in map(int, np.flatnonzero(reward[a] != base)):
            yield f"R: {action} : {states[s]} : * : * {number(sign * reward[a, s])}"
