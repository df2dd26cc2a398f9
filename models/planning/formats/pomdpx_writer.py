"""Writing APPL's `.pomdpx` files: modes as a fully observed variable, hidden states as another.

The format emits observations from the end state: where an observation tells of the start, the last observation
goes into the mode first (`models.planning.formats.end_state.observed_end`), which leaves values as they are. Costs
become rewards.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from models.planning.formats.end_state import SAME, action_names, observed_end
from models.planning.formats.words import legal_names, number, usual
from models.planning.problem import Array, Branch, Problem, csr

Entry = tuple[str, str]
"""An instance and its numbers."""

_DENSE = 0.4
"""A matrix with a larger share of entries that are not zero is written out as a whole."""


def pomdpx_text(problem: Problem) -> str:
    """A problem in the `.pomdpx` format.

    Names that the format does not allow are changed to ones that it does. Modes with fewer hidden states than the
    largest are filled up with states that are never reached and stay where they are.
    """
    return "\n".join(_Document(observed_end(problem)).lines()) + "\n"


class _Document:
    """What is written about one problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.n = problem.n_states
        self.has_mode = problem.n_modes > 1
        self.has_state = self.n > 1 or not self.has_mode
        self.modes = legal_names(problem.modes, "m", ("null",))
        longest = max(problem.states, key=len)
        self.states = legal_names(longest, "s", ("null",))
        self.actions = legal_names(action_names(problem), "a", ("null",))
        self.observations = legal_names(problem.observations, "o", ("null",))

    # -- the document ------------------------------------------------------------------------------
    def lines(self) -> Iterator[str]:
        title = "".join(c if c.isprintable() else " " for c in self.problem.name)
        yield '<?xml version="1.0" encoding="UTF-8"?>'
        yield f'<pomdpx version="1.0" id="{legal_names([title], "p")[0]}">'
        yield f"<Description>{escape(title)}</Description>"
        yield f"<Discount>{number(self.problem.discount)}</Discount>"
        yield "<Variable>"
        if self.has_mode:
            yield from self._variable('StateVar vnamePrev="mode_0" vnameCurr="mode_1" fullyObs="true"', self.modes)
        if self.has_state:
            yield from self._variable('StateVar vnamePrev="state_0" vnameCurr="state_1"', self.states)
        if len(self.observations) > 1:
            yield from self._variable('ObsVar vname="observation"', self.observations)
        yield from self._variable('ActionVar vname="action"', self.actions)
        yield '<RewardVar vname="reward"/>'
        yield "</Variable>"
        yield "<InitialStateBelief>"
        if self.has_mode:
            totals = np.array([b.sum() for b in self.problem.initial])
            yield from _function("CondProb", "mode_0", ["null"], [("-", _numbers(totals))])
        if self.has_state:
            yield from _function("CondProb", "state_0", ["mode_0"] if self.has_mode else ["null"], self._first())
        yield "</InitialStateBelief>"
        yield "<StateTransitionFunction>"
        if self.has_mode:
            yield from _function(
                "CondProb", "mode_1", self._given("action", "mode_0", "state_0"), self._mode_steps()
            )
        if self.has_state:
            free = self._free_of_end()
            names = ("action", "mode_0", "state_0") if free else ("action", "mode_0", "mode_1", "state_0")
            yield from _function("CondProb", "state_1", self._given(*names), self._state_steps(free))
        yield "</StateTransitionFunction>"
        if len(self.observations) > 1:
            yield "<ObsFunction>"
            yield from _function(
                "CondProb", "observation", self._given("action", "mode_1", "state_1"), self._shown()
            )
            yield "</ObsFunction>"
        yield "<RewardFunction>"
        yield from _function("Func", "reward", self._given("action", "mode_0", "state_0"), self._rewards())
        yield "</RewardFunction>"
        yield "</pomdpx>"

    @staticmethod
    def _variable(head: str, values: Sequence[str]) -> Iterator[str]:
        yield f"<{head}>"
        yield f"<ValueEnum>{' '.join(values)}</ValueEnum>"
        yield f"</{head.split()[0]}>"

    def _given(self, *names: str) -> list[str]:
        """Those of some variables that the file has."""
        return [
            n for n in names
            if (self.has_mode or not n.startswith("mode")) and (self.has_state or not n.startswith("state"))
        ]  # fmt: skip

    def _instance(self, action: str, modes: Sequence[str], states: Sequence[str], *rest: str) -> str:
        modes = modes if self.has_mode else ()
        states = states if self.has_state else ()
        return " ".join([action, *modes, *states, *rest])

    # -- functions ---------------------------------------------------------------------------------
    def _first(self) -> Iterator[Entry]:
        if not self.has_mode:
            yield "-", _numbers(self.problem.initial[0])
            return
        # In numbers and each once: APPL's reader takes no "uniform" with a parent, and adds up what is said twice.
        filled = np.full((len(self.modes), self.n), 1.0 / self.n)
        for x, _, belief in self.problem.starts():
            filled[x] = 0.0
            filled[x, : len(belief)] = belief
        for mode, row in zip(self.modes, filled, strict=True):
            yield f"{mode} -", _numbers(row)

    def _steps(self) -> Iterator[tuple[int, int, tuple[Branch, ...]]]:
        for a in range(len(self.actions)):
            for x, offered in enumerate(self.problem.choices):
                yield a, x, offered[a].branches

    def _mode_steps(self) -> Iterator[Entry]:
        # Everything stays in its mode unless said otherwise.
        yield self._instance("*", ["-"], ["*"], "-"), "identity"
        for a, x, branches in self._steps():
            chance = np.stack([np.asarray(b.transition.sum(axis=1)).ravel() for b in branches], axis=1)
            if len(branches) == 1 and branches[0].mode == x:
                continue
            alike = bool((chance == chance[0]).all())
            for y in range(1 if alike else len(chance)):
                state = "*" if alike else self.states[y]
                yield self._instance(self.actions[a], [self.modes[x]], [state], "*"), "0.0"
                for b, p in zip(branches, chance[y], strict=True):
                    if p:
                        end = self.modes[b.mode]
                        yield self._instance(self.actions[a], [self.modes[x]], [state], end), number(p)

    def _free_of_end(self) -> bool:
        """Whether the hidden state moves alike whatever mode follows, wherever more than one may."""
        for _, _, branches in self._steps():
            if len(branches) > 1 and _merged(branches, self.n) is None:
                return False
        return True

    def _state_steps(self, free: bool) -> Iterator[Entry]:
        # Hidden states stay as they are unless said otherwise; so do those of steps that are impossible.
        yield self._instance("*", ["*"] if free else ["*", "*"], ["-", "-"]), "identity"
        for a, x, branches in self._steps():
            if free:
                merged = _merged(branches, self.n)
                assert merged is not None
                yield from self._moves(self.actions[a], [self.modes[x]], *merged)
                continue
            for b in branches:
                yield from self._moves(
                    self.actions[a], [self.modes[x], self.modes[b.mode]], *_given_mode(b, self.n)
                )

    def _moves(
        self, action: str, modes: list[str], table: sparse.csr_array, rows: NDArray[np.int64]
    ) -> Iterator[Entry]:
        """Rows of a table that do not leave the hidden state as it is."""
        if table.nnz > _DENSE * self.n**2:
            full = np.eye(self.n)
            full[rows] = table[rows].toarray()
            yield self._instance(action, modes, ["-", "-"]), " ".join(map(_numbers, full))
            return
        for y in rows:
            span = slice(table.indptr[y], table.indptr[y + 1])
            ends, chance = table.indices[span], table.data[span]
            if len(ends) == 1 and ends[0] == y and chance[0] == 1:
                continue
            yield self._instance(action, modes, [self.states[y], "*"]), "0.0"
            for end, p in zip(ends, chance, strict=True):
                yield self._instance(action, modes, [self.states[y], self.states[end]]), number(p)

    def _shown(self) -> Iterator[Entry]:
        tables: dict[tuple[int, int], Array] = {}
        for a, _, branches in self._steps():
            for b in branches:
                if (a, b.mode) not in tables:
                    tables[a, b.mode] = self._emission(b)
        # What is said most often is said once, of everything; the rest are exceptions.
        common = Counter(t.tobytes() for t in tables.values()).most_common(1)[0][0]
        done = next(t for t in tables.values() if t.tobytes() == common)
        yield from self._emission_entries("*", "*", done)
        for (a, x), table in tables.items():
            if table.tobytes() != common:
                yield self._instance(self.actions[a], [self.modes[x]], ["*"], "*"), "0.0"
                yield from self._emission_entries(self.actions[a], self.modes[x], table)

    def _emission(self, branch: Branch) -> Array:
        table = np.zeros((self.n, len(self.observations)))
        size = branch.transition.shape[1]
        if branch.emission is None:
            table[:size, branch.observations[0]] = 1.0
        else:
            table[:size, list(branch.observations)] = branch.emission.toarray()
        table[size:, branch.observations[0]] = 1.0
        return table

    def _emission_entries(self, action: str, mode: str, table: Array) -> Iterator[Entry]:
        alike = bool((table == table[0]).all())
        if not alike and np.count_nonzero(table) > _DENSE * table.size:
            yield self._instance(action, [mode], ["-"], "-"), " ".join(map(_numbers, table))
            return
        for y in range(1 if alike else self.n):
            state = "*" if alike else self.states[y]
            for o in np.flatnonzero(table[y]):
                yield self._instance(action, [mode], [state], self.observations[o]), number(table[y, o])

    def _rewards(self) -> Iterator[Entry]:
        every = usual(np.concatenate([c.reward for offered in self.problem.choices for c in offered]))
        yield self._instance("*", ["*"], ["*"]), number(every)
        for a, action in enumerate(self.actions):
            for x, offered in enumerate(self.problem.choices):
                reward = offered[a].reward
                base = usual(reward) or (every if (reward == every).any() else 0.0)
                if base != every and (reward != every).any():
                    yield self._instance(action, [self.modes[x]], ["*"]), number(base)
                else:
                    base = every
                for y in np.flatnonzero(reward != base):
                    yield self._instance(action, [self.modes[x]], [self.states[y]]), number(reward[y])


