"""The planner's bounds one kernel at a time, against numpy on the problem's own matrices.

Small and quick, also where kernels are interpreted: what a node is given when it is made, what looking up and down
finds, what opening a choice notes, and what one backup makes of each bound.
"""

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.belief_tree import (
    SAME,
    TINY,
    choice_reward,
    empty_tree,
    give_up_point,
    grown_tree,
    look_down,
    look_up,
    node_of,
    note_risen,
    open_choice,
    plane_bound,
    room_for,
)
from models.planning.blind_policies import blind_vectors
from models.planning.fast_informed_bound import (
    informed_vectors,
    lower_informed_vectors,
    lower_mdp_bound,
    mdp_bound,
)
from models.planning.grid_run import blind_slots
from models.planning.node_backups import add_point, back_up_lower, back_up_upper, new_room
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.step_kernel import POSSIBLE, successors
from models.planning.textbook import textbook_problem
from models.planning.vectors import (
    SLACK,
    add_vector,
    best_since,
    best_vector,
    copied_vectors,
    empty_vectors,
    evaluate_closed,
    evaluate_graph,
    keep_useful,
)
from tests.planning_cases import dense_problem, latent_case, modal_problem, padded
from tests.reference import planning_numpy as reference

PROBLEMS = {
    "modal": modal_problem(3, (4, 1, 3, 2)),
    "small": modal_problem(1, (2, 3, 1)),
    "dense": dense_problem(2, 3, 3, 2),
    "latent": latent_case(2, "bernoulli"),
}


class Scene:
    """A problem with planes, corners and vectors that are made up, and a tree without nodes."""

    def __init__(self, name, seed=0, capacity=300):
        self.problem = PROBLEMS[name]
        self.arrays = arrays_of(self.problem)
        self.rng = np.random.default_rng(seed)
        self.width = self.problem.n_states
        self.planes = 5 + self.rng.normal(size=self.arrays.reward.shape)
        # As high as the planes say, so that neither bound of a belief always wins.
        self.corner = np.full((self.problem.n_modes, self.width), -np.inf)
        for x in range(self.problem.n_modes):
            self.corner[x] = self.planes[self.choices(x)].max(axis=0)
        self.tree = empty_tree(self.arrays, capacity, self.corner, self.planes)
        self.vectors = empty_vectors(self.arrays, blind_slots(self.arrays) + 40)
        blind_vectors(self.arrays, self.vectors, 64)
        self.table = reference.steps(self.problem)
        self.room = new_room(self.arrays)

    def choices(self, x):
        return slice(int(self.arrays.mode_choice[x]), int(self.arrays.mode_choice[x + 1]))

    def size(self, x):
        return len(self.problem.states[x])

    def belief(self, x):
        return self.rng.dirichlet(np.ones(self.size(x)))

    def node(self, x, belief):
        return node_of(self.tree, self.arrays, x, padded(belief, self.width))

    def plane(self, x, belief):
        return (self.planes[self.choices(x), : len(belief)] @ belief).max()

    def held(self, x):
        n = int(self.vectors.counts[0])
        return np.flatnonzero(self.vectors.mode[:n] == x)

    def lower(self, x, belief):
        return (self.vectors.alpha[self.held(x), : len(belief)] @ belief).max()

    def steps_after(self, x, j, belief):
        """Reward, and (place, mode, probability, belief) of every possible outcome of a choice."""
        step = self.table[x][j]
        after = reference.successors(step, belief)
        ways = [
            (z, step.outcomes[z][0], p, tau[: self.size(step.outcomes[z][0])])
            for z, (p, tau) in enumerate(after) if p > 0
        ]  # fmt: skip
        return belief @ step.reward, ways

    def opened(self, i, j):
        open_choice(self.tree, self.arrays, i, j, self.room.after, self.room.probability, self.room.reached)


every = pytest.mark.parametrize("name", sorted(PROBLEMS))


# -- nodes ---------------------------------------------------------------------------------------------
@every
def test_a_new_node_and_the_same_again(name):
    scene = Scene(name)
    tree = scene.tree
    made = []
    for k in range(3 * scene.problem.n_modes):
        x = k % scene.problem.n_modes
        belief = scene.belief(x)
        i = scene.node(x, belief)
        if scene.size(x) == 1 and k >= scene.problem.n_modes:
            assert i < len(made)
            continue
        made.append((x, belief))
        assert i == len(made) - 1
        assert tree.counts.tolist() == [len(made), 0, 0, 0, 0]
        assert tree.mode[i] == x
        np.testing.assert_array_equal(tree.belief[i], padded(belief, scene.width))
        assert tree.upper[i] == pytest.approx(scene.plane(x, belief), rel=1e-14)
        assert plane_bound(tree, scene.arrays, x, padded(belief, scene.width), scene.size(x)) == tree.upper[i]
        offered = len(scene.problem.choices[x])
        wanted = scene.planes[scene.choices(x), : len(belief)] @ belief
        np.testing.assert_allclose(tree.ahead[i, :offered], wanted, rtol=1e-14)
        assert (tree.lower[i], tree.best[i], tree.covered[i]) == (-np.inf, -1, np.inf)
        assert (tree.seen_vectors[i], tree.seen_points[i], tree.point_of[i]) == (0, 0, -1)
        assert not tree.opened[i].any()
    for i, (x, belief) in enumerate(made):
        assert scene.node(x, belief) == i
    assert tree.counts[0] == len(made)


def test_beliefs_that_differ_by_rounding_are_one_node():
    scene = Scene("dense")
    belief = np.array([0.25, 0.375, 0.375])  # far from where the hash would part them
    i = scene.node(0, belief)
    assert scene.node(0, belief + np.array([0.5, -0.5, 0.0]) * SAME) == i
    assert scene.node(0, belief + np.array([0.0, 0.5, -0.5]) * SAME) == i
    assert scene.node(0, belief + np.array([4.0, -4.0, 0.0]) * SAME) == i + 1
    assert scene.node(0, belief + np.array([0.0, 8.0, -8.0]) * SAME) == i + 2


