"""The study of safeguards: numbers against their modules, sentences, figures."""

import json

import numpy as np
import pytest

from analysis.cli_options import plain
from analysis.figures.safeguards import stricter, value_and_cost, who_is_influenced
from analysis.figures.style import to_svg
from analysis.safeguard_study import (
    ADAPTIVE,
    IN_EXPECTATION,
    LS_POMDP,
    MEAN_PLAN,
    OPTIMAL,
    WITHIN,
    SafeguardStudy,
    Wanted,
    fallback_actions,
    safeguard_study,
    study_fields,
)
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.planning.budget_plan import solve_with_budget
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.policy_files import policy_from_dict, policy_to_dict
from models.planning.schedule import Schedule
from models.safeguards.influence_report import ALL, NONE
from tests.models.safeguards.guard_cases import doubt

FREE = {"human_needs_help": "no_help"}


@pytest.fixture(scope="module")
def schedule():
    return Schedule.of(doubt(), "HRHRH")


@pytest.fixture(scope="module")
def study(schedule) -> SafeguardStudy:
    return safeguard_study(schedule, Wanted(30.0, 20.0, 4.0, 0.8, 0.5, FREE))


def test_published_numbers_of_the_known_truth():
    found = safeguard_study(Schedule.of(calibrated_truth(), "HRHRHRHRH"), Wanted(budget=1000.0))
    values = {p: found.report.run(p) for p in found.report.policies}
    for name, value, rate, cost in (
        ("always", 153.1, 0.917, 135), ("never", 162.6, 0.637, 0), ("reactive", 198.5, 0.838, 60),
        (OPTIMAL, 219.4, 0.868, 45),
    ):  # fmt: skip
        assert values[name].value == pytest.approx(value, abs=0.06)
        assert values[name].help_rate == pytest.approx(rate, abs=6e-4)
        assert values[name].cost == pytest.approx(cost, abs=0.5)
    assert values["never"].influence == 0
    assert found.threshold is None


def test_best_plans_are_those_of_their_modules(study, schedule):
    run = study.report.run
    assert study.best == ADAPTIVE
    assert run(ADAPTIVE).value == pytest.approx(solve_schedule(schedule).value)
    assert run(WITHIN).value == pytest.approx(solve_with_budget(schedule, 30.0).value)
    assert run(WITHIN, "budget").changed == 0
    assert run(WITHIN).value >= run(ADAPTIVE, "budget").value - 1e-9
    assert run(IN_EXPECTATION).cost <= 20 + 1e-9
    assert run(IN_EXPECTATION).value == pytest.approx(study.frontier.value_at(20.0))
    assert {MEAN_PLAN, LS_POMDP, "always", "never", "myopic", "reactive"} <= set(study.report.policies)
    for name in study.report.policies:
        assert run(name, "budget").most_cost <= 30
        assert run(name, ALL).most_cost <= 30
        # Nothing beats the frontier at its own expected cost.
        for guards in (NONE, ALL):
            assert run(name, guards).value <= study.frontier.value_at(run(name, guards).cost) + 1e-9


def test_the_policy_for_the_robot(study, schedule):
    robot = study.guarded
    assert robot.policy.name == IN_EXPECTATION
    assert [g.name for g in robot.safeguards] == ["influence", "confidence", "budget"]
    assert fallback_actions(robot.fallback) == {"human_needs_help": "no_help", "robot_needs_help": "no_signal"}
    again = policy_from_dict(json.loads(json.dumps(policy_to_dict(robot))))
    assert evaluate_schedule(again, schedule).value == pytest.approx(study.report.run(IN_EXPECTATION, ALL).value)
    alone = safeguard_study(schedule, Wanted(budget=30.0)).guarded
    assert alone.policy.name == WITHIN
    assert safeguard_study(schedule, Wanted(tolerance=1.0)).guarded.policy.name == ADAPTIVE


def test_words(study):
    said = " ".join(study.sentences)
    for words in (
        "Bayes-adaptive plan moves a person", "most influenced are people who start as",
        "Within a budget of 30 the best plan is worth", "With an expected cost of at most 20 the best value is",
        "under the safeguard influence", "under the safeguard confidence",
    ):  # fmt: skip
        assert words in said


def test_fields_are_plain(study):
    fields = plain(study_fields(study))
    json.dumps(fields, allow_nan=False)
    assert fields["policies"] == list(study.report.policies)
    assert [s["name"] for s in fields["safeguards"]] == ["budget", "expected_cost", "influence", "confidence"]
    assert fields["curve"][0]["highest_price"] is None
    costs, values = ([row[key] for row in fields["curve"]] for key in ("cost", "value"))
    slopes = np.diff(values) / np.diff(costs)
    assert np.all(np.diff(slopes) < 1e-9), "the curve is concave"
    assert fields["curve"][0]["cost"] == 0
    assert fields["budgets"][0]["budget"] == 0
    assert len(fields["influence"]) == len(study.report.runs)
    assert {"everybody", "starts as", "first response"} == {row["by"] for row in fields["who"]}
    assert [s["safeguard"] for s in fields["steps"]] == ["influence", "confidence"]


def test_counting_actions(schedule):
    found = safeguard_study(schedule, Wanted(budget=1.0, count=True))
    assert found.report.run(ADAPTIVE, "budget").most_cost == 1
    assert found.budgets.value_at(1.0) == pytest.approx(found.report.run(WITHIN).value)


def test_nothing_asked_for_is_a_little_of_everything(schedule):
    found = safeguard_study(schedule)
    assert [g.name for g in found.guarded.safeguards] == ["influence", "confidence", "budget"]
    calls = []
    safeguard_study(schedule, progress=lambda *told: calls.append(told))
    assert calls[0] == ("safeguards", 0, 4)
    assert calls[-1] == ("safeguards", 4, 4)


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        (Wanted(budget=-1.0), "budget"),
        (Wanted(expected_cost=-1.0), "--expected-cost: found -1.0"),
        (Wanted(confidence=1.5), "confidence, threshold"),
        (Wanted(budget=1.0, fallback={"human_needs_help": "help"}), "wanted free actions"),
        (Wanted(fallback={"nowhere": "help"}), "mode: found 'nowhere'"),
    ],
)
def test_refusals(schedule, wanted, words):
    with pytest.raises(InputError) as caught:
        safeguard_study(schedule, wanted)
    assert words in str(caught.value)


def test_figures(study):
    curve = value_and_cost(study.frontier, study.budgets, study.report, study.drawn)
    line = curve.lines[0].get_xydata()
    assert line[: len(study.frontier.points), 0] == pytest.approx([p.cost for p in study.frontier.points])
    marks = next(x for x in curve.lines if x.get_marker() == "s")
    assert marks.get_ydata()[-1] == pytest.approx(study.report.run(ADAPTIVE).value)
    steps = stricter([study.tolerance, study.threshold])
    assert len(steps.axes) == 4
    lost = steps.axes[0].lines[0].get_ydata()
    assert lost[0] == 0
    assert lost[-1] == pytest.approx(study.tolerance.values[0] - study.tolerance.values[-1])
    who = who_is_influenced(study.report, study.drawn, (NONE, ALL))
    assert len(who.axes) == len(study.drawn)
    labels = [t.get_text() for t in who.axes[0].get_yticklabels()]
    assert labels[0] == "everybody"
    assert "first response help" in labels
    for drawn in (curve, steps, who):
        assert to_svg(drawn).startswith("<svg")
