"""The command ``plan``: its JSON, words and refusals."""

import json

import numpy as np
import pytest

from models.model_files import write_model
from models.planning.policy_files import read_policy
from tests.analysis.command import result_of, run
from tests.models.planning.policy_cases import person


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.json"
    write_model(person(), path)
    return path


def test_study_two(shared, capsys):
    found = result_of(capsys, "plan", shared / "data" / "calibrated_truth.json", "--schedule", "HRHRHRHRH")
    digits = {name: f"{p['value']:.1f} {p['help_rate']:.3f} {p['costly_actions']:.1f}" for name, p in
              found["policies"].items()}  # fmt: skip
    assert digits["always"] == "153.1 0.917 9.0"
    assert digits["never"] == digits["myopic"] == "162.6 0.637 0.0"
    assert digits["reactive"] == "198.5 0.838 4.0"
    assert digits["optimal"] == "219.4 0.868 3.0"
    assert found["value"] == pytest.approx(found["policies"]["optimal"]["value"], rel=1e-12)
    assert found["first_action"] == "no_signal"
    assert found["discount"] == 1
    assert found["schedule"] == "HRHRHRHRH"
    assert found["seconds"] < 5
    assert found["compile_seconds"] >= 0


def test_exact_plan_in_words(model, capsys):
    assert run("plan", model, "--schedule", "RHR", "--discount", "0.9") == 0
    text = capsys.readouterr().out
    for word in (
        "best plan for RHR",
        "discount 0.9",
        "reactive",
        "less this once",
        "r = 0.06; costs: help 15, signal 15",
    ):
        assert word in text
    assert run("plan", model, "--quiet") == 0
    assert capsys.readouterr().out == ""


def test_options_change_the_reward(model, capsys):
    plain = result_of(capsys, "plan", model, "--schedule", "RH")
    cheap = result_of(
        capsys, "plan", model, "--schedule", "RH", "--cost-help", "1", "--cost", "signal=2", "--r", ".05"
    )
    assert cheap["reward"] == {"r": 0.05, "x": plain["reward"]["x"], "costs": {
        "no_help": 0, "help": 1, "no_signal": 0, "signal": 2}}  # fmt: skip
    assert cheap["policies"]["always"]["cost"] == 3
    assert plain["policies"]["always"]["cost"] == 30


def test_without_horizon(model, tmp_path, capsys):
    out = tmp_path / "policy.json"
    found = result_of(
        capsys, "plan", model, "--infinite", "--start-mode", "H", "--discount", "0.9", "--policy", out
    )
    assert found["status"] == "converged"
    assert found["lower"] <= found["upper"]
    assert found["relative_gap"] <= 1e-3
    assert set(found["action_by_mode"]) == {"human_needs_help", "robot_needs_help"}
    assert {"gap", "seconds", "compile_seconds", "alpha_vectors", "beliefs"} <= set(found)
    for name in ("always", "never", "reactive", "random", "myopic"):
        row = found["policies"][name]
        assert row["low"] <= row["value"] <= row["high"]
        assert row["low"] <= found["upper"] + 1e-6
    policy = read_policy(out)
    for mode, action in found["action_by_mode"].items():
        assert policy.action(person().initial, mode) == action


def test_mode_process(model, capsys):
    found = result_of(capsys, "plan", model, "--infinite", "--mode-process", "bernoulli:0.3", "--discount", ".8")
    assert "probability 0.3" in found["mode_process"]
    assert found["discount"] == 0.8


def test_a_policy_that_would_be_simulated_too_long_is_left_out(model, capsys):
    found = result_of(capsys, "plan", model, "--infinite", "--discount", ".999", "--precision", ".1")
    assert found["policies"]["myopic"] == {"value": None, "low": None, "high": None}
    assert found["policies"]["never"]["value"] < found["upper"]
    assert run("plan", model, "--infinite", "--discount", ".999", "--precision", ".1") == 0
    assert "myopic would have to be simulated, which takes too long" in capsys.readouterr().out
    assert run("plan", model, "--infinite", "--seed", "3") == 0
    assert "myopic is simulated (seed 3)" in capsys.readouterr().out