def test_the_same_numbers_in_another_mode_are_another_node():
    scene = Scene("latent")
    belief = scene.belief(0)
    assert [scene.node(0, belief), scene.node(1, belief), scene.node(0, belief)] == [0, 1, 0]


def test_a_node_made_where_one_was_forgotten_starts_anew():
    """Room that was used before must not show."""
    scene = Scene("small")
    tree = scene.tree
    for name in ("lower", "upper", "covered", "ahead", "belief"):
        getattr(tree, name)[:] = 77.0
    for name in ("best", "seen_vectors", "seen_points", "point_of"):
        getattr(tree, name)[:] = 77
    tree.opened[:] = True
    belief = scene.belief(0)
    i = scene.node(0, belief)
    np.testing.assert_array_equal(tree.belief[i], padded(belief, scene.width))
    assert (tree.lower[i], tree.best[i], tree.covered[i]) == (-np.inf, -1, np.inf)
    assert (tree.seen_vectors[i], tree.seen_points[i], tree.point_of[i]) == (0, 0, -1)
    assert not tree.opened[i].any()


@every
def test_a_grown_tree_is_the_same(name):
    scene = Scene(name)
    for k in range(6):
        x = k % scene.problem.n_modes
        i = scene.node(x, scene.belief(x))
        scene.opened(i, 0)
        scene.tree.upper[i] -= 0.5 + k
        add_point(scene.tree, scene.arrays, i)
        look_up(scene.tree, scene.vectors, i, scene.size(x))
    tree, nodes = scene.tree, int(scene.tree.counts[0])
    wider = grown_tree(tree, scene.arrays, 700)
    used = {"point": int(tree.counts[1]), "way_": int(tree.counts[4])}
    for field in tree._fields:
        old, new = getattr(tree, field), getattr(wider, field)
        if field in ("counts", "corner", "planes", "point_last"):
            np.testing.assert_array_equal(new, old)
        elif field != "table":
            key = "point" if field.startswith("point_") and field != "point_of" else field[:4]
            n = used.get(key, nodes)
            np.testing.assert_array_equal(new[:n], old[:n], err_msg=field)
    assert len(wider.mode) == 700
    assert len(wider.point_node) == 1400
    assert len(wider.table) >= 1400
    assert len(wider.table) & (len(wider.table) - 1) == 0
    for i in range(nodes):
        assert node_of(wider, scene.arrays, tree.mode[i], tree.belief[i]) == i
    assert wider.counts[0] == nodes


def test_a_tree_whose_table_is_nearly_full():
    """Nodes in every place of the table, the first one too, and many that had to move on."""
    scene = Scene("latent", capacity=256)
    made = [(k % 2, scene.belief(k % 2)) for k in range(250)]
    assert [scene.node(x, belief) for x, belief in made] == list(range(250))
    tree = grown_tree(scene.tree, scene.arrays, 250)
    assert len(tree.table) == 512
    assert (tree.table >= 0).sum() == 250
    # The same beliefs once more, in a table with hardly a place left.
    crowded = grown_tree(scene.tree, scene.arrays, 256)._replace(table=np.full(256, -1, dtype=np.int32))
    crowded.counts[0] = 0
    for other in (crowded, crowded, tree):
        assert [node_of(other, scene.arrays, x, padded(belief, 3)) for x, belief in made] == list(range(250))
        assert other.counts[0] == 250


def test_room_for_nodes_and_for_ways():
    scene = Scene("dense", capacity=10)
    tree = scene.tree
    assert len(tree.way_child) == 40
    assert room_for(tree, 10)
    assert not room_for(tree, 11)
    tree.counts[0], tree.counts[4] = 2, 34
    assert room_for(tree, 6)
    assert not room_for(tree, 7)
    tree.counts[0], tree.counts[4] = 7, 3
    assert room_for(tree, 3)
    assert not room_for(tree, 4)


# -- the lower bound of a node -------------------------------------------------------------------------
@every
def test_looking_up_finds_the_best_vector_and_then_only_looks_at_new_ones(name):
    scene = Scene(name)
    tree, vectors = scene.tree, scene.vectors
    for x in range(scene.problem.n_modes):
        belief = scene.belief(x)
        i = scene.node(x, belief)
        n = scene.size(x)
        before = int(tree.counts[2])
        look_up(tree, vectors, i, n)
        assert tree.counts[2] - before == n * len(scene.held(x))
        assert tree.lower[i] == pytest.approx(scene.lower(x, belief), rel=1e-13)
        values = vectors.alpha[:, :n] @ belief
        assert values[tree.best[i]] == pytest.approx(values[scene.held(x)].max(), rel=1e-13)
        assert vectors.mode[tree.best[i]] == x
        assert tree.seen_vectors[i] == vectors.counts[0]
        # Nothing new: nothing looked at.
        before = int(tree.counts[2])
        look_up(tree, vectors, i, n)
        assert tree.counts[2] == before
        # A worse one changes nothing, a better one is found.
        best = int(tree.best[i])
        for rise in (-1.0, 2.0):
            alpha = vectors.alpha[best] + rise
            made = add_vector(vectors, x, int(vectors.choice[best]), alpha, vectors.follow[best])
            look_up(tree, vectors, i, n)
            assert tree.best[i] == (made if rise > 0 else best)
        assert tree.lower[i] == pytest.approx(values[best] + 2.0, rel=1e-12)
        # One that was raised in its place counts at once, one that has not been looked at does not.
        vectors.alpha[tree.best[i], :n] += 1.0
        look_up(tree, vectors, i, n)
        assert tree.lower[i] == pytest.approx(values[best] + 3.0, rel=1e-12)


