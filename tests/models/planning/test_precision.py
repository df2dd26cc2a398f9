"""When a gap is small enough: where the optimum is zero, and whatever the unit and the origin of the rewards."""

from dataclasses import replace

import numpy as np
import pytest

from models.planning import solver
from models.planning.batch import solve_draws
from models.planning.latent import LatentBatch
from models.planning.precision import gap_wanted, relative_gap, value_size
from models.planning.problem import Problem
from models.planning.problems import problem as standard_problem
from models.planning.solver import solve
from models.planning.textbook import textbook_problem
from models.reward import Reward, default_x
from tests.planning_cases import CASES, dense_problem, latent_case, mode_processes, sparse_problem, sticky_draws
from tests.reference import planning_numpy as reference


def rescaled(problem: Problem, factor: float, shift: float = 0.0) -> Problem:
    return replace(problem, choices=tuple(
        tuple(replace(c, reward=factor * c.reward + shift) for c in offered) for offered in problem.choices
    ))  # fmt: skip


def graph_value(solution) -> float:
    values = reference.controller_values(solution.problem, solution.mode, solution.choice, solution.follow)
    return sum(
        max(joint @ v for v, m in zip(values, solution.mode, strict=True) if m == x)
        for x, joint in enumerate(solution.problem.initial) if joint.sum() > 0
    )  # fmt: skip


def test_one_rule():
    assert value_size(-3.0, 2.0, 1.0) == 3
    assert value_size(-1e-9, 0.0, 1e-6) == 1e-6
    assert gap_wanted(1e-3, True, 2.0, 4.0, 1.0) == 4e-3
    assert gap_wanted(1e-3, False, 2.0, 4.0, 1.0) == 1e-3
    assert relative_gap(0.0, 0.0, 0.0) == 0
    assert relative_gap(0.0, 1e-6, 1e-6) == 1


def test_span_and_largest_value():
    problem = dense_problem(1, 3)
    rewards = np.stack([c.reward for c in problem.choices[0]])
    assert problem.span == pytest.approx(np.ptp(rewards) / 0.1)
    assert problem.largest_value == pytest.approx(np.abs(rewards).max() / 0.1)
    assert rescaled(problem, 2.0, 5.0).span == pytest.approx(2 * problem.span)
    assert np.isinf(problem.with_discount(1.0).span)
    assert rescaled(problem, 0.0).with_discount(1.0).span == 0


@pytest.mark.parametrize("n", [2, 14])
@pytest.mark.parametrize("even", [True, False])
def test_an_optimum_of_zero_is_found(n, even):
    """A fair coin that is never seen, or nothing to be had at all."""
    rng = np.random.default_rng(n)
    t, o = rng.dirichlet(np.ones(n), size=(2, n)), rng.dirichlet(np.ones(2), size=(2, n))
    reward = np.stack([np.zeros(n), -rng.random(n) - 0.1])
    if even:
        t, o = np.full((2, n, n), 1 / n), np.ones((2, n, 1))
        sign = np.where(np.arange(n) % 2, 1.0, -1.0)
        reward = np.stack([sign, -sign])
    solution = solve(textbook_problem(t, o, reward, 0.95), time_limit=20)
    assert solution.status == "converged"
    assert solution.relative_gap <= 1e-3
    assert solution.gap <= 1e-9 * solution.problem.span
    assert solution.lower <= 1e-12 * solution.problem.span
    assert solution.upper >= -1e-12 * solution.problem.span


@pytest.mark.parametrize("search", ["grid", "trials"])
@pytest.mark.parametrize("name", ["tiger", "dense 2", "modal 3", "latent 1 alternating"])
@pytest.mark.parametrize(("factor", "shift"), [(1e-11, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 30.0), (1e-6, -1e-4)])
def test_units_and_origin_of_rewards_change_nothing(search, name, factor, shift, monkeypatch):
    if search == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    problem = standard_problem("tiger") if name == "tiger" else CASES[name]
    wanted = (1e-3 if search == "grid" else 1e-2) * problem.span
    one = solve(problem, wanted, relative=False, time_limit=20)
    other = solve(rescaled(problem, factor, shift), wanted * factor, relative=False, time_limit=20)
    assert one.status == other.status == "converged"
    low, high = ((v - shift / (1 - problem.discount)) / factor for v in (other.lower, other.upper))
    slack = 1e-9 * problem.span
    # Not only do the intervals meet: each bound is the same up to rounding that decided a tie.
    assert one.lower <= high + slack
    assert low <= one.upper + slack
    assert (low, high) == pytest.approx((one.lower, one.upper), abs=1.01 * wanted)
    assert graph_value(other) >= other.lower - 1e-9 * other.problem.span


