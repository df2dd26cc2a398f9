"""The best plan without lots: against all plans, against what others find, and its pieces against slow twins."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.planning.baselines import always, never, uniformly_random
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.robust import single_plan
from models.robust.candidates import posterior_mean, standard_candidates
from models.robust.cautious import cautious_plan
from models.robust.neighbour_plans import neighbour_values
from models.robust.open_loop import open_loop
from models.robust.own_plans import own_plans
from models.robust.plan_table import PlanEvaluator, plan_key
from models.robust.risk import RiskSet
from models.robust.single_plan import best_single, count_plans, decisions_of, pooled
from tests.models.planning.schedule_cases import schedules
from tests.models.robust.cases import few_plans
from tests.models.robust.information_cases import contested
from tests.planning_cases import sticky_draws
from tests.reference import all_plans as reference

ALPHAS = st.sampled_from([0.0, 0.1, 0.35, 0.9, 1.0])


def hard(seed=3, letters="HRHR", draws=9):
    """A schedule on which no single plan reaches the mixture of small regret."""
    schedule = Schedule.of(contested(seed, draws), letters)
    return cautious_plan(schedule, 0.0, reference=own_plans(schedule).values)


@given(few_plans(max_draws=5), ALPHAS, st.booleans())
def test_it_is_the_best_of_all_plans(schedule, alpha, regret):
    plans, values = reference.all_plans(schedule)
    against = own_plans(schedule).values if regret else np.zeros(schedule.draws.n_draws)
    mixture = cautious_plan(schedule, alpha, reference=against)
    found = best_single(mixture)
    risk = RiskSet(schedule.draws.weight, alpha)
    assert found.worth == pytest.approx(max(risk.lowest(v - against)[0] for v in values), rel=1e-9, abs=1e-9)
    assert count_plans(schedule, 10**6) == len(plans)
    assert found.proven
    assert found.every is (found.looked == len(plans) and found.lost > mixture.tolerance) or not found.every
    assert risk.lowest(PlanEvaluator(schedule).values(found.plan) - against)[0] == pytest.approx(found.worth)


@given(schedules(max_events=4, max_draws=5), st.data())
def test_neighbours_are_worth_what_they_are_worth_alone(schedule, data):
    sizes = [len(level) for level in solve_schedule(schedule).decisions]
    plan = tuple(
        np.array(data.draw(st.lists(st.integers(0, len(schedule.mode(k).actions) - 1), min_size=n, max_size=n)),
                 dtype=np.int8)
        for k, n in enumerate(sizes)
    )  # fmt: skip
    found = neighbour_values(schedule, plan)
    evaluator = PlanEvaluator(schedule)
    others = {plan_key(found.plan(i)) for i in range(len(found.changes))}
    assert len(others) == sum(n * (len(schedule.mode(k).actions) - 1) for k, n in enumerate(sizes))
    assert plan_key(plan) not in others
    for i, values in enumerate(found.values):
        assert values == pytest.approx(evaluator.values(found.plan(i)), rel=1e-9, abs=1e-9)


@given(st.integers(1, 8), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-3, 0.2, 0.7, 1.0]), st.floats(0, 1))
def test_many_outcomes_at_once(n, seed, alpha, kappa):
    rng = np.random.default_rng(seed)
    weight, outcomes = rng.dirichlet(np.ones(n)), rng.normal(size=(5, n))
    risk = RiskSet(weight, alpha, kappa)
    assert risk.lowest_each(outcomes) == pytest.approx(np.array([risk.lowest(row)[0] for row in outcomes]))


@pytest.mark.parametrize("seed", range(6))
def test_the_search_is_never_worse_than_its_pool_and_mostly_finds_the_best(seed, monkeypatch):
    mixture = hard(seed)
    best = best_single(mixture)
    monkeypatch.setattr(single_plan, "MOST_VALUES", 0)
    more = own_plans(mixture.schedule).plans
    found = best_single(mixture, more)
    assert not found.every
    table = mixture.table.with_plans(more)
    assert found.worth >= mixture.risk.lowest_each(table.values - mixture.reference).max() - 1e-9
    assert found.worth <= best.worth + 1e-9
    assert found.worth == pytest.approx(best.worth, abs=0.02 * np.ptp(mixture.values))
    assert found.looked > len(table.plans) or found.lost <= mixture.tolerance
    monkeypatch.setattr(single_plan, "WORK", 0)
    pool = best_single(mixture, more)
    assert pool.looked == len(table.plans)
    assert pool.worth <= found.worth + 1e-9


def test_some_of_these_are_hard(monkeypatch):
    """There single plans lose something, and plans that column generation met are not the best ones."""
    lost, met = [], []
    for seed in range(6):
        mixture = hard(seed)
        found = best_single(mixture)
        lost.append(found.lost)
        met.append(found.worth - mixture.risk.lowest_each(mixture.table.values - mixture.reference).max())
    assert max(lost) > 1e-3
    assert max(met) > 1e-3
    assert min(met) >= -1e-9


def test_no_plan_that_is_priced_beats_it(monkeypatch):
    monkeypatch.setattr(single_plan, "MOST_VALUES", 0)
    monkeypatch.setattr(single_plan, "WORK", 0)
    mixture = hard(1, "HRHRH", 20)
    schedule = mixture.schedule
    known = [c.choose(schedule) for c in standard_candidates(schedule)]
    more = pooled(
        [p for c in known for p in c.plans]
        + [decisions_of(c.policy, schedule) for c in known if c.policy is not None]
    )  # fmt: skip
    found = best_single(mixture, more)
    for chosen in known:
        if len(chosen.plans) == 1 or (chosen.policy is not None and chosen.policy.name != "random"):
            alone = mixture.risk.lowest(chosen.values(schedule) - mixture.reference)[0]
            assert found.worth >= alone - 1e-9


def test_as_a_mixture_of_one_the_bound_stays():
    mixture = hard()
    found = best_single(mixture)
    single = found.cautious
    assert single.deterministic
    assert single.lower == found.worth <= mixture.lower + 1e-12
    assert single.upper == mixture.upper
    assert single.lower == pytest.approx((single.values - mixture.reference).min())
    assert single.gap == pytest.approx(found.lost)


def test_a_mixture_of_one_is_the_answer_at_once():
    schedule = Schedule.of(sticky_draws(6, 4), "HRHR")
    mixture = cautious_plan(schedule, 1.0)
    found = best_single(mixture)
    assert plan_key(found.plan) == plan_key(mixture.plans[0])
    assert found.proven
    assert not found.every
    assert found.looked == len(mixture.table.plans)


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_policies_as_plans(seed):
    rng = np.random.default_rng(seed)
    letters = "".join(rng.choice(["H", "R"], size=rng.integers(1, 6)))
    schedule = Schedule.of(contested(seed, 3), letters)
    evaluator = PlanEvaluator(schedule)
    for candidate in standard_candidates(schedule):
        policy = candidate.choose(schedule).policy
        if policy is None:
            continue
        plan = decisions_of(policy, schedule)
        if policy.name == uniformly_random(PUBLISHED).name:
            assert plan is None
            continue
        assert evaluator.values(plan) == pytest.approx(evaluate_schedule(policy, schedule).values, abs=1e-9)
    idle = decisions_of(never(PUBLISHED), schedule)
    assert not any(
        level.any() for level, k in zip(idle, range(len(letters)), strict=True)
        if schedule.mode(k).actions[0].name == schedule.mode(k).null_action
    )  # fmt: skip


def test_histories_that_cannot_be_are_not_followed():
    """A robot that is certain would refuse to filter a response that its tables exclude."""
    schedule = Schedule.of(sticky_draws(2, 1), "HRH")
    certain = np.zeros_like(schedule.draws.emission)
    certain[..., 1] = 1.0
    sure = replace(schedule, draws=replace(schedule.draws, emission=certain))
    assert posterior_mean(sure.draws).emission[0, 0, 0] == 0
    assert [level.shape for level in decisions_of(always(PUBLISHED), sure)] == [(1,), (2,), (2,)]
    assert plan_key(open_loop(sure)) in {plan_key(p) for p in pooled([open_loop(sure), None, open_loop(sure)])}
    assert len(pooled([open_loop(sure), None, open_loop(sure)])) == 1
