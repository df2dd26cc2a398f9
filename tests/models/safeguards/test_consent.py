"""Consent: without it the fallback acts by the mode alone, and nothing of the person is left."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.baselines import ModePolicy
from models.planning.mixture import Mixture
from models.protocol import PUBLISHED
from models.runtime import Session
from models.safeguards.budget import CostBudget
from models.safeguards.consent import Consent, fallback_of
from models.safeguards.guarded import Guarded
from tests.models.planning.policy_cases import policy as bare
from tests.models.safeguards.guard_cases import HUMAN, NONE, ROBOT, guarded, rounds, walked


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.sampled_from(["vectors", "tracked", "random", "reactive"]))
def test_after_withdrawal_nothing_is_left(seed, steps, kind):
    own, rng = guarded(kind), np.random.default_rng(seed)
    memory, _ = walked(own, rounds(), rng, steps)
    gone = own.withdraw(memory)
    assert gone.mode == memory.mode
    assert gone == own.withdraw(own.begin(ROBOT)) or gone.mode != ROBOT
    assert (gone.policy, gone.states, gone.source, gone.event, gone.worth) == (None, (), None, 0, None)
    assert not any(isinstance(getattr(gone, f.name), np.ndarray) for f in fields(gone))
    # Whatever is seen afterwards leaves no trace.
    for seen in (1, 2, None):
        there = own.observe(gone, 0, seen, 1 - gone.mode)
        assert own.probabilities(there).tolist() == [1.0, 0.0]
        back = own.observe(there, 1, None, gone.mode)
        assert back == gone


def test_nothing_that_was_worked_out_is_left():
    own, rng = guarded("reactive"), np.random.default_rng(1)
    memory, _ = walked(own, rounds(), rng, 3)
    assert own.worth_source._known
    own.withdraw(memory)
    assert not own.worth_source._known


def test_plans_made_anew_for_a_history_are_forgotten():
    """A plan that was left is planned anew, also by policies that others hold beside the session."""
    own, rng = guarded("plan"), np.random.default_rng(3)
    memory, _ = walked(own, rounds(), rng, 4, overrule=1.0)
    own.probabilities(memory)
    assert own.policy._anew
    own.withdraw(memory)
    assert not own.policy._anew
    assert not own.worth_source._known
    mixed = Mixture([own.policy, bare("reactive")], [0.5, 0.5])
    for held, plan in ((own, own.policy), (mixed, own.policy), (own.policy, own.policy)):
        session = Session(held)
        for k in range(4):
            mode = held.vocabulary.modes[rounds().modes[k]]
            decision = session.act(mode)
            offered = held.vocabulary.actions[decision.mode]
            session.observe("help" if rounds().n_outcomes(k) > 1 else None, offered[1 - decision.choice])
        session.act(held.vocabulary.modes[rounds().modes[4]])
        assert plan._anew
        session.withdraw()
        assert not plan._anew


def test_never_given():
    own = guarded("vectors")
    memory = own.begin(ROBOT, Consent.NEVER)
    assert own.probabilities(memory).tolist() == [1.0, 0.0]
    found = own.decide(memory)
    assert found.changed_by == ()
    assert found.numbers == {}
    assert found.explanation == (
        "no_signal; consent was never given, so fallback looks at the mode robot_needs_help only, and nothing is "
        "believed."
    )
    assert "withdrawn" in own.decide(own.withdraw(own.begin(ROBOT))).explanation


def test_the_fallback_is_as_declared():
    declared = fallback_of(PUBLISHED, {"human_needs_help": "help"})
    own = Guarded(bare("tracked"), [], declared)
    assert own.without_consent() is declared
    memory = own.withdraw(own.observe(own.begin(ROBOT), 1, 2, HUMAN))
    assert own.vocabulary.actions[HUMAN][own.act(memory)] == "help"
    memory = own.observe(memory, 1, NONE, ROBOT)
    assert own.vocabulary.actions[ROBOT][own.act(memory)] == "no_signal"


def test_chances_that_depend_on_the_mode_only_are_no_adaptation():
    words = bare("always").vocabulary
    own = Guarded(bare("always"), [], ModePolicy(words, [[0.5, 0.5], [1.0, 0.0]], "coin"))
    memory, rng = own.begin(HUMAN, Consent.NEVER), np.random.default_rng(1)
    assert np.mean([own.act(memory, rng) for _ in range(500)]) == pytest.approx(0.5, abs=0.08)


@pytest.mark.parametrize("kind", ["reactive", "myopic", "tracked", "controller", "plan"])
def test_an_adaptive_fallback_is_refused_by_name(kind):
    adaptive = bare(kind)
    with pytest.raises(InputError) as caught:
        Guarded(bare("always"), [], adaptive)
    assert adaptive.name in str(caught.value)
    assert "a policy by mode" in str(caught.value)


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        ({"somewhere": "help"}, "mode: found 'somewhere'"),
        ({"human_needs_help": "signal"}, "action in mode human_needs_help: found 'signal'"),
    ],
)
def test_fallbacks_that_cannot_be(actions, words):
    with pytest.raises(InputError) as caught:
        fallback_of(PUBLISHED, actions)
    assert words in str(caught.value)


def test_a_budget_needs_a_fallback_that_spends_nothing():
    free = fallback_of(PUBLISHED, {"human_needs_help": "no_help"})
    Guarded(bare("always"), [CostBudget.of(PUBLISHED, 15)], free)
