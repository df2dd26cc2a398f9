"""Bounds hold where beliefs differ by almost nothing and that matters: no belief is moved without being charged."""

from dataclasses import replace

import numpy as np
import pytest

from models.planning import solver
from models.planning.arrays import arrays_of
from models.planning.grid_search import GridSearch
from models.planning.problems import problem as standard_problem
from models.planning.solver import solve, touching
from models.planning.textbook import textbook_problem
from tests.planning_cases import CASES, modal_problem, start_arrays
from tests.reference import planning_numpy as reference


@pytest.fixture(params=["grid", "trials"])
def search(request, monkeypatch):
    if request.param == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    return request.param


def drift(q: float, discount: float):
    """Paid 1 a step for ever once something has happened that hardly ever happens; nothing can be done."""
    problem = textbook_problem([[[1 - q, q], [0, 1]]], [[[1.0], [1.0]]], [[0.0, 1.0]], discount, [1.0, 0.0])
    return problem, discount * q / ((1 - discount) * (1 - discount + discount * q))


@pytest.mark.parametrize(("q", "discount"), [(2e-11, 0.9999), (8e-12, 0.99), (2e-13, 0.99), (1e-6, 0.999)])
def test_slow_drift(search, q, discount):
    problem, exact = drift(q, discount)
    solution = solve(problem, time_limit=2)
    assert solution.lower <= exact * (1 + 1e-8)
    assert solution.upper >= exact * (1 - 1e-8)
    assert solution.lower <= solution.upper
    if search == "grid":
        assert solution.status == "converged"


@pytest.mark.parametrize("worst", [-1e8, -1e9])
def test_a_belief_next_to_a_corner_is_not_the_corner(search, worst):
    """Half of the runs come to the tiger knowing where it is, half with a touch of ruin beside it."""
    room = [c.branches[0] for c in standard_problem("tiger").choices[0]]
    stray = 5e-10
    tables, seen, reward = [], [], []
    for b, c in zip(room, standard_problem("tiger").choices[0], strict=True):
        t = np.zeros((4, 4))  # left, right, ruin, start
        t[:2, :2] = b.transition.toarray()
        t[2, :2] = 0.5
        t[3] = [1 - 0.5 * stray, 0, 0.5 * stray, 0]
        o = np.zeros((4, 4))
        o[:2, :2] = b.emission.toarray()
        o[2, 3] = 1.0
        o[3, 2] = 1.0
        tables.append(t)
        seen.append(o)
        reward.append([*c.reward, worst, 0.0])
    for o in seen:  # ruin looks like the left door half of the time, in which it hides
        o[2] = [1.0, 0, 0, 0]
    problem = textbook_problem(tables, seen, reward, 0.95, [0, 0, 0, 1.0])
    solution = solve(problem, 1e-4, time_limit=5)
    values = reference.controller_values(problem, solution.mode, solution.choice, solution.follow)
    worth = max(v[3] for v in values)
    # The linear solve of the reference is off by rounding of its largest value, that of ruin.
    assert solution.upper >= worth - 1e-9 * abs(worth) - 1e-16 * problem.largest_value
    low, high = reference.tree_interval(problem, 4)
    assert solution.upper >= low
    assert solution.lower <= high


def test_bounds_that_cross_are_not_passed_on():
    assert touching("p", 1.0 + 1e-12, 1.0, 1.0) == 1.0 + 1e-12
    with pytest.raises(ArithmeticError, match=r"p: lower bound 1\.5 above upper bound 1, which"):
        touching("p", 1.5, 1.0, 1.0)


def test_bounds_that_cross_by_rounding_do_not_go_back(monkeypatch):
    told = iter([(0.5, 1.0), (1.0 + 2e-13, 1.0 - 2e-13)])

    class Rounded(GridSearch):
        said = (-np.inf, np.inf)
        lower = property(lambda self: self.said[0])
        upper = property(lambda self: self.said[1])

        def step(self, precision, relative):
            self.said = next(told)
            return False

    monkeypatch.setattr(solver, "GridSearch", Rounded)
    solution = solve(CASES["dense 2"])
    assert [(p.lower, p.upper) for p in solution.trace] == [(0.5, 1.0), (1.0, 1.0)]
    assert (solution.status, solution.lower, solution.upper) == ("converged", 1.0, 1.0)


@pytest.mark.parametrize("seed", range(6))
def test_points_of_the_grid_are_beliefs_however_fine_it_gets(seed):
    problem = modal_problem(seed, (2, 3, 1))
    grid = GridSearch(arrays_of(problem), *start_arrays(problem), 10**9)
    for _ in range(60):
        if grid.step(0.0, True) or grid.exhausted:
            break
    n = grid.beliefs
    belief = grid.run.grid.belief[:n]
    assert (belief >= 0).all()
    np.testing.assert_allclose(belief.sum(axis=1), 1, atol=1e-12)


@pytest.mark.parametrize("name", ["dense 2", "latent 1 alternating"])
def test_interrupted_before_anything_is_known(name, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(solver, "GridSearch", interrupt)
    problem = CASES[name]
    solution = solve(problem)
    assert solution.status == "interrupted"
    low, high = reference.tree_interval(problem, 4)
    assert solution.lower <= high
    assert solution.upper >= low
    assert solution.alpha_vectors > 0


def test_high_discount(search):
    solution = solve(standard_problem("tiger").with_discount(0.9999), time_limit=20)
    assert solution.status == "converged"
    values = reference.controller_values(solution.problem, solution.mode, solution.choice, solution.follow)
    worth = max(0.5 * v.sum() for v in values)
    assert solution.lower - 1e-6 <= worth <= solution.upper
    # Listening never costs more than it takes to be all but sure, every time: 19.3714 at .95 alike.
    assert solution.lower > 10_000


def test_limits_hold_for_large_dense_problems():
    """Time is looked at while bounds are set up, memory before anything is taken."""
    rng = np.random.default_rng(0)
    n, actions, seen = 60, 6, 30
    problem = textbook_problem(
        rng.dirichlet(np.ones(n), size=(actions, n)), rng.dirichlet(np.ones(seen), size=(actions, n)),
        rng.normal(size=(actions, n)), 0.99,
    )  # fmt: skip
    solve(problem, time_limit=0.01)
    solution = solve(problem, 1e-9, time_limit=0.3)
    assert solution.status == "time limit"
    assert solution.seconds < 6
    small = replace(problem, name="small")
    assert solve(small, 1e-9, time_limit=2, memory_limit=1_000_000).status in ("memory limit", "time limit")
