"""Distinct histories as one prefix tree: the form in which every likelihood is evaluated.

People with the same (action, response) history are exchangeable, so the likelihood needs only the distinct
histories and their counts. Histories that begin alike share their forward recursion, and because counts enter
linearly the backward recursion can be summed over everything that follows a common beginning. Both are exact
and come for free with a prefix tree: node 0 stands before the first event, every other node is one event
after its parent, and `ends` counts the runs whose last event it is.

Nodes are numbered breadth first with siblings sorted by (action, response), so the tree, and every
floating-point sum over it, does not depend on the order of the people in the file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.errors import located

DENSE = 16_384
"""Nodes whose children are found by table while the tree is grown."""

UNSEEN = -1
"""Response code of an event at which no response was seen (silent mode, or a missing record)."""


class TreeArrays(NamedTuple):
    """The arrays a kernel needs; `nodes` counts the root.

    Attributes
    ----------
    first_child : int64[nodes]
        Children of node n are ``first_child[n] : first_child[n] + n_children[n]``.
    n_children : int64[nodes]
    action : int64[nodes]
        Action index of the event, -1 at the root.
    response : int64[nodes]
        Response index, `UNSEEN` where none was seen.
    ends : float64[nodes]
        How many runs end with this event (any non-negative weight).
    """

    first_child: NDArray[np.int64]
    n_children: NDArray[np.int64]
    action: NDArray[np.int64]
    response: NDArray[np.int64]
    ends: NDArray[np.float64]


@dataclass(frozen=True)
class HistoryTree:
    """Prefix tree of the runs of an event log.

    Attributes
    ----------
    arrays : TreeArrays
    parent : int64[nodes]
    run_node : int64[runs]
        The node at which each run ends.
    n_actions, n_responses : int
    """

    arrays: TreeArrays
    parent: NDArray[np.int64]
    run_node: NDArray[np.int64]
    n_actions: int
    n_responses: int

    @classmethod
    def build(
        cls,
        offsets: NDArray[np.int64],
        action: NDArray[np.int8],
        response: NDArray[np.int8],
        n_actions: int,
        n_responses: int,
    ) -> HistoryTree:
        """Compress coded runs.

        Parameters
        ----------
        offsets : int64[runs + 1]
            Events of run i are ``offsets[i] : offsets[i + 1]``; no run is empty.
        action, response : int8[events]
            Codes; `UNSEEN` where no response was seen.
        n_actions, n_responses : int

        Raises
        ------
        InputError
            If a code is out of range or a run is empty.
        """
        if len(offsets) < 2:
            raise located("event log, runs", 0, "at least one run of events")
        lengths_positive = bool(np.all(offsets[1:] > offsets[:-1]))
        if not lengths_positive:
            raise located("event log, run lengths", 0, "at least one event in every run")
        for name, codes, low, high in (
            ("action", action, 0, n_actions - 1), ("response", response, UNSEEN, n_responses - 1),
        ):  # fmt: skip
            if codes.min() < low or codes.max() > high:
                bad = codes[(codes < low) | (codes > high)][0]
                raise located(f"event log, {name} code", int(bad), f"{low}..{high}")
        parent, symbol, run_node = _grow(offsets, action, response, n_actions, n_responses + 1)
        first_child, n_children, parent, symbol, rank = _renumber(parent, symbol)
        run_node = rank[run_node]
        ends = np.bincount(run_node, minlength=len(parent)).astype(np.float64)
        arrays = TreeArrays(
            first_child,
            n_children,
            np.where(symbol < 0, -1, symbol // (n_responses + 1)),
            np.where(symbol < 0, UNSEEN, symbol % (n_responses + 1) - 1),
            ends,
        )
        return cls(arrays, parent, run_node, n_actions, n_responses)

    def with_counts(self, ends: NDArray[np.float64]) -> HistoryTree:
        """Same tree, other weights: a bootstrap sample, a fold, a reweighting.

        `ends` has one entry a node and must be zero where no run ends.
        """
        if ends.shape != self.arrays.ends.shape:
            raise located("counts, shape", ends.shape, str(self.arrays.ends.shape))
        if not np.all(ends >= 0):
            raise located("counts", float(np.min(ends)), "non-negative numbers")
        stray = ends.copy()
        stray[self.terminals] = 0
        if np.any(stray):
            raise located("counts, node", int(np.flatnonzero(stray)[0]), "zero where no run ends")
        return replace(self, arrays=self.arrays._replace(ends=np.ascontiguousarray(ends, dtype=np.float64)))

    def with_runs(self, run_weight: NDArray[np.float64]) -> HistoryTree:
        """Reweight by run: `run_weight` has one non-negative entry a run of the log."""
        if run_weight.shape != self.run_node.shape:
            raise located("run weights, shape", run_weight.shape, str(self.run_node.shape))
        ends = np.bincount(self.run_node, weights=run_weight, minlength=self.n_nodes)
        return self.with_counts(ends)

    @property
    def n_nodes(self) -> int:
        """Number of nodes, the root included."""
        return len(self.parent)

    @property
    def n_runs(self) -> int:
        """Number of runs compressed."""
        return len(self.run_node)

    @cached_property
    def terminals(self) -> NDArray[np.int64]:
        """Nodes at which at least one run ends: the distinct histories."""
        return np.unique(self.run_node)

    @property
    def n_histories(self) -> int:
        """Number of distinct histories."""
        return len(self.terminals)

    @cached_property
    def depth(self) -> NDArray[np.int64]:
        """Events up to and including each node (0 at the root)."""
        return _depths(self.parent)

    def path(self, node: int) -> NDArray[np.int64]:
        """Nodes from the first event to `node`."""
        path = np.empty(self.depth[node], dtype=np.int64)
        for i in range(len(path) - 1, -1, -1):
            path[i] = node
            node = int(self.parent[node])
        return path


def _grow(
    offsets: NDArray[np.int64], action: NDArray[np.int8], response: NDArray[np.int8], n_actions: int, n_records: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Insert every run; returns parent and symbol of each node, and the last node of each run."""
    longest = int(np.diff(offsets).max())
    table = np.full(DENSE * n_actions * n_records, -1, np.int32)
    nodes: int = 1
    run: int = 0
    run_node = np.empty(len(offsets) - 1, np.int64)
    columns = np.full((4, max(1024, 2 * longest)), -1, np.int64)
    while True:
        # The arrays keep their size inside the kernel: reassigning them there costs a factor of twenty.
        nodes, run = _insert(offsets, action, response, n_records, table, columns, nodes, run, run_node)
        if run == len(run_node):
            parent, symbol = columns[:2, :nodes]
            return parent.copy(), symbol.copy(), run_node
        columns = np.concatenate([columns, np.full_like(columns, -1)], axis=1)


