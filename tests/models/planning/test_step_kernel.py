"""One step, compiled, against numpy on the problem's own matrices."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.planning.arrays import arrays_of
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.step_kernel import expected_reward, look_ahead, successors
from tests.planning_cases import dense_problem, latent_case, modal_problem, padded, sparse_problem
from tests.reference import planning_numpy as reference

KINDS = {
    "dense": lambda seed: dense_problem(seed, 2 + seed % 4, 2, 3),
    "sparse": lambda seed: sparse_problem(seed, 20),
    "modal": lambda seed: modal_problem(seed, ((2, 3, 1), (1, 4), (3, 3, 2))[seed % 3]),
    "latent": lambda seed: latent_case(seed, ("alternating", "bernoulli", "table")[seed % 3]),
}


def every_choice(problem):
    arrays = arrays_of(problem)
    table = reference.steps(problem)
    for x, row in enumerate(table):
        for j, step in enumerate(row):
            yield arrays, int(arrays.mode_choice[x]) + j, x, len(problem.states[x]), step


@given(st.sampled_from(sorted(KINDS)), st.integers(0, 10_000))
def test_successors(kind, seed):
    problem = KINDS[kind](seed)
    rng = np.random.default_rng(seed)
    width = problem.n_states
    for arrays, c, x, size, step in every_choice(problem):
        belief = rng.dirichlet(np.ones(size)) * (rng.random(size) < 0.7)
        belief = belief / belief.sum() if belief.sum() > 0 else np.eye(size)[0]
        outcomes = len(step.outcomes)
        # Scratch that was used before must not show.
        after, probability = np.full((outcomes, width), 7.0), np.full(outcomes, 7.0)
        successors(arrays, c, padded(belief, width), size, after, probability, np.full(width, 7.0))
        assert probability.sum() == pytest.approx(1, abs=1e-12)
        for z, (p, expected) in enumerate(reference.successors(step, belief)):
            assert probability[z] == pytest.approx(p, abs=1e-14)
            np.testing.assert_allclose(after[z, : len(expected)], expected, atol=1e-12)
        begin = arrays.choice_outcome[c]
        assert arrays.outcome_mode[begin : begin + outcomes].tolist() == [m for m, _, _ in step.outcomes]
        assert arrays.outcome_observation[begin : begin + outcomes].tolist() == [o for _, o, _ in step.outcomes]
        assert expected_reward(arrays, c, padded(belief, width), size) == pytest.approx(belief @ step.reward)
        # The joint form of the problem itself says the same.
        ours = {(m, o): p for (m, o, _), p in zip(step.outcomes, probability, strict=True) if p > 1e-12}
        theirs = {(m, o): p for m, o, p, _ in problem.outcomes(x, c - int(arrays.mode_choice[x]), belief)}
        assert ours == pytest.approx(theirs)


@given(st.sampled_from(sorted(KINDS)), st.integers(0, 10_000))
def test_look_ahead(kind, seed):
    problem = KINDS[kind](seed)
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(9, problem.n_states))
    for arrays, c, _, size, step in every_choice(problem):
        follow = rng.integers(9, size=len(step.outcomes)).astype(np.int32)
        out = np.zeros(problem.n_states)
        look_ahead(arrays, c, size, vectors, follow, out, np.full(problem.n_states, 7.0))
        expected = reference.look_ahead(step, problem.discount, [vectors[i] for i in follow])
        np.testing.assert_allclose(out[:size], expected, atol=1e-12)


def test_look_ahead_is_the_expectation_over_successors():
    """What connects the two: alpha . b = b . R + discount * sum over outcomes of p (alpha_z . tau_z)."""
    for seed in range(20):
        problem = modal_problem(seed, (2, 3, 1))
        rng = np.random.default_rng(seed)
        vectors = rng.normal(size=(5, 3))
        for arrays, c, _, size, step in every_choice(problem):
            follow = rng.integers(5, size=len(step.outcomes)).astype(np.int32)
            out, reached = np.zeros(3), np.zeros(3)
            look_ahead(arrays, c, size, vectors, follow, out, reached)
            belief = padded(rng.dirichlet(np.ones(size)), 3)
            after, p = np.zeros((len(follow), 3)), np.zeros(len(follow))
            successors(arrays, c, belief, size, after, p, reached)
            ahead = sum(p[z] * after[z] @ vectors[i] for z, i in enumerate(follow))
            assert out @ belief == pytest.approx(belief @ arrays.reward[c] + problem.discount * ahead, abs=1e-12)


def test_impossible_outcomes_have_no_belief():
    shows = csr([[1.0, 0.0], [0.0, 1.0]])
    stays = csr(np.eye(2))
    problem = Problem(
        ("m",), (("a", "b"),), ((Choice("look", np.zeros(2), (Branch(0, stays, (0, 1), shows),)),),),
        ("saw a", "saw b"), (np.array([1.0, 0.0]),), 0.9,
    )  # fmt: skip
    after, p = np.full((2, 2), 7.0), np.zeros(2)
    successors(arrays_of(problem), 0, np.array([1.0, 0.0]), 2, after, p, np.zeros(2))
    np.testing.assert_array_equal(p, [1, 0])
    np.testing.assert_array_equal(after, [[1, 0], [0, 0]])