def test_the_very_first_vector_counts_like_any_other():
    scene = Scene("dense")
    vectors = empty_vectors(scene.arrays, 2)
    add_vector(vectors, 0, 0, np.array([1.0, 2.0, 3.0]), np.zeros(vectors.follow.shape[1], dtype=np.int32))
    i = scene.node(0, np.array([0.5, 0.25, 0.25]))
    look_up(scene.tree, vectors, i, 3)
    assert (scene.tree.lower[i], scene.tree.best[i]) == (1.75, 0)
    vectors.alpha[0] += 1.0
    look_up(scene.tree, vectors, i, 3)
    assert scene.tree.lower[i] == 2.75
    vectors.alpha[0] += 1.0
    note_risen(scene.tree, scene.arrays, vectors)
    assert scene.tree.lower[i] == 3.75


def test_lower_bounds_follow_vectors_that_have_risen_and_never_fall():
    scene = Scene("small")
    tree, vectors = scene.tree, scene.vectors
    nodes = []
    for x in (0, 1, 2, 0):
        i = scene.node(x, scene.belief(x))
        nodes.append(i)
        if len(nodes) < 4:
            look_up(tree, vectors, i, scene.size(x))
    vectors.alpha[: vectors.counts[0]] += 1.5
    before = tree.lower[:4].copy()
    note_risen(tree, scene.arrays, vectors)
    np.testing.assert_allclose(tree.lower[:3], before[:3] + 1.5, rtol=1e-12)
    assert tree.lower[3] == -np.inf
    vectors.alpha[: vectors.counts[0]] -= 5.0
    note_risen(tree, scene.arrays, vectors)
    np.testing.assert_allclose(tree.lower[:3], before[:3] + 1.5, rtol=1e-12)


# -- the upper bound of a node -------------------------------------------------------------------------
@every
@pytest.mark.parametrize("seed", range(3))
def test_looking_down_is_the_sawtooth_over_the_points_of_the_mode(name, seed):
    scene = Scene(name, seed)
    tree = scene.tree
    points = {x: [] for x in range(scene.problem.n_modes)}
    known = []
    for k in range(18):
        x = int(scene.rng.integers(scene.problem.n_modes))
        belief = scene.belief(x) * (scene.rng.random(scene.size(x)) < 0.7)
        belief = belief / belief.sum() if belief.sum() > 0 else scene.belief(x)
        if belief.max() == 1.0:
            continue
        i = scene.node(x, belief)
        look_down(tree, i, scene.size(x))
        wanted = min(scene.plane(x, belief), reference.sawtooth(tree.corner[x, : len(belief)], points[x], belief))
        assert tree.upper[i] == pytest.approx(wanted, abs=1e-12)
        assert tree.seen_points[i] == tree.counts[1]
        value = float(tree.upper[i]) - (0.5 if k % 2 else 0.0)
        tree.upper[i] = value
        add_point(tree, scene.arrays, i)
        points[x].append((belief, value))
        known.append((i, x, belief))
    for i, x, belief in known:  # only later points are new to them
        look_down(tree, i, scene.size(x))
        wanted = reference.sawtooth(tree.corner[x, : len(belief)], points[x], belief)
        assert tree.upper[i] == pytest.approx(wanted, abs=1e-12)


def test_a_node_of_which_others_say_more_loses_its_point():
    scene = Scene("dense")
    tree = scene.tree
    one, other = scene.node(0, np.array([0.5, 0.5, 0.0])), scene.node(0, np.array([0.45, 0.55, 0.0]))
    tree.upper[one] = scene.corner[0] @ tree.belief[one] - 1.0
    add_point(tree, scene.arrays, one)
    assert tree.point_of[one] == 0
    assert tree.point_depth[0] == pytest.approx(-1.0)
    tree.upper[other] = scene.corner[0] @ tree.belief[other] - 10.0
    add_point(tree, scene.arrays, other)
    work = int(tree.counts[2])
    look_down(tree, one, 3)
    assert tree.counts[2] - work == 8
    assert tree.upper[one] == pytest.approx(scene.corner[0] @ tree.belief[one] - 10 * 0.5 / 0.55)
    assert tree.covered[one] == tree.upper[one]
    assert tree.point_of[one] == -1
    assert tree.point_depth[0] == 0.0
    # It gets none again until it is known to be worth less than what covers it.
    add_point(tree, scene.arrays, one)
    assert tree.point_of[one] == -1
    least = TINY * scene.arrays.largest
    tree.upper[one] = tree.covered[one] - 0.5 * least
    add_point(tree, scene.arrays, one)
    assert tree.point_of[one] == -1
    tree.upper[one] = tree.covered[one] - 3 * least
    add_point(tree, scene.arrays, one)
    assert tree.point_of[one] == 2
    give_up_point(tree, one)
    assert (tree.point_of[one], tree.point_depth[2], tree.counts[1]) == (-1, 0.0, 3)
    give_up_point(tree, one)  # which has none: the newest point of others stays
    assert tree.point_depth[1] == pytest.approx(-10.0)


def test_a_node_that_knows_more_than_others_keeps_its_point():
    scene = Scene("dense")
    tree = scene.tree
    one, other = scene.node(0, np.array([0.5, 0.5, 0.0])), scene.node(0, np.array([0.4, 0.6, 0.0]))
    for i, depth in ((one, 4.0), (other, 1.0)):
        tree.upper[i] = scene.corner[0] @ tree.belief[i] - depth
        add_point(tree, scene.arrays, i)
    before, work = tree.upper[:2].copy(), int(tree.counts[2])
    look_down(tree, one, 3)
    np.testing.assert_array_equal(tree.upper[:2], before)
    assert tree.point_of[:2].tolist() == [0, 1]
    assert tree.point_depth[:2].tolist() == pytest.approx([-4.0, -1.0])
    assert tree.counts[2] == work  # neither point is deep enough to be looked at


