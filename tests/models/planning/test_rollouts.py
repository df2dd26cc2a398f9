"""Simulated runs where nothing is left to chance: the interval must hold the value however sums are rounded."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.planning.baselines import ModePolicy
from models.planning.finite_memory import infinite_value
from models.planning.policies import Vocabulary
from models.planning.rollouts import beside, simulate_policies
from models.planning.textbook import textbook_problem


def certain_world(rewards, discount):
    """States one after the other, each worth its own reward; the last one stays."""
    n = len(rewards)
    move = np.eye(n, k=1)
    move[-1, -1] = 1.0
    table = np.array([rewards, rewards[::-1]])
    return textbook_problem([move, move], np.ones((2, n, 1)), table, discount, np.eye(n)[0])


def first_only(world, choice):
    words = Vocabulary.of(world)
    return ModePolicy(words, [np.eye(2)[choice]], f"only {choice}")


def exact(rewards, discount, steps):
    """Discounted sum in rational arithmetic."""
    g = Fraction(discount)
    return sum(g**k * Fraction(rewards[min(k, len(rewards) - 1)]) for k in range(steps))


NUMBERS = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=5)


@given(NUMBERS, st.floats(0.01, 1.0), st.integers(1, 60), st.integers(2, 300))
def test_the_interval_of_certain_returns_holds_the_sum(rewards, discount, steps, runs):
    world = certain_world(rewards, discount)
    options = {"runs": runs, "steps": steps, "seed": 3}
    one, other = simulate_policies([first_only(world, 0), first_only(world, 1)], world, **options)
    truth = exact(rewards, discount, steps)
    assert Fraction(one.low) <= truth <= Fraction(one.high)
    assert abs(truth - Fraction(one.value)) <= Fraction(one.rounding) + Fraction(one.error)
    assert one.rounding <= 1e-10 * max(map(abs, rewards)) * steps
    opposite = exact(rewards[::-1], discount, steps)
    difference = beside(one, other, float(opposite))
    assert abs(truth - Fraction(difference.value)) <= Fraction(difference.rounding) + Fraction(difference.error)


@pytest.mark.parametrize("seed", range(60))
def test_the_interval_of_certain_returns_holds_the_value_without_horizon(seed):
    rng = np.random.default_rng(seed)
    world = certain_world(rng.normal(size=4) * 10.0 ** rng.integers(-6, 6), float(rng.uniform(0.1, 0.95)))
    policy = first_only(world, 0)
    found = simulate_policies([policy], world, runs=50, steps=900)[0]
    known = infinite_value(policy, world)
    assert found.error <= found.rounding
    assert found.low - known.error <= known.value <= found.high + known.error
