"""The adaptive grid on its own: sound and monotone at every round, and what it holds is what it promises."""

import numpy as np
import pytest

from models.planning import grid_search
from models.planning.arrays import arrays_of
from models.planning.grid_run import blind_slots, new_run, solve_run
from models.planning.grid_search import GridSearch
from models.planning.grid_solver import DONE
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.textbook import textbook_problem
from models.planning.vectors import best_vector
from tests.planning_cases import CASES, dense_problem, latent_case, modal_problem, start_arrays
from tests.reference import planning_numpy as reference

ROUNDS = 40


def search(problem, precision=1e-4, memory=10**9, **options):
    grid = GridSearch(arrays_of(problem), *start_arrays(problem), memory, **options)
    trace = []
    for _ in range(ROUNDS):
        done = grid.step(precision, True)
        trace.append((grid.lower, grid.upper))
        if done or grid.exhausted:
            break
    return grid, np.array(trace), done


@pytest.mark.parametrize("name", sorted(CASES))
def test_bounds_are_monotone_and_hold_the_optimum(name):
    problem = CASES[name]
    grid, trace, done = search(problem)
    assert done
    assert (np.diff(trace[:, 0]) >= -1e-8).all()
    assert (np.diff(trace[:, 1]) <= 1e-8).all()
    assert (trace[:, 0] <= trace[:, 1] + 1e-9).all()
    if problem.n_states <= 2:
        low, high = reference.line_interval(problem)
    else:
        low, high = reference.tree_interval(problem, 4)
    assert (trace[:, 0] <= high + 1e-8).all()
    assert (trace[:, 1] >= low - 1e-8).all()
    # At every point of the grid, not just at the start.
    for i in range(grid.beliefs):
        x = int(grid.run.grid.mode[i])
        below = best_vector(grid.vectors, x, grid.run.grid.belief[i], len(problem.states[x]))[1]
        assert below <= grid.run.grid.upper[i] + 1e-8


@pytest.mark.parametrize("name", sorted(CASES))
def test_vectors_are_worth_what_they_say(name):
    problem = CASES[name]
    grid, _, _ = search(problem)
    n = int(grid.vectors.counts[0])
    mode = grid.vectors.mode[:n]
    choice = grid.vectors.choice[:n] - arrays_of(problem).mode_choice[mode]
    values = reference.controller_values(problem, mode, choice, grid.vectors.follow)
    for alpha, value in zip(grid.vectors.alpha, values, strict=False):
        assert (alpha[: len(value)] <= value + 1e-7).all()
    assert set(mode) == set(range(problem.n_modes))


@pytest.mark.parametrize("seed", range(8))
def test_points_never_fall_below_the_optimum(seed):
    """Upper bounds of points far from the start, after a few rounds, against plain grids on the line."""
    problem = modal_problem(seed + 50, (2, 2), 0.8)
    grid, _, _ = search(problem, 1e-6)
    points = grid.run.grid
    for i in np.unique(np.linspace(0, grid.beliefs - 1, 6).astype(int)):
        start = [np.zeros(2), np.zeros(2)]
        start[points.mode[i]] = points.belief[i].copy()
        low, _ = reference.line_interval(problem.started(start), 101, 80)
        assert points.upper[i] >= low - 1e-9


def test_a_belief_that_stays_is_swept():
    """Nothing is ever learned and nothing moves: no corner falls, but the start must."""
    coin = textbook_problem(np.eye(2)[None].repeat(2, 0), np.ones((2, 2, 1)), np.eye(2), 0.95)
    grid, trace, done = search(coin, 1e-4)
    assert done
    assert len(trace) <= 5
    assert grid.upper == pytest.approx(10, rel=1e-4)


def test_what_room_held_before_does_not_show():
    """Draws of a batch share their room: bit for bit as if it were new."""
    problems = [arrays_of(latent_case(seed, "alternating", 4, 0.95)) for seed in range(4)]
    modes, beliefs, weight = start_arrays(latent_case(3, "alternating", 4, 0.95))

    def solved(run):
        status = solve_run(problems[3], run, modes, beliefs, weight, 1e-3, True, 60, 0)
        n, k = int(run.grid.counts[0]), int(run.vectors.counts[0])
        return status, run.bounds.tolist(), int(run.rounds[0]), n, run.grid.upper[:n], run.vectors.alpha[:k]

    slots = 600 + blind_slots(problems[0])
    fresh = solved(new_run(problems[3], 4096, slots))
    used = new_run(problems[0], 4096, slots)
    for arrays in problems[:3]:
        solve_run(arrays, used, modes, beliefs, weight, 1e-3, True, 60, 0)
    again = solved(used)
    assert fresh[0] == DONE
    assert fresh[:4] == again[:4]
    np.testing.assert_array_equal(fresh[4], again[4])
    np.testing.assert_array_equal(fresh[5], again[5])


def test_more_modes_than_there_is_room_for_points_at_first():
    """Corners alone are more than the room that a search begins with."""
    modes = 2100
    rng = np.random.default_rng(0)
    stays = np.eye(2)
    choices = tuple(
        (Choice("a", rng.normal(size=2), (Branch((x + 1) % modes, csr(stays), (0,)),)),) for x in range(modes)
    )
    start = [np.zeros(2) for _ in range(modes)]
    start[5] = np.array([0.5, 0.5])
    problem = Problem(
        tuple(f"m{x}" for x in range(modes)), (("a", "b"),) * modes, choices, ("none",), tuple(start), 0.9
    )
    rewards = np.array([c[0].reward.mean() for c in choices])
    exact = sum(0.9**k * rewards[(5 + k) % modes] for k in range(400))
    grid, _, done = search(problem)
    assert done
    assert grid.lower - 1e-9 <= exact <= grid.upper + 1e-9


def test_gives_up_for_want_of_memory(monkeypatch):
    monkeypatch.setattr(grid_search, "POINTS", 64)
    grid, _, done = search(dense_problem(3, 6, 2, 2, 0.95), 1e-12, memory=1)
    assert not done
    assert grid.exhausted
    assert np.isfinite([grid.lower, grid.upper]).all()
