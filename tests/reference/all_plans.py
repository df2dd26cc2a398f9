"""Every deterministic plan of a schedule with its value in every draw; criteria over them by a plain program."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import linprog

from tests.reference.finite_horizon import policy_value


def count_plans(schedule):
    """How many deterministic plans there are."""
    total, histories = 1, 1
    for k in range(schedule.n_events):
        total *= len(schedule.mode(k).actions) ** histories
        histories *= schedule.n_outcomes(k)
    return total


def all_plans(schedule):
    """Plans as the workbench has them (action by number of the responses), and values ``[plan, draw]``."""
    end = np.zeros(schedule.n_states) if schedule.terminal is None else schedule.terminal
    draws = schedule.draws
    # Backwards: every plan of the events from k on, as its tree and its value by draw and state.
    rest = [((), np.tile(end, (draws.n_draws, 1)))]
    for k in range(schedule.n_events - 1, -1, -1):
        grown = []
        for c in range(len(schedule.mode(k).actions)):
            a = schedule.first_action(k) + c
            row = schedule.protocol.emission_index[a]
            for follow in product(rest, repeat=schedule.n_outcomes(k)):
                worth = np.tile(schedule.reward[a], (draws.n_draws, 1))
                for o, (_, after) in enumerate(follow):
                    chance = 1.0 if row < 0 else draws.emission[:, row, :, o]
                    ahead = np.einsum("dst,dt->ds", draws.transition[:, a], after)
                    worth = worth + schedule.discount * chance * ahead
                grown.append(((c, tuple(tree for tree, _ in follow)), worth))
        rest = grown
    plans = [_levels(tree, schedule.n_events) for tree, _ in rest]
    return plans, np.array([np.sum(draws.initial * worth, axis=1) for _, worth in rest])


def _levels(tree, events):
    """A tree of actions as one array an event, histories in order of their numbers."""
    level, out = [tree], []
    for _ in range(events):
        out.append(np.array([node[0] for node in level], dtype=np.int8))
        level = [after for node in level for after in node[1]]
    return tuple(out)


def values_of(schedule, plan):
    """Value of one plan in every draw, draw by draw."""
    tables = []
    seen = [()]
    for k, level in enumerate(plan):
        tables.append(dict(zip(seen, level.tolist(), strict=True)))
        if schedule.n_outcomes(k) > 1:
            seen = [(*h, o) for h in seen for o in range(schedule.n_outcomes(k))]
    out = []
    for d in range(schedule.draws.n_draws):
        draws = schedule.draws
        alone = replace(
            draws, initial=draws.initial[d : d + 1], transition=draws.transition[d : d + 1],
            emission=draws.emission[d : d + 1], weight=np.ones(1),
        )  # fmt: skip
        out.append(policy_value(replace(schedule, draws=alone), tables))
    return np.array(out)


def best_mean_cvar(outcomes, weight, alpha, mean_share=0.0):
    r"""Largest :math:`\kappa E + (1 - \kappa) CVaR_\alpha` over mixtures, by Rockafellar and Uryasev's program."""
    plans, draws = outcomes.shape
    # Columns: shares, threshold, shortfalls.
    cost = np.concatenate([-mean_share * outcomes @ weight, [-(1 - mean_share)], (1 - mean_share) * weight / alpha])
    matrix = np.hstack([-outcomes.T, np.ones((draws, 1)), -np.eye(draws)])
    total = np.concatenate([np.ones(plans), [0.0], np.zeros(draws)])[None]
    bounds = [(0, None)] * plans + [(None, None)] + [(0, None)] * draws
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    found = linprog(cost, matrix, np.zeros(draws), total, [1.0], bounds, options=options)
    assert found.status == 0, found.message
    return -found.fun


def best_worst(outcomes, weight):
    """Largest worst outcome over mixtures, of the draws with weight."""
    outcomes = outcomes[:, weight > 0]
    plans, draws = outcomes.shape
    cost = np.concatenate([np.zeros(plans), [-1.0]])
    matrix = np.hstack([-outcomes.T, np.ones((draws, 1))])
    total = np.concatenate([np.ones(plans), [0.0]])[None]
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    found = linprog(
        cost, matrix, np.zeros(draws), total, [1.0], [(0, None)] * plans + [(None, None)], options=options
    )
    assert found.status == 0, found.message
    return -found.fun
