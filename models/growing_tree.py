"""A prefix tree that grows while events come in, and trees put together into one.

`models.histories` builds the tree of a log that is all there. Here events come in parts, a run may go on from one
part to the next, and what is kept is the tree alone: some twenty bytes a node while it grows, whatever the number
of runs. The canonical numbering makes the result the same, bit for bit, in whichever parts the events came.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.errors import InputError, Phrase, located
from models.histories import DENSE, UNSEEN, HistoryTree, TreeArrays, _renumber

BYTES_A_NODE = 160
"""Memory at the most for one node: while the tree grows, and when it is numbered at the end."""

_TABLE = 1 << 22
"""Entries of the table in which the children of the first nodes are found."""


@dataclass(frozen=True)
class CountedTree(HistoryTree):
    """A prefix tree of runs that were counted and not kept: `run_node` is empty.

    Attributes
    ----------
    ended : int64[histories]
        Nodes at which at least one run ends, ascending.
    runs : int
        How many runs were counted.
    """

    ended: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    runs: int = 0

    @property
    def n_runs(self) -> int:
        """Number of runs compressed."""
        return self.runs

    @property
    def terminals(self) -> NDArray[np.int64]:
        """Nodes at which at least one run ends: the distinct histories."""
        return self.ended

    def with_runs(self, run_weight: NDArray[np.float64]) -> HistoryTree:
        """Refused: which run ended where was not kept."""
        raise InputError(f"run weights: found {len(run_weight)}, but runs were counted and not kept in this tree")


class GrowingTree:
    """The tree under construction.

    Parameters
    ----------
    n_actions, n_responses : int
    most_nodes : int, optional
        Nodes at the most; no bound unless given.
    keep_runs : bool
        Keep the node at which every run ends (eight bytes a run).
    """

    def __init__(
        self, n_actions: int, n_responses: int, most_nodes: int | None = None, keep_runs: bool = False
    ) -> None:
        self.n_actions, self.n_responses = n_actions, n_responses
        self._symbols = n_actions * (n_responses + 1)
        self._most = most_nodes
        self._table = np.full(max(1, min(DENSE, _TABLE // self._symbols)) * self._symbols, -1, np.int32)
        size = 4096
        self._parent, self._child, self._sibling = (np.full(size, -1, np.int32) for _ in range(3))
        self._symbol = np.full(size, -1, np.int32)
        self._ends = np.zeros(size)
        # Node of the run that may go on (-1: none, or one that is passed over), nodes in use, runs that ended.
        self._state = np.array([-1, 1, 0], dtype=np.int64)
        self._last: list[NDArray[np.int64]] | None = [] if keep_runs else None

    @property
    def n_nodes(self) -> int:
        """Nodes so far, the root included."""
        return int(self._state[1])

    def add(
        self, starts: NDArray[np.int64], wanted: NDArray[np.bool_], action: NDArray[np.int8],
        response: NDArray[np.int8],
    ) -> None:  # fmt: skip
        """Take the next events; those before the first start go on with the run that is open.

        Parameters
        ----------
        starts : int64[runs]
            Where runs begin among these events, ascending.
        wanted : bool[runs]
            Which of these runs are counted; the others are passed over.
        action, response : int8[events]
            Codes in range; `UNSEEN` where no response was seen.

        Raises
        ------
        InputError
            If the tree would get more than `most_nodes` nodes.
        """
        event = run = 0
        last = np.empty(len(starts) + 1, np.int64)
        before = int(self._state[2])
        while True:
            event, run = _extend(
                starts, wanted, action, response, self.n_responses + 1, self._table, self._symbols, self._parent,
                self._symbol, self._child, self._sibling, self._ends, last, before, self._state, event, run,
            )  # fmt: skip
            if event == len(action):
                break
            self._enlarge()
        if self._last is not None:
            self._last.append(last[: int(self._state[2]) - before].copy())

    def finish(self) -> HistoryTree:
        """The tree of all events so far, in canonical numbering; nothing can be added afterwards.

        Raises
        ------
        InputError
            If no run was counted.
        """
        node, nodes, _ = self._state.tolist()
        if node > 0:
            self._ends[node] += 1.0
            self._state[0], self._state[2] = -1, self._state[2] + 1
            if self._last is not None:
                self._last.append(np.array([node]))
        runs = int(self._state[2])
        if runs == 0:
            raise located("event log, runs", 0, "at least one run of events")
        parent, symbol = self._parent[:nodes].astype(np.int64), self._symbol[:nodes].astype(np.int64)
        ends = self._ends[:nodes].copy()
        del self._parent, self._symbol, self._child, self._sibling, self._ends, self._table
        return _numbered(parent, symbol, ends, runs, self._last, self.n_actions, self.n_responses)[0]

    def _enlarge(self) -> None:
        size = len(self._parent)
        if self._most is not None and size >= self._most:
            wanted = f"at most {self._most:,}: the histories do not fit into the memory allowed"
            raise located("prefix tree, nodes", Phrase(f"more than {size:,}"), wanted)
        more = max(1024, size // 2)
        if self._most is not None:
            more = min(more, self._most - size)
        for name in ("_parent", "_child", "_sibling", "_symbol"):
            old = getattr(self, name)
            setattr(self, name, np.concatenate([old, np.full(more, -1, old.dtype)]))
        self._ends = np.concatenate([self._ends, np.zeros(more)])


def merged(trees: Sequence[HistoryTree]) -> HistoryTree:
    """One tree of the runs of several: the tree of all their events, bit for bit.

    Parameters
    ----------
    trees : sequence of HistoryTree
        Of one protocol. The weights of a history are summed; if every tree keeps its runs, the result has the
        runs of the first, then those of the second, and so on.

    Raises
    ------
    InputError
        Without a tree, or where actions and responses differ in number.
    """
    return merged_with_places(trees)[0]


def merged_with_places(trees: Sequence[HistoryTree]) -> tuple[HistoryTree, list[NDArray[np.int64]]]:
    """As `merged`, and where every node of each tree is in it.

    Returns
    -------
    HistoryTree
    list of int64[nodes of a tree]
    """
    if not trees:
        raise located("trees to merge", 0, "at least one")
    first = trees[0]
    nodes = sum(tree.n_nodes - 1 for tree in trees) + 1
    grown = GrowingTree(first.n_actions, first.n_responses)
    parent, child, sibling = (np.full(nodes, -1, np.int32) for _ in range(3))
    symbol, ends, used = np.full(nodes, -1, np.int32), np.zeros(nodes), 1
    last: list[NDArray[np.int64]] | None = []
    ended = np.zeros(nodes, dtype=bool)
    places = []
    for tree in trees:
        if (tree.n_actions, tree.n_responses) != (first.n_actions, first.n_responses):
            found = Phrase(f"{tree.n_actions} actions and {tree.n_responses} responses")
            raise located("trees to merge", found, f"{first.n_actions} and {first.n_responses}, as in the first")
        place = np.zeros(tree.n_nodes, np.int64)
        used = _graft(
            tree.parent, tree.arrays.action, tree.arrays.response, tree.n_responses + 1, grown._table,
            grown._symbols, parent, symbol, child, sibling, used, place,
        )  # fmt: skip
        np.add.at(ends, place, tree.arrays.ends)
        ended[place[tree.terminals]] = True
        places.append(place)
        if isinstance(tree, CountedTree):
            last = None
        elif last is not None:
            last.append(place[tree.run_node])
    out, rank = _numbered(
        parent[:used].astype(np.int64), symbol[:used].astype(np.int64), ends[:used],
        sum(tree.n_runs for tree in trees), last, first.n_actions, first.n_responses, ended[:used],
    )  # fmt: skip
    return out, [rank[place] for place in places]


def _numbered(
    parent: NDArray[np.int64], symbol: NDArray[np.int64], ends: NDArray[np.float64], runs: int,
    last: list[NDArray[np.int64]] | None, n_actions: int, n_responses: int,
    ended: NDArray[np.bool_] | None = None,
) -> tuple[HistoryTree, NDArray[np.int64]]:  # fmt: skip
    """The tree in canonical numbering, and the new number of every node."""
    first_child, n_children, parent, symbol, rank = _renumber(parent, symbol)
    own = np.zeros(len(ends))
    own[rank] = ends
    stops = np.zeros(len(ends), dtype=bool)
    stops[rank] = ends > 0 if ended is None else ended
    response = symbol % (n_responses + 1) - 1
    response[0] = UNSEEN
    symbol //= n_responses + 1
    symbol[0] = -1
    arrays = TreeArrays(first_child, n_children, symbol, response, own)
    none = np.empty(0, np.int64)
    tree = CountedTree(arrays, parent, none, n_actions, n_responses, np.flatnonzero(stops), runs)
    if last is None:
        return tree, rank
    return HistoryTree(arrays, parent, rank[np.concatenate([none, *last])], n_actions, n_responses), rank


@kernel
def _extend(  # type: ignore[no-untyped-def]
    starts, wanted, action, response, n_records, table, n_symbols, parent, symbol, child, sibling, ends, last,
    before, state, event, run,
):  # fmt: skip
    """Insert events until done or until there is no room; returns the next event and the next run.

    The first nodes find their children in a table (one load an event), later ones along a list of siblings, as in
    `models.histories`.
    """
    node, nodes, closed = state[0], state[1], state[2]
    dense = len(table) // n_symbols
    n = len(action)
    while event < n:
        if run < len(starts) and starts[run] == event:
            if node > 0:
                ends[node] += 1.0
                last[closed - before] = node
                closed += 1
            node = np.int64(0) if wanted[run] else np.int64(-1)
            run += 1
        if node < 0:
            # Nothing counts before the next run begins.
            event = starts[run] if run < len(starts) else n
            continue
        code = np.int64(action[event]) * n_records + np.int64(response[event]) + 1
        if node < dense:
            found = np.int64(table[node * n_symbols + code])
        else:
            found = np.int64(child[node])
            while found >= 0 and symbol[found] != code:
                found = np.int64(sibling[found])
        if found < 0:
            if nodes == len(parent):
                break
            found = np.int64(nodes)
            nodes += 1
            parent[found], symbol[found] = node, code
            if node < dense:
                table[node * n_symbols + code] = found
            else:
                sibling[found] = child[node]
                child[node] = found
        node = found
        event += 1
    state[0], state[1], state[2] = node, nodes, closed
    return event, run


@kernel
def _graft(  # type: ignore[no-untyped-def]
    tree_parent, action, response, n_records, table, n_symbols, parent, symbol, child, sibling, nodes, place
):
    """Insert the nodes of a tree, parents before children; `place` says where each of them went."""
    dense = len(table) // n_symbols
    for i in range(1, len(tree_parent)):
        node = place[tree_parent[i]]
        code = action[i] * n_records + response[i] + 1
        if node < dense:
            found = np.int64(table[node * n_symbols + code])
        else:
            found = np.int64(child[node])
            while found >= 0 and symbol[found] != code:
                found = np.int64(sibling[found])
        if found < 0:
            found = np.int64(nodes)
            nodes += 1
            parent[found], symbol[found] = node, code
            if node < dense:
                table[node * n_symbols + code] = found
            else:
                sibling[found] = child[node]
                child[node] = found
        place[i] = found
    return nodes
