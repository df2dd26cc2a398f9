"""Nodes of the belief tree, what looking up finds and what opening a choice notes, against numpy.

Small and quick, also where kernels are interpreted.
"""

import numpy as np
import pytest

from models.planning.belief_tree import (
    SAME,
    choice_reward,
    grown_tree,
    look_up,
    node_of,
    note_risen,
    plane_bound,
    room_for,
)
from models.planning.node_backups import add_point, back_up_upper
from models.planning.step_kernel import successors
from models.planning.vectors import add_vector, empty_vectors
from tests.models.planning.by_hand_cases import Scene, every
from tests.planning_cases import padded


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
