"""The adaptive grid as a search that `models.planning.solver` drives: rounds, room, and when to give up."""

from __future__ import annotations

from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.grid_bounds import Grid, empty_grid, grown_grid
from models.planning.grid_run import GridRun, begin, blind_slots, new_run
from models.planning.grid_solver import DONE, FULL, advance
from models.planning.vectors import Vectors, grown_vectors

POINTS, SLOTS = 4096, 512
"""Room to begin with."""

PATIENCE = 8
"""Rounds in which the gap does not fall by a tenth before the grid gives up."""


def bytes_of(*groups: Grid | Vectors | tuple) -> int:
    """Memory that arrays take."""
    return sum(array.nbytes for group in groups for array in group if hasattr(array, "nbytes"))


def point_bytes(problem: ProblemArrays) -> int:
    """Memory that a node of the grid takes."""
    return bytes_of(empty_grid(problem, 1))


def least_points(problem: ProblemArrays) -> int:
    """Nodes without which a grid cannot begin: corners, starts, and room for one refinement."""
    return 2 * (int(problem.mode_size.sum()) + len(problem.mode_size))


class GridSearch:
    """Rounds of `models.planning.grid_solver.advance` with room that grows.

    Attributes
    ----------
    lower, upper : float
    beliefs : int
        Points of the grid.
    vectors : Vectors
    exhausted : bool
        Whether more rounds promise nothing.
    full : bool
        Whether that is for want of memory.
    """

    name = "grid"

    def __init__(
        self, problem: ProblemArrays, modes: Index, beliefs: Array, weight: Array, memory: int,
        warm: Vectors | None = None,
    ) -> None:  # fmt: skip
        self.problem, self.weight, self.memory = problem, weight, memory
        known = 0 if warm is None else int(warm.counts[0])
        points = max(least_points(problem), min(POINTS, memory // (2 * point_bytes(problem))))
        run = new_run(problem, points, SLOTS + blind_slots(problem) + known)
        if warm is not None:
            run = run._replace(vectors=grown_vectors(warm, len(run.vectors.mode)))
        self.run: GridRun = run
        self.first_root = begin(problem, run, modes, beliefs, known)
        self.exhausted = self.full = False
        self._best_gap, self._waited = float("inf"), 0

    @property
    def lower(self) -> float:
        """Lower bound at the start."""
        return float(self.run.bounds[0])

    @property
    def upper(self) -> float:
        """Upper bound at the start."""
        return float(self.run.bounds[1])

    @property
    def beliefs(self) -> int:
        """Points of the grid."""
        return int(self.run.grid.counts[0])

    @property
    def vectors(self) -> Vectors:
        """The vectors of the lower bound."""
        return self.run.vectors

    def step(self, precision: float, relative: bool) -> bool:
        """One round; True if the gap is small enough."""
        run = self.run
        status = advance(
            self.problem, run.grid, run.vectors, self.weight, self.first_root, precision, relative, run.bounds
        )
        if status == DONE:
            return True
        gap = self.upper - self.lower
        if gap < 0.9 * self._best_gap:
            self._best_gap, self._waited = gap, 0
        else:
            self._waited += 1
        self.exhausted = self._waited >= PATIENCE
        if status == FULL:
            self._make_room()
        return False

    def _make_room(self) -> None:
        grid, vectors = self.run.grid, self.run.vectors
        if 2 * bytes_of(grid, vectors) > self.memory:
            self.exhausted = self.full = True
            return
        # Whichever is fuller was the one without room.
        if vectors.counts[0] >= 0.9 * len(vectors.mode):
            self.run = self.run._replace(vectors=grown_vectors(vectors, 2 * len(vectors.mode)))
        else:
            self.run = self.run._replace(grid=grown_grid(grid, self.problem, 2 * len(grid.mode)))
