"""Cautious plans: column generation against a linear program over all deterministic plans."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from models.robust.cautious import acting_words, cautious_plan
from models.robust.own_plans import own_plans
from models.robust.risk import RiskSet, cvar
from tests.models.planning.schedule_cases import schedules
from tests.models.robust.cases import few_plans
from tests.planning_cases import sticky_draws
from tests.reference.all_plans import all_plans, best_mean_cvar, best_worst

CLOSE = {"rel": 1e-8, "abs": 1e-8}

ALPHAS = st.sampled_from([0.02, 0.1, 0.35, 0.5, 0.9, 1.0])


@given(few_plans(max_draws=5), ALPHAS, st.sampled_from([0.0, 0.3, 1.0]))
def test_mean_and_cvar_equal_the_program_over_all_plans(schedule, alpha, mean_share):
    _, values = all_plans(schedule)
    found = cautious_plan(schedule, alpha, mean_share=mean_share)
    wanted = best_mean_cvar(values, schedule.draws.weight, alpha, mean_share)
    assert found.lower == pytest.approx(wanted, **CLOSE)
    assert found.certified
    assert found.upper >= wanted - 1e-8 * max(1, abs(wanted))


@given(few_plans(max_draws=5))
def test_worst_draw_and_regret_equal_the_program_over_all_plans(schedule):
    _, values = all_plans(schedule)
    weight, own = schedule.draws.weight, own_plans(schedule).values
    assert own == pytest.approx(values.max(axis=0), rel=1e-10, abs=1e-10)
    assert cautious_plan(schedule, 0).lower == pytest.approx(best_worst(values, weight), **CLOSE)
    regret = cautious_plan(schedule, 0, reference=own)
    assert regret.lower == pytest.approx(best_worst(values - own, weight), **CLOSE)
    part = cautious_plan(schedule, 0.3, reference=own)
    assert part.lower == pytest.approx(best_mean_cvar(values - own, weight, 0.3), **CLOSE)


@given(schedules(max_events=4, max_draws=6, zeros=0.0), ALPHAS)
def test_orders_that_hold_exactly(schedule, alpha):
    """Optimal worst case <= optimal CVaR <= Bayes; both bounds are recomputed here from values."""
    bayes = solve_schedule(schedule).value
    worst, cautious = cautious_plan(schedule, 0), cautious_plan(schedule, alpha)
    slack = 1e-9 * max(1.0, np.abs(cautious.table.values).max())
    assert worst.lower <= cautious.upper + slack
    assert cautious.lower <= bayes + slack
    assert cautious.gap <= slack
    weight = schedule.draws.weight
    mixture = cautious.share @ np.array([cautious.table.values[cautious.table.row(p)] for p in cautious.plans])
    assert mixture == pytest.approx(cautious.values, rel=1e-12, abs=1e-12)
    assert cvar(mixture, weight, alpha) == pytest.approx(cautious.lower, rel=1e-12, abs=1e-12)
    q = cautious.weight
    assert q.sum() == pytest.approx(1, abs=1e-12)
    assert np.all(q >= 0)
    assert np.all(q <= weight / alpha * (1 + 1e-9) + 1e-15)
    bound = solve_schedule(replace(schedule, draws=replace(schedule.draws, weight=q / q.sum()))).value
    assert bound == pytest.approx(cautious.upper, rel=1e-9, abs=1e-9)


def test_a_warm_start_finds_the_same():
    schedule = Schedule.of(sticky_draws(40, 9), "HRHRH")
    own = own_plans(schedule).values
    cold = cautious_plan(schedule, 0, reference=own)
    warm = cautious_plan(schedule, 0, reference=own, start=cold.table)
    assert warm.lower == pytest.approx(cold.lower, abs=1e-9)
    assert warm.iterations < cold.iterations
    assert len(cold.plans) > 1, "the case is too easy to say anything"
    alone = cold.risk.lowest_each(cold.table.values - own)
    assert alone.max() < cold.lower
    rows = cold.rows()
    assert sum(r["share"] for r in rows) == pytest.approx(1)
    assert rows[0]["share"] == max(r["share"] for r in rows)


def test_one_draw_is_the_plain_plan():
    schedule = Schedule.of(sticky_draws(1, 2), "HRHR")
    plain = solve_schedule(schedule)
    for alpha in (0, 0.2, 1):
        found = cautious_plan(schedule, alpha)
        assert found.deterministic
        assert found.lower == pytest.approx(plain.value, rel=1e-12)


def test_draws_without_weight_do_not_matter():
    schedule = Schedule.of(sticky_draws(6, 4), "HRH")
    weight = np.array([0.5, 0.25, 0.25, 0, 0, 0])
    with_zeros = replace(schedule, draws=replace(schedule.draws, weight=weight))
    d = schedule.draws
    without = replace(
        d, initial=d.initial[:3], transition=d.transition[:3], emission=d.emission[:3], weight=weight[:3]
    )
    for alpha in (0, 0.3):
        a = cautious_plan(with_zeros, alpha)
        b = cautious_plan(replace(schedule, draws=without), alpha)
        assert a.lower == pytest.approx(b.lower, abs=1e-9)


@given(st.integers(1, 8), st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(0, 0.99))
def test_the_least_favourable_weights(n, seed, alpha, kappa):
    """No member of the set makes it worse (tried at random), and projecting gives members."""
    rng = np.random.default_rng(seed)
    weight, outcomes = rng.dirichlet(np.ones(n)), rng.normal(size=n)
    risk = RiskSet(weight, alpha, kappa)
    worth, q = risk.lowest(outcomes)
    assert q @ outcomes == pytest.approx(worth)
    for _ in range(20):
        member = risk.project(rng.dirichlet(np.ones(n)))
        assert member.sum() == pytest.approx(1)
        z = (member - kappa * weight) / (1 - kappa) if alpha < 1 else member
        assert np.all(z >= -1e-9)
        assert np.all(z <= risk.caps + 1e-9)
        assert member @ outcomes >= worth - 1e-9
    assert risk.project(q) == pytest.approx(q, abs=1e-9)


def test_cvar_is_the_mean_of_the_tail_by_weight():
    outcomes, weight = np.array([3.0, 1.0, 2.0]), np.array([0.5, 0.2, 0.3])
    assert cvar(outcomes, weight, 0.2) == pytest.approx(1)
    assert cvar(outcomes, weight, 0.4) == pytest.approx((0.2 * 1 + 0.2 * 2) / 0.4)
    assert cvar(outcomes, weight, 1) == pytest.approx(weight @ outcomes)
    assert cvar(outcomes, weight, 0) == 1


@pytest.mark.parametrize(
    ("alpha", "mean_share", "match"),
    [(-0.1, 0, "alpha"), (1.2, 0, "alpha"), (float("nan"), 0, "alpha"), (0.1, 2, "mean")],
)
def test_criteria_that_are_none(alpha, mean_share, match):
    with pytest.raises(InputError, match=match):
        cautious_plan(Schedule.of(sticky_draws(2, 1), "H"), alpha, mean_share=mean_share)


def test_words_where_a_plan_acts():
    schedule = Schedule.of(sticky_draws(2, 1), "HRH")
    idle = tuple(np.zeros(n, dtype=np.int8) for n in (1, 2, 2))
    assert acting_words(schedule, idle) == ["never acts"]
    helps = (idle[0], np.array([1, 0], dtype=np.int8), idle[2])
    (words,) = acting_words(schedule, helps)
    assert words.startswith("event 2 (R) ")
    assert "after (no_help)" in words


def test_weights_that_are_none():
    with pytest.raises(InputError, match="draw 1"):
        RiskSet(np.array([1.2, -0.2]))
    with pytest.raises(InputError, match="sum"):
        RiskSet(np.array([0.2, 0.2]))


def test_a_reference_that_does_not_fit():
    with pytest.raises(InputError, match="reference"):
        cautious_plan(Schedule.of(sticky_draws(2, 1), "H"), reference=np.zeros(3))
