"""Value against expected discounted cost without a horizon: both frontiers, and policies worth what they say."""

import numpy as np
import pytest

from models.errors import InputError
from models.planning import endless_cost as module
from models.planning.budget_problem import budget_problem
from models.planning.charges import charges_of
from models.planning.endless_cost import endless_cost_frontier
from models.planning.finite_memory import infinite_value
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating
from models.planning.solver import solve
from models.protocol import PUBLISHED
from tests.models.planning.policy_cases import person
from tests.models.planning.schedule_cases import random_model

DISCOUNT = 0.9


@pytest.fixture(scope="module")
def process():
    return alternating(PUBLISHED, "H")


@pytest.fixture(scope="module")
def frontier(process):
    return endless_cost_frontier(person(), process, DISCOUNT)


def test_ends(frontier, process):
    full = solve(latent_problem(person(), process, DISCOUNT))
    free = solve(budget_problem(person(), process, DISCOUNT, 0)[0])
    assert frontier.points[0].cost == 0
    assert free.lower - 1e-6 <= frontier.points[0].value <= free.upper + 1e-6
    assert frontier.points[-1].value >= full.lower - 1e-6
    assert frontier.upper_at(1e6) == pytest.approx(full.upper, rel=1e-3)
    assert frontier.value_at(1e6) == frontier.points[-1].value


def test_both_sides(frontier):
    assert frontier.status == "converged"
    size = max(abs(p.value) for p in frontier.points)
    assert frontier.gap <= 1e-3 * size
    for limit in np.linspace(0, 1.2 * frontier.points[-1].cost, 60):
        low, high = frontier.value_at(limit), frontier.upper_at(limit)
        assert low <= high + 1e-9
        assert high - low <= 1e-3 * size + 1e-9
    slopes = np.diff([p.value for p in frontier.points]) / np.diff([p.cost for p in frontier.points])
    assert np.all(slopes > 0)
    assert np.all(np.diff(slopes) < 0)


def test_policies_are_worth_and_cost_what_is_said(frontier):
    charge = dict(zip(PUBLISHED.action_names, charges_of(person()), strict=True))
    for share in (0.0, 0.2, 0.55, 1.0, 1.5):
        limit = share * frontier.points[-1].cost
        policy = frontier.policy(limit)
        found = infinite_value(policy, frontier.problem)
        spent = sum(p * charge[a] for a, p in found.frequencies.items()) / (1 - DISCOUNT)
        assert found.value == pytest.approx(frontier.value_at(limit), rel=1e-9)
        assert spent == pytest.approx(min(limit, frontier.points[-1].cost), rel=1e-9, abs=1e-9)


def test_hard_budgets_are_below_it(frontier, process):
    """Spending at most so much in all is spending at most so much discounted."""
    for budget in (15, 30, 60):
        found = solve(budget_problem(person(), process, DISCOUNT, budget)[0])
        assert found.lower <= frontier.upper_at(budget) + 1e-9


def test_weak_duality_at_prices_it_has_not_asked_for(frontier, process):
    """A policy that is best at any price is a point below the upper frontier."""
    from dataclasses import replace

    charge = dict(zip(PUBLISHED.action_names, charges_of(person()), strict=True))
    for price in (0.05, 0.33, 0.77, 1.9):
        choices = tuple(
            tuple(replace(c, reward=c.reward - price * charge[c.action]) for c in offered)
            for offered in frontier.problem.choices
        )
        found = solve(replace(frontier.problem, choices=choices))
        best = max(p.value - price * p.cost for p in frontier.points)
        assert best <= found.upper + 1e-9
        costs = np.linspace(0, 2 * frontier.points[-1].cost + 1, 400)
        assert max(frontier.upper_at(c) - price * c for c in costs) >= found.lower - 1e-3 * abs(found.lower)


def test_random_models():
    for seed in range(4):
        model = random_model(np.random.default_rng(seed), PUBLISHED, 2)
        found = endless_cost_frontier(model, None, 0.8, charges_of(model, "count"))
        assert found.status == "converged"
        assert found.points[0].cost == 0
        assert found.gap <= 1e-3 * max(abs(p.value) for p in found.points) + 1e-9


def test_words(frontier):
    assert list(frontier.table.columns) == ["cost", "value", "upper", "nodes"]
    assert "Without horizon (discount 0.9)" in frontier.sentence


def test_prices_run_out(monkeypatch, process):
    monkeypatch.setattr(module, "MOST_PRICES", 3)
    found = endless_cost_frontier(person(), process, DISCOUNT, precision=1e-4)
    assert found.status == "prices"
    assert found.gap > 1e-4 * found.points[-1].value
    for limit in np.linspace(0, found.points[-1].cost, 20):
        assert found.value_at(limit) <= found.upper_at(limit) + 1e-9


def test_what_it_refuses(frontier):
    with pytest.raises(InputError, match="discount"):
        endless_cost_frontier(person(), None, 1.0)
    with pytest.raises(InputError, match="precision"):
        endless_cost_frontier(person(), precision=0)
    for ask in (frontier.value_at, frontier.upper_at, frontier.policy):
        with pytest.raises(InputError, match="limit of the expected cost"):
            ask(-1)
