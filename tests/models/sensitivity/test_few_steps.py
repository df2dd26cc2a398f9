"""Exact decisions over a few steps: against enumeration of all plans, and what must be true of any of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.reward import PUBLISHED_X, Reward
from models.sensitivity.cases import OPEN, Cases
from models.sensitivity.few_steps import FewSteps
from tests.models.sensitivity.sensitivity_cases import cases_of, people, settings, some_draws, some_rewards
from tests.reference.finite_horizon import all_policies_value, expectimax


def schedule_of(draws, d, reward, discount, terminal):
    one = replace(draws.some(np.array([d])), reward=reward)
    names = list(draws.protocol.mode_names)
    return Schedule.of(one, names, discount, terminal=reward.prosocial() if terminal else None)


@given(settings(), st.booleans())
def test_decisions_are_those_of_plain_recursion(setting, terminal):
    draws, rewards, discount = setting
    decider = FewSteps(draws, terminal)
    answers = decider.decide(cases_of(draws, rewards, discount))
    for g, reward in enumerate(rewards):
        for d in range(draws.n_draws):
            case, schedule = g * draws.n_draws + d, schedule_of(draws, d, reward, discount, terminal)
            joints = [schedule.start()]
            for k in range(schedule.n_events):
                following = []
                for n, joint in zip(decider.nodes.of_step(k), joints, strict=True):
                    worth = np.array(expectimax(schedule, joint, k))
                    mass = joint.sum()
                    assert answers.chance[case, n] == pytest.approx(mass)
                    count = len(worth)
                    assert answers.lower[case, n, :count] * mass == pytest.approx(worth, abs=1e-9)
                    a = answers.choice[case, n]
                    assert worth[a] >= worth.max() - 1e-8 * max(1, np.abs(worth).max())
                    shows = schedule.mode(k).shows_response
                    seen = range(schedule.n_outcomes(k)) if shows else [None]
                    following += [schedule.after(joint, schedule.first_action(k) + a, o) for o in seen]
                joints = following


@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_no_plan_is_better(seed, terminal):
    draws = some_draws(seed, 1, 2 + seed % 3)
    (reward,) = some_rewards(seed, draws, 1)
    schedule = schedule_of(draws, 0, reward, 0.9, terminal)
    values = FewSteps(draws, terminal).action_values(cases_of(draws, [reward], 0.9))
    assert values[0][0, 0].max() == pytest.approx(all_policies_value(schedule))
    assert values[0][0, 0].max() == pytest.approx(solve_schedule(schedule).value)


@given(settings(), st.booleans(), st.floats(0.01, 100))
def test_the_scale_of_rewards_does_not_matter(setting, terminal, scale):
    draws, rewards, discount = setting
    decider, cases = FewSteps(draws, terminal), cases_of(draws, rewards, discount)
    scaled = replace(cases, reward=scale * cases.reward, prosocial=scale * cases.prosocial)
    values = decider.action_values(cases)[0][:, 0]
    if values.shape[1] > 1:
        gap = np.diff(np.sort(values, axis=1)[:, -2:], axis=1)[:, 0]
        clear = gap > 1e-6 * np.abs(cases.reward).max()
        assert np.array_equal(
            decider.decide(cases).choice[clear, 0], decider.decide(scaled).choice[clear, 0]
        )  # fmt: skip


@given(st.integers(0, 10_000), st.floats(0, 60), st.floats(0, 60), st.booleans())
def test_a_higher_cost_never_brings_an_action_in(seed, one, other, terminal):
    # Each mode comes once, so its own cost is paid by its own action only, at the same belief before it.
    draws = people(seed, 3, 4)
    low, high = sorted((one, other))
    for action, modes in (("help", (0, 1)), ("signal", (1,))):
        rewards = [Reward(PUBLISHED_X, 0.07, {action: c}) for c in (low, high)]
        decider = FewSteps(draws, terminal, modes)
        acts = decider.decide(cases_of(draws, rewards)).choice[:, 0].reshape(2, 3)
        assert np.all(acts[1] <= acts[0])


@given(st.integers(0, 10_000), st.floats(0, 20))
def test_the_last_step_never_costs_anything_if_nothing_follows(seed, cost):
    # Free actions that change nothing are ties, and ties leave people alone.
    draws = people(seed, 3, 4)
    answers = FewSteps(draws, False).decide(cases_of(draws, [Reward(PUBLISHED_X, 0.08, {"signal": cost})]))
    assert not answers.choice[:, 1].any()


def test_the_null_action_wins_ties_wherever_it_stands():
    first, second = PUBLISHED.modes
    turned = replace(PUBLISHED, modes=(replace(first, actions=first.actions[::-1]), second))
    draws = some_draws(3, 1, 3, turned)
    flat = Reward((45.0, 45.0, 45.0), 0.06, dict.fromkeys(turned.action_names, 0.0))
    answers = FewSteps(draws, True).decide(cases_of(draws, [flat]))
    assert answers.choice[0].tolist() == [1, 0]


def test_shares_and_labels():
    draws = people(5, 4, 3)
    answers = FewSteps(draws, True).decide(cases_of(draws, some_rewards(1, draws, 5)))
    for k in range(2):
        shares = answers.shares(k)
        assert shares.sum(axis=1) == pytest.approx(np.ones(20))
        assert not shares[:, -1].any()
        assert np.array_equal(answers.label(k), answers.choice[:, k])
    open_ = replace(answers, choice=np.where(np.arange(2) == 1, OPEN, answers.choice).astype(np.int8))
    assert (open_.label(1) == OPEN).all()
    assert (open_.label(0) != OPEN).all()
    assert open_.nodes.words(1, OPEN) == "undecided"


def test_too_many_steps_are_refused():
    draws = people(1, 1, 2)
    with pytest.raises(InputError, match="steps, histories"):
        FewSteps(draws, True, (1,) * 8)


def test_portions_do_not_matter(monkeypatch):
    draws = people(8, 5, 3)
    cases = cases_of(draws, some_rewards(2, draws, 4))
    whole = FewSteps(draws, True).decide(cases)
    monkeypatch.setattr("models.sensitivity.few_steps.PORTION", 7)
    parts = FewSteps(draws, True).decide(cases)
    assert np.array_equal(whole.choice, parts.choice)
    assert isinstance(cases, Cases)
    assert isinstance(draws, ModelDraws)
