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


def deepest(tree, i, size, points):
    """How far below the plane of the corners given points put a belief, by the formula."""
    others = tree.belief[tree.point_node[points], :size]
    ratio = np.where(others > 0, tree.belief[i, :size] / np.where(others > 0, others, 1.0), 1.0)
    return min(0.0, (np.minimum(ratio.min(axis=1), 1.0) * tree.point_depth[points]).min(initial=0.0))


@pytest.mark.parametrize("name", sorted(CASES))
def test_no_point_says_what_others_say(name):
    problem = CASES[name]
    trials, _, _ = search(problem, 1e-9, steps=10)
    tree, arrays = trials.tree, trials.problem
    for i in range(trials.beliefs):
        look_down(tree, i, int(arrays.mode_size[tree.mode[i]]))
    tidy_points(tree, arrays)
    n = int(tree.counts[1])
    nodes = tree.point_node[:n]
    assert len(np.unique(nodes)) == n
    assert sorted(np.flatnonzero(tree.point_of[: trials.beliefs] >= 0)) == sorted(nodes)
    slack = 1e-11 * arrays.largest
    for j in np.unique(np.linspace(0, n - 1, 40).astype(int)):
        i = int(nodes[j])
        assert tree.point_of[i] == j
        size = int(arrays.mode_size[tree.mode[i]])
        others = np.flatnonzero((np.arange(n) != j) & (tree.mode[nodes] == tree.mode[i]))
        assert deepest(tree, i, size, others) >= tree.point_depth[j] - slack
        # What a node is known to be worth at most, points say too, its own among them.
        said = tree.corner[tree.mode[i], :size] @ tree.belief[i, :size] + tree.point_depth[j]
        assert tree.upper[i] <= said + slack


def test_a_point_is_added_once():
    problem = dense_problem(0, 3)
    arrays = arrays_of(problem)
    tree = empty_tree(arrays, 50, np.full((1, 3), 10.0), np.full(arrays.reward.shape, 100.0))
    middle = node_of(tree, arrays, 0, np.array([0.5, 0.5, 0.0]))
    for upper, points, depth in ((6.0, 1, -4.0), (6.0, 1, -4.0), (5.0, 2, -5.0), (5.0, 2, -5.0)):
        tree.upper[middle] = upper
        add_point(tree, arrays, middle)
        assert tree.counts[1] == points
        assert tree.point_depth[tree.point_of[middle]] == depth
    tidy_points(tree, arrays)
    assert tree.counts[1] == 1
    # Another belief, of which the first says enough, and then one that says more of the first than itself.
    beside = node_of(tree, arrays, 0, np.array([0.4, 0.4, 0.2]))
    look_down(tree, beside, 3)
    assert tree.upper[beside] == pytest.approx(10 - 0.8 * 5)
    add_point(tree, arrays, beside)
    assert tree.counts[1] == 1
    tree.upper[beside] = 3.0
    add_point(tree, arrays, beside)
    look_down(tree, middle, 3)
    assert tree.upper[middle] == pytest.approx(
        5.0
    )  # its own is deeper there: the other says nothing beyond its face
    edge = node_of(tree, arrays, 0, np.array([0.45, 0.55, 0.0]))
    tree.upper[edge] = 0.0
    add_point(tree, arrays, edge)
    look_down(tree, middle, 3)
    assert tree.upper[middle] == pytest.approx(10 - 10 * 0.5 / 0.55)
    assert tree.point_of[middle] == -1
    tidy_points(tree, arrays)
    assert sorted(tree.point_node[: tree.counts[1]]) == sorted([beside, edge])


@pytest.mark.parametrize("seed", range(3))
def test_trials_end_where_there_is_no_room(seed):
    """A trial that cannot go on says so, rather than being tried for ever."""
    arrays = arrays_of(sparse_problem(seed, 40))
    trials = TrialSearch(arrays, *start_arrays(sparse_problem(seed, 40)), 10**9)
    tree = trials.tree
    left = 0
    while tree.counts[0] < len(tree.mode) - 4:  # all but taken
        belief = np.random.default_rng(left).dirichlet(np.ones(40))
        node_of(tree, arrays, 0, belief)
        left += 1
    before = int(tree.counts[3])
    trials.step(1e-9, True)
    assert len(trials.tree.mode) > len(tree.mode)
    assert int(trials.tree.counts[3]) - before < 1000
