"""What one backup makes of each bound of a belief, against one step of the plain matrices.

Small and quick, also where kernels are interpreted.
"""

from itertools import product

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.belief_tree import empty_tree, look_up, node_of, open_choice
from models.planning.node_backups import _exceeds, add_point, back_up_lower, back_up_upper, new_room
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.textbook import textbook_problem
from models.planning.vectors import add_vector, empty_vectors
from tests.models.planning.by_hand_cases import PROBLEMS, Scene, every
from tests.reference import planning_numpy as reference


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
            assert not back_up_lower(tree, scene.arrays, vectors, i, 1e9, scene.room)[1]
            assert (tree.lower[i], vectors.counts[0]) == (before, count)
            work = int(tree.counts[2])  # children have been looked up by now: what is left is one vector
            value, better = back_up_lower(tree, scene.arrays, vectors, i, 1e-9, scene.room)
            assert value == pytest.approx(max(worth.values()), rel=1e-10)
            assert better == (value > before + 1e-9)
            if not better:
                assert (tree.lower[i], vectors.counts[0]) == (before, count)
                continue
            rose += 1
            j = max(worth, key=worth.__getitem__)
            assert tree.counts[2] - work == n * len(scene.table[x][j].outcomes)
            assert tree.lower[i] == pytest.approx(worth[j], rel=1e-10)
            made = int(tree.best[i])
            np.testing.assert_allclose(vectors.alpha[made, :n], alphas[j], rtol=1e-10, atol=1e-12)
            assert (vectors.mode[made], vectors.choice[made] - scene.arrays.mode_choice[x]) == (x, j)
            assert vectors.counts[0] - count in (0, 1)
            for z, (mode, _, _) in enumerate(scene.table[x][j].outcomes):
                assert vectors.follow[made, z] >= 0
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


def watched(rewards, shows):
    """Two states that stay as they are, seen as `shows` says, two vectors, and a node where the first is known."""
    problem = textbook_problem([np.eye(2)], [np.array(shows, float)], [rewards], 0.5)
    arrays = arrays_of(problem)
    tree = empty_tree(arrays, 20, np.full((1, 2), 30.0), np.full((1, 2), 30.0))
    vectors = empty_vectors(arrays, 5)
    for start in (0.0, 5.0):
        add_vector(vectors, 0, 0, np.full(2, start), np.zeros(vectors.follow.shape[1], dtype=np.int32))
    return arrays, tree, vectors, new_room(arrays)


def test_a_vector_that_takes_a_place_brings_its_followers():
    arrays, tree, vectors, room = watched([10.0, 10.0], [[1.0], [1.0]])
    i = node_of(tree, arrays, 0, np.array([0.5, 0.5]))
    look_up(tree, vectors, i, 2)
    open_choice(tree, arrays, i, 0, room.after, room.probability, room.reached)
    assert back_up_lower(tree, arrays, vectors, i, 0.0, room) == (12.5, True)
    assert vectors.counts[0] == 2
    np.testing.assert_array_equal(vectors.alpha[:2], [[0.0, 0.0], [12.5, 12.5]])
    assert vectors.follow[:2].tolist() == [[0], [1]]


@pytest.mark.parametrize("seen", [0, 1])
def test_after_what_cannot_be_seen_the_newest_vector_follows(seen):
    """The older one would do as well; what was in the scratch would not."""
    shows = np.eye(2)[[seen, 1 - seen]]
    arrays, tree, vectors, room = watched([10.0, -90.0], shows)
    vectors.alpha[:2] = [[7.0, 0.0], [5.0, 9.0]]
    i = node_of(tree, arrays, 0, np.array([1.0, 0.0]))
    open_choice(tree, arrays, i, 0, room.after, room.probability, room.reached)
    room.follow[:] = -1
    assert back_up_lower(tree, arrays, vectors, i, 0.0, room) == (13.5, True)
    follow = vectors.follow[tree.best[i]].tolist()
    assert follow == ([0, 1] if seen == 0 else [1, 0])
    np.testing.assert_array_equal(vectors.alpha[tree.best[i]], [13.5, -85.5])


@pytest.mark.parametrize(("choices", "made"), [((1, 0), 1), ((0, 1), 2), ((0, 0), 1), ((1, 1), 2)])
def test_a_place_is_taken_from_a_vector_of_the_same_choice_only(choices, made):
    """From the one that was best, whatever stands beside it."""
    problem = textbook_problem([np.eye(2)] * 2, [np.ones((2, 1))] * 2, [[10.0, 10.0], [0.0, 0.0]], 0.5)
    arrays = arrays_of(problem)
    tree = empty_tree(arrays, 20, np.full((1, 2), 30.0), np.full((2, 2), 30.0))
    vectors, room = empty_vectors(arrays, 5), new_room(arrays)
    for choice, start in zip(choices, (0.0, 5.0), strict=True):
        add_vector(vectors, 0, choice, np.full(2, start), np.zeros(1, dtype=np.int32))
    i = node_of(tree, arrays, 0, np.array([0.5, 0.5]))
    look_up(tree, vectors, i, 2)
    open_choice(tree, arrays, i, 0, room.after, room.probability, room.reached)
    assert back_up_lower(tree, arrays, vectors, i, 0.0, room) == (12.5, True)
    assert tree.best[i] == made
    assert vectors.counts[0] == max(2, made + 1)
    assert vectors.choice[made] == 0
    np.testing.assert_array_equal(vectors.alpha[made], [12.5, 12.5])


@pytest.mark.parametrize(("bound", "rises"), [(5.0, False), (-37.5, False), (-37.75, True)])
def test_a_value_that_the_vectors_do_not_bear_out_makes_no_vector(bound, rises):
    """Children that were worth more once: what is told is one step ahead of them, what counts is the new vector."""
    arrays, tree, vectors, room = watched([10.0, -90.0], np.eye(2))
    i = node_of(tree, arrays, 0, np.array([0.5, 0.5]))
    look_up(tree, vectors, i, 2)
    open_choice(tree, arrays, i, 0, room.after, room.probability, room.reached)
    for state in np.eye(2):
        child = node_of(tree, arrays, 0, state)
        look_up(tree, vectors, child, 2)
        tree.lower[child] = 1000.0
    tree.lower[i] = bound
    assert back_up_lower(tree, arrays, vectors, i, 0.0, room) == (-40 + 0.5 * 1000, rises)
    assert tree.lower[i] == max(bound, (10.0 - 90.0) / 2 + 0.5 * 5.0)
    assert vectors.counts[0] == 2 + rises


def test_a_vector_exceeds_another_where_it_is_no_less_anywhere():
    """Beyond the mode's states nothing counts."""
    for one in product(range(3), repeat=3):
        for other in product(range(3), repeat=3):
            for size in (1, 2, 3):
                wanted = all(a >= b for a, b in zip(one[:size], other[:size], strict=True))
                assert _exceeds(np.array(one, float), np.array(other, float), size) == wanted
