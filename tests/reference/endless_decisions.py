"""What actions are worth without a horizon, by looking so many rounds ahead: twin of the compiled decisions."""

from __future__ import annotations

import numpy as np


def action_bounds(problem, mode, belief, rounds):
    """Lower and upper bound of each choice; beyond the rounds the least and the most there can be for ever."""
    rewards = np.concatenate([c.reward for offered in problem.choices for c in offered])
    ends = np.array([rewards.min(), rewards.max()]) / (1 - problem.discount)
    return [_choice(problem, mode, belief, c, rounds, ends) for c in range(len(problem.choices[mode]))]


def _choice(problem, mode, belief, choice, rounds, ends):
    worth = np.full(2, belief @ problem.choices[mode][choice].reward)
    for after, _, p, reached in problem.outcomes(mode, choice, belief):
        worth += problem.discount * p * _best(problem, after, reached, rounds - 1, ends)
    return worth


def _best(problem, mode, belief, rounds, ends):
    if rounds == 0:
        return ends
    choices = [_choice(problem, mode, belief, c, rounds, ends) for c in range(len(problem.choices[mode]))]
    return np.max(choices, axis=0)
