"""The model with known tables: what it refuses, the belief update by hand, the canonical order."""

import re

import numpy as np
import pytest
from hypothesis import given

from models.errors import InputError
from models.forward_backward import log_likelihood_and_gradient
from models.lspomdp import LatentStatePOMDP
from models.protocol import PUBLISHED
from models.reward import Reward
from tests.models.test_protocol import THREE
from tests.random_cases import cases, random_tables


def tables(n_states=2, seed=1, protocol=PUBLISHED):
    return random_tables(np.random.default_rng(seed), protocol, n_states)


# -- validation ------------------------------------------------------------------------------------------
def test_a_row_that_sums_to_098_is_named():
    initial, transition, emission = tables(4)
    transition[3, 2] = [0.28, 0.2, 0.2, 0.3]
    message = (
        "model, transition, action signal, state mid-prosocial, sum of the row: found '0.98', wanted 1 within 1e-9"
    )
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        LatentStatePOMDP(initial, transition, emission)


def test_an_emission_row_is_named_by_its_own_action():
    initial, transition, emission = tables(3)
    emission[1, 0] = [0.5, 0.6]
    message = "model, emission, action signal, state s0, sum of the row: found '1.1', wanted 1 within 1e-9"
    with pytest.raises(InputError, match=re.escape(message)):
        LatentStatePOMDP(initial, transition, emission)


@pytest.mark.parametrize("bad", [-0.25, np.nan, np.inf])
def test_entries_that_are_no_probabilities_are_named(bad):
    initial, transition, emission = tables(2)
    transition[0, 1] = [bad, 1 - bad] if np.isfinite(bad) else [bad, 0.5]
    message = "model, transition, action no_help, state s1: found ["
    with pytest.raises(InputError, match=re.escape(message) + r".*\], wanted probabilities between 0 and 1$"):
        LatentStatePOMDP(initial, transition, emission)


def test_the_initial_belief_is_checked():
    _, transition, emission = tables(2)
    with pytest.raises(InputError, match=r"^model, initial, sum of the row: found '0\.9', wanted 1 within 1e-9$"):
        LatentStatePOMDP(np.array([0.4, 0.5]), transition, emission)


