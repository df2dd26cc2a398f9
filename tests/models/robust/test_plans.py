"""Plans in many draws: the compiled walks against plain enumeration."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.mixed_policy import MixedPolicy
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.robust.contested import with_costs
from models.robust.open_loop import open_loop
from models.robust.own_plans import own_plans
from models.robust.plan_table import BestPlans, PlanEvaluator, PlanTable
from models.robust.stability import decision_stability
from tests.models.planning.policy_conformance import conforms
from tests.models.planning.schedule_cases import schedules
from tests.models.robust.cases import few_plans
from tests.planning_cases import sticky_draws
from tests.reference.all_plans import all_plans, values_of
from tests.reference.finite_horizon import expectimax

CLOSE = {"rel": 1e-10, "abs": 1e-10}


def alone(schedule, d):
    """The schedule with one of its draws."""
    one = schedule.draws
    draws = replace(
        one, initial=one.initial[d : d + 1], transition=one.transition[d : d + 1],
        emission=one.emission[d : d + 1], weight=np.ones(1),
    )  # fmt: skip
    return replace(schedule, draws=draws)


@given(schedules(max_draws=4))
def test_values_in_every_draw(schedule):
    plan = solve_schedule(schedule)
    values = PlanEvaluator(schedule).values(plan.decisions)
    assert values == pytest.approx(values_of(schedule, plan.decisions), **CLOSE)
    assert values @ schedule.draws.weight == pytest.approx(plan.value, **CLOSE)
    assert values == pytest.approx(evaluate_schedule(PlanPolicy.of(plan), schedule).values, **CLOSE)


@given(schedules(max_draws=4))
def test_own_plans_are_those_of_each_draw_alone(schedule):
    own = own_plans(schedule)
    evaluator = PlanEvaluator(schedule)
    for d in range(schedule.draws.n_draws):
        single = alone(schedule, d)
        assert own.first_values[d] == pytest.approx(expectimax(single), **CLOSE)
        assert evaluator.values(own.plans[own.which[d]])[d] == pytest.approx(own.values[d], **CLOSE)
    assert own.shares.sum() == pytest.approx(1)
    assert sum(own.first_action_shares.values()) == pytest.approx(1)
    assert min(own.first_action_losses.values()) >= 0


@given(few_plans(max_draws=3))
def test_orders_that_hold_exactly(schedule):
    """No plan beats the Bayes-adaptive one, which does not beat knowing the draw."""
    plan, own = solve_schedule(schedule), own_plans(schedule)
    weight = schedule.draws.weight
    slack = 1e-9 * max(1.0, np.abs(own.values).max())
    table = PlanTable.of(schedule, [*own.plans, open_loop(schedule)])
    assert np.all(table.means <= plan.value + slack)
    assert plan.value <= weight @ own.values + slack
    assert np.all(table.values <= own.values + slack)


@given(few_plans(max_draws=3))
def test_the_fixed_sequence_is_the_best_of_all(schedule):
    plans, values = all_plans(schedule)
    fixed = [i for i, plan in enumerate(plans) if all(len(set(level.tolist())) == 1 for level in plan)]
    best = (values[fixed] @ schedule.draws.weight).max()
    table = PlanTable.of(schedule, [open_loop(schedule)])
    assert table.means[0] == pytest.approx(best, **CLOSE)


@given(few_plans(max_draws=3), st.integers(0, 2**32 - 1))
def test_best_plan_for_other_weights(schedule, seed):
    weight = np.random.default_rng(seed).dirichlet(np.ones(schedule.draws.n_draws))
    weight[0] = 0.0
    if weight.sum() == 0:
        weight[0] = 1.0
    _, values = all_plans(schedule)
    found = values_of(schedule, BestPlans(schedule).plan(weight)) @ weight
    assert found == pytest.approx((values @ weight).max(), **CLOSE)


def test_equal_plans_are_kept_once():
    schedule = Schedule.of(sticky_draws(5, 3), "RHR")
    plan = solve_schedule(schedule)
    table = PlanTable.of(schedule, [plan, plan.decisions])
    assert len(table.plans) == 1
    more = table.with_plans([plan.decisions, open_loop(schedule)])
    assert more.row(plan.decisions) == 0
    assert more.row(tuple(1 - level for level in plan.decisions)) == -1


def test_draws_are_solved_alike_in_chunks_and_at_once(monkeypatch):
    schedule = Schedule.of(sticky_draws(23, 1), "HRHRH")
    whole = own_plans(schedule)
    monkeypatch.setattr("models.robust.own_plans.CHUNK", 4)
    parts = own_plans(schedule)
    assert np.array_equal(whole.values, parts.values)
    assert np.array_equal(whole.which, parts.which)


def test_a_plan_that_does_not_fit_is_refused():
    schedule = Schedule.of(sticky_draws(2, 3), "RH")
    with pytest.raises(InputError, match="event 2"):
        PlanEvaluator(schedule).values((np.zeros(1, np.int8),))
    with pytest.raises(InputError, match="event 1"):
        PlanEvaluator(schedule).values((np.full(1, 2, np.int8), np.zeros(1, np.int8)))


@given(schedules(max_draws=3))
def test_stability_along_a_plan(schedule):
    plan = solve_schedule(schedule)
    found = decision_stability(schedule, plan)
    by_event = [sum(x.probability for x in found.standings if x.event == k) for k in range(schedule.n_events)]
    assert by_event == pytest.approx(np.ones(schedule.n_events))
    first = found.standings[0]
    own = own_plans(schedule)
    best = np.sort(own.first_values, axis=1)
    if best.shape[1] == 1 or (best[:, -1] - best[:, -2]).min() > 1e-9:
        assert first.share == pytest.approx(own.first_action_shares)
    assert first.information == pytest.approx(0, abs=1e-12)
    for x in found.standings:
        assert sum(x.share.values()) == pytest.approx(1)
        assert x.weight.sum() == pytest.approx(1)
        assert 1 - 1e-9 <= x.effective_draws <= schedule.draws.n_draws + 1e-9
        # The weights after a history are Bayes' rule over the draws.
        names = schedule.protocol.response_names
        told = list(x.responses)
        joint = schedule.start()
        number = 0
        for k in range(x.event):
            seen = names.index(told.pop(0)) if schedule.mode(k).shows_response else None
            joint = schedule.after(joint, schedule.first_action(k) + int(plan.decisions[k][number]), seen)
            number = number * schedule.n_outcomes(k) + (seen or 0)
        assert x.weight == pytest.approx(joint.sum(axis=1) / joint.sum(), abs=1e-12)


@pytest.mark.parametrize("rounding", [0.0, 2e-16])
def test_draws_to_which_actions_are_worth_the_same_do_not_disagree(rounding):
    """A signal that changes nothing and is free: no draw is against it, nor against its absence."""
    draws = sticky_draws(12, 3)
    signal, quiet = (draws.protocol.action_names.index(a) for a in ("signal", "no_signal"))
    transition, emission = draws.transition.copy(), draws.emission.copy()
    transition[:, signal] = transition[:, quiet] * (1 + rounding * np.arange(12)[:, None, None])
    shown = [draws.protocol.emission_actions.index(a) for a in ("signal", "no_signal")]
    emission[:, shown[0]] = emission[:, shown[1]]
    same = with_costs(
        Schedule.of(replace(draws, transition=transition, emission=emission), "HRH"), {"signal": 0.0, "help": 4.0}
    )
    plan = solve_schedule(same)
    first = decision_stability(same, plan).standings[0]
    assert first.share[plan.first_action] == pytest.approx(1)
    assert first.words == f"{plan.first_action} first is right in every draw."
    other = tuple(1 - level if k == 0 else level for k, level in enumerate(plan.decisions))
    assert decision_stability(same, other).standings[0].regret == 0


def test_one_draw_is_sure_of_its_own_plan():
    schedule = Schedule.of(sticky_draws(1, 5), "HRHR")
    found = decision_stability(schedule, solve_schedule(schedule))
    assert found.agreement == pytest.approx(1)
    assert all(x.loss[x.action] == pytest.approx(0, abs=1e-12) for x in found.standings)


def test_a_tracker_puts_its_belief_in_place_of_the_draws_own():
    schedule = Schedule.of(sticky_draws(6, 5), "HRHR")
    model = schedule.draws.model(2)
    plan = solve_schedule(schedule)
    found = decision_stability(schedule, plan, tracker=model)
    assert found.beliefs != decision_stability(schedule, plan).beliefs
    same = replace(schedule.draws, initial=np.tile(model.initial, (6, 1)))
    own = own_plans(replace(schedule, draws=same))
    assert found.standings[0].share == pytest.approx(own.first_action_shares)


def test_a_tracker_with_other_states_is_refused():
    schedule = Schedule.of(sticky_draws(3, 5), "HR")
    with pytest.raises(InputError, match="tracker"):
        decision_stability(schedule, solve_schedule(schedule), tracker=sticky_draws(1, 1, 2).model(0))


@given(few_plans(max_draws=3), st.integers(0, 2**32 - 1))
def test_a_mixture_is_worth_the_mean_of_its_plans(schedule, seed):
    rng = np.random.default_rng(seed)
    plans, values = all_plans(schedule)
    some = rng.integers(len(plans), size=4)
    share = rng.dirichlet(np.ones(4))
    policy = MixedPolicy.of(schedule, [plans[i] for i in some], share)
    found = evaluate_schedule(policy, schedule).values
    assert found == pytest.approx(share @ values[some], **CLOSE)


def test_a_mixture_knows_which_plans_are_still_possible():
    schedule = Schedule.of(sticky_draws(1, 1), "RH")
    never, always = (np.zeros(1, np.int8),) * 2, (np.ones(1, np.int8),) * 2
    policy = MixedPolicy.of(schedule, [never, always], [0.25, 0.75])
    memory = policy.begin(schedule.modes[0])
    assert policy.probabilities(memory).tolist() == [0.25, 0.75]
    memory = policy.observe(memory, 1, 0, schedule.modes[1])
    assert policy.probabilities(memory).tolist() == [0.0, 1.0]
    with pytest.raises(InputError, match="shares"):
        MixedPolicy.of(schedule, [never, always], [0.25, 0.25])
    with pytest.raises(InputError, match="events"):
        MixedPolicy.of(schedule, [never[:1]], [1.0])
    one = MixedPolicy.of(schedule, [never], [1.0], left="error")
    with pytest.raises(InputError, match="none of its plans"):
        one.observe(one.begin(schedule.modes[0]), 1, 0, schedule.modes[1])


def test_a_mixture_is_a_policy_like_any_other(tmp_path):
    model = sticky_draws(1, 3).model(0)
    schedule = Schedule.of(model, "HRHRH")
    plans, _ = all_plans(Schedule.of(model, "HRH"))
    rest = (np.array([0, 1, 1, 0], np.int8),) * 2
    grown = [(*plan, *rest) for plan in plans]
    policy = MixedPolicy.of(schedule, [grown[i] for i in (0, 5, 9)], [0.2, 0.3, 0.5])
    conforms(policy, model, schedule.modes, tmp_path)
