"""Random schedules with charges, small enough that all their plans can be tried."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from tests.models.planning.schedule_cases import schedules
from tests.reference.all_plans import count_plans

AMOUNTS = (0.0, 0.1, 0.3, 1.0, 2.5)


def random_charges(rng, protocol):
    nulls = {m.null_action for m in protocol.modes}
    return np.array([0.0 if a in nulls else float(rng.choice(AMOUNTS)) for a in protocol.action_names])


@st.composite
def charged_schedules(draw, *, most_plans=2000, **sizes):
    """A schedule of at most so many plans, and charges of its actions."""
    schedule = draw(schedules(**sizes))
    while count_plans(schedule) > most_plans:
        schedule = replace(schedule, modes=schedule.modes[1:])
    charges = random_charges(np.random.default_rng(draw(st.integers(0, 2**32 - 1))), schedule.protocol)
    return schedule, charges


def histories(schedule, missing=False):
    """All histories of choices and responses (None: not recorded), whoever acts, by number of events passed."""
    found = [()]
    for k in range(schedule.n_events):
        yield k, found
        shows = schedule.mode(k).shows_response
        responses = [*range(schedule.n_outcomes(k)), *([None] if missing and shows else [])]
        found = [
            (*h, (c, o if shows else None)) for h in found for c in range(len(schedule.mode(k).actions))
            for o in responses
        ]  # fmt: skip


def named(schedule, history):
    """The same with names, as `Schedule.read` takes it."""
    return [
        (schedule.mode(k).actions[c].name, None if o is None else schedule.protocol.response_names[o])
        for k, (c, o) in enumerate(history)
    ]


def memory_after(policy, schedule, history):
    """Where a policy is after a history; None if it holds it for impossible."""
    memory = policy.begin(schedule.modes[0])
    for k, (c, o) in enumerate(history):
        after = schedule.modes[k + 1] if k + 1 < schedule.n_events else schedule.modes[k]
        shows = schedule.mode(k).shows_response
        memory = policy.observe(memory, c, (None if o is None else o + 1) if shows else 0, after)
    return memory


def spent_in(schedule, history, charges):
    return sum(charges[schedule.first_action(k) + c] for k, (c, _) in enumerate(history))