@pytest.mark.parametrize("sign", [-1, 1])
def test_rows_may_miss_one_by_a_billionth_and_no_more(sign):
    _, transition, emission = tables(2)
    LatentStatePOMDP(np.array([0.5, 0.5 + sign * 0.9e-9]), transition, emission)
    with pytest.raises(InputError, match="initial, sum of the row"):
        LatentStatePOMDP(np.array([0.5, 0.5 + sign * 1.1e-9]), transition, emission)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"initial": np.full((1, 2), 0.5)}, "model, initial: found (1, 2), wanted one probability a state"),
        ({"initial": np.array([])}, "model, initial: found (0,), wanted one probability a state"),
        ({"transition": np.full((3, 2, 2), 0.5)}, "model, shape of transition: found (3, 2, 2), wanted (4, 2, 2)"),
        ({"emission": np.full((4, 2, 2), 0.5)}, "model, shape of emission: found (4, 2, 2), wanted (2, 2, 2)"),
        ({"state_names": ("a", "a")}, "model, state names: found ['a', 'a'], wanted 2 different names"),
        ({"state_names": ("a",)}, "model, state names: found ['a'], wanted 2 different names"),
        ({"reward": Reward((1.0, 2.0, 3.0))}, "model, reward x: found 3, wanted 2 values, one a state"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(changes, message):
    initial, transition, emission = tables(2)
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        LatentStatePOMDP(**({"initial": initial, "transition": transition, "emission": emission} | changes))


def test_the_model_owns_its_tables():
    initial, transition, emission = tables(2)
    model = LatentStatePOMDP(initial, transition, emission)
    before = model.transition.copy()
    transition[0, 0] = [0.0, 1.0]
    assert np.array_equal(model.transition, before)
    with pytest.raises(ValueError, match="read-only"):
        model.transition[0, 0, 0] = 0.5


def test_names_and_rewards_have_defaults():
    model = LatentStatePOMDP(*tables(4))
    assert model.state_names == ("non-prosocial", "low-prosocial", "mid-prosocial", "high-prosocial")
    assert model.reward.x == (45.0, 48.0, 56.0, 67.0)
    smaller = LatentStatePOMDP(*tables(3))
    assert smaller.state_names == ("s0", "s1", "s2")
    assert smaller.reward.x == (45.0, 56.0, 67.0)


# -- belief ------------------------------------------------------------------------------------------------
HAND = LatentStatePOMDP(
    np.array([0.5, 0.5]),
    np.array([np.eye(2), [[0.2, 0.8], [0.0, 1.0]], [[0.9, 0.1], [0.3, 0.7]], [[0.5, 0.5], [0.25, 0.75]]]),
    np.array([[[0.8, 0.2], [0.4, 0.6]], [[1.0, 0.0], [0.1, 0.9]]]),
)


def test_update_is_bayes_rule_then_the_transition():
    """Prior (.5, .5); help under no_signal: (.5*.2, .5*.6) -> (.25, .75); then the state moves."""
    after = HAND.update(np.array([0.5, 0.5]), "no_signal", "help")
    np.testing.assert_allclose(after, [0.25 * 0.9 + 0.75 * 0.3, 0.25 * 0.1 + 0.75 * 0.7], rtol=1e-15)


def test_update_uses_the_state_before_the_transition():
    """A textbook POMDP would weigh the *next* state by the response; here that would give another belief."""
    predicted = np.array([0.5, 0.5]) @ HAND.transition[2]
    textbook = predicted * HAND.emission[0, :, 1]
    textbook = textbook / textbook.sum()
    assert np.abs(HAND.update(np.array([0.5, 0.5]), "no_signal", "help") - textbook).max() > 0.05


@pytest.mark.parametrize("action", ["help", "signal"])
def test_update_without_response_only_moves_the_state(action):
    belief = np.array([0.3, 0.7])
    np.testing.assert_allclose(HAND.update(belief, action), belief @ HAND.transition[PUBLISHED.action(action)])


def test_response_probability():
    np.testing.assert_allclose(HAND.response_probability(np.array([0.25, 0.75]), "signal"), [0.325, 0.675])
    message = "response probability, action: found 'help', wanted an action whose mode shows a response"
    with pytest.raises(InputError, match=re.escape(message)):
        HAND.response_probability(np.array([0.25, 0.75]), "help")


def test_an_impossible_response_stops_keeps_or_resets():
    sure = np.array([1.0, 0.0])
    with pytest.raises(
        InputError, match=r"'help' after 'signal' has probability zero .*\[1\.0, 0\.0\]; pass imposs"
    ):
        HAND.update(sure, "signal", "help")
    keep = HAND.update(sure, "signal", "help", impossible="keep")
    np.testing.assert_allclose(keep, sure @ HAND.transition[3])
    reset = HAND.update(sure, "signal", "help", impossible="reset")
    np.testing.assert_allclose(reset, HAND.initial @ HAND.transition[3])


def test_update_choice_does_not_matter_where_the_response_is_possible():
    belief = np.array([0.6, 0.4])
    results = [HAND.update(belief, "signal", "help", impossible=c) for c in ("error", "keep", "reset")]
    assert np.array_equal(results[0], results[1])
    assert np.array_equal(results[0], results[2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.5, 0.25, 0.25], "help"), "belief, shape: found (3,), wanted (2,)"),
        (([0.5, 0.4], "help"), "model, belief, sum of the row: found '0.9', wanted 1 within 1e-9"),
        (([1.5, -0.5], "help"), "model, belief: found [1.5, -0.5], wanted probabilities between 0 and 1"),
        (([0.5, 0.5], "wave"), "action: found 'wave', wanted one of no_help, help, no_signal, signal"),
        (
            ([0.5, 0.5], "help", "help"),
            "response after help: found 'help', wanted none: its mode shows no response",
        ),
        (([0.5, 0.5], "signal", "none"), "response: found 'none', wanted one of no_help, help"),
    ],
)
def test_unusable_rounds_are_refused(arguments, message):
    belief, *rest = arguments
    with pytest.raises(InputError, match=re.escape(message)):
        HAND.update(np.array(belief), *rest)


