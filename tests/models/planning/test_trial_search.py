"""SARSOP's trials on their own: the sawtooth, bounds at every belief met, and what the vectors are worth."""

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.belief_tree import empty_tree, grown_tree, look_down, node_of
from models.planning.node_backups import add_point
from models.planning.tree_tidying import tidy_points, tidy_vectors
from models.planning.trial_search import TrialSearch
from models.planning.vectors import best_vector
from tests.planning_cases import CASES, dense_problem, modal_problem, padded, sparse_problem, start_arrays
from tests.reference import planning_numpy as reference

STEPS = 12


def search(problem, precision=1e-3, memory=10**9, steps=STEPS, **options):
    trials = TrialSearch(arrays_of(problem), *start_arrays(problem), memory, **options)
    trials._work = 20_000  # smaller portions, so that a trace has several points
    trace = [(trials.lower, trials.upper)]
    for _ in range(steps):
        done = trials.step(precision, True)
        trace.append((trials.lower, trials.upper))
        if done or trials.exhausted:
            break
    return trials, np.array(trace), done


def check(problem, trials, trace):
    assert (np.diff(trace[:, 0]) >= -1e-8).all()
    assert (np.diff(trace[:, 1]) <= 1e-8).all()
    assert (trace[:, 0] <= trace[:, 1] + 1e-9).all()
    tree = trials.tree
    informed = reference.informed_vectors(problem, 400)
    scale = np.ptp(arrays_of(problem).reward) / (1 - problem.discount)
    for i in range(trials.beliefs):
        x = int(tree.mode[i])
        n = len(problem.states[x])
        belief = tree.belief[i, :n]
        assert belief.sum() == pytest.approx(1, abs=1e-9)
        below = best_vector(trials.vectors, x, tree.belief[i], n)[1]
        assert max(below, tree.lower[i]) <= tree.upper[i] + 1e-8
        assert tree.upper[i] <= (informed[x] @ belief).max() + 1e-6 * scale
        if tree.best[i] >= 0:
            assert tree.lower[i] <= below + 1e-8
    n = int(trials.vectors.counts[0])
    mode = trials.vectors.mode[:n]
    choice = trials.vectors.choice[:n] - arrays_of(problem).mode_choice[mode]
    if n * problem.n_states <= 3000:
        values = reference.controller_values(problem, mode, choice, trials.vectors.follow)
        for alpha, value in zip(trials.vectors.alpha, values, strict=False):
            assert (alpha[: len(value)] <= value + 1e-7).all()


@pytest.mark.parametrize("name", sorted(CASES))
def test_bounds_are_monotone_and_hold_the_optimum(name):
    problem = CASES[name]
    trials, trace, done = search(problem)
    check(problem, trials, trace)
    low, high = reference.line_interval(problem) if problem.n_states <= 2 else reference.tree_interval(problem, 4)
    assert trace[-1, 0] <= high + 1e-8
    assert trace[-1, 1] >= low - 1e-8
    assert done or np.ptp(trace[-1]) < 0.5 * np.ptp(trace[0])


@pytest.mark.parametrize("seed", range(3))
def test_sparse_problems(seed):
    problem = sparse_problem(seed, 20 + 20 * seed)
    trials, trace, _ = search(problem, 1e-2)
    check(problem, trials, trace)
    low, high = reference.tree_interval(problem, 3)
    assert trace[-1, 0] <= high + 1e-8
    assert trace[-1, 1] >= low - 1e-8


def test_tidying_and_growing_change_no_bound():
    problem = modal_problem(3, (4, 1, 3, 2))
    trials, _, _ = search(problem, 1e-7, steps=4)
    before = trials.lower, trials.upper
    tidy_points(trials.tree, trials.problem)
    tidy_vectors(trials.tree, trials.problem, trials.vectors)
    trials.tree = grown_tree(trials.tree, trials.problem, 2 * len(trials.tree.mode))
    assert (trials.lower, trials.upper) == before
    for i in range(trials.beliefs):
        x = int(trials.tree.mode[i])
        # Every node is still found where it was.
        assert node_of(trials.tree, trials.problem, x, trials.tree.belief[i]) == i
        if trials.tree.best[i] >= 0:
            assert trials.vectors.mode[trials.tree.best[i]] == x
            value = trials.vectors.alpha[trials.tree.best[i]] @ trials.tree.belief[i]
            assert value >= trials.tree.lower[i] - 1e-8


# -- the sawtooth --------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(10))
def test_sawtooth_is_the_plain_one(seed):
    problem = modal_problem(seed, (4, 3))
    arrays = arrays_of(problem)
    rng = np.random.default_rng(seed)
    # A convex function, by its values at corners and points; planes far above it.
    truth = [rng.normal(size=(5, n)) for n in (4, 3)]
    corner = np.zeros((2, 4))
    corner[0], corner[1, :3] = truth[0].max(axis=0), truth[1].max(axis=0)
    tree = empty_tree(arrays, 200, corner, np.full(arrays.reward.shape, 100.0))
    points = {0: [], 1: []}
    for k in range(30):
        x = int(rng.integers(2))
        n = (4, 3)[x]
        belief = rng.dirichlet(np.full(n, 0.5)) * (rng.random(n) < 0.7)
        belief = belief / belief.sum() if belief.sum() > 0 else np.eye(n)[k % n]
        i = node_of(tree, arrays, x, padded(belief, 4))
        look_down(tree, i, n)
        expected = reference.sawtooth(corner[x, :n], points[x], belief)
        if points[x]:
            assert tree.upper[i] == pytest.approx(expected, abs=1e-9)
        value = (truth[x] @ belief).max()
        tree.upper[i] = min(tree.upper[i], value)
        add_point(tree, arrays, i)
        if belief.max() < 1 - 1e-9 and value - corner[x, :n] @ belief < -1e-10:
            points[x].append((belief, value))
        assert expected >= value - 1e-9


def test_a_corner_that_falls_takes_the_plane_with_it():
    problem = dense_problem(0, 3)
    arrays = arrays_of(problem)
    tree = empty_tree(arrays, 50, np.full((1, 3), 10.0), np.full(arrays.reward.shape, 100.0))
    middle = node_of(tree, arrays, 0, np.array([0.5, 0.5, 0.0]))
    tree.upper[middle] = 6.0
    add_point(tree, arrays, middle)
    low = node_of(tree, arrays, 0, np.array([1.0, 0.0, 0.0]))
    tree.upper[low] = 8.0
    add_point(tree, arrays, low)
    assert tree.corner[0].tolist() == [8, 10, 10]
    asked = node_of(tree, arrays, 0, np.array([0.4, 0.3, 0.3]))
    look_down(tree, asked, 3)
    points = [(np.array([0.5, 0.5, 0.0]), 6.0)]
    expected = reference.sawtooth(np.array([8.0, 10, 10]), points, np.array([0.4, 0.3, 0.3]))
    assert tree.upper[asked] == pytest.approx(expected, abs=1e-12)


def test_gives_up_for_want_of_memory():
    trials, _, done = search(sparse_problem(0, 40), 1e-9, memory=1, steps=400)
    assert not done
    assert trials.exhausted
    assert trials.full
