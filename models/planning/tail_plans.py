r"""All plans of the last events of a schedule, as vectors.

A plan of the events from `k` on is an action and, for each response it may meet, a plan of the events after. What
it is worth is linear in the history's vector, with

.. math:: \alpha_{a, p}(s) = R(s, a) + g \sum_o O(o \mid s, a) \sum_{s'} T(s' \mid s, a)\, \alpha_{p_o}(s')

so the best one needs scalar products only. A plan that another one equals or exceeds everywhere is left out: it is
never better than that one. Their number explodes with the events, hence only the last ones, as many as pay.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from models.planning.schedule import Array, Schedule

MOST_PLANS = 64
"""Plans of one event that are looked at, before any is left out."""


@dataclass(frozen=True)
class TailPlans:
    """Plans of the last events.

    Attributes
    ----------
    leaf : int
        The event before those that are covered here: there the tree's walk stops.
    vectors : float64[p, d, s]
        Worth of each plan of event ``leaf + 1``.
    plans : tuple of tuple of (int, tuple of int)
        For each event after `leaf`: of each plan its action and, for each response, the plan that follows.
    """

    leaf: int
    vectors: Array
    plans: tuple[tuple[tuple[int, tuple[int, ...]], ...], ...]


def tail_plans(schedule: Schedule) -> TailPlans:
    """Plans of as many last events as make the whole cheapest."""
    n, last = schedule.n_states, schedule.n_events - 1
    shape = (schedule.draws.n_draws, n)
    end = np.zeros(n) if schedule.terminal is None else schedule.terminal
    vectors = np.ascontiguousarray(np.broadcast_to(end, shape))[None]
    plans: tuple[tuple[tuple[int, tuple[int, ...]], ...], ...] = ()
    histories = np.cumprod([1.0, *(_branching(schedule, k) for k in range(last))])
    best = TailPlans(last, vectors, plans)
    cheapest = _work(schedule, histories, last, 1)
    for k in range(last, 0, -1):
        actions, outcomes = len(schedule.mode(k).actions), schedule.n_outcomes(k)
        if actions * len(vectors) ** outcomes > MOST_PLANS:
            break
        candidates, names = [], []
        for a in range(actions):
            after = [followed(schedule, schedule.first_action(k) + a, o, vectors) for o in range(outcomes)]
            for follow in product(range(len(vectors)), repeat=outcomes):
                worth = schedule.reward[schedule.first_action(k) + a] + sum(
                    after[o][p] for o, p in enumerate(follow)
                )
                candidates.append(worth)
                names.append((a, follow))
        keep = _undominated(np.stack(candidates))
        vectors = np.stack([candidates[i] for i in keep])
        plans = (tuple(names[i] for i in keep), *plans)
        work = _work(schedule, histories, k - 1, len(vectors))
        if work < cheapest:
            best, cheapest = TailPlans(k - 1, vectors, plans), work
    return best


def followed(schedule: Schedule, action: int, outcome: int, vectors: Array) -> Array:
    r""":math:`g\,O(o \mid s, a) \sum_{s'} T(s' \mid s, a)\, \alpha_p(s')`, shape ``[p, d, s]``."""
    ahead = np.matmul(schedule.draws.transition[:, action], vectors[..., None])[..., 0]
    row = schedule.protocol.emission_index[action]
    shown = 1.0 if row < 0 else schedule.draws.emission[:, row, :, outcome]
    return np.asarray(schedule.discount * shown * ahead)


def _branching(schedule: Schedule, k: int) -> int:
    return len(schedule.mode(k).actions) * schedule.n_outcomes(k)


def _work(schedule: Schedule, histories: Array, leaf: int, n_plans: int) -> float:
    """Multiplications by state and draw: moves of the vector to every history up to `leaf`, products there."""
    moves = float(histories[1 : leaf + 1].sum()) * schedule.n_states
    actions = len(schedule.mode(leaf).actions)
    return moves + float(histories[leaf]) * (actions + _branching(schedule, leaf) * n_plans)


def _undominated(vectors: Array) -> list[int]:
    """Indices of vectors that no other one equals or exceeds everywhere; the first of equals."""
    flat = vectors.reshape(len(vectors), -1)
    kept: list[int] = []
    for i, own in enumerate(flat):
        others = [j for j in range(len(flat)) if j != i]
        if not any(np.all(flat[j] >= own) and (j < i or np.any(flat[j] > own)) for j in others):
            kept.append(i)
    return kept
