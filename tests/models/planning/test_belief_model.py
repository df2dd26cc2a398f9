"""Belief updates by hand and out of range; what is refused as a belief, a mode process or draws to plan with."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.belief_check import IMPOSSIBLE, checked_belief
from models.planning.belief_model import BeliefModel
from models.planning.belief_policy import Myopic
from models.planning.latent import LatentBatch
from models.planning.mode_process import ModeProcess, alternating, bernoulli, mode_table
from models.protocol import PUBLISHED
from tests.models.planning.policy_cases import person, problem
from tests.planning_cases import modal_problem, sticky_draws
from tests.random_cases import make_protocol


# -- updates -------------------------------------------------------------------------------------------
def by_hand(world, mode, belief, choice, observation, next_mode):
    """Unnormalised next belief, state by state."""
    out = np.zeros(len(world.states[next_mode]))
    for branch in world.choices[mode][choice].branches:
        table = branch.transition.toarray()
        for j, o in enumerate(branch.observations):
            if branch.mode == next_mode and observation in (None, o):
                for y, p in enumerate(belief):
                    for after in range(len(out)):
                        seen = 1.0 if branch.emission is None else branch.emission.toarray()[after, j]
                        out[after] += p * table[y, after] * seen
    return out


@given(st.integers(0, 2**32 - 1))
def test_update_is_bayes_rule(seed):
    world, rng = modal_problem(seed % 1000, (2, 3, 1)), np.random.default_rng(seed)
    model = BeliefModel.of_problem(world)
    mode, after = (int(x) for x in rng.integers(3, size=2))
    belief = rng.dirichlet(np.ones(len(world.states[mode])))
    choice = int(rng.integers(len(world.choices[mode])))
    seen = None if rng.random() < 0.3 else int(rng.integers(3))
    wanted = by_hand(world, mode, belief, choice, seen, after)
    if wanted.sum() <= IMPOSSIBLE:
        with pytest.raises(InputError, match="has probability zero"):
            model.update(mode, belief, choice, seen, after)
        return
    assert model.update(mode, belief, choice, seen, after) == pytest.approx(wanted / wanted.sum(), abs=1e-13)
    many = model.update_many(mode, np.stack([belief, belief[::-1]]), choice, seen, after)
    assert many[0] == pytest.approx(wanted / wanted.sum(), abs=1e-13)


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ((2, 0, 1, 1), "mode: found 2, wanted 0 to 1"),
        ((-1, 0, 1, 1), "mode: found -1, wanted 0 to 1"),
        ((0, 2, 1, 1), "action in mode human_needs_help: found 2, wanted 0 to 1"),
        ((0, -1, 1, 1), "action in mode human_needs_help: found -1, wanted 0 to 1"),
        ((1, 0, 3, 0), r"observation: found 3, wanted 0 to 2 \(none, no_help, help\)"),
        ((1, 0, -1, 0), "observation: found -1, wanted 0 to 2"),
        ((1, 0, 1.0, 0), "observation: found 1.0, wanted 0 to 2"),
        ((1, 0, 1, 2), "mode: found 2, wanted 0 to 1"),
        ((1, 0, 1, True), "mode: found True, wanted 0 to 1"),
    ],
)
def test_numbers_out_of_range(step, words):
    mode, choice, seen, after = step
    for model in (BeliefModel.of_problem(problem(), impossible="reset"), BeliefModel.of_latent(person())):
        with pytest.raises(InputError, match=words):
            model.update(mode, np.ones(3) / 3, choice, seen, after)
        with pytest.raises(InputError, match=words):
            model.update_many(mode, np.ones((2, 3)) / 3, choice, seen, after)


def test_beliefs_of_another_length_and_unknown_ways_to_go_on():
    model = BeliefModel.of_problem(problem())
    for n in (2, 4):
        with pytest.raises(InputError, match=r"belief in mode human_needs_help, states: found \(.*, wanted 3"):
            model.update(0, np.ones(n) / n, 0, 0, 1)
        with pytest.raises(InputError, match=r"belief in mode human_needs_help, states: found \(2, .*, wanted 3"):
            model.update_many(0, np.ones((2, n)) / n, 0, 0, 1)
    with pytest.raises(InputError, match="impossible observations: found 'bogus', wanted error, keep or reset"):
        BeliefModel.of_problem(problem(), impossible="bogus")


# -- beliefs -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("belief", "words"),
    [
        ("ab", "found 'ab', wanted 2 probabilities"),
        (["a", "b"], "wanted 2 probabilities"),
        ({"a": 1}, "wanted 2 probabilities"),
        (None, "found None, wanted 2 probabilities"),
        ([0.5, None], "wanted 2 probabilities"),
        ([[0.5], [0.25, 0.25]], "wanted 2 probabilities"),
        (np.array([0.5 + 0j, 0.5]), "wanted 2 probabilities"),
        (0.5, r"shape: found \(\), wanted \(2,\)"),
        ([], r"shape: found \(0,\), wanted \(2,\)"),
        ([0.5, 0.25, 0.25], r"shape: found \(3,\), wanted \(2,\)"),
        ([1.5, -0.5], "wanted probabilities between 0 and 1"),
        ([0.5, float("nan")], "wanted probabilities between 0 and 1"),
        ([0.5, 0.49], "sum: found '0.99', wanted 1 within 1e-9"),
    ],
)
def test_what_is_no_belief(belief, words):
    with pytest.raises(InputError, match=f"belief in mode calm.*{words}"):
        checked_belief(belief, "calm", 2)


def test_whole_numbers_and_truth_values_are_beliefs():
    for sure in ([1, 0], (True, False), np.array([1, 0], dtype=np.float32)):
        found = checked_belief(sure, "calm", 2)
        assert found.dtype == np.float64
        assert found.tolist() == [1, 0]


# -- mode processes and draws --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: mode_table(PUBLISHED, "abc"), "mode process, table: found 'abc', wanted rows of probabilities"),
        (lambda: mode_table(PUBLISHED, [[1.0], [0.5, 0.5]]), "wanted rows of probabilities"),
        (lambda: mode_table(PUBLISHED, [[0.5, 0.5]]), r"shape of the table: found \(1, 2\), wanted \(2, 2\)"),
        (lambda: mode_table(PUBLISHED, [[0.5, 0.4], [1, 0]]), "mode process, mode 0, sum of the row: found '0.9'"),
        (lambda: ModeProcess(np.eye(2), np.eye(2), ""), r"shape of the start: found \(2, 2\)"),
        (lambda: ModeProcess(np.eye(2), [0.5, 0.4], ""), "start, sum of the row: found '0.9'"),
        (lambda: alternating(PUBLISHED, "X"), "first mode: found 'X', wanted one of "),
        (lambda: bernoulli(PUBLISHED, "half"), "probability: found 'half', wanted a number from 0 to 1"),
        (lambda: bernoulli(PUBLISHED, float("nan")), "probability: found nan"),
        (lambda: bernoulli(make_protocol([True], [2], 2), 0.5), "modes of the protocol: found 1, wanted 2"),
    ],
)
def test_what_is_no_mode_process(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_mode_process_keeps_its_own_numbers():
    table = np.full((2, 2), 0.5)
    process = mode_table(PUBLISHED, table)
    table[0] = 7
    assert process.table.tolist() == [[0.5, 0.5], [0.5, 0.5]]
    with pytest.raises(ValueError, match="read-only"):
        process.start[0] = 3


def test_draws_are_checked_before_any_is_solved():
    draws, three = sticky_draws(2, 1), ModeProcess(np.eye(3), np.eye(3)[0], "three modes")
    with pytest.raises(InputError, match="mode process, modes: found 3, wanted 2, as the protocol has"):
        LatentBatch(draws, three)
    for discount in (-0.1, 1.5, float("nan")):
        with pytest.raises(InputError, match=r"draws, discount: found .*, wanted a number from 0 to 1"):
            LatentBatch(draws, alternating(PUBLISHED), discount)


# -- policies on beliefs -------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("prosocial", "words"),
    [
        ([1.0, 2.0], r"prosocial reward, shape: found \(2,\), wanted \(3,\)"),
        (1.0, r"prosocial reward, shape: found \(\), wanted \(3,\)"),
        ([[1.0, 2.0, 3.0]], r"prosocial reward, shape: found \(1, 3\)"),
        (["a", "b", "c"], "wanted one number a hidden state"),
        ([1.0, 2.0, float("inf")], "wanted finite numbers"),
    ],
)
def test_myopic_needs_a_number_for_each_state(prosocial, words):
    with pytest.raises(InputError, match=words):
        Myopic(BeliefModel.of_latent(person()), prosocial)


def test_myopic_needs_the_same_states_in_every_mode():
    with pytest.raises(InputError, match=r"found \(3,\), wanted \(1 or 2 or 3,\)"):
        Myopic(BeliefModel.of_problem(modal_problem(1, (2, 3, 1))), [1.0, 2.0, 3.0])
