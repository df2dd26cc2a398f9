r"""What all plans are worth that differ from a plan in one decision, in every draw.

With :math:`w_h` the unnormalised vector of a history under the plan and :math:`Q_h(a)` the worth of doing `a` there
and following the plan afterwards, changing one decision changes the value by :math:`w_h \cdot (Q_h(a') - Q_h(a))`.
One pass forwards gives the vectors, one backwards the worth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from models.planning.exact import Decisions
from models.planning.schedule import Array, Schedule
from models.robust.plan_table import plan_key


@dataclass(frozen=True)
class Neighbours:
    """Plans that differ from a plan in one decision.

    Attributes
    ----------
    centre : Decisions
        The plan itself.
    changes : tuple of (int, int, int)
        Event, number of the responses before it, and the action (counted within the event) instead.
    values : float64[n, d]
        What each is worth in every draw.
    """

    centre: Decisions
    changes: tuple[tuple[int, int, int], ...]
    values: Array

    def plan(self, number: int) -> Decisions:
        """One of them."""
        k, r, a = self.changes[number]
        level = self.centre[k].copy()
        level[r] = a
        return (*self.centre[:k], level, *self.centre[k + 1 :])

    def keys(self) -> Iterator[bytes]:
        """What tells these plans apart from others."""
        return (plan_key(self.plan(i)) for i in range(len(self.changes)))


def neighbour_values(schedule: Schedule, plan: Decisions) -> Neighbours:
    """Value all plans that differ from a plan in one decision.

    Parameters
    ----------
    schedule : Schedule
        Weights of its draws do not matter here.
    plan : Decisions
    """
    s, draws = schedule, schedule.draws
    held = _vectors(s, plan)
    end = np.zeros(s.n_states) if s.terminal is None else s.terminal
    size = len(plan[-1]) * s.n_outcomes(s.n_events - 1)
    after = np.broadcast_to(end, (draws.n_draws, size, s.n_states))
    changes: list[tuple[int, int, int]] = []
    gains = []
    for k in range(s.n_events - 1, -1, -1):
        number, level = s.n_outcomes(k), plan[k]
        choices = []
        for c in range(len(s.mode(k).actions)):
            a = s.first_action(k) + c
            ahead = s.discount * (after @ draws.transition[:, a].swapaxes(1, 2))
            row = s.protocol.emission_index[a]
            if row >= 0:
                each = ahead.reshape(draws.n_draws, -1, number, s.n_states)
                seen = draws.emission[:, row].swapaxes(1, 2)  # [d, o, s]
                ahead = np.einsum("dros,dos->drs", each, seen)
            choices.append(s.reward[a] + ahead)
        after = np.empty_like(choices[0])
        for c, worth in enumerate(choices):
            here = level == c
            after[:, here] = worth[:, here]
        for c, worth in enumerate(choices):
            other = np.flatnonzero(level != c)
            gains.append((held[k][:, other] * (worth[:, other] - after[:, other])).sum(axis=-1))
            changes += [(k, int(r), c) for r in other]
    own = (draws.initial * after[:, 0]).sum(axis=-1)
    return Neighbours(plan, tuple(changes), np.ascontiguousarray((own[:, None] + np.hstack(gains)).T))


def _vectors(s: Schedule, plan: Decisions) -> list[Array]:
    """Unnormalised vectors of all histories under a plan, one array ``[d, r, s]`` an event."""
    draws = s.draws
    out = [np.asarray(draws.initial[:, None])]
    for k in range(s.n_events - 1):
        now, number = out[-1], s.n_outcomes(k)
        new = np.zeros((*now.shape[:2], number, s.n_states))
        for c in range(len(s.mode(k).actions)):
            here, a = np.flatnonzero(plan[k] == c), s.first_action(k) + c
            row = s.protocol.emission_index[a]
            for o in range(number):
                seen = now[:, here] if row < 0 else now[:, here] * draws.emission[:, row, None, :, o]
                new[:, here, o] = s.discount * (seen @ draws.transition[:, a])
        out.append(new.reshape(draws.n_draws, -1, s.n_states))
    return out
