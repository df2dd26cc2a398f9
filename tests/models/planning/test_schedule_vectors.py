"""The exact plan as vectors: exact after every history, whoever acted; the budget is never exceeded."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.model_files import read_model
from models.planning import schedule_vectors as module
from models.planning.budget_plan import solve_with_budget
from models.planning.charges import charges_of
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import history_values, solve_schedule
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from tests.models.planning.budget_cases import charged_schedules, histories, memory_after, named, spent_in
from tests.models.planning.policy_cases import person
from tests.models.planning.schedule_cases import schedules
from tests.planning_cases import sticky_draws
from tests.reference.all_plans import values_of

CLOSE = {"rel": 1e-9, "abs": 1e-9}


@pytest.fixture(scope="module")
def truth(shared):
    return read_model(shared / "data" / "calibrated_truth.json")


def possible(schedule, missing):
    for k, found in histories(schedule, missing):
        for h in found:
            joint = schedule.start()
            for j, (c, o) in enumerate(h):
                joint = schedule.after(joint, schedule.first_action(j) + c, o)
            if joint.sum() > 1e-9:
                yield k, h, joint


@given(schedules(max_events=4, max_states=3, max_draws=3))
@settings(max_examples=40)
def test_exact_after_every_history(schedule):
    policy = schedule_vectors(schedule)
    for _, h, _ in possible(schedule, missing=True):
        memory = memory_after(policy, schedule, h)
        wanted = list(history_values(schedule, named(schedule, h)).values())
        assert policy.action_values(memory) == pytest.approx(wanted, **CLOSE)
    assert evaluate_schedule(policy, schedule).value == pytest.approx(solve_schedule(schedule).value, **CLOSE)


@pytest.fixture
def no_tail(monkeypatch):
    """Vectors made for histories alone, none of all plans."""
    monkeypatch.setattr(module, "MOST_PLANS", 1)


@pytest.mark.usefixtures("no_tail")
@pytest.mark.parametrize("seed", range(6))
def test_exact_without_all_plans_of_the_last_events(seed):
    schedule = Schedule.of(sticky_draws(1 + seed % 3, seed, 3), "HRHRH", 0.9, terminal=[0.0, 5.0, 20.0])
    for missing in (True, False):
        policy = schedule_vectors(schedule, missing=missing)
        for _, h, _ in possible(schedule, missing=True):
            memory = memory_after(policy, schedule, h)
            wanted = np.array(list(history_values(schedule, named(schedule, h)).values()))
            if missing or all(o is not None or not schedule.mode(j).shows_response for j, (_, o) in enumerate(h)):
                assert policy.action_values(memory) == pytest.approx(wanted, **CLOSE)
            else:
                assert np.all(policy.action_values(memory) <= wanted + 1e-9)


@pytest.mark.usefixtures("no_tail")
@given(charged_schedules(max_events=4, most_plans=10**6), st.sampled_from([0.0, 0.3, 1.1, 2.5, 5.0]))
@settings(max_examples=40)
def test_exact_within_a_budget_after_every_history(case, budget):
    schedule, charges = case
    policy = schedule_vectors(schedule, budget, charges)
    for k, h, joint in possible(schedule, missing=True):
        memory = memory_after(policy, schedule, h)
        left = max(round(budget - spent_in(schedule, h, charges), 9), 0.0)
        plan = solve_with_budget(schedule.rest(k, joint), left, charges)
        assert policy.action_values(memory) == pytest.approx(plan.first_values, nan_ok=True, **CLOSE)
        assert policy.left_of(memory) <= left
        assert policy.weights_of(memory) == pytest.approx(joint.sum(axis=1) / joint.sum(), **CLOSE)
        assert policy.belief_of(memory) == pytest.approx(joint.sum(axis=0) / joint.sum(), **CLOSE)


def committed(policy, schedule, k, memory, c):
    """What the policy's graph does from event `k` on after choice `c`, by responses as exact plans have it."""
    s, d = memory.belief.shape
    graph, m = policy.graph, schedule.modes[k]
    ahead = policy.beliefs.ahead(m, memory.belief).reshape(-1, schedule.n_outcomes(k), s * d)[c]
    y = int(policy.product.follow[memory.product, c, schedule.modes[k + 1] if k + 1 < schedule.n_events else m])
    vectors = np.flatnonzero(policy.mode == y)
    level = vectors[(policy.alpha[vectors].reshape(len(vectors), -1) @ ahead.T).argmax(axis=0)]
    out = [np.array([c], dtype=np.int8)]
    for j in range(k + 1, schedule.n_events):
        out.append(graph.choice[level].astype(np.int8))
        level = graph.follow[level, : schedule.n_outcomes(j)].ravel()
    return tuple(out)