def test_scaled_by_powers_of_two_everything_is_the_same_bit_by_bit():
    for problem in (CASES["dense 2"], latent_case(5), sparse_problem(3, 16, 2, 3, 0.6)):
        one = solve(problem, 1e-2, time_limit=20)
        for power in (-30, 40):
            other = solve(rescaled(problem, 2.0**power), 1e-2, time_limit=20)
            assert other.status == one.status == "converged"
            assert (other.lower, other.upper) == (one.lower * 2.0**power, one.upper * 2.0**power)
            np.testing.assert_array_equal(other.alpha, one.alpha * 2.0**power)


def test_an_action_that_nobody_takes_loosens_nothing():
    problem = CASES["dense 2"]
    absurd = replace(problem.choices[0][0], action="absurd", reward=np.full(4, -1e9))
    wider = replace(problem, choices=((*problem.choices[0], absurd),))
    assert wider.least_size < 0.1 * abs(solve(problem).upper)
    solution = solve(wider, 1e-4, time_limit=20)
    assert solution.status == "converged"
    assert solution.gap <= 1e-4 * max(abs(solution.lower), abs(solution.upper))


@pytest.mark.parametrize("search", ["grid", "trials"])
@pytest.mark.parametrize("worth", [1e9, -1e9])
def test_a_state_that_nothing_leads_to_loosens_nothing(search, worth, monkeypatch):
    if search == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    t, o, reward = np.zeros((3, 3, 3)), np.full((3, 3, 2), 0.5), np.full((3, 3), worth)
    for a, choice in enumerate(standard_problem("tiger").choices[0]):
        t[a, :2, :2] = choice.branches[0].transition.toarray()
        o[a, :2] = choice.branches[0].emission.toarray()
        reward[a, :2] = choice.reward
    t[:, 2, 2] = 1.0
    solution = solve(textbook_problem(t, o, reward, 0.95, [0.5, 0.5, 0.0]), 1e-3, time_limit=20)
    assert solution.status == "converged"
    assert solution.lower <= 19.37136838
    assert solution.upper >= 19.37136837
    assert solution.gap <= 1.1e-3 * solution.upper


@pytest.mark.parametrize("search", ["grid", "trials"])
def test_no_gap_at_all_is_too_much_to_ask(search, monkeypatch):
    """The search ends when rounding is all that is left, rather than with the time."""
    if search == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    solution = solve(standard_problem("tiger"), 0.0, time_limit=60)
    assert solution.status == "stalled"
    assert solution.gap <= 1e-7


@pytest.mark.parametrize("search", ["grid", "trials"])
@pytest.mark.parametrize("more", [9e-10, -9e-10, 1e-11])
def test_rows_that_nearly_sum_to_one(search, more, monkeypatch):
    """A chain that gains a little mass would be worth more than the highest reward for ever."""
    if search == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    problem = textbook_problem([[[1 + more]]], [[[1.0]]], [[1.0]], 0.9999)
    np.testing.assert_allclose(problem.choices[0][0].branches[0].row_sums(), 1, rtol=0, atol=1e-15)
    solution = solve(problem, 1e-6, time_limit=5)
    assert (solution.lower, solution.upper) == pytest.approx((1e4, 1e4), rel=1e-8)


def test_batches_follow_the_same_rule():
    batch = LatentBatch(sticky_draws(4, 1), mode_processes()["alternating"], 0.9)
    free = batch.with_reward(Reward(default_x(4), costs={"signal": 1e9}))
    for some in (batch, free):
        solved = solve_draws(some, 1e-3, threads=1)
        assert solved.certified.all()
        for d, gap in enumerate(solved.relative_gap):
            least = some.problem(d).least_size
            assert gap == pytest.approx(relative_gap(solved.lower[d], solved.upper[d], least), rel=1e-12)


@pytest.mark.parametrize(("options", "words"), [
    ({"memory_limit": 0}, "memory limit: found 0, wanted above 0 bytes"),
    ({"memory_limit": -1}, "memory limit: found -1"),
])  # fmt: skip
def test_memory_that_makes_no_sense(options, words):
    with pytest.raises(ValueError, match=words):
        solve(standard_problem("tiger"), **options)


def test_values_that_overflow_are_refused():
    problem = textbook_problem([np.eye(2)], [np.ones((2, 1))], [[1e308, -1e308]], 0.9)
    with pytest.raises(ValueError, match="largest reward divided by 1 - discount: found inf"):
        solve(problem)
