"""Bayes trees for many weights at once: against plain recursion, weight by weight."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.planning import tail_plans
from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from models.robust import many_weights
from models.robust.many_weights import ManyWeights
from models.robust.own_plans import own_plans
from models.robust.plan_table import BestPlans, PlanEvaluator
from tests.models.planning.schedule_cases import schedules
from tests.models.robust.information_cases import contested
from tests.reference.information import best_value

CLOSE = {"rel": 1e-10, "abs": 1e-10}


def some_weights(schedule, seed, number=4):
    rng = np.random.default_rng(seed)
    weights = rng.exponential(size=(number, schedule.draws.n_draws)) * (rng.random((number, 1)) * 2)
    weights[0, rng.integers(schedule.draws.n_draws)] = 0.0
    return weights


@given(schedules(), st.integers(0, 99))
def test_equals_plain_recursion(schedule, seed):
    weights = some_weights(schedule, seed)
    found = ManyWeights(schedule).optima(weights)
    assert found.values == pytest.approx([best_value(schedule, w) for w in weights], **CLOSE)
    assert found.first_values.max(axis=1) == pytest.approx(found.values, **CLOSE)


@given(schedules(zeros=0.0), st.integers(0, 99))
def test_plans_scored_with_other_weights(schedule, seed):
    """The plan of one set of weights, worth what it says under another."""
    rng = np.random.default_rng(seed)
    choose, score = rng.exponential(size=(2, 3, schedule.draws.n_draws))
    found = ManyWeights(schedule).optima(choose, score)
    plain = ManyWeights(schedule).optima(choose)
    assert found.values == pytest.approx(plain.values, **CLOSE)
    assert plain.scored == pytest.approx(plain.values, **CLOSE)
    evaluator = PlanEvaluator(schedule)
    wanted = [s @ evaluator.values(BestPlans(schedule).plan(c)) for c, s in zip(choose, score, strict=True)]
    assert found.scored == pytest.approx(wanted, **CLOSE)


@settings(max_examples=15)
@given(schedules(max_events=5), st.integers(0, 99))
def test_nothing_depends_on_how_the_work_is_cut(schedule, seed):
    weights = some_weights(schedule, seed, 7)
    whole = ManyWeights(schedule).optima(weights)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(many_weights, "ROOM", 20)
        patch.setattr(many_weights, "CHUNK", 2)
        patch.setattr(tail_plans, "MOST_PLANS", 1)
        cut = ManyWeights(schedule)
        assert cut.optima(weights).values == pytest.approx(whole.values, **CLOSE)
        assert cut.optima(weights).first_values == pytest.approx(whole.first_values, **CLOSE)


@given(schedules(max_events=5, max_draws=6))
def test_each_draw_by_itself(schedule):
    n = schedule.draws.n_draws
    found = ManyWeights(schedule).group_optima(np.ones((n, 1))).values
    assert found == pytest.approx(own_plans(schedule).values, **CLOSE)
    assert ManyWeights(schedule).optima(np.eye(n)).values == pytest.approx(found, **CLOSE)
    together = ManyWeights(schedule).group_optima(schedule.draws.weight[None]).values
    assert together == pytest.approx([solve_schedule(schedule).value], **CLOSE)


@given(schedules(), st.floats(0.01, 100))
def test_worth_is_proportional_to_weights(schedule, factor):
    weights = some_weights(schedule, 1)
    many = ManyWeights(schedule)
    assert many.optima(factor * weights).values == pytest.approx(factor * many.optima(weights).values, **CLOSE)


@pytest.mark.parametrize(("seed", "parts"), [(3, 2), (4, 3), (5, 1)])
def test_plans_chosen_without_a_part(seed, parts):
    schedule = Schedule.of(contested(seed, 6), "HRHR")
    rng = np.random.default_rng(seed)
    weights = rng.gamma(0.3, size=(40, 6))
    part, left_out = np.arange(6) % parts, rng.integers(parts, size=40)
    many = ManyWeights(schedule)
    found = many.crossed(weights, part, left_out)
    assert found.values == pytest.approx(many.optima(weights).values)
    mine = left_out[:, None] == part
    wanted = many.optima(np.where(mine, 0.0, weights), np.where(mine, weights, 0.0))
    assert found.scored == pytest.approx(wanted.scored)


def test_bad_weights():
    many = ManyWeights(Schedule.of(contested(1, 2), "HR"))
    assert many.optima(np.zeros((0, 2))).values.shape == (0,)
    with pytest.raises(InputError, match=r"weights, shape: found \(2,\)"):
        many.optima(np.ones(2))
    with pytest.raises(InputError, match=r"weights, shape: found \(2, 2\)"):
        many.optima(np.ones((1, 2)), np.ones((2, 2)))
    with pytest.raises(InputError, match=r"weights: found -1.0, wanted numbers of at least 0"):
        many.optima(np.array([[1.0, -1.0]]))
    with pytest.raises(InputError, match=r"groups of draws: found \(3, 1\), wanted 2 draws in all"):
        many.group_optima(np.ones((3, 1)))
