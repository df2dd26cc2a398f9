"""SARSOP's trials as a search that `models.planning.solver` drives: portions of work, room, sweeps, patience."""

from __future__ import annotations

import time

import numpy as np

from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.belief_tree import empty_tree, grown_tree, look_down, look_up, node_of
from models.planning.fast_informed_bound import informed_vectors, mdp_bound
from models.planning.grid_run import BLIND, blind_slots
from models.planning.grid_search import bytes_of
from models.planning.sarsop_trial import (
    DEEPEST,
    empty_bins,
    grown_bins,
    new_room,
    run_trials,
    sweep,
    tidy_points,
    tidy_vectors,
)
from models.planning.vectors import Vectors, blind_vectors, empty_vectors, evaluate_graph, grown_vectors

NODES, SLOTS = 2048, 2048
"""Room to begin with."""

PORTION = 0.05
"""Seconds that a step should take, so that Ctrl-C, limits and progress are looked at."""

GROWTH = 1.5
"""Nodes are all swept when there are that many times as many as at the last sweep."""

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
        values = np.zeros((len(sizes), problem.reward.shape[1]))
        scale = (problem.reward.max() - problem.reward.min()) / (1 - problem.discount)
        mdp_bound(problem, 1e-7 * scale * (1 - problem.discount), 100_000, values)
        planes = np.zeros_like(problem.reward)
        informed_vectors(problem, values, 1e-6 * scale * (1 - problem.discount), SWEEPS, planes)
        for x in range(len(sizes)):
            offered = planes[problem.mode_choice[x] : problem.mode_choice[x + 1]]
            values[x] = np.minimum(values[x], offered.max(axis=0))
        self.tree = empty_tree(problem, max(NODES, 2 * len(modes)), values, planes)
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
        wanted = precision * (max(map(abs, before)) if relative else 1.0)
        began = time.perf_counter()
        status = run_trials(
            self.tree, self.problem, self.vectors, self.bins, self.roots, self.weight, wanted, self._work, self.room
        )
        if status == 2:
            self._make_room()
        elif status == 1 and time.perf_counter() - began < PORTION:
            self._work *= 2
        if status == 1 and (self.beliefs > GROWTH * self._swept or before == (self.lower, self.upper)):
            self._swept = self.beliefs
            self._next = self.beliefs - 1
        self._waited = self._waited + 1 if before == (self.lower, self.upper) and status != 2 else 0
        self.exhausted = self.exhausted or self._waited >= PATIENCE
        return self.upper - self.lower <= precision * (max(abs(self.lower), abs(self.upper)) if relative else 1.0)

    def _go_on_sweeping(self, precision: float, relative: bool) -> bool:
        size = max(abs(self.lower), abs(self.upper))
        if self._next == self._swept - 1:
            evaluate_graph(self.problem, self.vectors, 0.0, 2)
        self._next = sweep(self.tree, self.problem, self.vectors, self._next, 1e-9 * size, self._work, self.room)
        if self._next == -2:
            self._make_room()
        return self.upper - self.lower <= precision * (max(abs(self.lower), abs(self.upper)) if relative else 1.0)

    def _make_room(self) -> None:
        tree, vectors = self.tree, self.vectors
        if tree.counts[1] + DEEPEST > len(tree.point_node):
            tidy_points(tree)
        if vectors.counts[0] + DEEPEST > len(vectors.mode):
            tidy_vectors(tree, self.problem, vectors)
        crowded = tree.counts[1] > 0.7 * len(tree.point_node) or tree.counts[0] > 0.9 * len(tree.mode)
        widest = int(np.diff(self.problem.choice_outcome).max())
        crowded = (
            crowded or tree.counts[1] + DEEPEST > len(tree.point_node) or tree.counts[0] + widest > len(tree.mode)
        )
        many = vectors.counts[0] > 0.7 * len(vectors.mode) or vectors.counts[0] + DEEPEST > len(vectors.mode)
        if (crowded or many) and 2 * bytes_of(tree, self.bins, vectors) > self.memory:
            self.exhausted = self.full = True
            return
        if crowded:
            self.tree = grown_tree(tree, self.problem, 2 * len(tree.mode))
            self.bins = grown_bins(self.bins, len(self.tree.mode))
        if many:
            self.vectors = grown_vectors(vectors, 2 * len(vectors.mode))