@given(cases(max_paths=10**9))
def test_filtering_gives_the_likelihood(case):
    """The product of predicted response probabilities along a run is its likelihood."""
    model = LatentStatePOMDP(*case.tables, case.protocol)
    names, responses = case.protocol.action_names, case.protocol.response_names
    logarithm = 0.0
    for run in case.runs:
        belief = model.initial
        for a, o in run:
            if o >= 0:
                logarithm += np.log(model.response_probability(belief, names[a])[o])
            belief = model.update(belief, names[a], responses[o] if o >= 0 else None)
            assert belief.sum() == pytest.approx(1, abs=1e-15)
    found = log_likelihood_and_gradient(case.tree(), *case.tables, case.index).log_likelihood
    assert found == pytest.approx(logarithm, rel=1e-11, abs=1e-11)


# -- order of states -----------------------------------------------------------------------------------------
def two_arms(no_signal, signal):
    """A model whose states help with these probabilities under the two arms."""
    n = len(no_signal)
    emission = np.stack([np.stack([1 - np.array(p), np.array(p)], axis=-1) for p in (no_signal, signal)])
    initial, transition, _ = tables(n, seed=5)
    return LatentStatePOMDP(initial, transition, emission)


def test_canonical_order_is_increasing_expected_score():
    model = two_arms([0.5, 0.9, 0.1], [0.6, 0.9, 0.2])
    ordered = model.canonical()
    assert ordered.emission[0, :, 1].tolist() == [0.1, 0.5, 0.9]
    for s, old in enumerate([2, 0, 1]):
        assert ordered.initial[s] == model.initial[old]
        for t, old_next in enumerate([2, 0, 1]):
            assert np.array_equal(ordered.transition[:, s, t], model.transition[:, old, old_next])
    assert ordered.state_names == model.state_names
    assert np.array_equal(ordered.canonical().transition, ordered.transition)


def test_an_arm_never_observed_cannot_decide_the_order():
    """Unobserved under signal, the states keep whatever EM started from there: .95 against .05."""
    model = two_arms([0.3, 0.6], [0.95, 0.05])
    assert model.canonical().emission[0, :, 1].tolist() == [0.6, 0.3]  # equal weights: .625 > .325
    observed = model.canonical(np.array([120.0, 0.0]))
    assert observed.emission[0, :, 1].tolist() == [0.3, 0.6]
    flipped = model.canonical(np.array([0.0, 7.0]))
    assert flipped.emission[1, :, 1].tolist() == [0.05, 0.95]


def test_order_follows_the_declared_scores():
    """Three responses scored -1, 0, 2: 'later' for certain (0) lies between the two others."""
    initial, transition, emission = tables(3, protocol=THREE)
    emission[:] = [[0.0, 0.1, 0.9], [0.9, 0.1, 0.0], [0.0, 1.0, 0.0]]
    model = LatentStatePOMDP(initial, transition, emission, THREE).canonical()
    assert model.emission[0].tolist() == [[0.9, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.1, 0.9]]


@given(cases(max_paths=10**9))
def test_reordering_keeps_the_likelihood_and_any_labelling_gives_one_canonical_model(case):
    model = LatentStatePOMDP(*case.tables, case.protocol)
    shuffled = model.reordered(np.roll(np.arange(case.n_states), 1)[::-1])
    one, two = model.canonical(), shuffled.canonical()
    for name in ("initial", "transition", "emission"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    value = log_likelihood_and_gradient(case.tree(), *case.tables, case.index).log_likelihood
    again = log_likelihood_and_gradient(case.tree(), one.initial, one.transition, one.emission, case.index)
    assert again.log_likelihood == pytest.approx(value, rel=1e-12, abs=1e-12)