def test_a_belief_on_the_plane_of_the_corners_gets_no_point():
    scene = Scene("dense")
    i = scene.node(0, np.array([0.2, 0.3, 0.5]))
    plane = scene.corner[0] @ scene.tree.belief[i]
    for depth, points in ((-1.0, 0), (0.0, 0), (0.5 * TINY * scene.arrays.largest, 0), (1e-6, 1)):
        scene.tree.upper[i] = plane - depth
        add_point(scene.tree, scene.arrays, i)
        assert scene.tree.counts[1] == points
    assert scene.tree.point_last[0] == 0
    assert scene.tree.point_previous[0] == -1
    assert scene.tree.point_node[0] == i
    assert scene.tree.covered[i] == scene.tree.upper[i]


def test_a_corner_that_falls_takes_the_plane_and_all_depths_with_it():
    scene = Scene("latent")
    tree, arrays = scene.tree, scene.arrays
    points = []
    for x in (0, 1):
        for belief in ([0.5, 0.25, 0.25], [0.0, 0.5, 0.5], [0.9, 0.1, 0.0]):
            i = scene.node(x, np.array(belief))
            tree.upper[i] = scene.corner[x] @ tree.belief[i] - 0.4
            add_point(tree, arrays, i)
            points.append((i, x, float(tree.upper[i])))
    corner = scene.node(0, np.array([1.0, 0.0, 0.0]))
    add_point(tree, arrays, corner)  # not below the corner yet: nothing
    np.testing.assert_array_equal(tree.corner, scene.corner)
    tree.upper[corner] = scene.corner[0, 0] - 0.6
    add_point(tree, arrays, corner)
    assert tree.counts[1] == 6
    assert tree.corner[0, 0] == tree.upper[corner]
    np.testing.assert_array_equal(tree.corner[0, 1:], scene.corner[0, 1:])
    np.testing.assert_array_equal(tree.corner[1], scene.corner[1])
    for j, (i, x, upper) in enumerate(points):
        plane = tree.corner[x] @ tree.belief[i]
        assert tree.point_depth[j] == pytest.approx(min(0.0, upper - plane), abs=1e-14)
    # Any corner of any mode may fall, each for itself.
    for x, y in ((1, 2), (1, 0), (0, 1)):
        before = tree.corner.copy()
        i = scene.node(x, np.eye(3)[y])
        tree.upper[i] = before.min() - 0.25
        add_point(tree, arrays, i)
        before[x, y] = tree.upper[i]
        np.testing.assert_array_equal(tree.corner, before)
    assert tree.counts[1] == 6
    tree.corner[:] = scene.corner
    # Next to a corner is not at it.
    near = scene.node(0, np.array([0.0, 1 - 1e-9, 1e-9]))
    tree.upper[near] = -50.0
    add_point(tree, arrays, near)
    np.testing.assert_array_equal(tree.corner[0, 1:], scene.corner[0, 1:])
    assert tree.counts[1] == 7


# -- ways on -------------------------------------------------------------------------------------------
@every
def test_an_opened_choice_knows_its_outcomes(name):
    scene = Scene(name)
    tree = scene.tree
    for x in range(scene.problem.n_modes):
        belief = scene.belief(x)
        i = scene.node(x, belief)
        for j in range(len(scene.problem.choices[x])):
            begin, work = int(tree.counts[4]), int(tree.counts[2])
            scene.opened(i, j)
            reward, ways = scene.steps_after(x, j, belief)
            assert choice_reward(tree, scene.arrays, i, j) == pytest.approx(reward, abs=1e-13)
            assert tree.opened[i, j]
            assert (tree.first_way[i, j], tree.ways[i, j]) == (begin, len(ways))
            assert tree.counts[4] == begin + len(ways)
            assert tree.counts[2] - work == scene.size(x) * len(scene.table[x][j].outcomes)
            for way, (z, mode, p, after) in enumerate(ways, begin):
                child = tree.way_child[way]
                assert tree.way_outcome[way] == z
                assert tree.way_probability[way] == pytest.approx(p, rel=1e-12)
                assert tree.mode[child] == mode
                np.testing.assert_allclose(tree.belief[child, : len(after)], after, atol=1e-12)
            assert tree.charge[i, j] <= 1e-13 * scene.arrays.span


def test_a_node_that_stands_for_another_belief_is_charged_for():
    scene = Scene("dense")
    tree, arrays = scene.tree, scene.arrays
    belief = scene.belief(0)
    i = scene.node(0, belief)
    _, ways = scene.steps_after(0, 0, belief)
    moved = np.array([0.5, -0.25, -0.25]) * SAME
    twins = [scene.node(0, after + moved) for _, _, _, after in ways]
    scene.opened(i, 0)
    own = [int(tree.way_child[w]) for w in range(tree.first_way[i, 0], tree.first_way[i, 0] + tree.ways[i, 0])]
    assert own == twins
    after = np.zeros_like(scene.room.after)
    probability = np.zeros_like(scene.room.probability)
    successors(arrays, 0, tree.belief[i], 3, after, probability, np.zeros(3))
    wanted = sum(
        0.5 * p * np.abs(tree.belief[child] - b).sum()
        for p, child, b in zip(probability[probability > 0], own, after[probability > 0], strict=True)
    )
    assert wanted > 0.2 * SAME
    assert tree.charge[i, 0] == pytest.approx(wanted * arrays.span, rel=1e-12, abs=0)
    # The charge is part of the upper bound.
    tree.charge[i, 0] = 3.0
    tree.ahead[i] = [1000.0, -1000.0, -1000.0]
    tree.upper[i] = 1000.0
    assert back_up_upper(tree, arrays, i, scene.room) == 0
    reward, ways = scene.steps_after(0, 0, belief)
    ahead = 3.0 + sum(p * scene.plane(0, b) for _, _, p, b in ways)
    assert tree.upper[i] == pytest.approx(reward + scene.problem.discount * ahead, rel=1e-12)


