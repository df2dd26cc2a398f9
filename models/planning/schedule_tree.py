"""The tree of histories of a schedule, laid out for the compiled walks over it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import prod

import numpy as np
from numpy.typing import NDArray

from models.errors import Phrase, located
from models.planning.history_kernel import TreeTables
from models.planning.schedule import Array, Schedule
from models.planning.tail_plans import TailPlans, followed, tail_plans

MOST_HISTORIES = 50_000_000
"""Histories that the walk may visit (some ten seconds for one model), and that a plan may hold an action for."""


@dataclass(frozen=True)
class ScheduleTree:
    """What a walk over the histories of a schedule works on.

    Attributes
    ----------
    schedule : Schedule
    tail : TailPlans
        Plans of the last events, which are not walked.
    offset : int64[leaf + 1]
        Where the histories of each event begin.
    histories, leaves : int
        Histories up to event ``tail.leaf``, and at it.
    """

    schedule: Schedule
    tail: TailPlans
    offset: NDArray[np.int64]
    histories: int
    leaves: int

    @property
    def start(self) -> Array:
        """What the walk starts from, shape ``[d, s]``."""
        own = self.__dict__.get("tables")
        return self.schedule.start() if own is None else own.start.T

    @cached_property
    def tables(self) -> TreeTables:
        """Tables of the models, draws last."""
        return tree_tables(self.schedule)

    @cached_property
    def leaf_vectors(self) -> Array:
        """What the walk multiplies with at event ``tail.leaf``, shape ``[s, d, j]``."""
        return _leaf_vectors(self.schedule, self.tail)

    def some(self, keep: NDArray[np.int64] | slice, start: Array) -> ScheduleTree:
        r"""The tree with some of its draws only, started from other vectors.

        Plans of the last events are kept as they are: those that are best for some of the draws are among them.
        What is laid out already is cut; the rest is laid out for these draws only, when it is needed.

        Parameters
        ----------
        keep : int64[n] or slice
            Draws.
        start : float64[n, s]
            In place of :math:`P(\text{draw}, s_0)`.
        """
        d = self.schedule.draws
        n = len(start)
        draws = replace(
            d, initial=d.initial[keep], transition=d.transition[keep], emission=d.emission[keep],
            weight=np.full(n, 1.0 / n),
        )  # fmt: skip
        tail = replace(self.tail, vectors=self.tail.vectors[:, keep])
        out = replace(self, schedule=replace(self.schedule, draws=draws), tail=tail)
        own = self.__dict__.get("tables")
        tables = tree_tables(out.schedule) if own is None else own._replace(
            transition=np.ascontiguousarray(own.transition[..., keep]),
            emission=np.ascontiguousarray(own.emission[..., keep]),
            reward=np.ascontiguousarray(own.reward[:, keep]),
        )  # fmt: skip
        out.__dict__["tables"] = tables._replace(start=np.ascontiguousarray(start.T))
        if "leaf_vectors" in self.__dict__:
            out.__dict__["leaf_vectors"] = np.ascontiguousarray(self.leaf_vectors[:, keep])
        return out

    @property
    def leaf(self) -> int:
        """Event at which the walk stops."""
        return self.tail.leaf

    @property
    def n_plans(self) -> int:
        """Plans of the events after the leaf."""
        return len(self.tail.vectors)

    def decisions(self, decision: NDArray[np.int8], picks: NDArray[np.int16]) -> tuple[NDArray[np.int8], ...]:
        """What a walk has chosen along the histories that its own choices lead to.

        Parameters
        ----------
        decision : int8[h, ...]
            Best action after each history, numbered as in `offset`; more axes (draws) are carried along.
        picks : int16[l, o, ...]
            Plan that follows each response at each leaf.

        Returns
        -------
        tuple of int8[r, ...]
            One array an event, as in `models.planning.exact.ExactPlan`.
        """
        s, more = self.schedule, decision.shape[1:]
        decision, picks = decision.reshape(len(decision), -1), picks.reshape(*picks.shape[:2], -1)
        draw = np.arange(decision.shape[1])
        out = []
        histories = np.zeros((1, len(draw)), dtype=np.int64)
        for k in range(self.leaf + 1):
            actions = decision[self.offset[k] + histories, draw]
            out.append(actions)
            if k < self.leaf:
                outcomes = s.n_outcomes(k)
                base = (histories * len(s.mode(k).actions) + actions) * outcomes
                histories = (base[:, None] + np.arange(outcomes)[:, None]).reshape(-1, len(draw))
        followers = picks[histories[:, None], np.arange(picks.shape[1])[:, None], draw].reshape(-1, len(draw))
        for level in self.tail.plans:
            actions = np.array([a for a, _ in level], dtype=np.int8)
            after = np.array([follow for _, follow in level], dtype=np.int16)
            out.append(actions[followers])
            followers = np.moveaxis(after[followers], -1, 1).reshape(-1, len(draw))
        return tuple(np.ascontiguousarray(level.reshape(len(level), *more)) for level in out)


def schedule_tree(schedule: Schedule) -> ScheduleTree:
    """Lay out the tree of a schedule.

    Raises
    ------
    InputError
        If there are too many histories to visit.
    """
    tail = tail_plans(schedule)
    counts = [1]
    for k in range(tail.leaf):
        counts.append(counts[-1] * len(schedule.mode(k).actions) * schedule.n_outcomes(k))
    answered = sum(prod(schedule.n_outcomes(j) for j in range(k)) for k in range(schedule.n_events))
    if max(sum(counts), answered) > MOST_HISTORIES:
        found = Phrase(f"{schedule.n_events} events, {float(max(sum(counts), answered)):.2g} histories")
        raise located(f"schedule {schedule.letters}", found, f"at most {MOST_HISTORIES:.0e} histories")
    offset = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    return ScheduleTree(schedule, tail, offset, sum(counts), counts[-1])


def tree_tables(schedule: Schedule) -> TreeTables:
    """Tables of a schedule in the layout of the kernels, draws last."""
    draws, events = schedule.draws, range(schedule.n_events)
    shape = (schedule.n_states, draws.n_draws, len(schedule.reward))
    reward = np.broadcast_to(schedule.reward.T[:, None, :], shape)
    return TreeTables(
        np.ascontiguousarray(schedule.start().T),
        np.ascontiguousarray(schedule.discount * np.moveaxis(draws.transition, 0, -1)),
        np.ascontiguousarray(np.moveaxis(draws.emission, 0, -1)),
        np.asarray(schedule.protocol.emission_index, dtype=np.int64),
        np.ascontiguousarray(reward),
        np.array([schedule.first_action(k) for k in events], dtype=np.int64),
        np.array([len(schedule.mode(k).actions) for k in events], dtype=np.int64),
        np.array([schedule.n_outcomes(k) for k in events], dtype=np.int64),
    )


def _leaf_vectors(schedule: Schedule, tail: TailPlans) -> Array:
    """What the kernel multiplies with at event `leaf`, shape ``[s, d, j]``."""
    first, actions = schedule.first_action(tail.leaf), len(schedule.mode(tail.leaf).actions)
    shape = (1, schedule.draws.n_draws, schedule.n_states)
    blocks = [np.broadcast_to(schedule.reward[first + a], shape) for a in range(actions)]
    blocks += [
        followed(schedule, first + a, o, tail.vectors)
        for a in range(actions)
        for o in range(schedule.n_outcomes(tail.leaf))
    ]
    return np.ascontiguousarray(np.concatenate(blocks).transpose(2, 1, 0))