@given(charged_schedules(max_events=4, most_plans=10**6), st.sampled_from([None, 1.1, 2.5]))
@settings(max_examples=30)
def test_draws_are_worth_what_the_committed_plan_is_in_them(case, budget):
    schedule, charges = case
    policy = schedule_vectors(schedule, budget, charges)
    for k, h, joint in possible(schedule, missing=False):
        memory = memory_after(policy, schedule, h)
        found, weight = policy.draw_action_values(memory), policy.weights_of(memory)
        assert found.shape == (schedule.draws.n_draws, len(schedule.mode(k).actions))
        assert weight @ np.nan_to_num(found) == pytest.approx(np.nan_to_num(policy.action_values(memory)), **CLOSE)
        beliefs = policy.draw_beliefs(memory)
        assert beliefs.sum(axis=1) == pytest.approx((weight > 0).astype(float))
        rest = schedule.rest(k, joint)
        for c in np.flatnonzero(np.isfinite(found[0])):
            wanted = values_of(rest, committed(policy, schedule, k, memory, c))
            assert found[weight > 0, c] == pytest.approx(wanted[weight > 0], **CLOSE)
            assert not found[weight == 0, c].any()


# -- nine events, whoever acts -------------------------------------------------------------------------
@pytest.mark.parametrize(
    "budget", [30, *(pytest.param(b, marks=pytest.mark.slow) for b in (0, 15, 45, 75))]
)  # fmt: skip
def test_budget_is_never_exceeded_in_nine_events(truth, budget):
    """All actions, taken by the policy or in its stead, all responses, responses not recorded."""
    schedule, costs = Schedule.of(truth, "HRHRHRHRH"), charges_of(truth)
    policy = schedule_vectors(schedule, budget)
    frontier = [(policy.begin(schedule.modes[0]), 0.0, 0.0)]
    visited = own = 0
    for k in range(schedule.n_events):
        after = schedule.modes[min(k + 1, schedule.n_events - 1)]
        seen = (1, 2, None) if schedule.mode(k).shows_response else (0,)
        reached = []
        for memory, spent, others in frontier:
            visited += 1
            wanted = policy.act(memory)
            for c in range(len(schedule.mode(k).actions)):
                charge = costs[schedule.first_action(k) + c]
                if c == wanted:
                    # Never more than is left, and nothing once others have spent more than there is.
                    assert charge == 0 or spent + charge <= budget
                    assert policy.left_of(memory) <= max(budget - spent, 0)
                    own += charge > 0
                by_others = others + (charge if c != wanted else 0.0)
                if k + 1 < schedule.n_events:
                    reached += [(policy.observe(memory, c, o, after), spent + charge, by_others) for o in seen]
        frontier = reached
    assert visited == sum(6 ** (k // 2 + k % 2) * 2 ** (k // 2) for k in range(9))
    assert (own > 0) == (budget > 0)


def test_exact_in_nine_events(truth):
    schedule = Schedule.of(truth, "HRHRHRHRH")
    policy, rng = schedule_vectors(schedule, 30), np.random.default_rng(1)
    for _ in range(300):
        k, h = int(rng.integers(9)), []
        for j in range(k):
            shows = schedule.mode(j).shows_response
            h.append((int(rng.integers(2)), [0, 1, None][rng.integers(3)] if shows else None))
        joint, _ = schedule.joint_after(named(schedule, h))
        left = max(30 - spent_in(schedule, h, charges_of(truth)), 0)
        plan = solve_with_budget(schedule.rest(k, joint), left)
        found = policy.action_values(memory_after(policy, schedule, h))
        assert found == pytest.approx(plan.first_values, nan_ok=True, **CLOSE)


def test_overspending_leaves_nothing(truth):
    schedule = Schedule.of(truth, "HRHRH")
    policy = schedule_vectors(schedule, 20)
    memory = memory_after(policy, schedule, [(1, 0)])
    assert policy.left_of(memory) == 0
    assert np.isnan(policy.action_values(memory)[1])
    memory = memory_after(policy, schedule, [(1, 0), (1, None), (1, 1)])
    assert policy.act(memory) == 0
    assert "no_help" in policy.reason(memory)
    assert "0 of the budget can still be spent" in policy.reason(memory)


# -- what it refuses -----------------------------------------------------------------------------------
def test_too_many_histories(monkeypatch):
    monkeypatch.setattr(module, "MOST_ENTRIES", 100)
    monkeypatch.setattr(module, "MOST_PLANS", 1)
    with pytest.raises(InputError, match=r"schedule HRHRH, event 3: found 72 histories, 3 numbers each, wanted"):
        schedule_vectors(Schedule.of(person(), "HRHRH"))
    with pytest.raises(InputError, match="event 4: found 64 histories"):
        schedule_vectors(Schedule.of(person(), "HRHRH"), missing=False)


def test_off_the_schedule():
    policy = schedule_vectors(Schedule.of(person(), "HRH"))
    human, robot = 0, 1
    with pytest.raises(InputError, match="first mode: found 'human_needs_help', wanted robot_needs_help"):
        policy.begin(human)
    start = policy.begin(robot)
    with pytest.raises(
        InputError, match="mode after event 1, robot_needs_help: found 'robot_needs_help', wanted human"
    ):
        policy.observe(start, 0, 1, robot)
    with pytest.raises(InputError, match="observation in mode robot_needs_help: found 'none', wanted a response"):
        policy.observe(start, 0, 0, human)
    second = policy.observe(start, 0, 1, human)
    with pytest.raises(InputError, match="observation in mode human_needs_help: found 'help', wanted none"):
        policy.observe(second, 0, 2, robot)
    last = policy.observe(second, 0, None, robot)
    for mode in (human, robot):
        end = policy.observe(last, 0, 2, mode)
        assert policy.mode_of(end) == mode
        for ask in (policy.act, policy.action_values, policy.draw_action_values, policy.why):
            with pytest.raises(InputError, match="the end, wanted an event of the schedule: it is over"):
                ask(end)
        with pytest.raises(InputError, match="it is over"):
            policy.observe(end, 0, None, mode)


def test_impossible_responses():
    sure = replace(person(), emission=np.array([[[1.0, 0.0]] * 3, [[0.5, 0.5]] * 3]))
    schedule = Schedule.of(sure, "HRH")
    with pytest.raises(InputError, match="'help': has probability zero after 'no_signal'"):
        memory_after(schedule_vectors(schedule), schedule, [(0, 1)])
    kept = schedule_vectors(schedule, impossible="keep")
    wanted = memory_after(kept, schedule, [(0, None)])
    assert kept.belief_of(memory_after(kept, schedule, [(0, 1)])) == pytest.approx(kept.belief_of(wanted))
    anew = schedule_vectors(schedule, impossible="reset")
    assert anew.belief_of(memory_after(anew, schedule, [(0, 1)])) == pytest.approx(sure.initial)
    with pytest.raises(InputError, match="wanted error, keep or reset"):
        schedule_vectors(schedule, impossible="ignore")
