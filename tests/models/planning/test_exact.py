"""The exact plan of a schedule: against brute force over all policies and plain expectimax."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.model_files import read_model
from models.planning import summed_walk
from models.planning import tail_plans as tail_module
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import ExactPlan, history_values, solve_schedule, walked
from models.planning.history_kernel import walk_tree
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.planning.schedule_tree import schedule_tree
from models.planning.solver import solve
from models.planning.tail_plans import MOST_PLANS, tail_plans
from models.protocol import PUBLISHED
from models.reward import Reward
from tests.models.planning.schedule_cases import random_model, schedules, telling_tables
from tests.planning_cases import sticky_draws
from tests.random_cases import random_tables
from tests.reference.finite_horizon import all_policies_value, expectimax, policy_value

CLOSE = {"rel": 1e-10, "abs": 1e-10}


@pytest.fixture(scope="module")
def truth(shared):
    return read_model(shared / "data" / "calibrated_truth.json")


def own_table(plan):
    """The plan as the reference has policies: by event, from responses to the action."""
    names = {r: i for i, r in enumerate(plan.schedule.protocol.response_names)}
    out = [{} for _ in plan.decisions]
    for row in plan.rows():
        actions = [a.name for a in plan.schedule.mode(row["event"] - 1).actions]
        out[row["event"] - 1][tuple(names[r] for r in row["responses"])] = actions.index(row["action"])
    return out


@given(schedules())
def test_equals_plain_expectimax(schedule):
    plan = solve_schedule(schedule)
    wanted = expectimax(schedule)
    assert plan.value == pytest.approx(max(wanted), **CLOSE)
    assert plan.first_values == pytest.approx(wanted, **CLOSE)
    assert wanted[plan.decisions[0][0]] == pytest.approx(max(wanted), **CLOSE)


@given(schedules(max_events=6))
def test_the_plan_is_worth_what_it_says(schedule):
    plan = solve_schedule(schedule)
    assert policy_value(schedule, own_table(plan)) == pytest.approx(plan.value, **CLOSE)


@pytest.mark.parametrize("most", [1, 4, 64])
def test_plans_that_depend_on_responses(most, monkeypatch):
    """However much of the schedule is left to the tail, a plan that listens is worth what it says."""
    monkeypatch.setattr(tail_module, "MOST_PLANS", most)
    listening = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        reward = Reward((0.0, 1.0, 2.0), 1.2, {"help": 0.2, "signal": 0.2})
        models = [LatentStatePOMDP(*telling_tables(rng, PUBLISHED, 3), reward=reward) for _ in range(1 + seed % 2)]
        schedule = Schedule.of(ModelDraws.from_models(models), "HHRHR")
        plan = solve_schedule(schedule)
        listening += "depends on the responses" in plan.sentence and "never" not in plan.sentence
        assert plan.value == pytest.approx(max(expectimax(schedule)), **CLOSE)
        assert policy_value(schedule, own_table(plan)) == pytest.approx(plan.value, **CLOSE)
        assert evaluate_schedule(PlanPolicy.of(plan), schedule).value == pytest.approx(plan.value, **CLOSE)
    assert listening > 15


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["H", "HR", "RH", "HRH", "RRH", "HHR"]))
def test_no_policy_of_all_is_better(seed, letters):
    model = random_model(np.random.default_rng(seed), PUBLISHED, 2)
    schedule = Schedule.of(model, letters)
    assert solve_schedule(schedule).value == pytest.approx(all_policies_value(schedule), **CLOSE)


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_no_policy_of_all_is_better_with_two_models(seed):
    rng = np.random.default_rng(seed)
    models = [random_model(rng, PUBLISHED, 2)]
    models.append(type(models[0])(*random_tables(rng, PUBLISHED, 2), reward=models[0].reward))
    schedule = Schedule.of(ModelDraws.from_models(models, np.array([0.3, 0.7])), "HRH")
    assert solve_schedule(schedule).value == pytest.approx(all_policies_value(schedule), **CLOSE)


@given(schedules(max_events=5), st.data())
def test_action_values_after_any_history(schedule, data):
    joint, history = schedule.start(), []
    for k in range(data.draw(st.integers(0, schedule.n_events - 1))):
        mode = schedule.mode(k)
        c = data.draw(st.integers(0, len(mode.actions) - 1))
        response = None
        if mode.shows_response and data.draw(st.booleans()):
            response = data.draw(st.sampled_from(schedule.protocol.response_names))
        seen = None if response is None else schedule.protocol.response_names.index(response)
        joint = schedule.after(joint, schedule.first_action(k) + c, seen)
        history.append((mode.actions[c].name, response))
    if joint.sum() == 0:
        with pytest.raises(InputError, match="probability zero"):
            history_values(schedule, history)
        return
    found = history_values(schedule, history)
    wanted = expectimax(schedule, joint / joint.sum(), len(history))
    assert list(found) == [a.name for a in schedule.mode(len(history)).actions]
    assert list(found.values()) == pytest.approx(wanted, **CLOSE)


@given(schedules(max_events=5))
def test_tail_plans_change_nothing(schedule):
    """The walk alone, to the very last event, gives the same."""
    from models.planning.schedule_tree import _leaf_vectors, tree_tables
    from models.planning.tail_plans import TailPlans

    last = schedule.n_events - 1
    end = np.zeros(schedule.n_states) if schedule.terminal is None else schedule.terminal
    shape = (1, schedule.draws.n_draws, schedule.n_states)
    tail = TailPlans(last, np.ascontiguousarray(np.broadcast_to(end, shape)), ())
    counts = [1]
    for k in range(last):
        counts.append(counts[-1] * len(schedule.mode(k).actions) * schedule.n_outcomes(k))
    offset = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    value = walk_tree(
        tree_tables(schedule), last, _leaf_vectors(schedule, tail), 1, offset, np.zeros(sum(counts), np.int8),
        np.zeros((counts[-1], schedule.n_outcomes(last)), np.int16), np.zeros(len(schedule.mode(0).actions)),
    )  # fmt: skip
    assert solve_schedule(schedule).value == pytest.approx(value, **CLOSE)
    assert len(tail_plans(schedule).vectors) <= MOST_PLANS


@given(schedules(max_draws=1))
def test_a_draw_split_in_two_changes_nothing(schedule):
    d = schedule.draws
    twice = ModelDraws(
        d.protocol, np.repeat(d.initial, 2, 0), np.repeat(d.transition, 2, 0), np.repeat(d.emission, 2, 0),
        np.array([0.25, 0.75]), reward=d.reward,
    )  # fmt: skip
    both = Schedule(twice, schedule.modes, schedule.discount, schedule.terminal)
    assert solve_schedule(both).value == pytest.approx(solve_schedule(schedule).value, **CLOSE)


@given(schedules(), st.floats(-5, 5), st.floats(0.1, 4))
def test_terminal_reward_shifts_and_scales(schedule, shift, scale):
    """A constant at the end adds itself, discounted; the state order is no matter."""
    end = np.zeros(schedule.n_states) if schedule.terminal is None else schedule.terminal
    more = Schedule(schedule.draws, schedule.modes, schedule.discount, end + shift)
    added = schedule.discount**schedule.n_events * shift
    assert solve_schedule(more).value == pytest.approx(solve_schedule(schedule).value + added, rel=1e-9, abs=1e-9)


@given(schedules(max_events=5), st.integers(0, 2**32 - 1))
def test_names_of_states_do_not_matter(schedule, seed):
    order = np.random.default_rng(seed).permutation(schedule.n_states)
    d = schedule.draws
    reward = Reward(tuple(d.reward.x[s] for s in order), d.reward.r, d.reward.costs)
    other = ModelDraws(
        d.protocol, d.initial[:, order], d.transition[:, :, order][..., order], d.emission[:, :, order], d.weight,
        reward=reward,
    )  # fmt: skip
    end = None if schedule.terminal is None else schedule.terminal[order]
    permuted = Schedule(other, schedule.modes, schedule.discount, end)
    # Rewards are measured from the first state's.
    shift = (np.exp(reward.r * reward.x[0]) - np.exp(reward.r * d.reward.x[0])) * sum(
        schedule.discount**k for k in range(schedule.n_events)
    )
    assert solve_schedule(permuted).value + shift == pytest.approx(
        solve_schedule(schedule).value, rel=1e-9, abs=1e-9
    )


@given(schedules(max_events=5, max_draws=1), st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_the_optimum_is_convex_in_the_belief(schedule, seed, t):
    one, two = np.random.default_rng(seed).dirichlet(np.ones(schedule.n_states), size=2)

    def value(belief):
        return solve_schedule(replace(schedule, draws=replace(schedule.draws, initial=belief[None]))).value

    ends = (1 - t) * value(one) + t * value(two)
    assert value((1 - t) * one + t * two) <= ends + 1e-9 * max(1, abs(ends))


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_long_schedules_approach_the_value_without_horizon(seed):
    model = random_model(np.random.default_rng(seed), PUBLISHED, 3)
    solution = solve(latent_problem(model, alternating(PUBLISHED, "H"), 0.5), 1e-6)
    exact = solve_schedule(Schedule.of(model, "HR" * 9, 0.5)).value
    rest = 0.5**18 * np.abs(model.reward_table()).max() / 0.5 + 1e-9
    assert solution.lower - rest <= exact <= solution.upper + rest


def test_study_two(truth):
    plan = solve_schedule(Schedule.of(truth, "HRHRHRHRH"))
    assert f"{plan.value:.1f}" == "219.4"
    assert plan.first_action == "no_signal"
    assert "219.4" in plan.sentence
    assert {row["action"] for row in plan.rows() if row["event"] in (2, 4, 6)} == {"help"}
    assert {row["action"] for row in plan.rows() if row["event"] == 8} == {"no_help"}
    assert len(plan.table) == 1 + 2 + 2 + 4 + 4 + 8 + 8 + 16 + 16


def test_two_step_with_terminal(truth):
    """Without a reward at the end nothing is done last; with it signalling may pay."""
    prosocial = truth.reward.prosocial()
    plain = solve_schedule(Schedule.of(truth, "RH"))
    ends = solve_schedule(Schedule.of(truth, "RH", terminal=3 * prosocial))
    assert set(plain.decisions[1]) == {0}
    assert ends.value > plain.value + 3 * prosocial.min()


def test_fifteen_rounds_and_four_thousand_draws_take_no_time(truth):
    solve_schedule(Schedule.of(truth, "HR"))
    begin = time.process_time()
    plan = solve_schedule(Schedule.of(truth, "HRHRHRHRHRHRHRH"))
    assert time.process_time() - begin < 2
    rng = np.random.default_rng(5)
    hard = random_model(rng, PUBLISHED, 4)
    begin = time.process_time()
    solve_schedule(Schedule.of(hard, "HRHRHRHRHRHRHRH"))
    assert time.process_time() - begin < 5
    assert plan.value > 219.4


# -- refusals ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"schedule": "HXH"}, "letter 2: found 'X', wanted one of R, H"),
        ({"schedule": ""}, "schedule"),
        ({"discount": 1.2}, "discount: found 1.2, wanted a number from 0 to 1"),
        ({"discount": float("nan")}, "discount: found nan"),
        ({"terminal": [1.0]}, "terminal reward, shape"),
        ({"terminal": [1.0, float("inf"), 0, 0]}, "terminal reward: found inf"),
    ],
)
def test_unusable_schedules(truth, change, words):
    given = {"schedule": "HRH", **change}
    with pytest.raises(InputError) as caught:
        Schedule.of(truth, given.pop("schedule"), **given)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("history", "words"),
    [
        ([("help", None)], "event 1, action: found 'help', wanted one of no_signal, signal"),
        ([("signal", "perhaps")], "event 1, response: found 'perhaps', wanted one of no_help, help"),
        ([("signal", "help"), ("help", "help")], "event 2, response: found 'help', wanted None"),
        ([("signal", "help"), ("help", None), ("signal", "help")], "the schedule is over"),
        ([("signal", "help"), ("help", None), ("signal", "help"), ("help", None)], "no more than 3 events"),
    ],
)
def test_unusable_histories(truth, history, words):
    with pytest.raises(InputError) as caught:
        history_values(Schedule.of(truth, "HRH"), history)
    assert words in str(caught.value)


def test_too_many_histories():
    model = random_model(np.random.default_rng(1), PUBLISHED, 5)
    with pytest.raises(InputError, match=r"histories, wanted at most 5e\+07"):
        solve_schedule(Schedule.of(model, "H" * 30))


@given(schedules(max_events=5, max_draws=6))
def test_draws_in_portions_give_the_same_plan(schedule):
    tree = schedule_tree(schedule)
    whole = walked(tree)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(summed_walk, "PORTION", 2)
        found = summed_walk.summed_walk(tree)
    assert found.value == pytest.approx(whole.value, **CLOSE)
    assert found.first_values == pytest.approx(whole.first_values, **CLOSE)
    plan = ExactPlan(schedule, found.value, found.first_values, tree.decisions(found.decision, found.picks))
    assert policy_value(schedule, own_table(plan)) == pytest.approx(whole.value, **CLOSE)


def test_many_draws_go_in_portions():
    draws = sticky_draws(2, 5)
    many = replace(
        draws, initial=np.tile(draws.initial, (1500, 1)), transition=np.tile(draws.transition, (1500, 1, 1, 1)),
        emission=np.tile(draws.emission, (1500, 1, 1, 1)), weight=np.full(3000, 1 / 3000),
    )  # fmt: skip
    schedule = Schedule.of(many, "HRHRH")
    assert summed_walk.pays(schedule_tree(schedule))
    few, all_ = solve_schedule(Schedule.of(draws, "HRHRH")), solve_schedule(schedule)
    assert all_.value == pytest.approx(few.value, rel=1e-12)
    assert [a.tolist() for a in all_.decisions] == [a.tolist() for a in few.decisions]