# -- backups -------------------------------------------------------------------------------------------
@every
@pytest.mark.parametrize("seed", range(3))
def test_backing_up_the_upper_bound(name, seed):
    for x in range(PROBLEMS[name].n_modes):
        scene = Scene(name, seed)
        tree, points = scene.tree, {}
        for other in range(scene.problem.n_modes):  # points of which children learn
            if scene.size(other) > 1:
                i = scene.node(other, scene.belief(other))
                tree.upper[i] = scene.corner[other] @ tree.belief[i] - 2.0
                add_point(tree, scene.arrays, i)
                points[other] = (tree.belief[i, : scene.size(other)].copy(), float(tree.upper[i]))
        belief = scene.belief(x)
        i = scene.node(x, belief)
        chosen = back_up_upper(tree, scene.arrays, i, scene.room)
        worth = []
        for j in range(len(scene.problem.choices[x])):
            reward, ways = scene.steps_after(x, j, belief)
            ahead = 0.0
            for _, mode, p, after in ways:
                above = scene.plane(mode, after)
                if mode in points:
                    above = min(above, reference.sawtooth(scene.corner[mode, : len(after)], [points[mode]], after))
                ahead += p * above
            plane = scene.planes[scene.choices(x)][j, : len(belief)] @ belief
            worth.append(min(plane, reward + scene.problem.discount * ahead))
        assert tree.upper[i] == pytest.approx(max(worth), rel=1e-12)
        assert worth[chosen] == pytest.approx(max(worth), rel=1e-12)
        assert tree.ahead[i, chosen] == tree.upper[i]
        if scene.size(x) > 1:  # again, from a bound that is lower already: it stays
            tree.upper[i] -= 1.0
            assert back_up_upper(tree, scene.arrays, i, scene.room) == chosen
            assert tree.upper[i] == pytest.approx(max(worth) - 1.0, rel=1e-12)


def test_without_room_nothing_is_opened():
    scene = Scene("dense", capacity=4)
    i = scene.node(0, scene.belief(0))
    scene.tree.counts[0] = 3
    assert back_up_upper(scene.tree, scene.arrays, i, scene.room) == -1
    assert not scene.tree.opened.any()


def test_room_is_asked_for_as_many_outcomes_as_the_choice_has():
    one, coin = csr([[1.0]]), csr([[0.5, 0.5]])
    quiet = Choice("quiet", np.zeros(1), (Branch(0, one, (0,)),))
    toss = Choice("toss", np.ones(1), (Branch(0, one, (0, 1), coin),))
    for offered, chosen in (((quiet, toss), 1), ((toss, quiet), 0)):
        problem = Problem(("m",), (("s",),), (offered,), ("heads", "tails"), (np.ones(1),), 0.9)
        arrays = arrays_of(problem)
        for left, found in ((1, -1), (2, chosen)):
            planes = np.where(arrays.reward > 0, 10.0, -50.0)
            tree = empty_tree(arrays, 8, np.full((1, 1), 10.0), planes)
            i = node_of(tree, arrays, 0, np.ones(1))
            tree.counts[0] = 8 - left
            assert back_up_upper(tree, arrays, i, new_room(arrays)) == found


@every
@pytest.mark.parametrize("seed", range(3))
def test_backing_up_the_lower_bound(name, seed):
    rose = 0
    for k in range(5):
        for x in range(PROBLEMS[name].n_modes):
            scene = Scene(name, 10 * k + seed)
            tree, vectors, discount = scene.tree, scene.vectors, scene.problem.discount
            vectors.alpha[: vectors.counts[0]] -= 3.0  # so that one step ahead is better for certain
            scene.room.follow[:] = -1  # what was there before must not show
            # Where the state is known, some outcomes are impossible.
            belief = scene.belief(x) if k < 3 else np.eye(scene.size(x))[(k + x) % scene.size(x)]
            i, n = scene.node(x, belief), scene.size(x)
            look_up(tree, vectors, i, n)
            offered = len(scene.problem.choices[x])
            opened = [j for j in range(offered) if (j + k) % 2 == 0 or k > 1]
            if not opened:
                assert back_up_lower(tree, scene.arrays, vectors, i, 0.0, scene.room) == (-np.inf, False)
                continue
            worth, alphas = {}, {}
            for j in opened:
                scene.opened(i, j)
                step = scene.table[x][j]
                followers = []
                reached = {z: after for z, _, _, after in scene.steps_after(x, j, belief)[1]}
                for z, (mode, _, _) in enumerate(step.outcomes):
                    held = scene.held(mode)
                    if z in reached:
                        values = vectors.alpha[held, : len(reached[z])] @ reached[z]
                        followers.append(vectors.alpha[held[values.argmax()]].copy())
                    else:
                        followers.append(vectors.alpha[held[-1]].copy())
                alphas[j] = reference.look_ahead(step, discount, followers)
                worth[j] = alphas[j] @ belief
            before, count = float(tree.lower[i]), int(vectors.counts[0])
            value, better = back_up_lower(tree, scene.arrays, vectors, i, 1e-9, scene.room)
            assert value == pytest.approx(max(worth.values()), rel=1e-10)
            assert better == (value > before + 1e-9)
            if not better:
                assert (tree.lower[i], vectors.counts[0]) == (before, count)
                continue
            rose += 1
            j = max(worth, key=worth.__getitem__)
            assert tree.lower[i] == pytest.approx(worth[j], rel=1e-10)
            made = int(tree.best[i])
            np.testing.assert_allclose(vectors.alpha[made, :n], alphas[j], rtol=1e-10, atol=1e-12)
            assert (vectors.mode[made], vectors.choice[made] - scene.arrays.mode_choice[x]) == (x, j)
            assert vectors.counts[0] - count in (0, 1)
            for z, (mode, _, _) in enumerate(scene.table[x][j].outcomes):
                assert vectors.mode[vectors.follow[made, z]] == mode
    assert rose > 1