def _given_mode(branch: Branch, n: int) -> tuple[sparse.csr_array, NDArray[np.int64]]:
    """Transition given that the branch is taken, ``[y, y']`` filled up to `n`, and the rows for which it can be."""
    table = branch.transition
    total = np.asarray(table.sum(axis=1)).ravel()
    scale = np.where((total > 0) & (np.abs(total - 1) > SAME), total, 1.0)
    start = np.concatenate([table.indptr, np.full(n - table.shape[0], table.nnz)])
    wide = sparse.csr_array(
        (table.data / np.repeat(scale, np.diff(table.indptr)), table.indices.copy(), start), shape=(n, n)
    )
    return wide, np.flatnonzero(total > 0)


def _merged(branches: Sequence[Branch], n: int) -> tuple[sparse.csr_array, NDArray[np.int64]] | None:
    """Transition whatever branch is taken; None if that makes a difference."""
    table, rows = _given_mode(branches[0], n)
    for branch in branches[1:]:
        other, more = _given_mode(branch, n)
        fresh = np.isin(np.arange(n), np.setdiff1d(more, rows)).astype(float)
        both = np.isin(np.arange(n), np.intersect1d(more, rows)).astype(float)
        if both.any() and abs(sparse.diags_array(both) @ (table - other)).max() > SAME:
            return None
        table = csr(table + sparse.diags_array(fresh) @ other)
        rows = np.union1d(rows, more)
    return table, rows


def _numbers(values: Array) -> str:
    return " ".join(number(v) for v in values)


def _function(
    tag: str, variable: str, parents: Sequence[str], entries: Iterator[Entry] | list[Entry]
) -> Iterator[str]:
    values = "ValueTable" if tag == "Func" else "ProbTable"
    yield f"<{tag}>"
    yield f"<Var>{variable}</Var>"
    yield f"<Parent>{' '.join(parents)}</Parent>"
    yield '<Parameter type="TBL">'
    for instance, numbers in entries:
        yield f"<Entry><Instance>{instance}</Instance><{values}>{numbers}</{values}></Entry>"
    yield "</Parameter>"
    yield f"</{tag}>"
