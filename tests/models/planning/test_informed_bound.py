"""Upper bounds of a robot that knows more: their order, their fixed points, and every sweep on the way."""

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.fast_informed_bound import informed_vectors, mdp_bound
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.textbook import textbook_problem
from tests.planning_cases import CASES, dense_problem, modal_problem
from tests.reference import planning_numpy as reference

MANY = 100_000


def bounds(problem, mdp_sweeps=MANY, sweeps=MANY):
    arrays = arrays_of(problem)
    values = np.zeros((problem.n_modes, problem.n_states))
    mdp_bound(arrays, 1e-13, mdp_sweeps, values)
    planes = np.zeros_like(arrays.reward)
    informed_vectors(arrays, values, 1e-13, sweeps, planes)
    split = [planes[arrays.mode_choice[x] : arrays.mode_choice[x + 1]] for x in range(problem.n_modes)]
    return values, split


@pytest.mark.parametrize("name", sorted(CASES))
def test_are_the_plain_ones(name):
    problem = CASES[name]
    values, planes = bounds(problem)
    for x, n in enumerate(map(len, problem.states)):
        np.testing.assert_allclose(values[x, :n], reference.mdp_values(problem, 600)[x], atol=1e-9)
        np.testing.assert_allclose(planes[x][:, :n], reference.informed_vectors(problem, 600)[x], atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_optimum_informed_qmdp_mdp(seed):
    """V* <= FIB <= QMDP <= MDP at random beliefs; V* from plain grids on the line."""
    problem = (dense_problem(seed, 2, 2, 2, 0.8), modal_problem(seed, (2, 1, 2), 0.8))[seed % 2]
    values, planes = bounds(problem)
    q = reference.qmdp_vectors(problem)
    rng = np.random.default_rng(seed)
    for x, n in enumerate(map(len, problem.states)):
        for belief in rng.dirichlet(np.ones(n), size=4):
            start = [np.zeros(len(s)) for s in problem.states]
            start[x] = belief
            low, _ = reference.line_interval(problem.started(start), 101, 80)
            informed = (planes[x][:, :n] @ belief).max()
            assert low <= informed + 1e-9
            assert informed <= (q[x] @ belief).max() + 1e-9
            assert (q[x] @ belief).max() <= values[x, :n] @ belief + 1e-9


@pytest.mark.parametrize("name", sorted(CASES))
def test_every_sweep_is_sound_and_none_rises(name):
    problem = CASES[name]
    exact = reference.mdp_values(problem, 600)
    informed = reference.informed_vectors(problem, 600)
    before, above = None, None
    for sweeps in (1, 2, 3, 5, 9, 30):
        values, planes = bounds(problem, sweeps, sweeps)
        for x, n in enumerate(map(len, problem.states)):
            assert (values[x, :n] >= exact[x] - 1e-9).all()
            assert (planes[x][:, :n] >= informed[x] - 1e-9).all()
            if before is not None:
                assert (values[x] <= before[x] + 1e-12).all()
                assert (planes[x] <= above[x] + 1e-12).all()
        before, above = values, planes


@pytest.mark.parametrize("seed", range(3))
def test_all_are_equal_when_the_end_state_is_seen(seed):
    hidden = dense_problem(seed, 4, 3, 4)
    seen = textbook_problem(
        [c.branches[0].transition for c in hidden.choices[0]], [np.eye(4)] * 3,
        np.stack([c.reward for c in hidden.choices[0]]), hidden.discount, hidden.initial[0],
    )  # fmt: skip
    values, planes = bounds(seen)
    q = reference.qmdp_vectors(seen)[0]
    np.testing.assert_allclose(planes[0], q, atol=1e-9)
    np.testing.assert_allclose(planes[0].max(axis=0), values[0], atol=1e-9)


def test_guessing_a_coin_by_hand():
    """Who will know the coin wins each time after the first; the informed bound knows that nobody will."""
    coin = textbook_problem(np.full((2, 2, 2), 0.5), np.ones((2, 2, 1)), np.eye(2), 0.9)
    values, planes = bounds(coin)
    np.testing.assert_allclose(values[0], 10, rtol=1e-10)
    np.testing.assert_allclose(planes[0], np.eye(2) + 0.9 * 5, rtol=1e-10)


@pytest.mark.parametrize("discount", [0.0, 0.5, 0.999])
def test_one_state_for_ever(discount):
    one = csr([[1.0]])
    offered = tuple(Choice(a, np.array([r]), (Branch(0, one, (0,)),)) for a, r in (("a", -2.0), ("b", -1.0)))
    values, planes = bounds(Problem(("m",), (("s",),), (offered,), ("none",), (np.ones(1),), discount))
    assert values[0, 0] == pytest.approx(-1 / (1 - discount), rel=1e-9)
    np.testing.assert_allclose(planes[0][:, 0], [-2 - discount / (1 - discount), -1 / (1 - discount)], rtol=1e-9)
