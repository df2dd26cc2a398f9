r"""Textbook problems: one mode, observations of the end state, :math:`T(s' \mid s, a)\,O(o \mid a, s')`."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from models.errors import Phrase, located
from models.planning.problem import Array, Branch, Choice, Problem, csr

TEXTBOOK_MODE = "always"
"""Name of the only mode of a problem without an observed part."""


def textbook_problem(
    transition: ArrayLike | Sequence[Any],
    observation: ArrayLike | Sequence[Any],
    reward: ArrayLike,
    discount: float,
    initial: ArrayLike | None = None,
    *,
    states: Sequence[str] = (),
    actions: Sequence[str] = (),
    observations: Sequence[str] = (),
    name: str = "problem",
    costs: bool = False,
) -> Problem:
    r"""A POMDP from its tables.

    Parameters
    ----------
    transition : float64[a, s, s'] or a sequence of sparse matrices
        :math:`T(s' \mid s, a)`.
    observation : float64[a, s', o] or a sequence of sparse matrices
        :math:`O(o \mid a, s')`, emitted by the state that was reached.
    reward : float64[a, s] or float64[a, s, s', o]
        Expected reward of an action, or the reward of every step, which is averaged.
    discount : float
    initial : float64[s], optional
        Uniform by default.
    states, actions, observations : sequence of str
        Names; numbers by default.

    Raises
    ------
    InputError
        As `Problem` does.

    Examples
    --------
    >>> import numpy as np
    >>> listen = np.eye(2)[None]
    >>> textbook_problem(listen, [[[.85, .15], [.15, .85]]], [[-1.0, -1.0]], 0.95).n_states
    2
    """
    moves, seen = _tables(transition, f"{name}, transition"), _tables(observation, f"{name}, observation")
    if not moves:
        raise located(f"{name}, actions", 0, "at least one")
    n = moves[0].shape[0]
    try:
        rewards = np.asarray(reward, dtype=np.float64)
    except (TypeError, ValueError):
        raise located(f"{name}, reward", Phrase("rows of different lengths, or no numbers"), "numbers") from None
    if len(seen) != len(moves):
        found = Phrase(f"{len(moves)} transition and {len(seen)} observation tables")
        raise located(f"{name}, actions", found, "one of each for an action")
    for what, given, count in (
        ("states", states, n), ("actions", actions, len(moves)), ("observations", observations, seen[0].shape[1]),
    ):  # fmt: skip
        if given and (len(given) != count or len(set(given)) != count):
            raise located(f"{name}, names of {what}", list(given)[:20], f"{count} different ones")
    if rewards.ndim == 4:
        wanted = (len(moves), n, n, seen[0].shape[1])
        if rewards.shape != wanted:
            raise located(f"{name}, shape of the reward", rewards.shape, str(wanted))
        rewards = np.stack(
            [np.einsum("st,to,sto->s", t.toarray(), o.toarray(), r)
             for t, o, r in zip(moves, seen, rewards, strict=True)]
        )  # fmt: skip
    if rewards.shape != (len(moves), n):
        raise located(f"{name}, shape of the reward", rewards.shape, f"({len(moves)}, {n})")
    start = np.full(n, 1.0 / n) if initial is None else np.asarray(initial, dtype=np.float64)
    kinds = tuple(range(seen[0].shape[1]))
    action_names = tuple(actions) or tuple(map(str, range(len(moves))))
    choices = tuple(
        Choice(action_names[a], rewards[a], (Branch(0, moves[a], kinds, seen[a]),)) for a in range(len(moves))
    )
    return Problem(
        (TEXTBOOK_MODE,), (tuple(states) or tuple(map(str, range(n))),), (choices,),
        tuple(observations) or tuple(map(str, kinds)), (start,), float(discount), name, costs,
    )  # fmt: skip


def _tables(tables: Any, place: str) -> list[Any]:
    """One sparse matrix an action."""
    found = []
    for a, table in enumerate(tables):
        try:
            found.append(csr(table))
        except (TypeError, ValueError):
            raise located(f"{place}, action {a}", Phrase("no table of numbers"), "a matrix") from None
    return found


def problem_from_functions(
    states: Sequence[Hashable],
    actions: Sequence[str],
    transition: Callable[[Any, str], Mapping[Hashable, float]],
    observation: Callable[[str, Any], Mapping[str, float]],
    reward: Callable[[Any, str], float],
    discount: float,
    initial: Mapping[Hashable, float],
    *,
    mode: Callable[[Any], str] | None = None,
    available: Callable[[str, str], bool] | None = None,
    name: str = "problem",
) -> Problem:
    r"""A problem from functions of named states.

    Parameters
    ----------
    states : sequence
        Every state; any hashable value, shown by `str`.
    actions : sequence of str
    transition : callable
        ``(state, action) -> {next state: probability}``.
    observation : callable
        ``(action, next state) -> {observation: probability}``.
    reward : callable
        ``(state, action) -> float``, expected.
    discount : float
    initial : mapping
        ``{state: probability}``.
    mode : callable, optional
        The part of a state that is observed: ``state -> name``. Beliefs then range over the states of one mode,
        which is far less work than folding it into the observation.
    available : callable, optional
        ``(mode, action) -> bool``; all actions everywhere by default. With one mode the mode's name is ``always``.

    Raises
    ------
    InputError
        On a state that is unknown, or as `Problem` does.
    """
    where: dict[Hashable, tuple[int, int]] = {}
    modes: list[str] = []
    members: list[list[Hashable]] = []
    for state in states:
        label = TEXTBOOK_MODE if mode is None else mode(state)
        if label not in modes:
            modes.append(label)
            members.append([])
        x = modes.index(label)
        where[state] = (x, len(members[x]))
        members[x].append(state)
    kinds: dict[str, int] = {}
    choices = []
    for x, label in enumerate(modes):
        offered = [a for a in actions if available is None or available(label, a)]
        choices.append(
            tuple(_choice(members, where, kinds, x, a, transition, observation, reward, name) for a in offered)
        )
    start = [np.zeros(len(m)) for m in members]
    for state, probability in initial.items():
        x, y = _place(where, state, f"{name}, initial belief")
        start[x][y] += probability
    names = tuple(tuple(str(s) for s in group) for group in members)
    return Problem(
        tuple(modes), names, tuple(choices), tuple(kinds) or ("none",), tuple(start), float(discount), name
    )


def _choice(
    members: list[list[Hashable]], where: Mapping[Hashable, tuple[int, int]], kinds: dict[str, int], x: int,
    action: str, transition: Callable[[Any, str], Mapping[Hashable, float]],
    observation: Callable[[str, Any], Mapping[str, float]], reward: Callable[[Any, str], float], name: str,
) -> Choice:  # fmt: skip
    moves: dict[int, list[tuple[int, int, float]]] = {}
    for y, state in enumerate(members[x]):
        for after, probability in transition(state, action).items():
            z, column = _place(where, after, f"{name}, transition of {state} under {action}")
            moves.setdefault(z, []).append((y, column, probability))
    branches = []
    for z, entries in sorted(moves.items()):
        table = np.zeros((len(members[x]), len(members[z])))
        seen: dict[int, Array] = {}
        for y, column, probability in entries:
            table[y, column] += probability
        for column in {c for _, c, _ in entries}:
            for kind, probability in observation(action, members[z][column]).items():
                o = kinds.setdefault(kind, len(kinds))
                seen.setdefault(o, np.zeros(len(members[z])))[column] += probability
        order = tuple(sorted(seen))
        emission = csr(np.stack([seen[o] for o in order], axis=1))
        if len(order) == 1 and np.allclose(
            emission.sum(axis=1)[sorted({c for _, c, _ in entries})], 1.0, atol=1e-12
        ):
            branches.append(Branch(z, csr(table), order))
        else:
            branches.append(Branch(z, csr(table), order, emission))
    return Choice(action, np.array([float(reward(s, action)) for s in members[x]]), tuple(branches))


def _place(where: Mapping[Hashable, tuple[int, int]], state: Hashable, place: str) -> tuple[int, int]:
    if state not in where:
        raise located(f"{place}, state", str(state), "one of the states")
    return where[state]
