"""Reading APPL's `.pomdpx` files: factored models with fully observed variables.

The values of the fully observed variables together are the modes of the problem, those of the others its hidden
states; the last variable declared changes fastest. Without `InitialStateBelief` for a fully observed variable its
first value is uniform. Several reward functions add up; rewards that depend on the end of the step are averaged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import sparse

from models.errors import Phrase
from models.planning.formats.pomdp_lexer import count_of
from models.planning.formats.pomdp_preamble import MOST_NAMES
from models.planning.formats.pomdpx_expand import Factor, cell, digits, expand, joint_names, joint_size, ordered
from models.planning.formats.pomdpx_table import Axis, Function, one_number, read_function
from models.planning.formats.pomdpx_xml import Node, read_tree
from models.planning.formats.source import problem_name
from models.planning.formats.written_table import MOST_ROWS, Index
from models.planning.problem import Array, Branch, Choice, Problem, csr
from models.planning.textbook import TEXTBOOK_MODE

_PARTS = (
    "Description", "Discount", "Variable", "InitialStateBelief", "StateTransitionFunction", "ObsFunction",
    "RewardFunction",
)  # fmt: skip
_VARIABLES = ("StateVar", "ObsVar", "ActionVar", "RewardVar")


def read_pomdpx(path: str | Path) -> Problem:
    """Read a `.pomdpx` file (or ``.pomdpx.gz``).

    Tables (TBL) and decision diagrams (DD) are understood, with all their shorthands. Rows of probabilities within
    1e-5 of one are normalised.

    Raises
    ------
    InputError
        With file, line, what was found and what was wanted.
    """
    return PomdpxReader(read_tree(path), problem_name(path)).problem()


class PomdpxReader:
    """One reading of one file."""

    def __init__(self, root: Node, name: str) -> None:
        if root.tag != "pomdpx":
            raise root.error(f"<{root.tag}>", "<pomdpx>")
        self.root = root
        self.name = name
        for child in root.all(*_PARTS):
            if child.tag != "Description":
                root.only(child.tag)
        self.discount = one_number(root.only("Discount"), "the discount")
        if not 0 <= self.discount <= 1:
            raise root.only("Discount").error(self.discount, "a discount from 0 to 1")
        self.taken: set[str] = set()
        self.before: list[Axis] = []
        self.after: list[Axis] = []
        self.observed: list[bool] = []
        self.actions: list[Axis] = []
        self.seen: list[Axis] = []
        self.rewards: set[str] = set()
        variable = root.only("Variable")
        for node in variable.all(*_VARIABLES):
            self._variable(node)
        for kind, found in (("StateVar", self.before), ("ActionVar", self.actions), ("RewardVar", self.rewards)):
            if not found:
                raise variable.error(Phrase(f"no <{kind}>"), "at least one")

    # -- variables ---------------------------------------------------------------------------------
    def _variable(self, node: Node) -> None:
        if node.tag == "RewardVar":
            self.rewards.add(self._name(node, "vname"))
        elif node.tag == "StateVar":
            values = self._values(node, "s")
            before, after = self._name(node, "vnamePrev"), self._name(node, "vnameCurr")
            seen = node.attributes.get("fullyObs", "false").strip()
            if seen not in ("true", "false", "1", "0"):
                raise node.error(seen, 'fullyObs="true" or "false"')
            self.before.append(Axis(before, values))
            self.after.append(Axis(after, values, before))
            self.observed.append(seen in ("true", "1"))
        else:
            letter, into = ("a", self.actions) if node.tag == "ActionVar" else ("o", self.seen)
            into.append(Axis(self._name(node, "vname"), self._values(node, letter)))

    def _name(self, node: Node, attribute: str) -> str:
        name = node.attribute(attribute)
        if name in self.taken or name == "null" or len(name.split()) != 1:
            raise node.error(name, f"a name for {attribute} of one word that no other variable has")
        self.taken.add(name)
        return name

    def _values(self, node: Node, letter: str) -> tuple[str, ...]:
        kinds = list(node.all("ValueEnum", "NumValues"))
        if len(kinds) != 1:
            raise node.error(Phrase(f"{len(kinds)} lists of values"), "one <ValueEnum> or <NumValues>")
        words = kinds[0].words
        if kinds[0].tag == "NumValues":
            count = count_of(words[0]) if len(words) == 1 else None
            if count is None or not 1 <= count <= MOST_NAMES:
                raise kinds[0].error(kinds[0].text.strip(), f"a number from 1 to {MOST_NAMES}")
            return tuple(f"{letter}{i}" for i in range(count))
        if not words or len(set(words)) != len(words) or {"*", "-"} & set(words):
            raise kinds[0].error(kinds[0].text.strip(), "different names, none of them * or -")
        return tuple(words)

    # -- functions ---------------------------------------------------------------------------------
    def _functions(
        self, part: str, child: str, own: Sequence[Axis], given: Sequence[Axis], *, probabilities: bool = True
    ) -> list[Function]:
        """Functions of a part of the file, each variable in one of them."""
        nodes = [n for n in self.root.children if n.tag == part]
        if not nodes:
            return []
        found: list[Function] = []
        done: set[str] = set()
        for node in nodes[0].all(child):
            names = node.only("Var").words
            if probabilities:
                variables = [self._axis(n, own, node.only("Var")) for n in names]
            elif len(names) != 1 or names[0] not in self.rewards:
                raise node.only("Var").error(" ".join(names), f"one of {', '.join(sorted(self.rewards))}")
            else:
                variables = []
            if not names or len(set(names)) != len(names) or set(names) & done:
                raise node.only("Var").error(" ".join(names), "variables that no other element is about")
            done |= set(names)
            above = node.only("Parent").words
            if len(set(above)) != len(above):
                raise node.only("Parent").error(" ".join(above), "different parents")
            parents = [] if above == ["null"] else [self._axis(n, given, node.only("Parent")) for n in above]
            clash = next((a.name for a in parents if a.name in names), None)
            if clash is not None:
                raise node.only("Parent").error(clash, "a parent that is not the variable itself")
            for _ in node.all("Var", "Parent", "Parameter"):
                pass
            found.append(read_function(node, parents, variables, probabilities=probabilities))
        return found

    @staticmethod
    def _axis(name: str, among: Sequence[Axis], node: Node) -> Axis:
        for axis in among:
            if axis.name == name:
                return axis
        raise node.error(name, f"one of {', '.join(a.name for a in among) or 'none: there is no such variable'}")

    def _factors(
        self, part: str, own: Sequence[Axis], given: Sequence[Axis], optional: Sequence[Axis] = ()
    ) -> list[Factor]:
        factors = [Factor.of(f) for f in self._functions(part, "CondProb", own, given)]
        done = {a.name for f in factors for a in f.variables}
        for axis in own:
            if axis.name in done:
                continue
            if axis not in optional:
                nodes = [n for n in self.root.children if n.tag == part]
                at = nodes[0] if nodes else self.root
                raise at.error(Phrase(f"nothing about {axis.name}"), f"a <CondProb> for it in <{part}>")
            even = sparse.csr_array(np.full((1, len(axis.values)), 1.0 / len(axis.values)))
            factors.append(Factor((), (axis,), even, self.root.place))
        known = {a.name for a in given} - {a.name for a in own}
        return ordered(factors, known)

    # -- the problem -------------------------------------------------------------------------------
    def problem(self) -> Problem:
        """Put everything together."""
        place = f"{self.root.place}, line {self.root.only('Variable').line}"
        order = sorted(range(len(self.before)), key=lambda i: not self.observed[i])
        before, after = [self.before[i] for i in order], [self.after[i] for i in order]
        n_seen = sum(self.observed)
        size = joint_size(before, "states", place, MOST_NAMES * 5)
        n_modes = math.prod(len(a.values) for a in before[:n_seen])
        n_hidden = size // n_modes
        n_actions = joint_size(self.actions, "actions", place, MOST_NAMES)
        joint_size((*before, *self.actions), "pairs of state and action", place, MOST_ROWS)
        n_kinds = joint_size(self.seen, "observations", place, MOST_NAMES)

        first = self._factors("InitialStateBelief", before, before, before[:n_seen])
        steps = self._factors("StateTransitionFunction", after, (*self.actions, *before, *after))
        shown = self._factors("ObsFunction", self.seen, (*self.actions, *after, *self.seen))
        gains = self._functions(
            "RewardFunction", "Func", (), (*self.actions, *before, *after, *self.seen), probabilities=False
        )
        if not gains:
            raise self.root.error(Phrase("no reward function"), "a <RewardFunction> with at least one <Func>")

        start = np.zeros(size)
        rows = expand({}, 1, first)
        np.add.at(start, cell(before, rows.known, len(rows.origin)), rows.probability)
        values = [(g.parents, g.table.matrix().sum(axis=1)) for g in gains]
        offered: list[list[Choice]] = [[] for _ in range(n_modes)]
        names = joint_names(self.actions, "")
        states = np.arange(size)
        for a in range(n_actions):
            chosen = digits(self.actions, np.array([a]))
            step = expand(digits(before, states) | _all(chosen, size), size, steps)
            end = cell(after, step.known, len(step.origin))
            moves = csr(sparse.coo_array((step.probability, (step.origin, end)), shape=(size, size)))
            emitted = expand(digits(after, states) | _all(chosen, size), size, shown)
            kind = cell(self.seen, emitted.known, len(emitted.origin))
            seen = csr(sparse.coo_array((emitted.probability, (emitted.origin, kind)), shape=(size, n_kinds)))
            reward = self._reward(values, chosen, before, after, moves, seen)
            for x in range(n_modes):
                own = slice(x * n_hidden, (x + 1) * n_hidden)
                branches = _branches(moves[own], seen, n_hidden)
                offered[x].append(Choice(names[a], reward[own], branches))
        hidden = joint_names(before[n_seen:], "only")
        return Problem(
            joint_names(before[:n_seen], TEXTBOOK_MODE), (hidden,) * n_modes, tuple(tuple(c) for c in offered),
            joint_names(self.seen, "none"), tuple(start.reshape(n_modes, n_hidden)), self.discount, self.name,
        )  # fmt: skip

    def _reward(
        self, gains: list[tuple[tuple[Axis, ...], Array]], chosen: dict[str, Index], before: list[Axis],
        after: list[Axis], moves: sparse.csr_array, seen: sparse.csr_array,
    ) -> Array:  # fmt: skip
        """Expected reward of an action, by state."""
        size = moves.shape[0]
        total = np.zeros(size)
        ends, kinds = {a.name for a in after}, {a.name for a in self.seen}
        for parents, value in gains:
            names = {a.name for a in parents}
            origin, chance = np.arange(size), np.ones(size)
            known = digits(before, origin)
            if names & (ends | kinds):
                step = moves.tocoo()
                origin, chance, end = step.row.astype(np.int64), step.data, step.col.astype(np.int64)
                if names & kinds:
                    count = np.diff(seen.indptr)[end]
                    again = np.repeat(np.arange(len(end)), count)
                    within = np.arange(len(again)) - np.repeat(np.cumsum(count) - count, count)
                    place = seen.indptr[end][again] + within
                    origin, chance, end = origin[again], chance[again] * seen.data[place], end[again]
                    known = digits(self.seen, seen.indices[place].astype(np.int64))
                known = known if names & kinds else {}
                known |= digits(before, origin) | digits(after, end)
            at = cell(parents, known | _all(chosen, len(origin)), len(origin))
            total += np.bincount(origin, weights=chance * value[at], minlength=size)
        return total


def _all(values: dict[str, Index], size: int) -> dict[str, Index]:
    return {name: np.full(size, value[0]) for name, value in values.items()}


def _branches(moves: sparse.csr_array, seen: sparse.csr_array, n_hidden: int) -> tuple[Branch, ...]:
    """Branches of a mode's rows ``[y, (x', y')]``, one for each mode that may follow."""
    step = moves.tocoo()
    mode, end = np.divmod(step.col, n_hidden)
    branches = []
    for x in np.unique(mode):
        of = mode == x
        table = csr(sparse.coo_array((step.data[of], (step.row[of], end[of])), shape=(n_hidden, n_hidden)))
        emission = seen[x * n_hidden : (x + 1) * n_hidden]
        used = np.unique(emission.indices)
        if len(used) == 1:
            branches.append(Branch(int(x), table, (int(used[0]),)))
        else:
            branches.append(Branch(int(x), table, tuple(int(o) for o in used), csr(emission[:, used])))
    return tuple(branches)
