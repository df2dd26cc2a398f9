r"""Other forms of a problem, with the same values: for file formats and solvers that know fewer kinds of problems.

Formats emit observations from the state that was reached, :math:`O(o \mid a, x', y')`, offer the same actions
everywhere, and some know no observed part. Three steps lead there, and none of them changes what a plan is worth:

1. `same_actions`: a mode that lacks an action repeats its first choice under that name.
2. `observed_end`: where an observation tells more than the end state does (above all, what it shows of the state
   the step *started* from), the last observation becomes part of the mode: it is seen, so beliefs over hidden
   states stay as they were. Rewards are still those of the step, so nothing is shifted in time.
3. `flat`: mode and hidden state become one state, and every observation shows the mode that was reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from models.errors import InputError
from models.planning.problem import Array, Branch, Choice, Problem, csr
from models.planning.textbook import TEXTBOOK_MODE

SAME = 1e-12
"""Emission probabilities closer than that are the same."""

NOTHING = "none"
"""Name of the only observation of a problem that shows nothing but its mode."""


def action_names(problem: Problem) -> tuple[str, ...]:
    """Every action of a problem, in the order of first mention."""
    return tuple(dict.fromkeys(c.action for offered in problem.choices for c in offered))


def same_actions(problem: Problem) -> Problem:
    """The problem with every action offered in every mode, in one order.

    A mode that lacks an action repeats its first choice under that name, so no plan becomes better or worse.
    """
    names = action_names(problem)
    choices = []
    for offered in problem.choices:
        known = {c.action: c for c in offered}
        choices.append(tuple(known.get(name, replace(offered[0], action=name)) for name in names))
    return replace(problem, choices=tuple(choices))


def observed_end(problem: Problem) -> Problem:
    r"""The problem with observations of the end state only, :math:`O(o \mid a, x', y')`.

    A problem that is of that form already keeps its modes; otherwise each mode is paired with the last observation.
    Every choice has at most one branch for each mode it may lead to.
    """
    problem = same_actions(problem)
    emissions = _end_emissions(problem)
    if emissions is None:
        return _with_last_observation(problem)
    choices = []
    for offered in problem.choices:
        branches = []
        for a, choice in enumerate(offered):
            parts = []
            for x, group in _by_mode(choice).items():
                table, used = emissions[a, x]
                sure = len(used) == 1 and bool(np.all(table.sum(axis=1) == 1))
                parts.append(Branch(x, _total(group), used, None if sure else table))
            branches.append(replace(choice, branches=tuple(parts)))
        choices.append(tuple(branches))
    return replace(problem, choices=tuple(choices))


def flat(problem: Problem, *, hide_start: bool = False) -> Problem:
    """The problem with one mode; each observation names the mode that was reached.

    Parameters
    ----------
    problem : Problem
    hide_start : bool
        A problem that may start in several modes shows the first one before any action, for which this form has no
        place. True leaves it out: the values are then those of not being told, at most those of the problem.

    Raises
    ------
    InputError
        If the problem may start in several modes and `hide_start` is not set.
    """
    problem = observed_end(problem)
    if problem.n_modes == 1:
        return problem
    first = [problem.modes[x] for x, _, _ in problem.starts()]
    if len(first) > 1 and not hide_start:
        raise InputError(
            f"{problem.name}: starts in one of {len(first)} modes ({', '.join(first[:4])}, ...), which is seen "
            f"before acting; without an observed part that cannot be said. Start from one mode (Problem.started), "
            f"write .pomdpx, or set hide_start=True: then the first mode is not shown"
        )
    sizes = [len(s) for s in problem.states]
    place = np.concatenate([[0], np.cumsum(sizes)])
    pairs = sorted({
        (b.mode, o) for offered in problem.choices for c in offered for b in c.branches for o in b.observations
    })  # fmt: skip
    reached = {x for x, _ in pairs}
    pairs = sorted(pairs + [(x, 0) for x in range(problem.n_modes) if x not in reached])
    pair_of = {pair: i for i, pair in enumerate(pairs)}
    choices = []
    for a, action in enumerate(action_names(problem)):
        moves, seen, known = [], [], np.zeros(place[-1], dtype=bool)
        for x, offered in enumerate(problem.choices):
            for b in offered[a].branches:
                t = b.transition.tocoo()
                moves.append((t.row + place[x], t.col + place[b.mode], t.data))
                rows = np.arange(place[b.mode], place[b.mode + 1])
                if not known[rows[0]]:
                    known[rows] = True
                    e = sparse.coo_array(np.ones((len(rows), 1)) if b.emission is None else b.emission)
                    columns = np.array([pair_of[b.mode, o] for o in b.observations])
                    seen.append((e.row + place[b.mode], columns[e.col], e.data))
        rest = np.flatnonzero(~known)
        any_pair = {x: i for (x, _), i in reversed(pair_of.items())}
        mode_of = np.repeat(np.arange(problem.n_modes), sizes)
        seen.append((rest, np.array([any_pair[x] for x in mode_of[rest]], dtype=np.int64), np.ones(len(rest))))
        reward = np.concatenate([offered[a].reward for offered in problem.choices])
        branch = Branch(
            0,
            _joined(moves, (place[-1], place[-1])),
            tuple(range(len(pairs))),
            _joined(seen, (place[-1], len(pairs))),
        )
        choices.append(Choice(action, reward, (branch,)))
    states = [f"{mode},{s}" for mode, group in zip(problem.modes, problem.states, strict=True) for s in group]
    if max(sizes) == 1:
        states = list(problem.modes)
    shown = [problem.modes[x] + ("" if len(problem.observations) == 1 else f",{problem.observations[o]}")
             for x, o in pairs]  # fmt: skip
    return Problem(
        (TEXTBOOK_MODE,), (tuple(states),), (tuple(choices),), tuple(shown), (np.concatenate(problem.initial),),
        problem.discount, problem.name, problem.costs,
    )  # fmt: skip


# -- parts of a step -----------------------------------------------------------------------------------
def _by_mode(choice: Choice) -> dict[int, list[Branch]]:
    groups: dict[int, list[Branch]] = {}
    for branch in sorted(choice.branches, key=lambda b: b.mode):
        groups.setdefault(branch.mode, []).append(branch)
    return groups


def _emission(branch: Branch) -> sparse.csr_array:
    """Emission of a branch, ``[y', observation of the branch]``."""
    if branch.emission is not None:
        return branch.emission
    return sparse.csr_array(np.ones((branch.transition.shape[1], 1)))


def _scaled(table: sparse.csr_array, by_column: Array) -> sparse.csr_array:
    """Columns of a table, each times a number; the table itself if all are one."""
    if np.all(np.abs(by_column - 1)[np.unique(table.indices)] <= SAME):
        return table
    return csr(table @ sparse.diags_array(by_column))


def _total(group: Sequence[Branch]) -> sparse.csr_array:
    """Transition to a mode with all observations together, ``[y, y']``."""
    parts = [_scaled(b.transition, np.asarray(_emission(b).sum(axis=1)).ravel()) for b in group]
    return parts[0] if len(parts) == 1 else csr(sum(parts[1:], parts[0]))


def _of_observation(group: Sequence[Branch]) -> dict[int, sparse.csr_array]:
    """Transition to a mode jointly with each observation, ``[y, y']``."""
    found: dict[int, sparse.csr_array] = {}
    for branch in group:
        emission = _emission(branch).tocsc()
        for j, o in enumerate(branch.observations):
            part = _scaled(branch.transition, emission[:, [j]].toarray().ravel())
            found[o] = csr(found[o] + part) if o in found else part
    return {o: table for o, table in found.items() if table.nnz}


@dataclass(frozen=True)
class _Seen:
    """Emission given the end state ``[y', o]``, the end states reached, and those whose row is complete."""

    table: sparse.csr_array
    reached: NDArray[np.bool_]
    complete: NDArray[np.bool_]


def _group_emission(group: Sequence[Branch], n_observations: int) -> _Seen | None:
    """Emission of the branches to one mode; None if it depends on more than the end state."""
    n = group[0].transition.shape[1]
    reached = np.zeros(n, dtype=bool)
    if len(group) == 1:
        e = _emission(group[0]).tocoo()
        columns = np.array(group[0].observations)[e.col]
        table = csr(sparse.coo_array((e.data, (e.row, columns)), shape=(n, n_observations)))
        reached[group[0].transition.indices] = True
    else:
        total = _total(group)
        into = np.asarray(total.sum(axis=0)).ravel()
        dense = np.zeros((n, n_observations))
        for o, joint in _of_observation(group).items():
            dense[:, o] = np.asarray(joint.sum(axis=0)).ravel() / np.where(into > 0, into, 1)
            if abs(joint - total @ sparse.diags_array(dense[:, o])).max() > SAME:
                return None
        table, reached = csr(dense), into > 0
    sums = np.asarray(table.sum(axis=1)).ravel()
    reached &= sums > 0
    uneven = reached & (np.abs(sums - 1) > SAME)
    if uneven.any():
        table = csr(sparse.diags_array(1 / np.where(uneven, sums, 1.0)) @ table)
    return _Seen(table, reached, reached | (np.abs(sums - 1) <= SAME))


def _end_emissions(
    problem: Problem,
) -> dict[tuple[int, int], tuple[sparse.csr_array, tuple[int, ...]]] | None:
    """Emission by action and end mode over the observations used; None if the end state does not settle it."""
    found: dict[tuple[int, int], _Seen] = {}
    for offered in problem.choices:
        for a, choice in enumerate(offered):
            for x, group in _by_mode(choice).items():
                part = _group_emission(group, len(problem.observations))
                if part is None:
                    return None
                known = found.setdefault((a, x), part)
                both = known.reached & part.reached
                if known is part:
                    continue
                if both.any() and abs(_rows(both, known.table) - _rows(both, part.table)).max() > SAME:
                    return None
                fresh = part.reached & ~known.reached
                spare = part.complete & ~known.complete & ~fresh
                if fresh.any() or spare.any():
                    table = _rows(~(fresh | spare), known.table) + _rows(fresh | spare, part.table)
                    found[a, x] = _Seen(csr(table), known.reached | fresh, known.complete | fresh | spare)
    return {key: _over_used(seen.table, seen.complete, problem) for key, seen in found.items()}


def _rows(chosen: NDArray[np.bool_], table: sparse.csr_array) -> sparse.csr_array:
    """Some rows of a table, the others empty."""
    return sparse.diags_array(chosen.astype(float)) @ table


def _over_used(
    table: sparse.csr_array, known: NDArray[np.bool_], problem: Problem
) -> tuple[sparse.csr_array, tuple[int, ...]]:
    """Complete the rows of end states that are never reached, and keep the observations that occur."""
    if not known.all():
        table = csr(_rows(known, table))
    used = np.unique(table.indices) if problem.n_modes > 1 else np.arange(len(problem.observations))
    if not known.all():
        rest = np.flatnonzero(~known)
        filler = (np.ones(len(rest)), (rest, np.full(len(rest), used[0])))
        table = csr(table + sparse.coo_array(filler, shape=table.shape))
    return csr(table[:, used]), tuple(int(o) for o in used)


def _with_last_observation(problem: Problem) -> Problem:
    """The problem with modes (mode, last observation)."""
    joint = {
        (x, a, after): _of_observation(group)
        for x, offered in enumerate(problem.choices)
        for a, choice in enumerate(offered)
        for after, group in _by_mode(choice).items()
    }
    pairs = {(after, o) for (_, _, after), tables in joint.items() for o in tables}
    reached = {x for x, _ in pairs}
    ordered = sorted(pairs | {(x, 0) for x, _, _ in problem.starts() if x not in reached})
    place = {pair: i for i, pair in enumerate(ordered)}
    first: dict[int, int] = {}
    for i, (x, _) in enumerate(ordered):
        first.setdefault(x, i)
    choices = {}
    for x in sorted(first):
        choices[x] = tuple(
            Choice(choice.action, choice.reward, tuple(
                Branch(place[after, o], table, (0,))
                for after in _by_mode(choice) for o, table in joint[x, a, after].items()
            ))
            for a, choice in enumerate(problem.choices[x])
        )  # fmt: skip
    initial = tuple(
        problem.initial[x] if first[x] == i else np.zeros(len(problem.states[x]))
        for i, (x, _) in enumerate(ordered)
    )
    alone = problem.n_modes == 1
    shown = problem.observations
    return Problem(
        tuple(shown[o] if alone else f"{problem.modes[x]},{shown[o]}" for x, o in ordered),
        tuple(problem.states[x] for x, _ in ordered), tuple(choices[x] for x, _ in ordered), (NOTHING,), initial,
        problem.discount, problem.name, problem.costs,
    )  # fmt: skip


def _joined(parts: list[tuple[NDArray, NDArray, Array]], shape: tuple[int, int]) -> sparse.csr_array:
    rows, columns, values = (np.concatenate([p[i] for p in parts]) for i in range(3))
    return csr(sparse.coo_array((values, (rows, columns)), shape=shape))
