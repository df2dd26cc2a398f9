"""The best sequence of actions that is fixed before the first event and listens to nobody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.planning.exact import Decisions, solve_schedule
from models.planning.schedule import Schedule


def open_loop(schedule: Schedule) -> Decisions:
    """The best fixed sequence of actions by what is believed of the draws, as a plan.

    People who always answer the same tell nothing, and rewards do not depend on responses: the best plan for them
    is the best one that does not listen.

    Parameters
    ----------
    schedule : Schedule
    """
    silent = np.zeros_like(schedule.draws.emission)
    silent[..., 0] = 1.0
    plan = solve_schedule(replace(schedule, draws=replace(schedule.draws, emission=silent)))
    size, out = 1, []
    for k, level in enumerate(plan.decisions):
        # Only responses numbered 0 come up: the first history of every event is the one that is met.
        out.append(np.full(size, level[0], dtype=np.int8))
        size *= schedule.n_outcomes(k)
    return tuple(out)
