"""Modes without a grid: which ones, and bounds that hold with them."""

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.graph_value import solve_reachable
from models.planning.grid_modes import passing_modes
from models.planning.grid_search import GridSearch
from models.planning.vectors import best_vector
from tests.models.planning.test_vectors import random_graph, worth
from tests.planning_cases import CASES, dense_problem, latent_case, modal_problem, start_arrays
from tests.reference import planning_numpy as reference


def test_alternating_modes_pass_through_the_one_after_a_silent_round():
    problem = latent_case(1, "alternating")
    passing = passing_modes(arrays_of(problem))
    assert passing.sum() == 1
    x = int(np.flatnonzero(passing)[0])
    before = 1 - x
    assert all(len(c.branches) == 1 for c in problem.choices[before])


def test_modes_that_may_last_do_not():
    assert not passing_modes(arrays_of(latent_case(2, "bernoulli"))).any()
    assert not passing_modes(arrays_of(dense_problem(1, 3))).any()


@pytest.mark.parametrize("seed", range(40))
def test_no_passing_mode_follows_another(seed):
    problem = modal_problem(seed, (2, 2, 3, 1, 2))
    passing = passing_modes(arrays_of(problem))
    for x, offered in enumerate(problem.choices):
        for choice in offered:
            for b in choice.branches:
                assert not (passing[x] and passing[b.mode])


@pytest.mark.parametrize("seed", range(8))
def test_bounds_hold_at_every_node(seed):
    """Two hidden states, where plain grids give a narrow interval at any belief."""
    problem = latent_case(seed, "alternating", 2)
    grid = GridSearch(arrays_of(problem), *start_arrays(problem), 10**9)
    done = False
    for _ in range(40):
        done = grid.step(1e-5, True)
        if done:
            break
    assert done
    nodes = grid.run.grid
    exact = np.flatnonzero(nodes.exact[nodes.mode[: grid.beliefs]])
    assert exact.size
    for i in [*exact[:3], *range(0, grid.beliefs, max(1, grid.beliefs // 4))]:
        start = [np.zeros(2), np.zeros(2)]
        start[nodes.mode[i]] = nodes.belief[i].copy()
        low, high = reference.line_interval(problem.started(start), 201)
        assert nodes.upper[i] >= low - 1e-7
        assert best_vector(grid.vectors, int(nodes.mode[i]), nodes.belief[i], 2)[1] <= high + 1e-7


@pytest.mark.parametrize("name", sorted(CASES))
@pytest.mark.parametrize("seed", range(5))
def test_a_policy_is_valued_at_once(name, seed):
    problem = CASES[name]
    arrays, vectors = random_graph(problem, seed, 9)
    values = worth(problem, arrays, vectors)
    size = len(problem.states[int(vectors.mode[0])])
    if not solve_reachable(arrays, vectors, 0):
        assert sum(len(problem.states[x]) for x in vectors.mode[: vectors.counts[0]]) > 48
        return
    np.testing.assert_allclose(vectors.alpha[0, :size], values[0], rtol=1e-10)
    for alpha, value in zip(vectors.alpha, values, strict=False):
        assert (alpha[: len(value)] <= value + 1e-11 * arrays.largest).all()