def test_a_better_vector_of_the_same_choice_takes_the_place_of_the_old_one():
    """Where it is no less anywhere; otherwise the old one is still wanted."""
    problem = textbook_problem([np.eye(2)], [np.ones((2, 1))], [[1.0, 2.0]], 0.5)
    arrays = arrays_of(problem)
    for start, replaced in (((0.0, 0.0), True), ((2.0, 4.0 - 4.0), True), ((3.0, 0.0), False)):
        tree = empty_tree(arrays, 20, np.full((1, 2), 10.0), np.full((1, 2), 10.0))
        vectors, room = empty_vectors(arrays, 5), new_room(arrays)
        follow = np.zeros(1, dtype=np.int32)
        add_vector(vectors, 0, 0, np.array(start), follow)
        i = node_of(tree, arrays, 0, np.array([0.25, 0.75]))
        look_up(tree, vectors, i, 2)
        open_choice(tree, arrays, i, 0, room.after, room.probability, room.reached)
        work = int(tree.counts[2])
        value, rose = back_up_lower(tree, arrays, vectors, i, 0.0, room)
        alpha = np.array([1.0, 2.0]) + 0.5 * np.array(start)
        assert rose
        assert value == pytest.approx(alpha @ [0.25, 0.75])
        assert tree.counts[2] - work == 2
        assert vectors.counts[0] == (1 if replaced else 2)
        np.testing.assert_allclose(vectors.alpha[tree.best[i]], alpha)
        assert tree.lower[i] == pytest.approx(value)
        # A rise that is not more than asked for is none.
        value = alpha @ [0.25, 0.75]
        gain = (np.array([1.0, 2.0]) + 0.5 * alpha) @ [0.25, 0.75] - value
        assert not back_up_lower(tree, arrays, vectors, i, gain + 1e-9, room)[1]
        assert back_up_lower(tree, arrays, vectors, i, gain - 1e-9, room)[1]


# -- vectors as a graph --------------------------------------------------------------------------------
def graph(problem, entries, capacity=None):
    """Vectors from (mode, place of the choice, alpha, followers)."""
    arrays = arrays_of(problem)
    vectors = empty_vectors(arrays, capacity or len(entries))
    for mode, choice, alpha, follow in entries:
        places = np.zeros(vectors.follow.shape[1], dtype=np.int32)
        places[: len(follow)] = follow
        add_vector(vectors, mode, int(arrays.mode_choice[mode]) + choice, np.array(alpha, float), places)
    return arrays, vectors


def test_a_mode_without_vectors_has_none():
    _, vectors = graph(PROBLEMS["small"], [(0, 0, [1.0, 2.0, 0.0], [])])
    assert best_vector(vectors, 1, np.array([1.0, 0, 0]), 3) == (-1, -np.inf)
    assert best_since(vectors, 1, np.array([1.0, 0, 0]), 3, 0, -7.0) == -7.0
    assert best_vector(vectors, 0, np.array([0.5, 0.5, 0]), 2) == (0, 1.5)


@pytest.mark.parametrize("capacity", [5, 9])
def test_one_sweep_raises_vectors_from_the_newest_to_the_oldest(capacity):
    """Each by one step followed by its followers as they are by then; what would fall stays."""
    problem = dense_problem(2, 4, 3, 3)
    rng = np.random.default_rng(3)
    follow = rng.integers(5, size=(5, 3))
    choice = rng.integers(3, size=5)
    alpha = rng.normal(size=(5, 4))
    arrays, vectors = graph(
        problem, [(0, c, a, f) for c, a, f in zip(choice, alpha, follow, strict=True)], capacity
    )
    table = reference.steps(problem)[0]
    for tolerance in (0.0, 1e9):
        before = alpha.copy()
        for i in range(4, -1, -1):
            after = reference.look_ahead(table[choice[i]], problem.discount, [alpha[j] for j in follow[i]])
            alpha[i] = np.maximum(alpha[i], after)
        assert evaluate_graph(arrays, vectors, tolerance, 1) == 1
        np.testing.assert_allclose(vectors.alpha[:5], alpha, rtol=1e-13)
        assert (alpha > before).any()
    assert evaluate_graph(arrays, vectors, 1e9, 50) == 1  # quiet after the first
    assert evaluate_graph(arrays, vectors, 0.0, 3) == 3
    arrays.halt[0] = 1
    kept = vectors.alpha.copy()
    assert evaluate_graph(arrays, vectors, 0.0, 3) == 1
    evaluate_closed(arrays, vectors, 0, 0.0, 3)
    np.testing.assert_array_equal(vectors.alpha, kept)


def test_what_all_values_have_in_common_is_there_after_one_sweep():
    problem = textbook_problem([np.eye(2)], [np.ones((2, 1))], [[1.0, 1.0]], 0.75)
    arrays, vectors = graph(problem, [(0, 0, [9.0, 9.0], [0]), (0, 0, [0.0, 0.0], [1])])
    evaluate_closed(arrays, vectors, 1, 0.0, 1)
    np.testing.assert_allclose(vectors.alpha, [[9.0, 9.0], [4.0, 4.0]], rtol=1e-14)
    # Where gains differ it is the least that all have in common, and half a sweep would be one too few.
    problem = textbook_problem([np.eye(2)], [np.ones((2, 1))], [[1.0, 3.0]], 0.75)
    arrays, vectors = graph(problem, [(0, 0, [0.0, 0.0], [0])])
    evaluate_closed(arrays, vectors, 0, 0.0, 1)
    np.testing.assert_allclose(vectors.alpha, [[4.0, 6.0]], rtol=1e-14)
    evaluate_closed(arrays, vectors, 0, 1e9, 9)  # quiet enough after one more
    np.testing.assert_allclose(vectors.alpha, [[4.0, 3 + 0.75 * 6]], rtol=1e-14)


