"""Sweeps of the bounds from more information, one by one.

Small and quick, also where kernels are interpreted.
"""

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.fast_informed_bound import informed_vectors, lower_informed_vectors, lower_mdp_bound, mdp_bound
from models.planning.problem import Branch, Choice, Problem, csr
from tests.models.planning.by_hand_cases import PROBLEMS, every
from tests.reference import planning_numpy as reference


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
            assert not ours[x, n:].any()
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
def test_the_fully_observed_bound_starts_at_the_highest_reward_for_ever(name):
    """Wherever it is; what stands beyond a mode's states says nothing."""
    problem = PROBLEMS[name]
    arrays = arrays_of(problem)
    for x, offered in enumerate(problem.choices):
        for c in range(arrays.mode_choice[x], arrays.mode_choice[x] + len(offered)):
            for y in range(len(problem.states[x])):
                arrays.reward[:] = 99.0
                for other, states in enumerate(problem.states):
                    rows = slice(arrays.mode_choice[other], arrays.mode_choice[other + 1])
                    arrays.reward[rows, : len(states)] = -3.0
                arrays.reward[c, y] = -1.0
                ours = np.full((problem.n_modes, problem.n_states), 7.0)
                assert mdp_bound(arrays, 0.0, 0, ours) == 0
                for other, states in enumerate(problem.states):
                    assert ours[other, : len(states)] == pytest.approx(-1.0 / (1 - problem.discount))
                    assert not ours[other, len(states) :].any()


@every
def test_what_would_rise_stays(name):
    """From an upper bound that is uneven, so that one step ahead of the low ones is above them."""
    problem = PROBLEMS[name]
    arrays = arrays_of(problem)
    sizes = [len(s) for s in problem.states]
    ours = np.zeros((problem.n_modes, problem.n_states))
    mdp_bound(arrays, 1e-12, 10_000, ours)
    values = [ours[x, :n] + np.where((np.arange(n) == 0) & (x == 0), 0.01, 5.0) for x, n in enumerate(sizes)]
    for x, n in enumerate(sizes):
        ours[x, :n] = values[x]
    new = observed_sweep(problem, values)
    rise = max((a - b).max() for a, b in zip(new, values, strict=True))
    ahead = problem.discount / (1 - problem.discount)
    assert rise > 0
    assert lower_mdp_bound(arrays, 0.0, 1, ours) == 1
    for x, n in enumerate(sizes):
        np.testing.assert_allclose(ours[x, :n], np.minimum(values[x], new[x] + ahead * rise), rtol=1e-12)


@pytest.mark.parametrize("first", [0, 1])
def test_the_choice_of_most_outcomes_may_be_any(first):
    """Of a quiet choice worth nothing and a coin of two sides, worth one: a coin for ever."""
    one, coin = csr([[1.0]]), csr([[0.5, 0.5]])
    toss = Choice("toss", np.ones(1), (Branch(0, one, (0, 1), coin),))
    quiet = Choice("quiet", np.zeros(1), (Branch(0, one, (0,)),))
    offered = (toss, quiet) if first == 0 else (quiet, toss)
    arrays = arrays_of(Problem(("m",), (("s",),), (offered,), ("heads", "tails"), (np.ones(1),), 0.5))
    planes = np.full((2, 1), 9.0)
    assert lower_informed_vectors(arrays, 0.0, 1, planes) == 1
    # In place: the second choice sees what the first has come down to, if that is not the higher one.
    toss_first, quiet_first = [5.5, 4.5], [4.5, 5.5]
    assert planes[:, 0].tolist() == (toss_first if first == 0 else quiet_first)


def test_what_a_branch_shows_may_be_a_part_of_what_happens():
    """Half the time one of two outcomes that its table shares out, half the time a third one."""
    one = csr([[1.0]])
    parts = (Branch(0, one, (0, 1), csr([[0.25, 0.25]])), Branch(0, csr([[0.5]]), (2,)))
    look = Choice("look", np.ones(1), parts)
    problem = Problem(("m",), (("s",),), ((look,),), ("left", "right", "none"), (np.ones(1),), 0.5)
    arrays = arrays_of(problem)
    values, planes = np.full((1, 1), 4.0), np.full((1, 1), 4.0)
    assert informed_vectors(arrays, values, 0.0, 0, planes) == 0
    assert planes.item() == 1 + 0.5 * 4.0
    assert lower_informed_vectors(arrays, 0.0, 1, planes) == 1
    assert planes.item() == 1 + 0.5 * 3.0
    assert lower_mdp_bound(arrays, 0.0, 1, values) == 1
    assert values.item() == 2.0  # what all have fallen by is taken at once


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
        assert not planes[arrays.mode_choice[x] : arrays.mode_choice[x + 1], n:].any()
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
