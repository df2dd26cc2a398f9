"""Spending limited in expectation: the frontier against a linear program over all plans."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_files import read_model
from models.planning.budget_plan import budget_values, solve_with_budget
from models.planning.charges import charges_of
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.expected_cost import cost_frontier
from models.planning.schedule import Schedule
from models.reward import Reward
from tests.models.planning.budget_cases import charged_schedules
from tests.models.planning.policy_cases import person
from tests.models.planning.policy_conformance import conforms
from tests.planning_cases import sticky_draws
from tests.random_cases import make_protocol
from tests.reference.budget import best_in_expectation, plans_with_costs

SHARES = (0.0, 0.1, 0.37, 0.5, 0.9, 1.0, 1.3)


@pytest.fixture(scope="module")
def truth(shared):
    return read_model(shared / "data" / "calibrated_truth.json")


@given(charged_schedules(), st.sampled_from(SHARES))
def test_equals_the_linear_program(case, share):
    schedule, charges = case
    values, costs, _ = plans_with_costs(schedule, charges)
    frontier = cost_frontier(schedule, charges)
    limit = share * float(costs.max())
    size = max(1.0, float(np.abs(values).max()))
    assert frontier.value_at(limit) == pytest.approx(best_in_expectation(values, costs, limit), abs=2e-8 * size)
    mixture = frontier.mixture(limit)
    found = evaluate_schedule(mixture, schedule)
    assert found.value == pytest.approx(frontier.value_at(limit), abs=1e-9 * size)
    spent = expected_charge(schedule, mixture, charges)
    assert spent <= limit + 1e-9
    if frontier.price_at(limit) > 0:
        assert spent == pytest.approx(limit, abs=1e-9)


def expected_charge(schedule, policy, charges):
    found = evaluate_schedule(policy, schedule)
    by_name = dict(zip(schedule.protocol.action_names, charges.tolist(), strict=True))
    return sum(p * by_name[a] for event in found.action_path for a, p in event.items())


@given(charged_schedules())
def test_corners_are_plans_best_at_their_prices(case):
    schedule, charges = case
    values, costs, _ = plans_with_costs(schedule, charges)
    frontier = cost_frontier(schedule, charges)
    size = max(1.0, float(np.abs(values).max()))
    assert frontier.points[0].highest_price == np.inf
    assert frontier.points[-1].lowest_price == 0
    for point in frontier.points:
        prices = (point.lowest_price, min(point.highest_price, point.lowest_price + 10))
        for price in prices:
            best = (values - price * costs).max()
            assert point.value - price * point.cost == pytest.approx(best, abs=1e-7 * size * (1 + price))
    slopes = np.diff([p.value for p in frontier.points]) / np.diff([p.cost for p in frontier.points])
    assert np.all(slopes > 0)
    assert np.all(np.diff(slopes) < 0)


@given(charged_schedules(max_events=5, most_plans=10**9))
@settings(max_examples=30)
def test_ends_are_the_free_and_the_unconstrained_plan(case):
    schedule, charges = case
    frontier = cost_frontier(schedule, charges)
    free, full = frontier.points[0], frontier.points[-1]
    close = {"rel": 1e-9, "abs": 1e-8}
    assert free.cost == 0
    assert free.value == pytest.approx(solve_with_budget(schedule, 0, charges).value, **close)
    assert full.value == pytest.approx(solve_schedule(schedule).value, **close)
    assert frontier.value_at(1e9) == full.value


def test_published_schedule(truth):
    schedule = Schedule.of(truth, "HRHRHRHRH")
    frontier = cost_frontier(schedule)
    assert round(frontier.points[0].value, 1) == 162.6
    assert round(frontier.points[-1].value, 1) == 219.4
    assert frontier.points[-1].cost == pytest.approx(45)
    hard = budget_values(schedule)
    for budget, value in zip(hard.budgets, hard.values, strict=True):
        assert value <= frontier.value_at(budget) + 1e-9
    # Randomising pays: a limit of 15 on every path costs something against 15 in expectation.
    assert frontier.value_at(15) > hard.value_at(15) + 0.3
    found = evaluate_schedule(frontier.mixture(15), schedule)
    assert found.cost == pytest.approx(15, abs=1e-10)
    assert found.value == pytest.approx(frontier.value_at(15), abs=1e-9)
    assert frontier.table.shape == (len(frontier.points), 4)
    assert "from 162.6 to 219.4 reward units" in frontier.sentence


def test_many_draws_count_together():
    draws = sticky_draws(7, 2, 3)
    schedule = Schedule.of(draws, "HRHRH")
    frontier = cost_frontier(schedule)
    limit = 0.4 * frontier.points[-1].cost
    found = evaluate_schedule(frontier.mixture(limit), schedule)
    assert found.cost == pytest.approx(limit, abs=1e-9)
    assert found.value == pytest.approx(frontier.value_at(limit), abs=1e-9)


def test_nothing_that_costs_is_worth_it():
    schedule = Schedule.of(person(), "RH")
    frontier = cost_frontier(schedule, charges_of(person(), "count"))
    assert len(cost_frontier(Schedule.of(person(), "R")).points) == 1
    assert "nothing worth its while costs anything" in cost_frontier(Schedule.of(person(), "R")).sentence
    assert frontier.value_at(3) == pytest.approx(solve_schedule(schedule).value)
    assert frontier.price_at(100) == 0


def test_cheapest_of_equal_plans():
    """Two actions that do and cost the person the same, one charged twice as much as the other."""
    protocol = make_protocol([True], [3], 2)
    stay, up = np.eye(2), np.array([[0.1, 0.9], [0.0, 1.0]])
    model = LatentStatePOMDP(
        [0.7, 0.3], [stay, up, up], np.full((3, 2, 2), 0.5), protocol,
        reward=Reward((0.0, 10.0), 0.3, {"act00": 0.0, "act01": 1.0, "act02": 1.0}),
    )  # fmt: skip
    frontier = cost_frontier(Schedule.of(model, "AAA"), [0.0, 2.0, 1.0])
    assert [p.cost for p in frontier.points] == [0.0, 1.0, 2.0]
    assert frontier.points[-1].value == pytest.approx(solve_schedule(Schedule.of(model, "AAA")).value)


def test_conformance(truth, tmp_path):
    schedule = Schedule.of(truth, "HRHRHRHRH")
    for limit in (0, 20, 45):
        conforms(cost_frontier(schedule).mixture(limit), truth, schedule.modes, tmp_path)


@pytest.mark.parametrize("limit", [-1, float("nan"), "15"])
def test_limits_that_are_none(limit):
    frontier = cost_frontier(Schedule.of(person(), "HRH"))
    for ask in (frontier.value_at, frontier.price_at, frontier.mixture):
        with pytest.raises(InputError, match="limit of the expected cost"):
            ask(limit)
