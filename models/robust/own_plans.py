"""Every draw solved by itself over a schedule, as if it were known to be true."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from models.planning.exact import Decisions
from models.planning.schedule import Array, Schedule
from models.planning.schedule_tree import ScheduleTree, schedule_tree
from models.robust.plan_kernel import own_optima
from models.robust.plan_table import unweighted
from models.spread_out import chunks, spread_out

CHUNK = 512
"""Draws that one call works on, so that their vectors stay in the processor's cache."""


@dataclass(frozen=True)
class OwnPlans:
    """The best plan of every draw, as if it were known to be true.

    Attributes
    ----------
    schedule : Schedule
    values : float64[d]
        :math:`V^*_i`.
    first_values : float64[d, a]
        Value of each action at the first event, followed by the draw's best plan.
    plans : tuple of Decisions
        Distinct plans, the most believed one first.
    which : int64[d]
        Plan of each draw.
    """

    schedule: Schedule
    values: Array
    first_values: Array
    plans: tuple[Decisions, ...]
    which: NDArray[np.int64]

    @cached_property
    def shares(self) -> Array:
        """Share of the draws, by weight, whose best plan each is, shape ``[p]``."""
        return np.bincount(self.which, weights=self.schedule.draws.weight, minlength=len(self.plans))

    @property
    def mean(self) -> float:
        """Mean of the optimal values: what could be had if the draw were known beforehand."""
        return float(self.schedule.draws.weight @ self.values)

    @property
    def first_action_shares(self) -> dict[str, float]:
        """Share of the draws, by weight, that prefer each action at the first event; the first of equals."""
        best = np.argmax(self.first_values, axis=1)
        weight = self.schedule.draws.weight
        names = [a.name for a in self.schedule.mode(0).actions]
        return {name: float(weight[best == a].sum()) for a, name in enumerate(names)}

    @property
    def first_action_losses(self) -> dict[str, float]:
        """Expected loss of each action at the first event against the draw's best one, in the schedule's unit."""
        lost = self.first_values.max(axis=1, keepdims=True) - self.first_values
        means = self.schedule.draws.weight @ lost
        return dict(zip([a.name for a in self.schedule.mode(0).actions], means.tolist(), strict=True))


def own_plans(schedule: Schedule, executor: Executor | None = None) -> OwnPlans:
    """Solve every draw of a schedule exactly.

    Parameters
    ----------
    schedule : Schedule
    executor : concurrent.futures.Executor, optional
        What draws are spread over; threads of this process by default.

    Raises
    ------
    InputError
        If there are too many histories to visit.
    """
    tree = schedule_tree(unweighted(schedule))
    initial = schedule.draws.initial
    pieces = [tree.some(span, initial[span]) for span in chunks(schedule.draws.n_draws, CHUNK)]
    parts = spread_out(executor, _solve, pieces)
    first = np.concatenate([p[0] for p in parts], axis=1).T
    rows = np.concatenate([p[1] for p in parts], axis=1).T
    distinct, which = np.unique(rows, axis=0, return_inverse=True)
    share = np.bincount(which, weights=schedule.draws.weight)
    order = np.argsort(-share, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    edges = np.cumsum(parts[0][2])[:-1]
    plans = tuple(tuple(np.ascontiguousarray(v) for v in np.split(distinct[i], edges)) for i in order)
    return OwnPlans(schedule, first.max(axis=1), np.ascontiguousarray(first), plans, place[which.ravel()])


def _solve(tree: ScheduleTree) -> tuple[Array, NDArray[np.int8], list[int]]:
    """Values of the first actions ``[a, d]``, decisions of all events ``[r, d]``, decisions of each event."""
    s = tree.schedule
    draws = tree.tables.start.shape[1]
    decision = np.zeros((tree.histories, draws), dtype=np.int8)
    picks = np.zeros((tree.leaves, s.n_outcomes(tree.leaf), draws), dtype=np.int16)
    first = np.zeros((len(s.mode(0).actions), draws))
    own_optima(tree.tables, tree.leaf, tree.leaf_vectors, tree.n_plans, tree.offset, decision, picks, first)
    levels = tree.decisions(decision, picks)
    return first, np.concatenate(levels), [len(level) for level in levels]
