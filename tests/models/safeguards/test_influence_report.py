"""The influence report: exact sums against enumeration, other walks, and settings tried directly."""

from html import unescape
from itertools import product

import numpy as np
import pytest

from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning.evaluation import evaluate_schedule
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.safeguards import guarded_run as module
from models.safeguards.budget import CostBudget
from models.safeguards.confidence import Confidence
from models.safeguards.consent import fallback_of
from models.safeguards.guarded import Guarded
from models.safeguards.guarded_run import guarded_run
from models.safeguards.influence import MinimumInfluence
from models.safeguards.influence_report import ALL, NONE, Watched, influence_report
from models.safeguards.schedule_worth import ScheduleWorth
from models.safeguards.steps import threshold_steps, tolerance_steps
from tests.models.safeguards.guard_cases import all_guards, doubt, guarded, policy, rounds

POLICIES = ("always", "reactive", "random", "vectors", "tracked")


@pytest.mark.parametrize("kind", POLICIES)
@pytest.mark.parametrize("with_guards", [False, True])
def test_values_are_those_of_the_evaluation(kind, with_guards):
    s = Schedule.of(doubt(), "HRHRH", 0.8, terminal=[0.0, 3.0, 9.0])
    own = guarded(kind) if with_guards else policy(kind)
    found, known = guarded_run(own, s), evaluate_schedule(own, s)
    assert found.value == pytest.approx(known.value)
    assert found.values == pytest.approx(known.values)
    assert found.cost == pytest.approx(known.cost)
    assert found.help_rate == pytest.approx(known.help_rate)
    assert found.influences @ found.weight == pytest.approx(found.influence)


def enumerated(own, s: Schedule, d):
    """All paths of states, actions and responses in one draw: influence by start and first response, most spent."""
    model = s.draws.model(d)
    by_start, by_response = np.zeros(s.n_states), np.zeros(2)
    chance_of_response, most = np.zeros(2), 0.0
    left = [(0, own.begin(s.modes[0]), i, i, model.initial[i], 0.0, 0.0, -1) for i in range(s.n_states)]
    while left:
        k, memory, start, state, chance, moved, spent, first = left.pop()
        if k == s.n_events:
            by_start[start] += chance * moved
            if first >= 0:
                by_response[first] += chance * moved
                chance_of_response[first] += chance
            most = max(most, spent)
            continue
        for c, p in enumerate(own.probabilities(memory)):
            if p <= 0:
                continue
            a = s.first_action(k) + c
            null = s.protocol.action(s.mode(k).null_action)
            push = 0.5 * np.abs(model.transition[a, state] - model.transition[null, state]).sum()
            row = s.protocol.emission_index[a]
            for o in range(s.n_outcomes(k)):
                told = 1.0 if row < 0 else model.emission[row, state, o]
                seen = 0 if row < 0 else o + 1
                after = own.observe(memory, c, seen, s.modes[k + 1]) if k + 1 < s.n_events else None
                response = o if first < 0 and row >= 0 else first
                left += [
                    (k + 1, after, start, y, chance * p * told * model.transition[a, state, y], moved + push,
                     spent + s.costs[a], response)
                    for y in range(s.n_states)
                ]  # fmt: skip
    return by_start / model.initial, by_response / chance_of_response, most


@pytest.mark.parametrize("kind", ["always", "reactive", "random", "vectors"])
@pytest.mark.parametrize("letters", ["HRH", "RRHR"])
def test_who_is_influenced_is_enumeration(kind, letters):
    s = rounds(letters, 2)
    own = guarded(kind, all_guards(s, budget=15.0, threshold=0.4), letters, 2)
    found = guarded_run(own, s)
    most = 0.0
    for d in range(2):
        by_start, by_response, spent = enumerated(own, s, d)
        assert found.by_state[d] == pytest.approx(by_start)
        assert found.by_response[d] == pytest.approx(by_response)
        assert found.influences[d] == pytest.approx(s.draws.initial[d] @ by_start)
        most = max(most, spent)
    assert found.most_cost == pytest.approx(most)


def test_changes_are_counted():
    s = rounds("HRHR")
    own = Guarded(policy("always"), [CostBudget.of(PUBLISHED, 30)], fallback_of(PUBLISHED))
    found = guarded_run(own, s)
    assert (found.changed, found.withheld, found.changed_by) == (0.5, 0.5, {"budget": 0.5})
    assert (found.cost, found.most_cost) == (pytest.approx(30), 30)
    counted = guarded_run(own, s, charges=[0, 1, 0, 1])
    assert (counted.cost, counted.most_cost) == (pytest.approx(2), 2)
    half = guarded_run(Guarded(policy("random"), [CostBudget.of(PUBLISHED, 0)], fallback_of(PUBLISHED)), s)
    assert (half.changed, half.withheld, half.cost) == (pytest.approx(0.5), pytest.approx(1.0), 0)
    quiet = guarded_run(Guarded(policy("never"), [CostBudget.of(PUBLISHED, 0)], fallback_of(PUBLISHED)), s)
    assert (quiet.changed, quiet.withheld) == (0, 0)


