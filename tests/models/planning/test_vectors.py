"""Alpha vectors as a policy graph: blind policies, evaluation, and what may be dropped."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.planning.arrays import arrays_of
from models.planning.blind_policies import blind_vectors
from models.planning.grid_run import blind_slots
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.textbook import textbook_problem
from models.planning.vectors import (
    add_vector,
    best_since,
    best_vector,
    empty_vectors,
    evaluate_closed,
    evaluate_graph,
    grown_vectors,
    keep_useful,
)
from tests.planning_cases import CASES, modal_problem, padded
from tests.reference import planning_numpy as reference


def random_graph(problem, seed, count=12, *, low=None):
    """A closed random policy graph, every mode in it, all vectors at the lowest value there could be."""
    arrays = arrays_of(problem)
    rng = np.random.default_rng(seed)
    vectors = empty_vectors(arrays, count + 5)
    low = arrays.reward.min() / (1 - problem.discount) if low is None else low
    mode = np.concatenate([np.arange(problem.n_modes), rng.integers(problem.n_modes, size=count - problem.n_modes)])
    table = reference.steps(problem)
    for x in mode:
        c = int(rng.integers(len(problem.choices[x])))
        follow = np.zeros(vectors.follow.shape[1], dtype=np.int32)
        for z, (after, _, _) in enumerate(table[x][c].outcomes):
            follow[z] = rng.choice(np.flatnonzero(mode == after))
        alpha = np.full(problem.n_states, low)
        add_vector(vectors, int(x), int(arrays.mode_choice[x]) + c, alpha, follow)
    return arrays, vectors


def worth(problem, arrays, vectors):
    """Value of every node by the linear solve of the reference."""
    n = int(vectors.counts[0])
    mode = vectors.mode[:n]
    return reference.controller_values(problem, mode, vectors.choice[:n] - arrays.mode_choice[mode], vectors.follow)


def best(vectors, x, belief, width):
    return best_vector(vectors, x, padded(belief, width), len(belief))[1]


@pytest.mark.parametrize("name", sorted(CASES))
def test_blind_policies_are_the_linear_solve(name):
    problem = CASES[name]
    arrays = arrays_of(problem)
    vectors = empty_vectors(arrays, blind_slots(arrays))
    blind_vectors(arrays, vectors, 64)
    assert vectors.counts[0] == blind_slots(arrays)
    scale = np.ptp(arrays.reward) / (1 - problem.discount)
    policies = list(itertools.product(*(range(len(c)) for c in problem.choices)))
    found = {}
    for first in range(0, int(vectors.counts[0]), problem.n_modes):
        picks = tuple(int(vectors.choice[first + x] - arrays.mode_choice[x]) for x in range(problem.n_modes))
        found[picks] = first
    assert sorted(found) == policies
    for picks, first in found.items():
        for x, value in enumerate(reference.blind_value(problem, picks)):
            ours = vectors.alpha[first + x, : len(value)]
            np.testing.assert_allclose(ours, value, atol=1e-7 * scale)
            assert (ours <= value + 1e-10 * scale).all()


def test_with_too_many_combinations_there_is_one_policy_an_action():
    problem = modal_problem(0, (2, 2, 2))
    arrays = arrays_of(problem)
    vectors = empty_vectors(arrays, 100)
    blind_vectors(arrays, vectors, 1)
    deepest = max(len(c) for c in problem.choices)
    assert deepest > 1
    assert vectors.counts[0] == 3 * deepest
    for alpha, value in zip(vectors.alpha, worth(problem, arrays, vectors), strict=False):
        np.testing.assert_allclose(alpha[: len(value)], value, atol=1e-6)


@given(st.sampled_from(sorted(CASES)), st.integers(0, 1000))
def test_evaluation_rises_to_the_controllers_value_and_never_beyond(name, seed):
    problem = CASES[name]
    arrays, vectors = random_graph(problem, seed)
    values = worth(problem, arrays, vectors)
    before = vectors.alpha.copy()
    for _ in range(6):
        evaluate_graph(arrays, vectors, 0.0, 1)
        assert (vectors.alpha >= before).all()
        for alpha, value in zip(vectors.alpha, values, strict=False):
            assert (alpha[: len(value)] <= value + 1e-9).all()
        before = vectors.alpha.copy()
    evaluate_graph(arrays, vectors, 1e-13, 5000)
    for alpha, value in zip(vectors.alpha, values, strict=False):
        np.testing.assert_allclose(alpha[: len(value)], value, atol=1e-9)


@given(st.sampled_from(sorted(CASES)), st.integers(0, 1000), st.integers(1, 5))
def test_closed_evaluation_is_sound_after_any_number_of_sweeps(name, seed, sweeps):
    problem = CASES[name]
    for most in (sweeps, 3000):
        arrays, vectors = random_graph(problem, seed)
        values = worth(problem, arrays, vectors)
        evaluate_closed(arrays, vectors, 0, 1e-13, most)
        for alpha, value in zip(vectors.alpha, values, strict=False):
            assert (alpha[: len(value)] <= value + 1e-9).all()
            if most > 5:
                np.testing.assert_allclose(alpha[: len(value)], value, atol=1e-8)


@given(st.sampled_from(sorted(CASES)), st.integers(0, 1000), st.booleans())
def test_dropping_keeps_the_maximum_where_it_was_wanted(name, seed, all_wanted):
    problem = CASES[name]
    arrays, vectors = random_graph(problem, seed, 14)
    evaluate_graph(arrays, vectors, 1e-13, 5000)
    rng = np.random.default_rng(seed)
    width, n = problem.n_states, int(vectors.counts[0])
    wanted = np.zeros(n + 3, dtype=bool)
    beliefs = []
    for x, states in enumerate(problem.states):
        for belief in rng.dirichlet(np.ones(len(states)), size=3):
            beliefs.append((x, belief, best(vectors, x, belief, width)))
            wanted[best_vector(vectors, x, padded(belief, width), len(belief))[0]] = True
    wanted[:n] |= all_wanted
    asked = wanted.copy()
    old = vectors.alpha[:n].copy(), vectors.mode[:n].copy()
    number = keep_useful(vectors, arrays, wanted)
    kept = int(vectors.counts[0])
    assert 0 < kept <= n
    for x, belief, value in beliefs:
        assert best(vectors, x, belief, width) >= value - 1e-12 * arrays.largest
    # A vector's new number is its own place, or that of one that dominates it in its mode.
    for i in range(n):
        if asked[i]:
            assert number[i] >= 0
        if number[i] >= 0:
            size = len(problem.states[old[1][i]])
            assert vectors.mode[number[i]] == old[1][i]
            assert (vectors.alpha[number[i], :size] >= old[0][i, :size] - 1e-12 * arrays.largest).all()
    # The graph is closed, modes agree (checked by the reference), and it is worth what the vectors say.
    for alpha, value in zip(vectors.alpha, worth(problem, arrays, vectors), strict=False):
        assert (alpha[: len(value)] <= value + 1e-7).all()
    # Lists by mode are those of the vectors that are left.
    for x in range(problem.n_modes):
        chain, i = [], int(vectors.last[x])
        while i >= 0:
            chain.append(i)
            i = int(vectors.previous[i])
        assert chain == np.flatnonzero(vectors.mode[:kept] == x)[::-1].tolist()


def test_every_mode_keeps_a_vector():
    """Nothing that is wanted leads to the second mode, but a later backup may."""
    one = csr([[1.0]])
    stay = Choice("stay", np.array([0.0]), (Branch(0, one, (0,)),))
    go = Choice("go", np.array([1.0]), (Branch(1, one, (0,)),))
    rest = Choice("rest", np.array([0.5]), (Branch(1, one, (0,)),))
    problem = Problem(("a", "b"), (("s",),) * 2, ((stay, go), (rest,)), ("none",), (np.ones(1), np.zeros(1)), 0.9)
    arrays = arrays_of(problem)
    vectors = empty_vectors(arrays, 8)
    for x, c, value, after in ((0, 0, 9.0, 0), (1, 2, 5.0, 1)):
        follow = np.full(vectors.follow.shape[1], after, dtype=np.int32)
        add_vector(vectors, x, c, np.array([value]), follow)
    wanted = np.array([True, False])
    keep_useful(vectors, arrays, wanted)
    assert vectors.mode[: vectors.counts[0]].tolist() == [0, 1]


def test_equal_vectors_leave_one():
    problem = modal_problem(1, (2, 2))
    arrays, vectors = random_graph(problem, 0, 10, low=-1.0)
    number = keep_useful(vectors, arrays, np.ones(10, dtype=bool))
    assert vectors.mode[: vectors.counts[0]].tolist() == [0, 1]
    assert number.tolist() == [int(x) for x in random_graph(problem, 0, 10)[1].mode[:10]]


def test_a_large_entry_does_not_hide_what_another_one_gains():
    """Where ruin is possible, a small share of its value is much of every other one."""
    problem = textbook_problem([np.eye(2)] * 2, [np.ones((2, 1))] * 2, [[1.0, -1e8], [0.9, -1e8]], 0.9999)
    arrays = arrays_of(problem)
    vectors = empty_vectors(arrays, 2)
    for i, good in enumerate([9999.995, 9999.999]):
        add_vector(vectors, 0, i, np.array([good, -1e12]), np.zeros(1, dtype=np.int32))
    number = keep_useful(vectors, arrays, np.ones(2, dtype=bool))
    assert number.tolist() == [0, 0]
    assert vectors.alpha[0, 0] == 9999.999


def test_best_vector_is_the_oldest_of_equals_and_knows_the_new_ones():
    problem = modal_problem(1, (2, 2))
    vectors = random_graph(problem, 0, 6)[1]
    rng = np.random.default_rng(0)
    vectors.alpha[:6] = rng.normal(size=(6, 2))
    belief = np.array([0.3, 0.7])
    for x in range(2):
        held = np.flatnonzero(vectors.mode[:6] == x)
        values = vectors.alpha[held] @ belief
        assert best_vector(vectors, x, belief, 2) == (held[values.argmax()], pytest.approx(values.max()))
        for since in range(7):
            new = values[held >= since]
            assert best_since(vectors, x, belief, 2, since, 0.1) == pytest.approx(max([0.1, *new]))
        vectors.alpha[held] = 1.0
        assert best_vector(vectors, x, belief, 2)[0] == held[0]


def test_more_slots_change_nothing():
    problem = modal_problem(3, (4, 1, 3, 2))
    arrays, vectors = random_graph(problem, 2, 11)
    wider = grown_vectors(vectors, 50)
    for name in ("alpha", "mode", "choice", "follow", "previous"):
        np.testing.assert_array_equal(getattr(wider, name)[:11], getattr(vectors, name)[:11])
        assert len(getattr(wider, name)) == 50
    np.testing.assert_array_equal(wider.last, vectors.last)
    evaluate_graph(arrays, wider, 1e-13, 5000)
    for alpha, value in zip(wider.alpha, worth(problem, arrays, wider), strict=False):
        np.testing.assert_allclose(alpha[: len(value)], value, atol=1e-9)
