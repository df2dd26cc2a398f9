"""A budget without a horizon: bounds against long finite horizons, runs that never exceed it."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.planning import budget_problem as module
from models.planning.budget_plan import solve_with_budget
from models.planning.budget_problem import budget_problem
from models.planning.charges import charges_of
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating, bernoulli
from models.planning.product_policy import ProductPolicy
from models.planning.rollouts import simulate_policy
from models.planning.schedule import Schedule
from models.planning.solver import solve
from models.protocol import PUBLISHED
from tests.models.planning.budget_cases import random_charges
from tests.models.planning.policy_cases import person
from tests.models.planning.schedule_cases import random_model
from tests.random_cases import protocols

HUMAN, ROBOT = 0, 1


def bracket(model, process, discount, budget, charges, events):
    """Bounds of the optimum from the best plan of the first events, what comes after at its least and most."""
    first = int(process.start.argmax())
    modes = [(first + k) % len(process.start) for k in range(events)]
    names = [model.protocol.modes[m].name for m in modes]
    schedule = Schedule.of(model, names, discount)
    value = solve_with_budget(schedule, budget, charges).value
    rest = discount**events / (1 - discount)
    reward = model.reward_table()
    return value + rest * reward.min(), value + rest * reward.max()


@given(protocols(), st.integers(0, 2**32 - 1), st.integers(1, 3), st.sampled_from([0.0, 0.3, 1.1, 2.6]))
@settings(max_examples=20, deadline=None)
def test_bounds_bracket_long_horizons(protocol, seed, n, budget):
    rng = np.random.default_rng(seed)
    model, charges = random_model(rng, protocol, n), random_charges(rng, protocol)
    process, discount = alternating(protocol), 0.2
    problem, _ = budget_problem(model, process, discount, budget, charges)
    found = solve(problem, 1e-6)
    low, high = bracket(model, process, discount, budget, charges, 6)
    slack = 1e-6 * max(1.0, abs(low), abs(high))
    assert found.upper >= low - slack
    assert found.lower <= high + slack
    assert found.upper - found.lower <= 2e-6 * max(1.0, abs(found.upper))


@pytest.mark.parametrize("budget", [0, 15, 30, 60])
def test_published_protocol_against_twelve_events(budget):
    process = alternating(PUBLISHED, "H")
    problem, _ = budget_problem(person(), process, 0.4, budget)
    found = solve(problem, 1e-7)
    low, high = bracket(person(), process, 0.4, budget, charges_of(person()), 12)
    assert low - 1e-3 <= found.lower <= found.upper <= high + 1e-3
    assert high - low < 0.01


def test_enough_money_is_no_limit():
    process = alternating(PUBLISHED, "H")
    plain = solve(latent_problem(person(), process, 0.5), 1e-6)
    rich = solve(budget_problem(person(), process, 0.5, 600)[0], 1e-6)
    assert rich.lower <= plain.upper + 1e-6
    assert rich.upper >= plain.lower - 1e-4 * abs(plain.lower)


def test_values_rise_with_the_budget():
    found = [solve(budget_problem(person(), None, 0.9, b)[0]) for b in (0, 15, 30, 45, 60)]
    for poor, rich in pairwise(found):
        assert rich.upper >= poor.lower


@pytest.mark.parametrize(("budget", "charges"), [(45, None), (20, None), (2.0, [0, 1.5, 0, 0.25]), (0, None)])
def test_runs_never_exceed_it(budget, charges):
    process = alternating(PUBLISHED, "H")
    problem, product = budget_problem(person(), process, 0.9, budget, charges)
    policy = ProductPolicy.of(solve(problem).policy, product, person())
    own = charges_of(person()) if charges is None else np.array(charges)
    rng, model = np.random.default_rng(5), person()
    total = 0.0
    for run in range(60):
        memory, spent, s = policy.begin(ROBOT), 0.0, rng.choice(3, p=model.initial)
        others = run % 2 == 1
        for _ in range(60):
            m = policy.mode_of(memory)
            chosen = policy.act(memory)
            done = int(rng.integers(2)) if others and rng.random() < 0.2 else chosen
            charge = own[2 * m + done]
            if done == chosen:
                assert charge == 0 or spent + charge <= budget + 1e-9
                total += charge
            assert policy.left_of(memory) <= max(budget - spent, 0) + 1e-9
            spent += charge
            row = PUBLISHED.emission_index[2 * m + done]
            seen = 0 if row < 0 else 1 + int(rng.choice(2, p=model.emission[row, s]))
            memory = policy.observe(memory, done, None if m == ROBOT and rng.random() < 0.1 else seen, 1 - m)
            s = rng.choice(3, p=model.transition[2 * m + done, s])
        assert others or spent <= budget + 1e-9
    assert (total > 0) == (budget > 0)


@pytest.mark.parametrize(
    "process", [alternating(PUBLISHED, "H"), bernoulli(PUBLISHED, 0.4)], ids=["turns", "chance"]
)
def test_simulated_runs_are_those_of_the_product(process):
    """On the same luck: plain modes with the budget in the memory, and the problem whose modes hold it."""
    problem, product = budget_problem(person(), process, 0.9, 45)
    found = solve(problem)
    policy = ProductPolicy.of(found.policy, product, person())
    runs = simulate_policy(policy, latent_problem(person(), process, 0.9), runs=4000)
    inner = simulate_policy(found.policy, problem, runs=4000)
    assert runs.returns == pytest.approx(inner.returns)
    assert found.lower - 4 * runs.error <= runs.value <= found.upper + 4 * runs.error


def test_amounts_are_sums_of_charges():
    problem, product = budget_problem(person(), alternating(PUBLISHED), 0.9, 1.0, [0, 0.3, 0, 0.5])
    assert sorted(set(product.left.tolist())) == [0, 0.3, 0.5, 0.6, 0.8, 0.9, 1.0]
    assert len(problem.modes) == 14
    assert np.array_equal(product.allowed[:7, 1], np.array([0, 0.3, 0.5, 0.6, 0.8, 0.9, 1.0]) >= 0.3)


def test_starts_where_the_process_does():
    problem, product = budget_problem(person(), bernoulli(PUBLISHED, 1.0), 0.9, 15)
    policy = ProductPolicy.of(solve(problem).policy, product, person())
    assert policy.left_of(policy.begin(HUMAN)) == 15
    with pytest.raises(InputError, match="first mode: found 'robot_needs_help', wanted human_needs_help"):
        policy.begin(ROBOT)


def test_what_it_refuses(monkeypatch):
    with pytest.raises(InputError, match="budget: found -1"):
        budget_problem(person(), None, 0.9, -1)
    with pytest.raises(InputError, match="budget: found"):
        budget_problem(person(), None, 0.9, float("inf"))
    with pytest.raises(InputError, match="charges, shape"):
        budget_problem(person(), None, 0.9, 15, [1.0])
    monkeypatch.setattr(module, "MOST_AMOUNTS", 3)
    with pytest.raises(InputError, match="more than 3 amounts left"):
        budget_problem(person(), None, 0.9, 60)