def test_states_in_which_nobody_starts():
    from models.lspomdp import LatentStatePOMDP

    like = doubt(1).model(0)
    model = LatentStatePOMDP([0.0, 0.4, 0.6], like.transition, like.emission)
    found = guarded_run(policy("always"), Schedule.of(model, "HRH"))
    assert np.isnan(found.by_state[0, 0])
    assert np.isfinite(found.by_state[0, 1:]).all()


def test_too_many_histories(monkeypatch):
    monkeypatch.setattr(module, "MOST_DECISIONS", 5)
    with pytest.raises(InputError, match="more than 5 decisions"):
        guarded_run(policy("random"), rounds("HRHRH"))


# -- the report ----------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def report():
    s = rounds()
    budget, influence, sure = all_guards(s, budget=30.0, tolerance=5.0, threshold=0.8)
    sets = {"budget": [budget], "influence": [influence], "confidence": [sure], ALL: [budget, influence, sure]}
    watched = [Watched(policy("vectors"))]
    watched += [Watched(policy(k), ScheduleWorth(policy(k), s)) for k in ("always", "reactive", "never")]
    return influence_report(watched, sets, fallback_of(PUBLISHED), s)


def test_report(report):
    table = report.table
    assert len(table) == 4 * 5
    assert report.policies == ("exact plan by belief", "always", "reactive", "never")
    for name, guards in product(report.policies, table["safeguards"].unique()):
        run = report.run(name, guards)
        row = table[(table["policy"] == name) & (table["safeguards"] == guards)].iloc[0]
        assert row["lost"] == pytest.approx(report.run(name).value - run.value)
        assert row["influence_low"] <= row["influence_high"]
        assert run.influence <= report.run(name).influence + 1e-9 or name == "reactive"
        if guards in ("budget", ALL):
            assert run.most_cost <= 30
    assert report.run("never").influence == 0
    who = report.who
    assert set(who["by"]) == {"everybody", "starts as", "first response"}
    assert (who["low"] <= who["high"]).all()
    most = report.most_influenced("always")
    own = who[(who["policy"] == "always") & (who["safeguards"] == NONE) & (who["by"] == "starts as")]
    assert most["influence"] == own["influence"].max()
    assert most["who"] in report.sentence or report.policies[0] != "always"
    assert "all safeguards together change" in report.sentence
    html = report._repr_html_()
    assert html.startswith("<div")
    assert report.sentence in unescape(html)
    assert "<table" in html
    assert report.to_dict()["runs"][0]["policy"] == "exact plan by belief"


# -- stricter and stricter -----------------------------------------------------------------------------------------
def test_tolerance_steps_are_all_there_are():
    s, own = rounds("HRHRH"), policy("vectors")
    steps = tolerance_steps(Watched(own), fallback_of(PUBLISHED), s)
    assert steps.complete
    assert steps.levels[0] == 0
    assert np.all(np.diff(steps.levels) > 0)
    assert steps.influences[-1] == 0
    rng = np.random.default_rng(1)
    for level in [*rng.uniform(0, steps.levels[-1] * 1.2, 25), *steps.levels]:
        guard = Guarded(own, [MinimumInfluence.of(s.draws, float(level))], fallback_of(PUBLISHED))
        i = int(np.searchsorted(steps.levels, level, side="right")) - 1
        assert evaluate_schedule(guard, s).value == pytest.approx(steps.values[i], abs=1e-9)
    assert "halves its influence" in steps.sentence
    assert list(steps.table["lost"]) == pytest.approx(list(steps.values[0] - steps.values))


def test_threshold_steps_are_all_there_are():
    s, own = rounds("HRHRH"), policy("always")
    watched = Watched(own, ScheduleWorth(own, s))
    steps = threshold_steps(watched, fallback_of(PUBLISHED), s, 2.0)
    assert steps.complete
    assert len(steps.levels) > 1
    for level in np.linspace(0, 0.99, 34):
        guard = Guarded(own, [Confidence.of(PUBLISHED, float(level), 2.0)], fallback_of(PUBLISHED), watched.worth)
        i = int(np.searchsorted(steps.levels, level, side="right")) - 1
        assert evaluate_schedule(guard, s).value == pytest.approx(steps.values[i], abs=1e-9)


def test_one_draw_has_points_for_intervals():
    s = Schedule.of(ModelDraws.from_models([doubt().model(0)]), "HRH")
    found = influence_report([Watched(policy("always"))], {}, fallback_of(PUBLISHED), s)
    row = found.rows()[0]
    assert row["influence_low"] == row["influence_high"] == pytest.approx(row["influence"])
    assert found.sentence.endswith(").")
