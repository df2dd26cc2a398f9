"""The best plan of a schedule by trying every policy there is: a policy is a table from histories to actions."""

from __future__ import annotations

from itertools import product

import numpy as np


def all_policies_value(schedule) -> float:
    """Value of the best of all deterministic policies that may depend on the responses so far."""
    shapes = [_response_histories(schedule, k) for k in range(schedule.n_events)]
    tables = [
        product(range(len(schedule.mode(k).actions)), repeat=len(shapes[k])) for k in range(schedule.n_events)
    ]
    return max(
        policy_value(schedule, [dict(zip(h, t, strict=True)) for h, t in zip(shapes, policy, strict=True)])
        for policy in product(*tables)
    )


def policy_value(schedule, policy) -> float:
    """Value of a policy: sum over draws, state paths and responses, event by event."""
    draws, total = schedule.draws, 0.0
    for d in range(draws.n_draws):
        for s in range(schedule.n_states):
            total += draws.weight[d] * draws.initial[d, s] * _from(schedule, policy, d, s, 0, ())
    return total


def _from(schedule, policy, d, s, k, seen) -> float:
    if k == schedule.n_events:
        return 0.0 if schedule.terminal is None else float(schedule.terminal[s])
    a = schedule.first_action(k) + policy[k][seen]
    row = schedule.protocol.emission_index[a]
    worth = float(schedule.reward[a, s])
    responses = [(None, 1.0)] if row < 0 else list(enumerate(schedule.draws.emission[d, row, s]))
    for o, p in responses:
        after = seen if o is None else (*seen, o)
        for t, q in enumerate(schedule.draws.transition[d, a, s]):
            if p * q > 0:
                worth += schedule.discount * p * q * _from(schedule, policy, d, t, k + 1, after)
    return worth


def expectimax(schedule, joint=None, k=0) -> list[float]:
    """Value of each action at event `k` by plain recursion over all histories, nothing left out."""
    joint = schedule.start() if joint is None else joint
    out = []
    for c in range(len(schedule.mode(k).actions)):
        a = schedule.first_action(k) + c
        worth = float(np.sum(joint @ schedule.reward[a]))
        for o in range(schedule.n_outcomes(k)):
            after = schedule.after(joint, a, o if schedule.mode(k).shows_response else None)
            if k + 1 < schedule.n_events:
                worth += schedule.discount * max(expectimax(schedule, after, k + 1))
            elif schedule.terminal is not None:
                worth += schedule.discount * float(np.sum(after @ schedule.terminal))
        out.append(worth)
    return out


def _response_histories(schedule, k):
    shown = [j for j in range(k) if schedule.mode(j).shows_response]
    return list(product(range(schedule.protocol.n_responses), repeat=len(shown)))
