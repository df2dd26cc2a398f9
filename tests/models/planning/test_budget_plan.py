"""Plans within a hard budget: against all plans there are, and the numbers under the calibrated truth."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.model_files import read_model
from models.planning import budget_tree
from models.planning.budget_plan import budget_values, solve_with_budget
from models.planning.budget_tree import BudgetTree
from models.planning.charges import charges_of, in_units
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.expected_cost import cost_frontier
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from models.safeguards.guarded_run import guarded_run
from tests.models.planning.budget_cases import charged_schedules, named, spent_in
from tests.models.planning.policy_cases import person
from tests.planning_cases import sticky_draws
from tests.reference.all_plans import all_plans
from tests.reference.budget import history_sums, most_spent, plans_with_costs

CLOSE = {"rel": 1e-10, "abs": 1e-10}
BUDGETS = (0.0, 0.1, 0.3, 0.35, 1.0, 1.1, 2.5, 3.6, 100.0, np.inf)


@pytest.fixture(scope="module")
def truth(shared):
    return read_model(shared / "data" / "calibrated_truth.json")


@given(charged_schedules(), st.sampled_from(BUDGETS))
def test_equals_all_plans(case, budget):
    schedule, charges = case
    values, _, spent = plans_with_costs(schedule, charges)
    plan = solve_with_budget(schedule, budget, charges)
    within = spent <= budget + 1e-9
    assert plan.value == pytest.approx(values[within].max(), **CLOSE)
    assert plan.most_spent <= budget
    assert most_spent(schedule, plan.decisions, charges) <= budget + 1e-9
    assert np.nanmax(plan.first_values) == plan.value
    first = schedule.first_action(0)
    affordable = charges[first : first + len(schedule.mode(0).actions)] <= budget
    assert np.array_equal(np.isfinite(plan.first_values), affordable)
    assert evaluate_schedule(plan.policy(), schedule).value == pytest.approx(plan.value, **CLOSE)


@given(charged_schedules())
def test_values_at_every_budget(case):
    schedule, charges = case
    values, _, spent = plans_with_costs(schedule, charges)
    found = budget_values(schedule, charges)
    for budget in BUDGETS:
        assert found.value_at(budget) == pytest.approx(values[spent <= budget + 1e-9].max(), **CLOSE)
    assert np.all(np.diff(found.values) >= 0)
    assert found.budgets[0] == 0
    for budget, value in zip(found.budgets.tolist(), found.values.tolist(), strict=True):
        p = found.plan(budget)
        assert p.value == pytest.approx(value, **CLOSE)
        assert p.most_spent <= budget
        assert p.value == pytest.approx(solve_with_budget(schedule, budget, charges).value, **CLOSE)
    assert found.value_at(found.enough) == pytest.approx(found.values[-1], **CLOSE)


@given(charged_schedules(max_events=5, most_plans=10**9))
def test_without_limit_and_without_money(case):
    schedule, charges = case
    assert solve_with_budget(schedule, np.inf, charges).value == pytest.approx(
        solve_schedule(schedule).value, **CLOSE
    )
    free = solve_with_budget(schedule, 0, charges)
    for k, level in enumerate(free.decisions):
        assert not charges[schedule.first_action(k) + level.astype(int)].any()
    assert free.most_spent == 0


@given(charged_schedules(max_events=5, most_plans=10**9), st.sampled_from(BUDGETS))
def test_sums_equal_the_slow_ones(case, budget):
    schedule, charges = case
    units = in_units(charges, budget)
    tree = BudgetTree.of(schedule, units)

    def affordable(_, seen):
        return sum(units.charge[schedule.first_action(j) + c] for j, (c, _) in enumerate(seen)) <= units.budget

    wanted = history_sums(schedule, affordable=affordable)
    found = [[()]]
    for own in tree.child:
        places = np.argwhere(own >= 0)
        found.append([(*found[-1][h], (int(c), int(o))) for h, c, o in places])
    assert sum(map(len, found)) == len(wanted)
    rewards, mass = tree.sums
    for k, level in enumerate(found):
        for h, seen in enumerate(level):
            assert rewards[k][h] == pytest.approx(wanted[seen][0], **CLOSE)
            assert mass[k][h] == pytest.approx(wanted[seen][1], **CLOSE)
            spent = spent_in(schedule, seen, units.charge)
            assert tree.top[k][h] == tree.levels.level(k, units.budget - spent)


def test_portions_of_draws_add_up(monkeypatch):
    schedule = Schedule.of(sticky_draws(23, 4, 3), "HRHRH")
    whole = solve_with_budget(schedule, 30)
    monkeypatch.setattr(budget_tree, "PORTION", 5)
    parts = solve_with_budget(schedule, 30)
    assert parts.value == pytest.approx(whole.value, rel=1e-13)
    assert all(np.array_equal(a, b) for a, b in zip(parts.decisions, whole.decisions, strict=True))


@given(charged_schedules(), st.sampled_from(BUDGETS))
@settings(max_examples=25)
def test_never_better_than_in_expectation(case, budget):
    schedule, charges = case
    frontier = cost_frontier(schedule, charges)
    plan = solve_with_budget(schedule, budget, charges)
    assert plan.value <= frontier.value_at(min(budget, 1e9)) + 1e-9 * max(1, abs(plan.value))


def test_values_need_not_be_concave():
    """Two helps in a row bring what one does not; the table says so."""
    from models.lspomdp import LatentStatePOMDP
    from models.reward import Reward

    stay, up = np.eye(3), np.array([[0, 1.0, 0], [0, 0, 1], [0, 0, 1]])
    model = LatentStatePOMDP(
        [1.0, 0, 0], [stay, up, stay, stay], np.full((2, 3, 2), 0.5), reward=Reward((0.0, 1.0, 60.0), 0.06)
    )
    found = budget_values(Schedule.of(model, "RRR", terminal=[0.0, 0.0, 1000.0]))
    assert not found.concave
    assert "some steps bring more per unit than earlier ones" in found.sentence
    assert found.table["budget"].tolist() == [0, 15, 30, 45]
    assert found.value_at(15) == found.value_at(0)
    assert found.value_at(30) > 1000


# -- under the calibrated truth ------------------------------------------------------------------------
def test_published_schedule(truth):
    schedule = Schedule.of(truth, "HRHRHRHRH")
    found = budget_values(schedule)
    wanted = [162.6, 190.3, 210.1, *7 * [219.4]]
    assert [round(r["value"], 1) for r in found.rows()] == wanted
    assert found.budgets.tolist() == [15.0 * i for i in range(10)]
    assert found.enough == 45
    assert found.concave
    assert found.value_at(135) == found.value_at(45) == pytest.approx(solve_schedule(schedule).value)
    assert found.value_at(44.9) == found.value_at(30)
    plan = solve_with_budget(schedule, 15)
    assert plan.value == pytest.approx(found.value_at(15), rel=1e-12)
    assert plan.most_spent == 15
    assert set(plan.table.columns) == {"event", "mode", "responses", "spent", "action"}
    assert "never spends more than 15 is worth 190.3 reward units" in plan.sentence
    by_count = solve_with_budget(schedule, 1, charges_of(truth, "count"))
    assert by_count.value == pytest.approx(plan.value, rel=1e-12)


def test_rows_add_up_what_was_spent(truth):
    schedule = Schedule.of(truth, "HRHRH")
    plan = solve_with_budget(schedule, 30)
    costs = charges_of(truth)
    by_history = {(row["event"] - 1, row["responses"]): row for row in plan.rows()}
    assert {row["event"] for row in plan.rows()} == {1, 2, 3, 4, 5}
    for (k, seen), row in by_history.items():
        spent = 0.0
        for j in range(k):
            shown = sum(schedule.mode(i).shows_response for i in range(j))
            before = by_history[j, seen[:shown]]
            spent += costs[schedule.protocol.action(before["action"])]
        assert row["spent"] == spent


# -- what it refuses -----------------------------------------------------------------------------------
@pytest.mark.parametrize("budget", [-1, float("nan"), "15"])
def test_budgets_that_are_none(budget):
    with pytest.raises(InputError, match="budget"):
        solve_with_budget(Schedule.of(person(), "HR"), budget)


def test_too_many_histories(monkeypatch):
    monkeypatch.setattr(budget_tree, "MOST_CELLS", 100)
    with pytest.raises(InputError, match=r"schedule HRHRH: found 64 histories before event 4, 2 amounts left"):
        solve_with_budget(Schedule.of(person(), "HRHRH"), np.inf)
    assert solve_with_budget(Schedule.of(person(), "HRHRH"), 15).most_spent <= 15


def test_costs_below_zero_are_no_charges():
    from models.reward import Reward

    model = replace(person(), reward=Reward(person().reward.x, 0.06, {"help": -1.0}))
    with pytest.raises(InputError, match="charge of help"):
        solve_with_budget(Schedule.of(model, "HR"), 15)


def test_named_histories_are_the_schedule_s():
    schedule = Schedule.of(person(), "HR")
    assert named(schedule, [(1, 0)]) == [("signal", "no_help")]


def test_a_budget_is_counted_in_the_units_of_the_table():
    schedule = Schedule.of(person(), "RHRH")
    charges = [0.0, 1 / 3, 0.0, 0.1]
    values = budget_values(schedule, charges)
    for budget in (0.0, 0.5, 0.7666666666666666, 2.605785027996414, 1e9):
        assert values.value_at(budget) == pytest.approx(solve_with_budget(schedule, budget, charges).value)


MEASURED = (0.0, 1 / 3, 0.1, 0.37284910283746, 14.738928371234567, 2 / 7, 15.0, 1e-7 / 3)


def exact_sums(schedule, charges):
    """The most that each plan spends, added up as the decimals that charges are written as."""
    plans, _ = all_plans(schedule)
    exact = np.array([Fraction(repr(float(c))) for c in charges])
    out = []
    for plan in plans:
        spent = np.array([Fraction(0)])
        for k, level in enumerate(plan):
            spent = spent + exact[schedule.first_action(k) + level.astype(int)]
            if k + 1 < len(plan):
                spent = np.repeat(spent, schedule.n_outcomes(k))
        out.append(max(spent.tolist()))
    return out


@given(charged_schedules(max_events=5), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_charges_of_many_digits_are_counted_exactly(case, seed):
    schedule, charges = case
    rng = np.random.default_rng(seed)
    charges = np.where(charges > 0, rng.choice(MEASURED, charges.shape), 0.0)
    values, _, _ = plans_with_costs(schedule, charges)
    spent = np.array([float(s) for s in exact_sums(schedule, charges)])
    found = budget_values(schedule, charges)
    between = 0.5 * (found.budgets[1:] + found.budgets[:-1])
    for budget in [*found.budgets.tolist(), *between.tolist(), *BUDGETS, 1e12]:
        wanted = values[spent <= budget].max()
        assert found.value_at(budget) == pytest.approx(wanted, **CLOSE)
        plan = solve_with_budget(schedule, budget, charges)
        assert plan.value == pytest.approx(wanted, **CLOSE)
        assert found.plan(budget).value == pytest.approx(wanted, **CLOSE)
        assert plan.most_spent <= budget
    assert set(spent.tolist()) <= set(found.budgets.tolist())
    assert found.values[-1] == pytest.approx(solve_schedule(schedule).value, **CLOSE)
    assert np.all(np.isfinite([r["gain_per_unit"] for r in found.rows()[1:]]))


def test_without_limit_charges_of_many_digits_pay_for_everything(truth):
    schedule = Schedule.of(truth, "HRHRHR")
    charges = charges_of(truth, {"help": 1 / 3, "signal": 0.1})
    best = solve_schedule(schedule).value
    found = budget_values(schedule, charges)
    assert solve_with_budget(schedule, np.inf, charges).value == pytest.approx(best)
    assert found.value_at(np.inf) == found.values[-1] == pytest.approx(best)
    assert found.budgets[-1] == pytest.approx(1.3)
    # What was printed as a budget pays for what it was printed for, also where its sum has more digits.
    for budget, value in zip(found.budgets.tolist(), found.values.tolist(), strict=True):
        assert solve_with_budget(schedule, budget, charges).value == pytest.approx(value, **CLOSE)
        policy = schedule_vectors(schedule, budget, charges)
        assert evaluate_schedule(policy, schedule).value == pytest.approx(value, **CLOSE)
        assert guarded_run(policy, schedule, charges).most_cost <= budget * (1 + 1e-12)
