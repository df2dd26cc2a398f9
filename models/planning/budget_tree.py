r"""The tree of the histories that a budget can pay for, and the best plan on it for every amount left.

After history `h` with the amount `l` left,

.. math:: V(h, l) = \max_{a:\, c_a \le l} r(h, a) + \sum_o V(h a o,\, l - c_a)

where :math:`r(h, a)` is the expected reward times the probability of the history. The tree does not depend on the
amount: one walk serves all budgets.
"""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from models.errors import Phrase, located
from models.planning.budget_kernel import history_rewards
from models.planning.budget_levels import BudgetLevels, budget_levels
from models.planning.charges import Units
from models.planning.schedule import Array, Schedule
from models.planning.schedule_tree import tree_tables
from models.planning.summed_walk import PORTION
from models.spread_out import threads_here

Index = NDArray[np.int64]

MOST_CELLS = 100_000_000
"""Histories times amounts left that may be looked at: 800 MB for the largest event."""


@dataclass(frozen=True, eq=False)
class BudgetTree:
    """Histories of a schedule within a budget.

    Attributes
    ----------
    schedule : Schedule
    units : Units
        Charges and budget.
    levels : BudgetLevels
    child : tuple of int64[h, c, o]
        For each event but the last: place of the histories that follow among those of the next event; -1 where the
        choice cannot be paid for.
    top : tuple of int64[h]
        For each event: level of what is left of the whole budget after each history.
    """

    schedule: Schedule
    units: Units
    levels: BudgetLevels
    child: tuple[Index, ...]
    top: tuple[Index, ...]

    @classmethod
    def of(cls, schedule: Schedule, units: Units) -> BudgetTree:
        """Lay out the tree.

        Raises
        ------
        InputError
            If there are too many histories to visit.
        """
        own = [choice_charges(schedule, k, units) for k in range(schedule.n_events)]
        levels = budget_levels(own, units.budget)
        top = [np.array([len(levels.left[0]) - 1])]
        child: list[Index] = []
        for k in range(schedule.n_events - 1):
            reached = levels.after[k][top[-1], : len(own[k])]
            kept = np.repeat(reached[:, :, None], schedule.n_outcomes(k), axis=2)
            number = np.cumsum((kept >= 0).ravel()).reshape(kept.shape) - 1
            child.append(np.where(kept >= 0, number, -1))
            top.append(kept[kept >= 0])
            if len(top[-1]) * len(levels.left[k + 1]) > MOST_CELLS:
                place, amounts = f"schedule {schedule.letters}", len(levels.left[k + 1])
                found = Phrase(f"{len(top[-1])} histories before event {k + 1}, {amounts} amounts left")
                raise located(place, found, f"a product of at most {MOST_CELLS:.0e}")
        return cls(schedule, units, levels, tuple(child), tuple(top))

    @cached_property
    def sums(self) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """By event: expected reward of each choice after each history ``[h, c]``, and probability ``[h]``.

        Rewards are discounted and multiplied by the probability of the history; probabilities are not discounted.
        """
        s = self.schedule
        plain = replace(s, discount=1.0)
        tables = tree_tables(plain)
        end = np.zeros((0, tables.start.shape[1], 0))
        if s.terminal is not None:
            end = s.discount * np.einsum("astd,t->sda", tables.transition, s.terminal)
        sizes = [len(t) for t in self.top]
        begin = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        width = max(len(s.mode(k).actions) * s.n_outcomes(k) for k in range(s.n_events))
        child = np.full((begin[-1], width), -1)
        for k, own in enumerate(self.child):
            flat = own.reshape(len(own), -1)
            child[begin[k] : begin[k + 1], : flat.shape[1]] = np.where(flat >= 0, flat + begin[k + 1], -1)
        shape = int(begin[-1]), max(len(m.actions) for m in s.protocol.modes)
        draws = s.draws.n_draws

        def portion(span: slice) -> tuple[Array, Array]:
            own = tables._replace(
                start=np.ascontiguousarray(tables.start[:, span]),
                transition=np.ascontiguousarray(tables.transition[..., span]),
                emission=np.ascontiguousarray(tables.emission[..., span]),
                reward=np.ascontiguousarray(tables.reward[:, span]),
            )
            rewards, mass = np.zeros(shape), np.zeros(shape[0])
            history_rewards(own, s.reward, np.ascontiguousarray(end[:, span]), child, rewards, mass)
            return rewards, mass

        rewards, mass = np.zeros(shape), np.zeros(shape[0])
        spans = [slice(i, min(i + PORTION, draws)) for i in range(0, draws, PORTION)]
        with ThreadPoolExecutor(threads_here()) as threads:
            # Added in the order of the draws: the sums do not depend on who is first.
            for r, m in map(portion, spans) if len(spans) == 1 else threads.map(portion, spans):
                rewards += r
                mass += m
        events = range(s.n_events)
        spans = [slice(begin[k], begin[k + 1]) for k in events]
        discounted = tuple(s.discount**k * rewards[spans[k], : len(s.mode(k).actions)] for k in events)
        return discounted, tuple(mass[spans[k]] for k in events)

    @cached_property
    def best(self) -> tuple[tuple[Array, NDArray[np.int8]], ...]:
        """By event: best value ``[h, l]``, minus infinity beyond the budget, and choice, the lowest of equals."""
        rewards, _ = self.sums
        out: list[tuple[Array, NDArray[np.int8]]] = []
        for k in range(self.schedule.n_events - 1, -1, -1):
            worth = self.worth(k, rewards[k], out[-1][0] if out else None)
            choice = worth.argmax(axis=2)
            out.append((np.take_along_axis(worth, choice[:, :, None], 2)[:, :, 0], choice.astype(np.int8)))
        return tuple(reversed(out))

    def worth(self, k: int, rewards: Array, following: Array | None) -> Array:
        """Value of every choice ``[h, l, c]`` of event `k`, given values ``[h', l']`` of the next."""
        n, levels, choices = len(rewards), len(self.levels.left[k]), rewards.shape[1]
        out = np.empty((n, levels, choices))
        for c in range(choices):
            after = self.levels.after[k, :levels, c]
            out[:, :, c] = rewards[:, [c]]
            if following is not None:
                for o in range(self.child[k].shape[2]):
                    out[:, :, c] += following[self.child[k][:, [c], o], after[None]]
            out[:, after < 0, c] = -np.inf
        out[np.arange(levels) > self.top[k][:, None]] = -np.inf
        return out

    def level(self, units: float) -> int:
        """Level of a budget before the first event."""
        return self.levels.level(0, units)

    def followed(self, level: int) -> Iterable[tuple[int, Index, Index, Index]]:
        """Along the best plan from a level: event, history, level and choice by number of the responses."""
        history, left = np.zeros(1, dtype=np.int64), np.array([level])
        for k in range(self.schedule.n_events):
            choice = self.best[k][1][history, left].astype(np.int64)
            yield k, history, left, choice
            if k + 1 < self.schedule.n_events:
                history = self.child[k][history, choice].ravel()
                left = np.repeat(self.levels.after[k, left, choice], self.schedule.n_outcomes(k))


def choice_charges(schedule: Schedule, k: int, units: Units) -> Index:
    """Charges of the choices of an event, in units."""
    first = schedule.first_action(k)
    return units.charge[first : first + len(schedule.mode(k).actions)]