@kernel
def _insert(  # type: ignore[no-untyped-def]
    offsets, action, response, n_records, table, columns, nodes, first_run, run_node
):
    """Insert runs until done or until the next one might not fit; returns nodes in use and the next run.

    The first `DENSE` nodes find their children in a table (one load an event), later ones along a list of
    siblings, which costs no memory where histories are long and hardly ever shared.
    """
    parent, symbol, child, sibling = columns[0], columns[1], columns[2], columns[3]
    n_symbols = len(table) // DENSE
    for run in range(first_run, len(run_node)):
        if nodes + offsets[run + 1] - offsets[run] > len(parent):
            return nodes, run
        node = np.int64(0)
        for event in range(offsets[run], offsets[run + 1]):
            code = np.int64(action[event]) * n_records + np.int64(response[event]) + 1
            if node < DENSE:
                found = np.int64(table[node * n_symbols + code])
            else:
                found = child[node]
                while found >= 0 and symbol[found] != code:
                    found = sibling[found]
            if found < 0:
                found = np.int64(nodes)
                nodes += 1
                parent[found], symbol[found] = node, code
                if node < DENSE:
                    table[node * n_symbols + code] = found
                else:
                    sibling[found] = child[node]
                    child[node] = found
            node = found
        run_node[run] = node
    return nodes, len(run_node)


@kernel
def _renumber(parent, symbol):  # type: ignore[no-untyped-def]
    """Breadth-first numbering with siblings in order of their symbol; `rank` maps old to new numbers."""
    nodes = len(parent)
    degree = np.zeros(nodes + 1, np.int64)
    for node in range(1, nodes):
        degree[parent[node] + 1] += 1
    start = np.cumsum(degree)
    fill = start.copy()
    children = np.empty(nodes, np.int64)
    for node in range(1, nodes):
        above = parent[node]
        # Insertion sort among siblings: there are at most as many as symbols.
        place = fill[above]
        while place > start[above] and symbol[children[place - 1]] > symbol[node]:
            children[place] = children[place - 1]
            place -= 1
        children[place] = node
        fill[above] += 1
    rank = np.empty(nodes, np.int64)
    order = np.empty(nodes, np.int64)
    first_child = np.empty(nodes, np.int64)
    n_children = np.empty(nodes, np.int64)
    new_parent = np.empty(nodes, np.int64)
    new_symbol = np.empty(nodes, np.int64)
    order[0], rank[0], new_parent[0], new_symbol[0] = 0, 0, -1, -1
    tail = 1
    for position in range(nodes):
        old = order[position]
        first_child[position] = tail
        n_children[position] = start[old + 1] - start[old]
        for i in range(start[old], start[old + 1]):
            node = children[i]
            order[tail], rank[node] = node, tail
            new_parent[tail], new_symbol[tail] = position, symbol[node]
            tail += 1
    return first_child, n_children, new_parent, new_symbol, rank


@kernel
def _depths(parent):  # type: ignore[no-untyped-def]
    depth = np.zeros(len(parent), np.int64)
    for node in range(1, len(parent)):
        depth[node] = depth[parent[node]] + 1
    return depth