def test_more_slots_are_a_copy():
    _, vectors = graph(PROBLEMS["small"], [(0, 0, [1.0, 2.0, 0.0], []), (0, 0, [3.0, 2.0, 0.0], [])])
    wider = copied_vectors(vectors, 7)
    wider.alpha[:] = 0.0
    wider.counts[0] = 0
    wider.last[:] = -1
    assert vectors.counts[0] == 2
    assert vectors.last[0] == 1
    assert vectors.alpha[1, 0] == 3.0


def lone(alphas):
    """Vectors of one mode that lead to themselves, with a choice each, so that they can be told apart."""
    n, width = len(alphas), len(alphas[0])
    problem = textbook_problem(
        [np.eye(width)] * n, [np.ones((width, 1))] * n, np.zeros((n, width)), 0.9, np.full(width, 1 / width)
    )
    return graph(problem, [(0, c, alpha, [c]) for c, alpha in enumerate(alphas)])


@pytest.mark.parametrize(("alphas", "number"), [
    ([[0.0, 1.0], [0.0, 1.0]], [0, 0]),  # of equals the oldest stays
    ([[0.0, 1.0], [0.0, 2.0]], [0, 0]),
    ([[0.0, 2.0], [0.0, 1.0]], [0, 0]),
    ([[0.0, 1.0], [1.0, 0.0]], [0, 1]),
    ([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0], [0.0, 4.0]], [0, 0, 0, 1]),
    ([[100, 100 * (1 - SLACK / 2)], [100 * (1 - SLACK / 2), 100]], [0, 0]),  # but for rounding the same
    ([[100, 100 * (1 - 8 * SLACK)], [100 * (1 - 8 * SLACK), 100]], [0, 1]),
])  # fmt: skip
def test_which_vectors_are_dominated(alphas, number):
    arrays, vectors = lone(alphas)
    found = keep_useful(vectors, arrays, np.ones(len(alphas), dtype=bool))
    assert found.tolist() == number
    kept = vectors.choice[: vectors.counts[0]].tolist()
    if number == [0, 0]:
        larger = np.argmax([sum(a) for a in alphas]) if np.ptp([sum(a) for a in alphas]) > 1e-9 else 0
        assert kept == [larger]
    elif len(alphas) == 4:
        assert kept == [2, 3]
    else:
        assert kept == [0, 1]


@pytest.mark.parametrize("seed", range(12))
def test_what_is_kept_is_what_is_wanted_and_what_that_leads_to(seed):
    """Small whole numbers, so that many are equal or dominated; what stands beyond a mode's states says nothing."""
    problem = PROBLEMS["small"]
    rng = np.random.default_rng(seed)
    table, sizes = reference.steps(problem), [len(s) for s in problem.states]
    modes = np.concatenate([[0, 1, 2], rng.integers(3, size=9)])
    entries = []
    for x in modes:
        c = int(rng.integers(len(table[x])))
        follow = [rng.choice(np.flatnonzero(modes == after)) for after, _, _ in table[x][c].outcomes]
        alpha = np.concatenate([rng.integers(0, 3, sizes[x]), rng.choice([-99, 99], 3 - sizes[x])])
        entries.append((int(x), c, alpha, follow))
    arrays, vectors = graph(problem, entries)
    wanted = rng.random(12) < 0.3
    asked = wanted.copy()
    number = keep_useful(vectors, arrays, wanted)
    kept = int(vectors.counts[0])
    own = [np.array(e[2])[: sizes[e[0]]] for e in entries]
    now = [vectors.alpha[k, : sizes[vectors.mode[k]]] for k in range(kept)]
    for i in range(12):
        assert number[i] >= 0 or not asked[i]
        if number[i] >= 0:
            assert vectors.mode[number[i]] == modes[i]
            assert (now[number[i]] >= own[i]).all()
    for k in range(kept):
        for other in range(kept):
            if other != k and vectors.mode[other] == vectors.mode[k]:
                assert (now[other] < now[k]).any()
    assert set(vectors.mode[:kept].tolist()) == {0, 1, 2}
    # The followers of what is left are what the old followers have become.
    origin = {}
    for i, (x, c, alpha, follow) in enumerate(entries):
        k = int(number[i])
        same = k >= 0 and (vectors.choice[k] - arrays.mode_choice[x]) == c and (vectors.alpha[k] == alpha).all()
        if same and [int(number[j]) for j in follow] == vectors.follow[k, : len(follow)].tolist():
            origin.setdefault(k, i)
    assert sorted(origin) == list(range(kept))
    # Nothing is kept that nobody wants: all is reached from what was asked for, but for one lone vector a mode.
    reached = {int(number[i]) for i in np.flatnonzero(asked)}
    roots = {int(vectors.mode[k]) for k in reached}
    lone_modes = {0, 1, 2} - roots
    first = {x: min(k for k in range(kept) if vectors.mode[k] == x) for x in lone_modes}
    reached |= set(first.values())
    left = list(reached)
    while left:
        k = left.pop()
        n = int(arrays.choice_outcome[vectors.choice[k] + 1] - arrays.choice_outcome[vectors.choice[k]])
        for follower in vectors.follow[k, :n].tolist():
            if follower not in reached:
                reached.add(follower)
                left.append(follower)
    assert len(reached) == kept
    for x in range(3):
        chain, i = [], int(vectors.last[x])
        while i >= 0:
            chain.append(i)
            i = int(vectors.previous[i])
        assert chain == np.flatnonzero(vectors.mode[:kept] == x)[::-1].tolist()


