"""Functions of a `.pomdpx` file: tables with ``*`` and ``-``, and decision diagrams.

A function has *axes*: its parents and then the variables it is about. Both ways of writing it end in the same
sparse table, rows for the values of the parents, columns for those of the variables. A decision diagram is a
function like any other: along a path each test fixes a value, what is not tested is open, and what no path reaches
is zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from models.errors import Phrase
from models.planning.formats.pomdp_lexer import count_of, number_in
from models.planning.formats.pomdpx_xml import Node
from models.planning.formats.words import counted
from models.planning.formats.written_table import FILE_TOLERANCE, MOST_ENTRIES, Array, Index, WrittenTable

OPEN, CYCLE = -1, -2
"""``*``: every value alike; ``-``: every value in turn."""

MOST_PATHS = 1_000_000
"""Paths of a decision diagram that are followed."""


@dataclass(frozen=True)
class Axis:
    """A variable as it stands in a function.

    Attributes
    ----------
    name : str
    values : tuple of str
    partner : str
        For the end of a step, the name of the same variable at its start; empty otherwise.
    """

    name: str
    values: tuple[str, ...]
    partner: str = ""
    index: dict[str, int] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        self.index.update({value: i for i, value in enumerate(self.values)})

    def value(self, word: str, node: Node) -> int:
        """Index of a value, by name or number.

        Raises
        ------
        InputError
            If there is none of that name.
        """
        found = self.index.get(word)
        if found is None:
            found = count_of(word)
            if found is None or found >= len(self.values):
                some = ", ".join(self.values[:8]) + (", ..." if len(self.values) > 8 else "")
                raise node.error(word, f"a value of {self.name}: {some}")
        return found


@dataclass(frozen=True)
class Function:
    """A function of some axes, as a table ``[values of the parents, values of the variables]``."""

    parents: tuple[Axis, ...]
    variables: tuple[Axis, ...]
    table: WrittenTable
    node: Node

    def words_of(self, row: int) -> str:
        """Values of the parents in a row, in words."""
        of = ", ".join(axis.name for axis in self.variables)
        if not self.parents:
            return of
        values = np.unravel_index(row, [len(a.values) for a in self.parents])
        given = ", ".join(f"{a.name} {a.values[int(v)]}" for a, v in zip(self.parents, values, strict=True))
        return f"{of} given {given}"


def read_function(
    node: Node, parents: Sequence[Axis], variables: Sequence[Axis], *, probabilities: bool
) -> Function:
    """Read what a ``<CondProb>`` or ``<Func>`` says.

    Parameters
    ----------
    node : Node
    parents, variables : sequence of Axis
    probabilities : bool
        Whether values must lie between 0 and 1, and stand in ``<ProbTable>``.
    """
    rows = math.prod(len(a.values) for a in parents)
    columns = math.prod(len(a.values) for a in variables)
    table = WrittenTable(rows, columns, node.place)
    parameter = node.only("Parameter")
    kind = parameter.attributes.get("type", "TBL").strip()
    writer = _Writer(table, (*parents, *variables), len(parents), probabilities)
    if kind == "TBL":
        for entry in parameter.all("Entry"):
            writer.entry(entry)
    elif kind == "DD":
        writer.diagram(parameter)
    else:
        raise parameter.error(kind, "type TBL or DD")
    return Function(tuple(parents), tuple(variables), table, node)


class _Writer:
    """Writes entries and diagrams to a table."""

    def __init__(self, table: WrittenTable, axes: tuple[Axis, ...], n_parents: int, probabilities: bool) -> None:
        self.table = table
        self.axes = axes
        self.sizes = [len(a.values) for a in axes]
        self.n_parents = n_parents
        self.probabilities = probabilities
        self.place = {a.name: i for i, a in enumerate(axes)}
        self.paths = 0

    # -- tables ------------------------------------------------------------------------------------
    def entry(self, entry: Node) -> None:
        """Write one ``<Entry>``."""
        instance = entry.only("Instance")
        words = instance.words
        if len(words) != len(self.axes):
            names = " ".join(a.name for a in self.axes)
            raise instance.error(Phrase(f"{len(words)} values"), f"{len(self.axes)}: one for each of {names}")
        spots = [
            OPEN if w == "*" else CYCLE if w == "-" else a.value(w, instance)
            for w, a in zip(words, self.axes, strict=True)
        ]
        for _ in entry.all("Instance", "ProbTable", "ValueTable"):
            pass
        given = any(c.tag == "ValueTable" for c in entry.children) and not self.probabilities
        node = entry.only("ValueTable" if given else "ProbTable")
        if node.words == ["uniform"] and self.probabilities:
            own = range(self.n_parents, len(self.axes))
            if any(spots[i] >= 0 for i in own):
                raise node.error("uniform", "numbers, as the variable's own value is given")
            share = np.array(1.0 / math.prod(self.sizes[i] for i in own))
            self.write([OPEN if s == CYCLE else s for s in spots], share, entry.line, node)
        elif node.words == ["identity"] and self.probabilities:
            self._identity(spots, entry.line, node)
        else:
            self.write(spots, self._values(node, spots), entry.line, node)

    def _identity(self, spots: list[int], line: int, node: Node) -> None:
        cycled = [i for i, s in enumerate(spots) if s == CYCLE]
        sizes = [self.sizes[i] for i in cycled]
        if len(cycled) != 2 or sizes[0] != sizes[1]:
            found = Phrase(f"identity over {' x '.join(map(str, sizes)) or 'nothing'}")
            raise node.error(found, "two '-' of the same size")
        self.write([OPEN if s == CYCLE else s for s in spots], np.array(0.0), line, node)
        self._diagonal(spots, cycled[0], cycled[1], line, node)

    def _diagonal(self, spots: list[int], one: int, other: int, line: int, node: Node) -> None:
        """Write 1 wherever two axes of the same size have the same value."""
        first = self._places([0 if i in (one, other) else s for i, s in enumerate(spots)], self.sizes, node)
        size = self.sizes[one]
        if len(first) * size > MOST_ENTRIES:
            raise node.error(Phrase(f"{len(first) * size} entries at once"), f"at most {MOST_ENTRIES}")
        stride = sum(math.prod(self.sizes[i + 1 :]) for i in (one, other))
        cells = (first[:, None] + stride * np.arange(size)).ravel()
        self.table.put_cells(cells // self.table.n_columns, cells % self.table.n_columns, np.ones(len(cells)), line)

    def _values(self, node: Node, spots: list[int]) -> Array:
        sizes = [self.sizes[i] for i, s in enumerate(spots) if s == CYCLE]
        values = []
        for word in node.words:
            value = number_in(word)
            if value is None:
                raise node.error(word, "a number")
            values.append(value)
        wanted = math.prod(sizes)
        if len(values) != wanted:
            found = Phrase(counted(len(values), "number"))
            raise node.error(found, f"{wanted}, one for each combination of the '-'")
        return np.array(values).reshape(sizes)

    def write(self, spots: list[int], values: Array, line: int, node: Node) -> None:
        """Write values, an axis for each ``-``, to the places that an instance names."""
        if self.probabilities and values.size and not (values.min() >= 0 and values.max() <= 1 + FILE_TOLERANCE):
            bad = values[(values < 0) | (values > 1 + FILE_TOLERANCE)].flat[0]
            raise node.error(float(bad), "probabilities from 0 to 1")
        own = spots[self.n_parents :]
        cycled_parent = any(s == CYCLE for s in spots[: self.n_parents])
        if all(s < 0 for s in own) and not cycled_parent:
            # Whole rows that are all alike.
            shape = [n if s == CYCLE else 1 for s, n in zip(own, self.sizes[self.n_parents :], strict=True)]
            row = np.broadcast_to(values.reshape(shape), self.sizes[self.n_parents :]).ravel()
            rows = self._places(spots[: self.n_parents], self.sizes[: self.n_parents], node)
            self.table.put_rows(rows, row, line)
            return
        shape = [n if s == CYCLE else 1 for s, n in zip(spots, self.sizes, strict=True)]
        extent = [1 if s >= 0 else n for s, n in zip(spots, self.sizes, strict=True)]
        cells = self._places(spots, self.sizes, node)
        block = np.broadcast_to(values.reshape(shape), extent).ravel()
        width = self.table.n_columns
        if all(s < 0 for s in own):
            self.table.put_rows(cells[::width] // width, block.reshape(-1, width), line)
        else:
            self.table.put_cells(cells // width, cells % width, block, line)

    def _places(self, spots: Sequence[int], sizes: Sequence[int], node: Node) -> Index:
        """Flat places of all cells that an instance names."""
        count = math.prod(1 if s >= 0 else n for s, n in zip(spots, sizes, strict=True))
        if count > MOST_ENTRIES:
            raise node.error(Phrase(f"{count} entries at once"), f"at most {MOST_ENTRIES}")
        flat = np.zeros(1, dtype=np.int64)
        for s, n in zip(spots, sizes, strict=True):
            flat = (flat[:, None] * n + (np.array([s]) if s >= 0 else np.arange(n))).ravel()
        return flat

    # -- decision diagrams -------------------------------------------------------------------------
    def diagram(self, parameter: Node) -> None:
        """Write a decision diagram."""
        templates: dict[str, Node] = {}
        for child in parameter.all("DAG", "SubDAGTemplate"):
            if child.tag == "SubDAGTemplate":
                name = child.attribute("id")
                if name in templates:
                    raise child.error(name, "different names of templates")
                templates[name] = child
        self._below(parameter.only("DAG"), [OPEN] * len(self.axes), templates, ())

    def _below(self, holder: Node, spots: list[int], templates: dict[str, Node], inside: tuple[str, ...]) -> None:
        """Follow what stands in a ``<DAG>``, a template or an ``<Edge>``."""
        found = list(holder.all("Node", "SubDAG", "Terminal"))
        if len(found) != 1:
            raise holder.error(Phrase(f"{len(found)} elements"), "one <Node>, <SubDAG> or <Terminal>")
        node = found[0]
        self.paths += 1
        if self.paths > MOST_PATHS:
            raise node.error(Phrase("more paths"), f"a diagram of at most {MOST_PATHS} paths")
        if node.tag == "Terminal":
            self.write(spots, self._values(node, []), node.line, node)
        elif node.tag == "SubDAG":
            self._short(node, spots, templates, inside)
        else:
            i = self._axis(node)
            axis, seen = self.axes[i], set()
            for edge in node.all("Edge"):
                value = axis.value(edge.attribute("val"), edge)
                if value in seen:
                    raise edge.error(axis.values[value], "one edge for each value")
                seen.add(value)
                if spots[i] in (OPEN, value):
                    self._below(edge, [value if j == i else s for j, s in enumerate(spots)], templates, inside)

    def _axis(self, node: Node) -> int:
        name = node.attribute("var")
        if name not in self.place:
            raise node.error(name, f"one of {', '.join(self.place)}")
        return self.place[name]

    def _short(self, node: Node, spots: list[int], templates: dict[str, Node], inside: tuple[str, ...]) -> None:
        """Write a ``<SubDAG>``: a template, or one of the three shorthands."""
        kind = node.attribute("type")
        if kind == "template":
            name = node.attribute("idref")
            if name not in templates:
                raise node.error(name, f"a template: {', '.join(templates) or 'there is none'}")
            if name in inside:
                raise node.error(name, "templates that do not contain themselves")
            self._below(templates[name], spots, templates, (*inside, name))
            return
        if kind not in ("deterministic", "persistent", "uniform"):
            raise node.error(kind, "deterministic, persistent, uniform or template")
        i = self._axis(node)
        if kind == "uniform":
            self.write(spots, np.array(1.0 / self.sizes[i]), node.line, node)
        elif kind == "deterministic":
            value = self.axes[i].value(node.attribute("val"), node)
            if spots[i] in (OPEN, value):
                self.write([value if j == i else s for j, s in enumerate(spots)], np.array(1.0), node.line, node)
        else:
            before = self.place.get(self.axes[i].partner)
            if before is None:
                raise node.error(self.axes[i].name, "the end of a step whose start is among the parents")
            fixed = {spots[i], spots[before]} - {OPEN}
            if not fixed:
                self._diagonal(spots, i, before, node.line, node)
            elif len(fixed) == 1:
                value = fixed.pop()
                both = [value if j in (i, before) else s for j, s in enumerate(spots)]
                self.write(both, np.array(1.0), node.line, node)


def one_number(node: Node, what: str) -> float:
    """The only number inside an element."""
    words = node.words
    if len(words) != 1:
        raise node.error(Phrase(f"{len(words)} words"), f"one number: {what}")
    value = number_in(words[0])
    if value is None:
        raise node.error(words[0], f"a number: {what}")
    return value