def test_a_long_schedule_is_announced(model, capsys, monkeypatch):
    monkeypatch.setattr("analysis.cli_plan.MANY_RESPONSES", 3)
    assert run("plan", model, "--schedule", "HRH", "--json", "-") == 0
    shown = capsys.readouterr()
    assert "following 4 sequences of responses takes a while" in shown.err
    assert json.loads(shown.out)["schedule"] == "HRH"
    assert run("plan", model, "--schedule", "HRH", "--quiet") == 0
    assert capsys.readouterr().err == ""


def test_plan_can_be_run_from_its_file(model, tmp_path, capsys):
    out = tmp_path / "plan.json"
    found = result_of(capsys, "plan", model, "--schedule", "HRH", "--policy", out)
    policy = read_policy(out)
    memory = policy.begin(1)
    assert policy.vocabulary.actions[1][policy.act(memory)] == found["first_action"]
    assert np.allclose(list(policy.why().values.values()), list(found["first_action_values"].values()))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--schedule", "HRQ"), "letter 3: found 'Q', wanted one of R, H"),
        (("--schedule", "H", "--infinite"), "--infinite: found --schedule H beside it"),
        (("--start-mode", "H"), "--start-mode: found 'H', wanted no value: it belongs to --infinite"),
        (("--infinite", "--start-mode", "Q"), "first mode: found 'Q'"),
        (("--infinite", "--mode-process", "sometimes"), "--mode-process: found 'sometimes'"),
        (("--infinite", "--mode-process", "bernoulli:2"), "probability: found 2.0"),
        (("--infinite", "--mode-process", "bernoulli:x"), "--mode-process: found 'bernoulli:x'"),
        (("--infinite", "--discount", "1"), "discount: found 1.0, wanted below 1"),
        (("--infinite", "--time-limit", "0"), "time limit: found 0.0"),
        (("--discount", "1.5"), "discount: found 1.5, wanted a number from 0 to 1"),
        (("--cost", "dance=3"), "cost of dance: found action dance, wanted one of no_help, help"),
        (("--cost", "help"), "--cost: found 'help', wanted ACTION=X"),
        (("--cost", "help=a"), "--cost: found 'help=a'"),
        (("--cost", "help=1", "--cost", "help=2"), "wanted the cost of help once"),
        (("--cost", "help=1", "--cost-help", "2"), "wanted the cost of help once"),
        (("--schedule", ""), "schedule: found '', wanted letters from"),
        (("--cost-help", "inf"), "cost of help: found inf"),
        (("--r", "nan"), "--r: found nan"),
        (("--r", "50"), "--r: found 50.0, wanted a steepness at which exp(r x) is a finite number"),
    ],
)
def test_refusals(model, capsys, options, words):
    assert run("plan", model, *options) == 2
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error


def test_files_that_are_not_models(tmp_path, model, capsys):
    assert run("plan", tmp_path / "none.json") == 2
    assert "no such file" in capsys.readouterr().err
    assert run("plan", model, "--policy", model) == 2
    assert "wanted another file" in capsys.readouterr().err
    assert run("plan", model, "--policy", tmp_path) == 2
    assert "found a folder" in capsys.readouterr().err


def test_another_first_round_than_the_studys_is_said(model, capsys):
    """The two commands side by side plan for different first rounds unless one says otherwise."""
    hint = "HRHRHRHRH, planned for without --infinite, starts with robot_needs_help (--start-mode H)"
    for options, said in (((), True), (("--start-mode", "H"), False), (("--start-mode", "R"), False)):
        assert run("plan", model, "--infinite", "--discount", "0.5", *options) == 0
        assert (hint in capsys.readouterr().out) == said
    assert run("plan", model, "--infinite", "--discount", "0.5", "--mode-process", "bernoulli:0.3") == 0
    assert hint not in capsys.readouterr().out
