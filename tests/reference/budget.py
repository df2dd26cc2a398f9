"""Plans within a budget the slow way: histories by recursion, all plans tried, mixtures by a linear program."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from tests.reference.all_plans import all_plans


def history_sums(schedule, k=0, joint=None, seen=(), affordable=lambda k, seen: True):
    """By history: expected reward of each choice, and probability; the twin of `budget_kernel.history_rewards`.

    Histories are tuples of (choice, response); those that take a choice that is not `affordable` are left out.
    """
    joint = schedule.start() if joint is None else joint
    out, rewards = {}, []
    for c in range(len(schedule.mode(k).actions)):
        a = schedule.first_action(k) + c
        worth = float((joint @ schedule.reward[a]).sum())
        for o in range(schedule.n_outcomes(k)):
            shows = schedule.mode(k).shows_response
            after = schedule.after(joint, a, o if shows else None)
            if k + 1 == schedule.n_events:
                if schedule.terminal is not None:
                    worth += schedule.discount * float((after @ schedule.terminal).sum())
            elif affordable(k, (*seen, (c, o))):
                out.update(history_sums(schedule, k + 1, after, (*seen, (c, o)), affordable))
        rewards.append(schedule.discount**k * worth)
    out[seen] = (rewards, float(joint.sum()))
    return out


def most_spent(schedule, plan, charges):
    """Largest sum of charges over all sequences of responses, possible or not."""
    spent = np.zeros(1)
    for k, level in enumerate(plan):
        spent = spent + charges[schedule.first_action(k) + level.astype(int)]
        if k + 1 < len(plan):
            spent = np.repeat(spent, schedule.n_outcomes(k))
    return float(spent.max())


def plans_with_costs(schedule, charges):
    """Every deterministic plan: value, expected cost (not discounted), most that it spends."""
    plans, values = all_plans(schedule)
    priced = replace(schedule, discount=1.0, terminal=None)
    priced.__dict__["reward"] = np.tile(charges[:, None], (1, schedule.n_states))
    _, costs = all_plans(priced)
    weight = schedule.draws.weight
    spent = np.array([most_spent(schedule, p, charges) for p in plans])
    return values @ weight, costs @ weight, spent


def best_in_expectation(values, costs, limit):
    """Largest value of a mixture of plans with an expected cost of at most `limit`."""
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    found = linprog(
        -values, costs[None], [limit], np.ones((1, len(values))), [1.0], [(0, None)] * len(values), options=options
    )  # fmt: skip
    assert found.status == 0, found.message
    return -found.fun