# -- bounds from more information ----------------------------------------------------------------------
def observed_sweep(problem, values):
    """One sweep with everything observed, every mode and state."""
    table = reference.steps(problem)
    return [
        np.max([
            reference.look_ahead(s, problem.discount, [values[x] for x, _, _ in s.outcomes]) for s in row
        ], axis=0)
        for row in table
    ]  # fmt: skip


@every
def test_sweeps_of_the_fully_observed_bound(name):
    """From as much as the highest reward for ever; the least that all have fallen by is taken at once."""
    problem = PROBLEMS[name]
    arrays = arrays_of(problem)
    sizes = [len(s) for s in problem.states]
    highest = max(c.reward.max() for offered in problem.choices for c in offered)
    values = [np.full(n, highest / (1 - problem.discount)) for n in sizes]
    ahead = problem.discount / (1 - problem.discount)
    for sweeps in (1, 2, 3):
        new = observed_sweep(problem, values)
        rise = max((a - b).max() for a, b in zip(new, values, strict=True))
        values = [np.minimum(v, n + ahead * rise) for v, n in zip(values, new, strict=True)]
        ours = np.full((problem.n_modes, problem.n_states), 7.0)
        assert mdp_bound(arrays, 0.0, sweeps, ours) == sweeps
        for x, n in enumerate(sizes):
            np.testing.assert_allclose(ours[x, :n], values[x], rtol=1e-12)
    before = ours.copy()
    new = observed_sweep(problem, values)
    rise = max((a - b).max() for a, b in zip(new, values, strict=True))
    change = max((v - np.minimum(v, n + ahead * rise)).max() for v, n in zip(values, new, strict=True))
    assert lower_mdp_bound(arrays, change * 1.001, 9, ours.copy()) == 1
    assert change == 0 or lower_mdp_bound(arrays, change * 0.999, 9, ours.copy()) > 1
    arrays.halt[0] = 1
    assert lower_mdp_bound(arrays, 0.0, 5, ours) == 0
    np.testing.assert_array_equal(ours, before)


@every
def test_sweeps_of_the_fast_informed_bound(name):
    """In place, choice by choice and state by state; what would rise stays."""
    problem = PROBLEMS[name]
    arrays = arrays_of(problem)
    sizes = [len(s) for s in problem.states]
    values = np.zeros((problem.n_modes, problem.n_states))
    mdp_bound(arrays, 1e-3, 100, values)
    table = reference.steps(problem)
    alpha = [
        np.array([
            reference.look_ahead(s, problem.discount, [values[x] for x, _, _ in s.outcomes]) for s in row
        ]) for row in table
    ]  # fmt: skip
    planes = np.full_like(arrays.reward, 7.0)
    assert informed_vectors(arrays, values, 0.0, 0, planes) == 0
    for x, n in enumerate(sizes):
        np.testing.assert_allclose(
            planes[arrays.mode_choice[x] : arrays.mode_choice[x + 1], :n], alpha[x], rtol=1e-12
        )
    falls = []
    for sweeps in (1, 2, 3):
        fall = 0.0
        for x, row in enumerate(table):
            for j, s in enumerate(row):
                for y in range(sizes[x]):
                    best = sum((t[y] @ alpha[after].T).max() for after, _, t in s.outcomes)
                    value = s.reward[y] + problem.discount * best
                    fall = max(fall, alpha[x][j, y] - value)
                    alpha[x][j, y] = min(alpha[x][j, y], value)
        falls.append(fall)
        ours = np.empty_like(planes)
        assert informed_vectors(arrays, values, -1.0, sweeps, ours) == sweeps
        for x, n in enumerate(sizes):
            found = ours[arrays.mode_choice[x] : arrays.mode_choice[x + 1], :n]
            np.testing.assert_allclose(found, alpha[x], rtol=1e-12)
    if falls[0] > falls[1] > falls[2] > 1e-9:
        assert informed_vectors(arrays, values, falls[1] * 1.001, 9, ours) == 2
        assert informed_vectors(arrays, values, falls[1] * 0.999, 9, ours) == 3
    arrays.halt[0] = 1
    before = ours.copy()
    assert lower_informed_vectors(arrays, 0.0, 5, ours) == 0
    np.testing.assert_array_equal(ours, before)
    # Told to come back before it began: above whatever could follow.
    informed_vectors(arrays, values, 0.0, 5, ours)
    for x, n in enumerate(sizes):
        rows = slice(arrays.mode_choice[x], arrays.mode_choice[x + 1])
        wanted = arrays.reward[rows, :n] + problem.discount * values.max()
        np.testing.assert_allclose(ours[rows, :n], wanted, rtol=1e-13)


# -- one step ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("p", "possible"), [(2 * POSSIBLE, True), (POSSIBLE, False), (0.5 * POSSIBLE, False)])
def test_where_an_outcome_begins_to_be_possible(p, possible):
    shows = csr([[1.0, p], [1.0, p]])
    problem = Problem(
        ("m",), (("a", "b"),), ((Choice("look", np.zeros(2), (Branch(0, csr(np.eye(2)), (0, 1), shows),)),),),
        ("usual", "hardly ever"), (np.array([1.0, 0.0]),), 0.9,
    )  # fmt: skip
    after, probability = np.full((2, 2), 7.0), np.full(2, 7.0)
    successors(arrays_of(problem), 0, np.array([1.0, 0.0]), 2, after, probability, np.zeros(2))
    assert probability.tolist() == [1.0, p if possible else 0.0]
    assert after.tolist() == [[1.0, 0.0], [float(possible), 0.0]]
