"""SARSOP's trials as a search that `models.planning.solver` drives: portions of work, room, sweeps, patience."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.belief_tree import TINY, empty_tree, grown_tree, look_down, look_up, node_of, note_risen
from models.planning.blind_policies import blind_vectors
from models.planning.fast_informed_bound import (
    informed_vectors,
    lower_informed_vectors,
    lower_mdp_bound,
    mdp_bound,
)
from models.planning.graph_value import solve_reachable
from models.planning.grid_run import BLIND, blind_slots
from models.planning.grid_search import bytes_of
from models.planning.node_backups import DEEPEST, new_room
from models.planning.precision import gap_wanted
from models.planning.sarsop_trial import run_trials, sweep
from models.planning.tree_tidying import tidy_points, tidy_vectors
from models.planning.value_bins import empty_bins, grown_bins
from models.planning.vectors import Vectors, empty_vectors, evaluate_graph, grown_vectors

NODES, SLOTS = 2048, 2048
"""Room to begin with."""

PORTION = 0.05
"""Seconds that a step should take, so that Ctrl-C, limits and progress are looked at."""

GROWTH = 1.5
"""Nodes are all swept when there are that many times as many as at the last sweep."""

GROWN = 8
"""Times as many nodes as before there is room for, when there was none left."""

INFORMED = 0.5
"""Seconds that each of the upper bounds is worth with which trials begin."""

PATIENCE = 40
"""Steps without any progress before the search has stalled."""

SWEEPS = 2_000
"""Sweeps of the upper bounds that trials begin with, at most."""


class TrialSearch:
    """Trials in portions, with room that grows and sweeps over all beliefs in between.

    Attributes
    ----------
    lower, upper : float
    beliefs : int
        Nodes of the tree.
    vectors : Vectors
    exhausted : bool
        Whether more steps promise nothing.
    full : bool
        Whether that is for want of memory.
    """

    name = "trials"

    def __init__(
        self, problem: ProblemArrays, modes: Index, beliefs: Array, weight: Array, memory: int,
        vectors: Vectors | None = None,
    ) -> None:  # fmt: skip
        self.problem, self.weight, self.memory = problem, weight, memory
        if vectors is None:
            vectors = empty_vectors(problem, blind_slots(problem) + SLOTS)
            blind_vectors(problem, vectors, BLIND)
        self.vectors = vectors
        sizes = problem.mode_size
        values, planes = _informed(problem)
        room = memory // (2 * bytes_of(empty_tree(problem, 1, values, planes)))
        least = 2 * (len(modes) + int(np.diff(problem.choice_outcome).max()))
        self.tree = empty_tree(problem, max(least, min(NODES, room)), values, planes)
        self.bins = empty_bins(problem, self.tree)
        self.room = new_room(problem)
        roots = []
        for mode, belief in zip(modes, beliefs, strict=True):
            i = node_of(self.tree, problem, mode, belief)
            look_up(self.tree, self.vectors, i, sizes[mode])
            look_down(self.tree, i, sizes[mode])
            roots.append(i)
        self.roots = np.array(roots, dtype=np.int64)
        self.exhausted = self.full = False
        self._work = 300_000
        self._swept = NODES // 4
        self._next = -1
        self._waited = 0
        self._known = (self.lower, self.upper)

    @property
    def lower(self) -> float:
        """Lower bound at the start."""
        return float(self.weight @ self.tree.lower[self.roots])

    @property
    def upper(self) -> float:
        """Upper bound at the start."""
        return float(self.weight @ self.tree.upper[self.roots])

    @property
    def beliefs(self) -> int:
        """Nodes of the tree."""
        return int(self.tree.counts[0])

    def step(self, precision: float, relative: bool) -> bool:
        """One portion of trials; True if the gap is small enough."""
        if self._next >= 0:
            return self._go_on_sweeping(precision, relative)
        before = (self.lower, self.upper)
        wanted = self._wanted(precision, relative)
        began = time.perf_counter()
        status = run_trials(
            self.tree, self.problem, self.vectors, self.bins, self.roots, self.weight, wanted, self._work, self.room
        )
        room = (len(self.tree.mode), len(self.vectors.mode))
        if status == 2:
            self._make_room()
        elif status == 1 and time.perf_counter() - began < PORTION:
            self._work *= 2
        # Making room by tidying alone is no progress: points of the same beliefs fill it again.
        grown = room != (len(self.tree.mode), len(self.vectors.mode))
        stuck = before == (self.lower, self.upper)
        if not self.exhausted and not grown and status != 0 and (self.beliefs > GROWTH * self._swept or stuck):
            self._swept = self.beliefs
            self._next = self.beliefs - 1
        # Sweeps since the last portion count too.
        moved = self.lower - self._known[0] + self._known[1] - self.upper
        self._known = (self.lower, self.upper)
        idle = moved <= 10 * TINY * self.problem.largest and not grown
        self._waited = self._waited + 1 if idle else 0
        self.exhausted = self.exhausted or self._waited >= PATIENCE
        return self.upper - self.lower <= self._wanted(precision, relative)

    def _wanted(self, precision: float, relative: bool) -> float:
        return gap_wanted(precision, relative, self.lower, self.upper, self.problem.least)

    def _go_on_sweeping(self, precision: float, relative: bool) -> bool:
        wanted = self._wanted(precision, relative) * (1 - self.problem.discount)
        least = max(1e-3 * wanted, TINY * self.problem.largest)
        if self._next == self._swept - 1:
            for i in self.roots:
                solve_reachable(self.problem, self.vectors, int(self.tree.best[i]))
            evaluate_graph(self.problem, self.vectors, 0.0, 2)
            note_risen(self.tree, self.problem, self.vectors)
        self._next = sweep(self.tree, self.problem, self.vectors, self._next, least, self._work, self.room)
        if self._next == -2:
            self._make_room()
        return self.upper - self.lower <= self._wanted(precision, relative)

    def _make_room(self) -> None:
        tree, vectors = self.tree, self.vectors
        if tree.counts[1] + DEEPEST > len(tree.point_node):
            tidy_points(tree, self.problem)
        if vectors.counts[0] + DEEPEST > len(vectors.mode):
            tidy_vectors(tree, self.problem, vectors)
        crowded = tree.counts[1] > 0.7 * len(tree.point_node) or tree.counts[0] > 0.9 * len(tree.mode)
        widest = int(np.diff(self.problem.choice_outcome).max())
        crowded = (
            crowded or tree.counts[1] + DEEPEST > len(tree.point_node) or tree.counts[0] + widest > len(tree.mode)
            or tree.counts[4] + widest > 0.9 * len(tree.way_child)
        )  # fmt: skip
        many = vectors.counts[0] > 0.7 * len(vectors.mode) or vectors.counts[0] + DEEPEST > len(vectors.mode)
        if (crowded or many) and 2 * bytes_of(tree, self.bins, vectors) > self.memory:
            self.exhausted = self.full = True
            return
        if crowded:
            # Fresh memory costs nothing before it is written to, but copying what is there takes time: so seldom.
            node = bytes_of(tree, self.bins) / len(tree.mode)
            most = int((self.memory - bytes_of(vectors)) / node)
            self.tree = grown_tree(tree, self.problem, max(2 * len(tree.mode), min(GROWN * len(tree.mode), most)))
            self.bins = grown_bins(self.bins, len(self.tree.mode))
        if many:
            self.vectors = grown_vectors(vectors, 2 * len(vectors.mode))


def _informed(problem: ProblemArrays) -> tuple[Array, Array]:
    """Upper bounds that trials begin with: corners ``[x, w]`` and planes ``[c, w]``, in portions."""
    values = np.zeros((len(problem.mode_size), problem.reward.shape[1]))
    planes = np.zeros_like(problem.reward)
    step = problem.span * (1 - problem.discount)
    mdp_bound(problem, 1e-7 * step, 1, values)
    _in_portions(lambda most: lower_mdp_bound(problem, 1e-7 * step, most, values), 100_000)
    informed_vectors(problem, values, 1e-6 * step, 1, planes)
    _in_portions(lambda most: lower_informed_vectors(problem, 1e-6 * step, most, planes), SWEEPS)
    for x in range(len(problem.mode_size)):
        offered = planes[problem.mode_choice[x] : problem.mode_choice[x + 1]]
        values[x] = np.minimum(values[x], offered.max(axis=0))
    return values, planes


def _in_portions(sweep: Callable[[int], int], most: int) -> None:
    """Sweep until nothing moves, or enough has been done; every sweep is sound, so any of them may be the last."""
    began = time.perf_counter()
    done, portion = 0, 1
    while done < most and time.perf_counter() - began < INFORMED:
        start = time.perf_counter()
        swept = sweep(portion)
        if swept < portion:
            break
        done += swept
        if time.perf_counter() - start < PORTION:
            portion *= 2
