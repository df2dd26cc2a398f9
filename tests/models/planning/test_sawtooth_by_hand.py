"""The sawtooth on points made by hand: what it says of a belief, which points it is given and gives up.

Small and quick, also where kernels are interpreted.
"""

import numpy as np
import pytest

from models.planning.belief_tree import TINY, give_up_point, look_down
from models.planning.node_backups import add_point
from tests.models.planning.by_hand_cases import Scene, every
from tests.reference import planning_numpy as reference


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
    tree.counts[2] += 100
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
    tree.point_depth[-1] = -7.0
    give_up_point(tree, one)  # which has none: the newest point of others stays, and what is last in memory
    assert tree.point_depth[1] == pytest.approx(-10.0)
    assert tree.point_depth[-1] == -7.0


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


@pytest.mark.parametrize(("others", "upper", "after"), [(3.0, 4.0, 4.0), (9.0, 5.5, 5.0), (3.0, 5.5, 5.0)])
def test_a_corner_is_compared_with_itself_alone(others, upper, after):
    """Whatever the other corners are worth, those of its mode and those of the same state."""
    for x in (0, 1):
        for y in range(3):
            scene = Scene("latent")
            tree, wanted = scene.tree, np.full((2, 3), others)
            tree.corner[:] = others
            tree.corner[x, y] = 5.0
            i = scene.node(x, np.eye(3)[y])
            tree.upper[i] = upper
            add_point(tree, scene.arrays, i)
            wanted[x, y] = after
            np.testing.assert_array_equal(tree.corner, wanted)
