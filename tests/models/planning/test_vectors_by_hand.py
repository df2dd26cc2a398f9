"""Vectors as a graph: sweeps, and what is kept of it.

Small and quick, also where kernels are interpreted.
"""

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.textbook import textbook_problem
from models.planning.vectors import (
    SLACK,
    best_since,
    best_vector,
    copied_vectors,
    empty_vectors,
    evaluate_closed,
    evaluate_graph,
    keep_useful,
)
from tests.models.planning.by_hand_cases import PROBLEMS, graph, lone
from tests.planning_cases import dense_problem
from tests.reference import planning_numpy as reference


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


def test_fewer_vectors_than_states():
    problem = dense_problem(2, 4, 3, 3)
    low = np.full(4, -50.0)
    arrays, vectors = graph(problem, [(0, 1, low, [0, 0, 0])])
    assert evaluate_graph(arrays, vectors, 0.0, 1) == 1
    wanted = reference.look_ahead(reference.steps(problem)[0][1], problem.discount, [low] * 3)
    np.testing.assert_allclose(vectors.alpha, [wanted], rtol=1e-13)
    assert (wanted > low).all()


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


def test_room_for_vectors_is_empty():
    widest = max(len(step.outcomes) for row in reference.steps(PROBLEMS["small"]) for step in row)
    vectors = empty_vectors(arrays_of(PROBLEMS["small"]), 4)
    assert [part.shape for part in vectors] == [(1,), (4, 3), (4,), (4,), (4, widest), (3,), (4,)]
    assert vectors.counts.tolist() == [0]
    assert vectors.last.tolist() == [-1, -1, -1]
    assert vectors.previous.tolist() == [-1, -1, -1, -1]


@pytest.mark.parametrize(("alphas", "wanted", "number", "kept"), [
    # One that was wanted leaves its place to what dominates it, one that was not takes nobody's part.
    ([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0]], [1, 0, 0], [0, 0, -1], [1]),
    ([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0]], [0, 0, 1], [-1, -1, 0], [2]),
    ([[5.0, 0.0], [0.0, 1.0], [0.0, 2.0]], [1, 0, 0], [0, -1, -1], [0]),
    ([[0.0, 1.0], [0.0, 2.0], [0.0, 3.0], [9.0, 0.0]], [1, 0, 0, 0], [0, 0, 0, -1], [2]),
    # Any that is wanted stands for its mode; only where there is none the oldest does.
    ([[0.0, 1.0], [1.0, 0.0]], [0, 1], [-1, 0], [1]),
    ([[0.0, 1.0], [1.0, 0.0]], [0, 0], [0, -1], [0]),
    ([[0.0, 1.0], [0.0, 2.0], [1.0, 0.0]], [0, 0, 0], [0, 0, -1], [1]),
    # Rounding is a share of the two that are compared, whatever stands beside them.
    ([[1.0, 1 + 1e-6], [1e9, -1e9], [1 + 1e-6, 1.0]], [1, 1, 1], [0, 1, 2], [0, 1, 2]),
    ([[1e9, -1e9], [1.0, 1 + 1e-6], [1 + 1e-6, 1.0]], [1, 1, 1], [0, 1, 2], [0, 1, 2]),
    ([[1 + 1e-6, 1.0], [1.0, 1 + 1e-6], [1e9, -1e9]], [1, 1, 1], [0, 1, 2], [0, 1, 2]),
])  # fmt: skip
def test_who_stands_for_whom(alphas, wanted, number, kept):
    arrays, vectors = lone(alphas)
    assert keep_useful(vectors, arrays, np.array(wanted, dtype=bool)).tolist() == number
    assert vectors.choice[: vectors.counts[0]].tolist() == kept
    np.testing.assert_array_equal(vectors.alpha[: vectors.counts[0]], np.array(alphas)[kept])


def test_dominance_but_for_rounding_goes_round_in_no_circle():
    """The first below the second, that below the third, and that but for rounding the first: one is left."""
    slack = 100 * SLACK
    above = np.array([[0.0, 0.0], [1.5, -0.6], [0.6, 0.9]])
    arrays, vectors = lone((100 + slack * above).tolist())
    assert keep_useful(vectors, arrays, np.ones(3, dtype=bool)).tolist() == [0, 0, 0]
    assert vectors.choice[: vectors.counts[0]].tolist() == [2]
