"""The value of information by definition: every draw, every data set, every history, one after the other."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import prod

import numpy as np

from tests.reference.finite_horizon import expectimax


def best_value(schedule, weight) -> float:
    """What the best plan is worth under other weights, which need not sum to one."""
    total = float(np.sum(weight))
    if total == 0:
        return 0.0
    draws = replace(schedule.draws, weight=np.asarray(weight) / total)
    return total * max(expectimax(replace(schedule, draws=draws)))


def perfect_value(schedule, kinds=1) -> float:
    """EVPI; with kinds, of knowing the draw but not the kind of person."""
    weight = schedule.draws.weight
    told = 0.0
    for begin in range(0, len(weight), kinds):
        own = np.zeros_like(weight)
        own[begin : begin + kinds] = weight[begin : begin + kinds]
        told += best_value(schedule, own)
    return told - best_value(schedule, weight)


def grouped_value(schedule, group) -> float:
    """What it is worth to be told the group of the true draw."""
    weight = schedule.draws.weight
    told = sum(best_value(schedule, np.where(group == g, weight, 0.0)) for g in np.unique(group))
    return told - best_value(schedule, weight)


def arm_histories(arm) -> list[list[tuple[int, int | None]]]:
    """All histories of an arm as (action, response), in the order of the arm's table."""
    p, events = arm.protocol, []
    last = max((k for k, m in enumerate(arm.modes) if p.modes[m].shows_response), default=-1)
    for m, chance in list(zip(arm.modes, arm.actions, strict=True))[: last + 1]:
        first = p.mode_of_action.index(m)
        actions = [first + a for a, c in enumerate(chance) if c > 0]
        responses = range(p.n_responses) if p.modes[m].shows_response else [None]
        events.append(list(product(actions, responses)))
    return [list(h) for h in product(*events)]


def history_probability(draws, d, arm, history) -> float:
    """Sum over all state paths."""
    p, total = draws.protocol, 0.0
    chance = prod(arm.actions[k][a - p.mode_of_action.index(arm.modes[k])] for k, (a, _) in enumerate(history))
    for path in product(range(draws.n_states), repeat=len(history)):
        worth = draws.initial[d, path[0]] if path else 1.0
        for k, (a, o) in enumerate(history):
            if o is not None:
                worth *= draws.emission[d, p.emission_index[a], path[k], o]
            if k + 1 < len(history):
                worth *= draws.transition[d, a, path[k], path[k + 1]]
        total += worth
    return chance * total


def sample_value(schedule, study, people, kinds=1) -> float:
    """EVSI: the sum over all ordered lists of histories that the participants may show."""
    draws, weight = schedule.draws, schedule.draws.weight
    columns = []
    for arm, share in zip(study.arms, study.shares, strict=True):
        for history in arm_histories(arm):
            own = np.array([history_probability(draws, d, arm, history) for d in range(draws.n_draws)])
            # A participant is one kind of person, and not the one who is served afterwards.
            both = weight.reshape(-1, kinds)
            mixed = (both * own.reshape(-1, kinds)).sum(axis=1) / both.sum(axis=1)
            columns.append(share * np.repeat(mixed, kinds))
    told = 0.0
    for data in product(range(len(columns)), repeat=people):
        told += best_value(schedule, weight * np.prod([columns[h] for h in data], axis=0))
    return told - best_value(schedule, weight)
