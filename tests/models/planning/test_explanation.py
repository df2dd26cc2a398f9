"""Why an action: the flips that are named are flips, and none is missed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.baselines import myopic
from models.planning.exact import history_values, solve_schedule
from models.planning.explanation import explain
from models.planning.plan_policy import PlanPolicy
from models.planning.policy_files import policy_from_dict, policy_to_dict
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.reward import Reward
from tests.models.planning.policy_cases import alpha, person, policy
from tests.models.planning.schedule_cases import random_model

STATES, ACTIONS = ("low", "mid", "high"), ("wait", "help")


def linear(planes):
    """Values that are linear in the belief: flips are where two lines cross."""
    return lambda beliefs: beliefs @ np.asarray(planes).T


def test_flip_of_linear_values_is_where_the_lines_cross():
    planes = [[0.0, 0.0, 0.0], [-1.0, 0.5, -4.0]]
    belief = np.array([0.6, 0.3, 0.1])
    found = explain(linear(planes), belief, STATES, ACTIONS, "mode")
    # help - wait = -0.85 at the belief and 0.5 at certainty of mid: zero at 0.85 / 1.35 of the way.
    assert found.action == "wait"
    assert found.margin == pytest.approx(0.85)
    assert found.costs == pytest.approx({"help": 0.85})
    assert [s.share for s in found.shifts] == [None, pytest.approx(0.85 / 1.35, abs=1e-5), None]
    assert found.nearest.state == "mid"
    assert found.nearest.action == "help"
    assert "help would be done if it cost 0.85 less this once" in found.sentence
    assert "63% of the way to certainty of mid would make it help" in found.sentence
    assert list(found.table["action"]) == ["wait", "help"]
    assert found.table["less_than_best"][1] == pytest.approx(0.85)


@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 4))
def test_at_a_named_shift_the_action_changes_and_before_it_does_not(seed, n_actions, n):
    rng = np.random.default_rng(seed)
    planes = rng.normal(size=(n_actions, n))
    names, states = [f"a{i}" for i in range(n_actions)], [f"s{i}" for i in range(n)]
    belief = rng.dirichlet(np.ones(n))
    found = explain(linear(planes), belief, states, names, "mode")
    best = names.index(found.action)
    assert best == int(np.argmax(planes @ belief))
    for y, shift in enumerate(found.shifts):
        corner = np.eye(n)[y]
        # Linear values: the action is the best on the whole way unless it is not at some corner crossing.
        way = [(1 - t) * belief + t * corner for t in np.linspace(0, 1, 2001)]
        keeps = [planes[best] @ b >= (planes @ b).max() - 1e-7 for b in way]
        if shift.share is None:
            assert all(keeps)
        else:
            assert keeps.index(False) / 2000 == pytest.approx(shift.share, abs=1e-3)
            past = (1 - shift.share) * belief + shift.share * corner
            assert names.index(shift.action) != best
            assert planes[names.index(shift.action)] @ past == pytest.approx((planes @ past).max(), abs=1e-5)


def test_ties_and_single_actions():
    even = explain(linear([[1.0, 0.0], [0.0, 1.0]]), np.array([0.5, 0.5]), STATES[:2], ACTIONS, "mode")
    assert even.margin == 0
    assert "as much as help" in even.sentence
    assert even.nearest.share < 0.02
    only = explain(linear([[1.0, 0.0]]), np.array([0.5, 0.5]), STATES[:2], ACTIONS[:1], "mode")
    assert only.other is None
    assert only.nearest is None
    assert only.sentence == "wait: mode mode offers nothing else."


@pytest.mark.parametrize("kind", ["alpha", "myopic"])
@pytest.mark.parametrize("mode", [0, 1])
def test_belief_policies_explain_what_they_do(kind, mode):
    p = policy(kind)
    for belief in ([0.4, 0.3, 0.3], [0.02, 0.03, 0.95], [1, 0, 0]):
        found = p.why(belief, mode)
        assert found.action == p.action(belief, mode)
        assert found.values == pytest.approx(p.action_values(belief, mode))
        assert found.margin == pytest.approx(found.values[found.action] - found.values[found.other])
        for y, shift in enumerate(found.shifts):
            if shift.share is not None:
                past = (1 - shift.share) * np.asarray(belief) + shift.share * np.eye(3)[y]
                assert p.action(past / past.sum(), mode) == shift.action


def test_cost_at_which_an_action_flips():
    """Raising the cost by the margin makes the myopic robot indifferent."""
    model = person()
    dear = Reward(model.reward.x, 0.09, {"help": 15.0})
    first = myopic(type(model)(model.initial, model.transition, model.emission, reward=dear))
    found = first.why(model.initial, "human_needs_help")
    sign = 1 if found.action == "help" else -1
    flip = Reward(model.reward.x, 0.09, {"help": 15.0 + sign * found.margin})
    even = myopic(type(model)(model.initial, model.transition, model.emission, reward=flip))
    assert even.why(model.initial, "human_needs_help").margin == pytest.approx(0, abs=1e-9)


def test_plan_explains_any_history():
    plan = policy("plan")
    for history in ((), (("signal", "help"),), (("no_signal", "no_help"), ("no_help", None))):
        found = plan.why(history)
        assert found.values == pytest.approx(history_values(plan.schedule, history))
        assert found.mode == plan.schedule.mode(len(history)).name
        assert found.sentence == plan.reason(plan.memory_after(history))
        assert sum(found.belief.values()) == pytest.approx(1)


def test_plan_of_several_models_shifts_states_and_keeps_what_they_say_of_the_models():
    rng = np.random.default_rng(8)
    from models.model_draws import ModelDraws

    first = random_model(rng, PUBLISHED, 2)
    second = random_model(rng, PUBLISHED, 2)
    second = type(first)(second.initial, second.transition, second.emission, reward=first.reward)
    schedule = Schedule.of(ModelDraws.from_models([first, second]), "RHR")
    found = PlanPolicy.of(solve_schedule(schedule)).why()
    assert found.values == pytest.approx(history_values(schedule))
    joint = schedule.start()
    for y in range(2):
        sure = joint * (np.arange(2) == y)
        at = solve_schedule(schedule.rest(0, sure)).first_values
        changes = at.argmax() != [a.name for a in schedule.mode(0).actions].index(found.action)
        assert not changes or found.shifts[y].share is not None


def test_a_plan_read_without_models_cannot_explain():
    bare = policy_from_dict({**policy_to_dict(policy("plan")), "schedule": None})
    with pytest.raises(InputError, match="read without them"):
        bare.why()
    assert "in mode robot_needs_help" in bare.reason(bare.begin(1))


def test_reasons_of_baselines():
    reactive = policy("reactive")
    memory = reactive.begin(1)
    assert "there is no response to answer yet" in reactive.reason(memory)
    assert "the last response was not to help" in reactive.reason(reactive.observe(memory, 0, 1, 0))
    assert reactive.reason(reactive.observe(memory, 0, 2, 0)).endswith(
        ": help, because the last response was to help."
    )
    assert "no_signal with probability 0.5 or signal" in policy("random").reason(policy("random").begin(1))
    assert "less this once" in alpha().reason(alpha().begin(1))
