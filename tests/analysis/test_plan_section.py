"""The report's section on what the robot should do: numbers against the planner, words, what is left out."""

import numpy as np
import pytest

from analysis import datasets
from analysis.policy_study import STUDY2
from analysis.report.build import build_report
from analysis.report.registry import SECTIONS
from analysis.report.section import Origin
from analysis.simulate import calibrated_truth, simulate_study1
from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from tests.analysis.report_cases import CORRIDOR, data_set, little_effort, random_log

ONLY = [e for e in SECTIONS if e.key == "plan"]


@pytest.fixture(scope="module", autouse=True)
def little():
    with pytest.MonkeyPatch.context() as patch:
        little_effort(patch)
        yield


def section(log, out, states, **card):
    study = data_set(log, kind="simulated", **card)
    made = build_report(study, states=states, quick=True, out=out, sections=ONLY, date="2026-01-31")
    return made, made.sections[0]


@pytest.fixture(scope="module")
def silent(tmp_path_factory):
    """A study in which nobody signals."""
    log = simulate_study1(participants=80, seed=3)
    quiet = [c for c in log.conditions if "no-signal" in c]
    return section(log.select(conditions=quiet), tmp_path_factory.mktemp("silent"), (2,))


@pytest.fixture(scope="module")
def bundled(tmp_path_factory):
    out = tmp_path_factory.mktemp("bundled")
    made = build_report(datasets.load("simulated_study1"), states=(2,), quick=True, out=out, sections=ONLY)
    return made, made.sections[0]


def table(shown, start):
    return next(t for t in shown.tables if t.key.startswith(start))


def test_actions_without_evidence_are_left_out_and_named(silent):
    _, shown = silent
    said = " ".join(shown.sentences)
    assert "Left out: signal." in said
    for t in shown.tables:
        assert "signal" not in set(t.frame.iloc[:, 0])
    for f in shown.figures:
        # The action map and the graph know nothing of it either.
        assert " signal" not in " ".join(f.alt).replace("no signal", "")


def test_numbers_are_those_of_the_planner(bundled):
    made, shown = bundled
    model = made.study.fits[2].model
    values = table(shown, "plan-values").frame.set_index("policy")
    exact = solve_schedule(Schedule.of(model, STUDY2))
    assert values.loc["best plan", "value"] == pytest.approx(exact.value)
    truth = solve_schedule(Schedule.of(calibrated_truth(), STUDY2))
    assert values.loc["best plan, were the truth known", "t_value"] == pytest.approx(truth.value)
    assert values.loc["never", "t_value"] == pytest.approx(162.609, abs=1e-3)
    assert values["t_value"].max() == pytest.approx(truth.value)
    assert np.isnan(values.loc["best plan, were the truth known", "value"])
    rounds = table(shown, "plan-rounds").frame.set_index("action")
    assert rounds.sum(axis=None) == pytest.approx(values.loc["best plan", "costly"])
    assert list(rounds.columns) == [f"{k + 1} {letter}" for k, letter in enumerate(STUDY2)]
    assert rounds.loc["help", "1 H"] != rounds.loc["help", "1 H"]


def test_the_certificate_is_printed(bundled):
    _, shown = bundled
    said = " ".join(shown.sentences)
    for word in ("at least", "what no policy exceeds", "status: converged", "In the truth"):
        assert word in said
    endless = table(shown, "plan-endless").frame.set_index("policy")
    assert endless.loc["the policy found", "low"] <= endless.loc["the policy found", "high"]
    assert (endless["low"] <= endless.loc["the policy found", "high"] + 1e-6).all()
    assert endless.loc["myopic", "known"].startswith("simulated")


def test_the_truth_is_told_from_what_was_learned(bundled, silent):
    values = table(bundled[1], "plan-values")
    assert set(values.origin) == {Origin.SIMULATED, Origin.DEFINITION}
    assert ("in the truth behind the simulation", 3) in values.groups
    assert "t_value" not in table(silent[1], "plan-values").frame
    assert "truth" not in " ".join(silent[1].sentences)


def test_scores_that_were_not_printed_are_called_an_assumption(bundled):
    reward = next(f for f in bundled[1].figures if f.key == "plan-reward-2")
    assert "45 to 67: an assumption" in reward.caption


def test_one_state_needs_no_plan(tmp_path):
    _, shown = section(simulate_study1(participants=40), tmp_path, (1,))
    assert shown.blocks == ()
    assert "nothing the robot does changes anybody" in shown.omitted


def test_nothing_is_known_about_leaving_people_alone(tmp_path):
    log = simulate_study1(participants=80, seed=3)
    always = [c for c in log.conditions if c.startswith("help")]
    _, shown = section(log.select(conditions=always), tmp_path, (2,))
    assert shown.blocks == ()
    assert shown.omitted == "the data say nothing about no help, with which everything else is compared"


def test_a_control_arm_alone_leaves_nothing_to_decide(tmp_path):
    """Nobody was helped or signalled to: a baseline study, or the control arm of one."""
    planning = [e for e in SECTIONS if e.key in ("plan", "robust", "sensitivity", "safeguards")]
    log = simulate_study1(participants=80, seed=3).select(conditions=["no-help+no-signal"])
    made = build_report(data_set(log, kind="simulated"), states=(2,), quick=True, out=tmp_path, sections=planning)
    wanted = "the data say nothing about help or signal, so there is nothing to decide"
    for shown in made.sections[:-1]:  # the last is the appendix
        assert shown.omitted == wanted, shown.key
        assert shown.blocks == (), f"{shown.key} introduces what is not there"


def test_another_protocol_has_no_reward(tmp_path):
    study = data_set(random_log(CORRIDOR, people=30))
    made = build_report(study, states=(2,), quick=True, out=tmp_path, sections=ONLY)
    assert "protocol 'corridor'" in made.sections[0].omitted
