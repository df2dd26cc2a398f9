"""The command ``safeguard``: JSON, words, files, refusals."""

from contextlib import suppress

import pytest

from analysis import cli_safeguard
from analysis.safeguard_study import Wanted, safeguard_study
from models.errors import InputError
from models.model_draws import ModelDraws
from models.model_files import write_model
from models.planning.evaluation import evaluate_schedule
from models.planning.policy_files import read_policy
from models.planning.schedule import Schedule
from models.safeguards.guarded import Guarded
from tests.analysis import command
from tests.analysis.draws_cases import failed, fit_file, json_file, people


@pytest.fixture
def fit(tmp_path):
    return fit_file(tmp_path / "fit.nc", people(6, 3, seed=2))


def test_numbers_are_those_of_the_study(fit, capsys):
    found = command.result_of(
        capsys, "safeguard", fit, "--schedule", "HRHR", "--budget", 15, "--tolerance", 2, "--confidence", 0.6
    )
    schedule = Schedule.of(ModelDraws.from_models(people(6, 3, seed=2)), "HRHR")
    study = safeguard_study(schedule, Wanted(15.0, None, 2.0, 0.6))
    assert found["policies"] == list(study.report.policies)
    for row, wanted in zip(found["influence"], study.report.rows(), strict=True):
        assert row["value"] == pytest.approx(wanted["value"])
        assert row["influence"] == pytest.approx(wanted["influence"])
    assert [r["value"] for r in found["curve"]] == pytest.approx([p.value for p in study.frontier.points])
    assert found["budgets"][1]["value"] == pytest.approx(study.budgets.value_at(15.0))
    assert {"policies", "safeguards", "curve", "budgets", "influence", "who", "steps", "seconds"} <= set(found)


def test_words_and_policy_file(fit, tmp_path, capsys):
    path = tmp_path / "guarded.json"
    status, out, err = command.run_captured(
        capsys, "safeguard", fit, "--schedule", "HRH", "--budget", 15, "--policy", path, "--fallback",
        "human_needs_help=no_help",
    )  # fmt: skip
    assert status == 0, err
    for words in ("moves a person", "Changed: share of the decisions", "under a hard budget", str(path)):
        assert words in out
    robot = read_policy(path)
    assert isinstance(robot, Guarded)
    schedule = Schedule.of(ModelDraws.from_models(people(6, 3, seed=2)), "HRH")
    assert evaluate_schedule(robot, schedule).cost <= 15


def test_a_policy_from_a_fit_that_failed_its_gate_says_so_in_its_file(tmp_path, capsys):
    bad, path = fit_file(tmp_path / "bad.nc", people(6), gate=failed()), tmp_path / "guarded.json"
    words = ("safeguard", bad, "--schedule", "HR", "--budget", 15, "--policy", path)
    status, out, err = command.run_captured(capsys, *words, "--force")
    assert status == 0, err
    robot = read_policy(path)
    assert robot.cautions == ("the posterior failed its convergence gate",)
    assert robot.cautions[0] in out


def test_a_model_file_and_counted_actions(tmp_path, capsys):
    write_model(people(1, 3, seed=4)[0], tmp_path / "model.json")
    found = command.result_of(
        capsys, "safeguard", tmp_path / "model.json", "--schedule", "HRH", "--budget", 1, "--count",
        "--expected-cost", 0.5,
    )  # fmt: skip
    assert found["policies"][0] == "optimal plan"
    assert found["charges"] == {"no_help": 0, "help": 1, "no_signal": 0, "signal": 1}
    assert all(r["most_cost"] <= 1 for r in found["influence"] if r["safeguards"] == "budget")
    json_file(tmp_path / "list.json", people(3, 3), [0.5, 0.25, 0.25])
    found = command.result_of(capsys, "safeguard", tmp_path / "list.json", "--schedule", "HR")
    assert [s["name"] for s in found["safeguards"]] == ["budget", "influence", "confidence"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--budget", "-1"), "--budget: found -1.0, wanted a number of at least 0"),
        (("--expected-cost", "nan"), "--expected-cost: found nan"),
        (("--tolerance", "inf"), "--tolerance: found inf"),
        (("--confidence", "1"), "--confidence: found 1.0, wanted a probability from 0 to below 1"),
        (("--confidence", ".5", "--margin", "-1"), "--margin: found -1.0, wanted a number of at least 0"),
        (("--budget", "30", "--margin", "2"), "--margin: found 2.0, wanted --confidence with it"),
        (("--fallback", "help"), "--fallback: found 'help', wanted MODE=ACTION"),
        (("--fallback", "human_needs_help=wave"), "action in mode human_needs_help: found 'wave'"),
        (("--budget", "15", "--fallback", "human_needs_help=help"), "wanted free actions"),
        (("--schedule", "HX"), "X"),
        (("--policy", ""), "--policy: found ''"),
    ],
)
def test_refusals(fit, capsys, options, words):
    status, _, err = command.run_captured(capsys, "safeguard", fit, "--schedule", "HR", *options)
    assert status == 2
    assert words in err


def test_modes_of_fallbacks_may_be_letters(fit, capsys):
    options = ("safeguard", fit, "--schedule", "HR", "--tolerance", 1, "--fallback")
    found = command.result_of(capsys, *options, "R=help", "--fallback", "robot_needs_help=signal")
    assert found["fallback"] == {"human_needs_help": "help", "robot_needs_help": "signal"}
    status, _, err = command.run_captured(capsys, *options, "R=help", "--fallback", "human_needs_help=no_help")
    assert status == 2
    assert "the action of human_needs_help once" in err


def test_both_limits_on_spending(fit, capsys):
    """The robot's policy keeps the expected cost by itself and the budget by the safeguard; that is said."""
    options = ("safeguard", fit, "--schedule", "HRHR", "--budget", 15, "--expected-cost", 10)
    found = command.result_of(capsys, *options)
    assert sum("the budget of 15 stops it and is not planned for" in s for s in found["sentences"]) == 1
    found = command.result_of(capsys, *options[:6])
    assert not any("not planned for" in s for s in found["sentences"])


def test_charges_of_many_digits(tmp_path, capsys):
    """No plan within a budget is worth less than one that a safeguard stops there, none more than the best."""
    write_model(people(1, 3, seed=4)[0], tmp_path / "model.json")
    options = ("--cost-help", "0.3333333333333333", "--cost-signal", 0.1, "--budget", 2.6)
    found = command.result_of(capsys, "safeguard", tmp_path / "model.json", "--schedule", "HRHRHR", *options)
    best = next(r["value"] for r in found["influence"] if r["safeguards"] == "none")
    assert found["budgets"][-1]["value"] == pytest.approx(best)
    assert found["curve"][-1]["value"] == pytest.approx(best)
    assert found["budgets"][-1]["budget"] == pytest.approx(1.3)
    assert any("no less." in s for s in found["sentences"])


def test_the_policy_is_written_before_anything_is_said(fit, tmp_path, capsys, monkeypatch):
    """Whoever reads the first lines only, as `head` does, ends the command."""

    def broken(*_, **__):
        raise BrokenPipeError

    monkeypatch.setattr("analysis.cli_options.Report.say", broken)
    with suppress(BaseException):
        command.run_captured(
            capsys, "safeguard", fit, "--schedule", "HR", "--budget", 15, "--policy", tmp_path / "guarded.json"
        )
    assert isinstance(read_policy(tmp_path / "guarded.json"), Guarded)


def test_fallbacks_twice():
    with pytest.raises(InputError, match="the action of m once"):
        cli_safeguard.fallbacks(["m=a", "m=b"])
