"""Distinct histories counted by condition while events come in: a tree of each condition, put together at the end.

The convergence gate of a posterior examines the log-likelihood of each condition beside the entries. That takes how
often every history occurred in it, which a tree of all conditions together does not know.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.errors import Phrase, located
from models.growing_tree import GrowingTree, merged_with_places
from models.histories import HistoryTree

_TREE = 5_000
"""Nodes that take as much memory as the tables of one more tree."""


class ConditionTrees:
    """The trees under construction.

    Parameters
    ----------
    n_actions, n_responses : int
    most_nodes : int, optional
        Nodes that would fit into the memory allowed, were there one tree; no bound unless given.
    """

    def __init__(self, n_actions: int, n_responses: int, most_nodes: int | None = None) -> None:
        self.n_actions, self.n_responses = n_actions, n_responses
        # The trees stay while they are put together: some 230 bytes a node instead of 160.
        self._most = None if most_nodes is None else max(4096, most_nodes * 2 // 3)
        self._trees: dict[int, GrowingTree] = {}

    @property
    def n_nodes(self) -> int:
        """Nodes so far in all trees, tables of more than one tree counted as nodes."""
        return sum(tree.n_nodes for tree in self._trees.values()) + _TREE * max(0, len(self._trees) - 1)

    def add(
        self, starts: NDArray[np.int64], condition: NDArray[np.integer], wanted: NDArray[np.bool_],
        action: NDArray[np.int8], response: NDArray[np.int8],
    ) -> None:  # fmt: skip
        """Take the next events; those before the first start go on with the run that is open.

        Parameters
        ----------
        starts : int64[runs]
            Where runs begin among these events, ascending.
        condition : int[runs]
        wanted : bool[runs]
            Which of these runs are counted.
        action, response : int8[events]

        Raises
        ------
        InputError
            If the trees would get too large.
        """
        for code in np.unique(condition[wanted]).tolist():
            if code not in self._trees:
                self._trees[code] = GrowingTree(self.n_actions, self.n_responses, self._most)
        for code, tree in self._trees.items():
            tree.add(starts, wanted & (condition == code), action, response)
        if self._most is not None and self.n_nodes > self._most:
            room = f"at most {self._most:,}: the histories by condition do not fit into the memory allowed"
            raise located("prefix trees, nodes", Phrase(f"more than {self._most:,}"), room)

    def finish(self) -> tuple[HistoryTree, dict[int, NDArray[np.float64]]]:
        """The tree of all conditions, and by condition how many runs have each of its histories.

        Raises
        ------
        InputError
            If no run was counted.
        """
        codes = sorted(self._trees)
        if not codes:
            raise located("event log, runs", 0, "at least one run of events")
        trees = [self._trees.pop(code).finish() for code in codes]
        tree, places = merged_with_places(trees)
        counts = {}
        for code, own, place in zip(codes, trees, places, strict=True):
            counts[code] = np.zeros(tree.n_histories)
            history = np.searchsorted(tree.terminals, place[own.terminals])
            counts[code][history] = own.arrays.ends[own.terminals]
        return tree, counts
