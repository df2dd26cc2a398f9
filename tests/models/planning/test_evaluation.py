"""What policies are worth: over schedules against brute force, in simulated runs against exact values."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.model_draws import ModelDraws
from models.model_files import read_model
from models.planning.baselines import Reciprocal, always, baselines, myopic, never, uniformly_random
from models.planning.evaluation import evaluate_schedule, follow_responses
from models.planning.exact import solve_schedule
from models.planning.finite_memory import infinite_value
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating
from models.planning.plan_policy import PlanPolicy
from models.planning.rollouts import beside, simulate_policies, simulate_policy
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from models.protocol import PUBLISHED
from tests.models.planning.policy_cases import KINDS, SCHEDULE, alpha, person, policy, problem
from tests.models.planning.schedule_cases import random_model, schedules
from tests.random_cases import make_protocol


@pytest.fixture(scope="module")
def truth(shared):
    return read_model(shared / "data" / "calibrated_truth.json")


@pytest.mark.parametrize(
    ("name", "value", "help_rate", "costly"),
    [
        ("always", "153.1", ".917", "9.0"),
        ("never", "162.6", ".637", "0.0"),
        ("myopic", "162.6", ".637", "0.0"),
        ("reactive", "198.5", ".838", "4.0"),
        ("optimal", "219.4", ".868", "3.0"),
        ("literal", None, ".826", None),
    ],
)
def test_study_two_to_the_printed_digits(truth, name, value, help_rate, costly):
    """Reference values of nine rounds under the calibrated truth, discount 1."""
    schedule = Schedule.of(truth, "HRHRHRHRH")
    if name == "optimal":
        p = PlanPolicy.of(solve_schedule(schedule))
    elif name == "literal":
        p = Reciprocal(PUBLISHED, literal=True)
    else:
        p = {b.name: b for b in baselines(truth)}[name]
    found = evaluate_schedule(p, truth, "HRHRHRHRH")
    assert f"{found.help_rate:.3f}"[1:] == help_rate
    if value:
        assert f"{found.value:.1f}" == value
        assert f"{found.costly_actions:.1f}" == costly
        assert found.cost == pytest.approx(15 * found.costly_actions)
    assert p.name in found.sentence
    assert found.table["value"][0] == found.value


# -- against brute force -------------------------------------------------------------------------------------------
def by_paths(p, schedule):
    """Value, help rate and costly actions, history by history, state by state, nothing joined."""
    draws, protocol = schedule.draws, schedule.protocol
    null = {protocol.action(m.null_action) for m in protocol.modes}
    shown = sum(schedule.mode(k).shows_response for k in range(schedule.n_events))
    sums = np.zeros(3)

    def go(k, memory, d, s, chance):
        if k == schedule.n_events:
            if schedule.terminal is not None:
                sums[0] += chance * schedule.discount**k * schedule.terminal[s]
            return
        for c, share in enumerate(p.probabilities(memory)):
            if share == 0:
                continue
            a, now = schedule.first_action(k) + c, chance * share
            sums[0] += now * schedule.discount**k * schedule.reward[a, s]
            sums[2] += now * (a not in null)
            row = protocol.emission_index[a]
            responses = [(0, 1.0)] if row < 0 else [(o + 1, q) for o, q in enumerate(draws.emission[d, row, s])]
            for seen, q in responses:
                if row >= 0:
                    sums[1] += now * q * protocol.scores[seen - 1] / shown
                if q == 0:
                    continue
                last = k + 1 == schedule.n_events
                after = None if last else p.observe(memory, c, seen, schedule.modes[k + 1])
                for t, r in enumerate(draws.transition[d, a, s]):
                    if r > 0:
                        go(k + 1, after, d, t, now * q * r)

    for d in range(draws.n_draws):
        for s in range(schedule.n_states):
            go(0, p.begin(schedule.modes[0]), d, s, draws.weight[d] * draws.initial[d, s])
    return sums, shown


@given(schedules(max_events=4))
def test_equals_sums_over_all_paths(schedule):
    two = all(len(m.actions) == 2 for m in schedule.protocol.modes)
    # Its belief is about another model than the true ones, one without impossible responses.
    robot = random_model(np.random.default_rng(7), schedule.protocol, 2)
    for p in (
        uniformly_random(schedule.protocol), myopic(robot), PlanPolicy.of(solve_schedule(schedule)),
        *((Reciprocal(schedule.protocol),) if two else ()),
    ):  # fmt: skip
        found = evaluate_schedule(p, schedule)
        (value, rate, costly), shown = by_paths(p, schedule)
        assert found.value == pytest.approx(value, rel=1e-9, abs=1e-9)
        assert found.costly_actions == pytest.approx(costly)
        assert np.isnan(found.help_rate) if shown == 0 else found.help_rate == pytest.approx(rate)
        assert found.state_path.sum(axis=1) == pytest.approx(1)
        assert [sum(actions.values()) for actions in found.action_path] == pytest.approx([1] * schedule.n_events)
        assert found.values @ schedule.draws.weight == pytest.approx(found.value)


@given(schedules(max_events=5))
def test_the_plan_is_worth_its_value_and_nothing_is_worth_more(schedule):
    plan = solve_schedule(schedule)
    assert evaluate_schedule(PlanPolicy.of(plan), schedule).value == pytest.approx(plan.value, rel=1e-9, abs=1e-9)
    for p in (always(schedule.protocol), never(schedule.protocol), uniformly_random(schedule.protocol)):
        assert evaluate_schedule(p, schedule).value <= plan.value + 1e-9 * max(1, abs(plan.value))


def test_draws_are_evaluated_one_by_one():
    rng = np.random.default_rng(4)
    first = random_model(rng, PUBLISHED, 3)
    models = [first, *(random_model(rng, PUBLISHED, 3) for _ in range(3))]
    models = [type(first)(m.initial, m.transition, m.emission, reward=first.reward) for m in models]
    draws = ModelDraws.from_models(models, np.array([0.4, 0.3, 0.2, 0.1]))
    p = myopic(first)
    together = evaluate_schedule(p, draws, "HRHRH", 0.9)
    alone = [evaluate_schedule(p, m, "HRHRH", 0.9) for m in models]
    assert together.values == pytest.approx([a.value for a in alone])
    assert together.help_rates == pytest.approx([a.help_rate for a in alone])
    assert together.costly == pytest.approx([a.costly_actions for a in alone])
    mixed = sum(w * a.belief_path for w, a in zip(draws.weight, alone, strict=True))
    assert together.belief_path == pytest.approx(mixed)


# -- belief paths --------------------------------------------------------------------------------------------------
def test_mean_belief_by_the_true_model_is_the_share_of_states():
    found = evaluate_schedule(policy("myopic"), person(), SCHEDULE)
    assert found.belief_path == pytest.approx(found.state_path[:-1])
    wrong = evaluate_schedule(policy("myopic"), random_model(np.random.default_rng(2), PUBLISHED, 3), SCHEDULE)
    assert np.abs(wrong.belief_path - wrong.state_path[:-1]).max() > 0.01
    assert evaluate_schedule(policy("reactive"), person(), SCHEDULE).belief_path is None


def test_one_run():
    other = random_model(np.random.default_rng(2), PUBLISHED, 3)
    steps = follow_responses(policy("myopic"), other, "HRH", ("help", "no_help"))
    assert [s.response for s in steps] == ["help", None, "no_help"]
    belief, true = person().initial, other.initial
    for s in steps:
        assert s.belief == pytest.approx(belief)
        assert s.true_belief == pytest.approx(true)
        if s.response:
            row = PUBLISHED.emission_index[PUBLISHED.action(s.action)]
            seen = PUBLISHED.response_names.index(s.response)
            assert s.probability == pytest.approx(true @ other.emission[row, :, seen])
        belief, true = person().update(belief, s.action, s.response), other.update(true, s.action, s.response)
    assert follow_responses(policy("reactive"), other, "H", ("help",))[0].belief is None
    with pytest.raises(InputError, match="responses: found 1, wanted 2, one for each event of HRH"):
        follow_responses(policy("myopic"), other, "HRH", ("help",))


# -- simulated runs ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["always", "never", "reactive", "random", "controller"])
def test_simulated_value_agrees_with_the_exact_one(kind):
    exact = infinite_value(policy(kind), problem())
    found = simulate_policy(policy(kind), problem(), runs=4000, level=0.9999, seed=3)
    assert found.low <= exact.value <= found.high
    assert found.frequencies == pytest.approx(exact.frequencies, abs=0.02)
    assert "4000 simulated runs" in found.sentence
    assert found.table["seed"][0] == 3


def test_alpha_policy_is_worth_its_bound_when_simulated():
    p = alpha()
    found = simulate_policy(p, problem(), runs=4000, level=0.9999)
    assert found.high >= p.value(person().initial, "robot_needs_help")


def test_same_luck():
    """Policies that act alike have the same returns; the difference of others is surer than their values."""
    pair = simulate_policies([never(PUBLISHED, "one"), never(PUBLISHED, "two")], problem(), runs=200)
    assert np.array_equal(pair[0].returns, pair[1].returns)
    again = simulate_policy(never(PUBLISHED), problem(), runs=200)
    assert np.array_equal(again.returns, pair[0].returns)
    assert not np.array_equal(simulate_policy(never(PUBLISHED), problem(), runs=200, seed=2).returns, again.returns)
    tracked, compiled = simulate_policies([policy("tracked"), policy("controller")], problem(), runs=2000)
    known = infinite_value(policy("controller"), problem()).value
    assert beside(tracked, compiled, known).error < 0.7 * tracked.error
    assert beside(again, again, 5.0).value == 5.0
    reactive, control = simulate_policies(
        [policy("reactive"), policy("literal")], problem(), runs=4000, level=0.9999
    )
    better = beside(reactive, control, infinite_value(policy("literal"), problem()).value)
    assert better.low <= infinite_value(policy("reactive"), problem()).value <= better.high
    with pytest.raises(InputError, match="different luck"):
        beside(tracked, again, known)


def test_finite_runs_are_the_schedule():
    world = latent_problem(person(), alternating(PUBLISHED, "H"), 1.0)
    found = simulate_policies([policy("reactive"), policy("plan")], world, runs=20_000, steps=5, level=0.9999)
    for result, kind in zip(found, ("reactive", "plan"), strict=True):
        exact = evaluate_schedule(policy(kind), person(), SCHEDULE)
        assert result.left == 0
        assert result.low <= exact.value <= result.high


@pytest.mark.parametrize("kind", KINDS)
def test_fifteen_rounds_take_a_second_at_most(kind):
    if kind == "plan":
        pytest.skip("its schedule is shorter")
    begin = time.process_time()
    evaluate_schedule(policy(kind), person(), "HRHRHRHRHRHRHRH")
    assert time.process_time() - begin < 2


# -- refusals ------------------------------------------------------------------------------------------------------
def test_policy_of_another_protocol():
    other = make_protocol([True], [2], 2)
    with pytest.raises(InputError, match="modes, actions and observations"):
        evaluate_schedule(never(other), person(), "HRH")
    with pytest.raises(InputError, match="modes, actions and observations"):
        simulate_policy(never(other), problem())


def test_response_that_the_robot_takes_for_impossible():
    from models.lspomdp import LatentStatePOMDP

    sure = LatentStatePOMDP([1.0], np.ones((4, 1, 1)), [[[1.0, 0.0]]] * 2)
    with pytest.raises(InputError, match="has probability zero"):
        evaluate_schedule(myopic(sure), person(), "HRH")


def test_too_many_histories(monkeypatch):
    import models.planning.evaluation as module

    monkeypatch.setattr(module, "MOST_HISTORIES", 4)
    with pytest.raises(InputError, match="wanted at most 4: simulate it instead"):
        evaluate_schedule(policy("myopic"), person(), "HHHH")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"runs": 1}, "simulation, runs: found 1, wanted a whole number, at least 2"),
        ({"runs": 1e4}, "simulation, runs: found 10000.0"),
        ({"steps": 2.5}, "simulation, steps: found 2.5"),
        ({"level": 1.0}, "simulation, level"),
        ({"steps": 0}, "simulation, steps: found 0"),
    ],
)
def test_unusable_simulations(options, words):
    with pytest.raises(InputError, match=words):
        simulate_policy(never(PUBLISHED), problem(), **options)
    with pytest.raises(InputError, match="found none, with discount 1, wanted a number of steps"):
        simulate_policy(never(PUBLISHED), problem().with_discount(1.0))


@given(st.integers(0, 2**32 - 1))
def test_every_history_of_a_schedule_counts_once(seed):
    model = random_model(np.random.default_rng(seed), PUBLISHED, 3)
    found = evaluate_schedule(uniformly_random(PUBLISHED), model, "HRHRHR", 0.7)
    per_event = [model.reward_table()[2 * (k % 2 == 0) : 2 * (k % 2 == 0) + 2].mean(axis=0) for k in range(6)]
    wanted = sum(0.7**k * found.state_path[k] @ per_event[k] for k in range(6))
    assert found.value == pytest.approx(wanted)


def test_beliefs_of_a_plan_as_vectors(truth):
    """By its own model its belief is the true one; the mean belief before each event is then the true path."""
    schedule = Schedule.of(truth, "HRHRH")
    plan = schedule_vectors(schedule)
    found = evaluate_schedule(plan, schedule)
    assert found.belief_path.shape == (5, truth.n_states)
    assert found.belief_path == pytest.approx(found.state_path[:-1])
    for step in follow_responses(plan, schedule, responses=["help", "no_help", "help"]):
        assert step.belief == pytest.approx(step.true_belief)
    drifting = replace(truth, transition=0.5 * truth.transition + 0.5 / truth.n_states)
    other = evaluate_schedule(schedule_vectors(Schedule.of(drifting, "HRHRH")), schedule)
    assert other.belief_path.sum(axis=1) == pytest.approx(np.ones(5))
    assert not np.allclose(other.belief_path, other.state_path[:-1])
    assert found.value == pytest.approx(evaluate_schedule(PlanPolicy.of(solve_schedule(schedule)), schedule).value)
