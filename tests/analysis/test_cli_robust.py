"""The command ``robust`` and how further studies are written: JSON, words, files, refusals."""

import numpy as np
import pytest

from analysis.next_studies import next_studies, published_studies
from models.errors import InputError
from models.model_draws import ModelDraws
from models.model_files import write_model
from models.planning.baselines import never
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.policy_files import read_policy
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.robust import single_plan
from models.robust.cautious import cautious_plan
from models.robust.own_plans import own_plans
from tests.analysis import command
from tests.analysis.command import run
from tests.analysis.draws_cases import failed, fit_file, json_file, people


def result_of(capsys, *arguments):
    return command.result_of(capsys, "robust", *arguments)


@pytest.fixture
def fit(tmp_path):
    return fit_file(tmp_path / "fit.nc", people(12, 3, seed=2))


def test_numbers_are_those_of_the_modules(fit, capsys):
    found = result_of(capsys, fit, "--schedule", "HRHR", "--criterion", "cvar", "--alpha", "0.25")
    schedule = Schedule.of(ModelDraws.from_models(people(12, 3, seed=2)), "HRHR")
    assert found["bayes_value"] == pytest.approx(solve_schedule(schedule).value)
    assert found["value"] == pytest.approx(cautious_plan(schedule, 0.25).lower)
    assert found["certified"]
    assert found["gap"] <= 1e-6
    own = own_plans(schedule)
    assert found["evpi"] == pytest.approx(own.mean - found["bayes_value"])
    assert found["optimal_values"]["mean"] == pytest.approx(own.mean)
    assert found["first_action_shares"] == pytest.approx(own.first_action_shares)
    assert not found["evppi_enough"]
    assert all(row["worth"] is None for name, row in found["evppi"].items())
    for key in ("plans", "evppi", "adaptivity", "mixture", "seconds", "compile_seconds"):
        assert key in found
    plan = found["plans"]["Bayes-adaptive"]
    assert {"mean", "cvar", "worst", "max_regret", "gain", "held_out"} <= set(plan)
    assert set(plan["gain"]) >= {"mean", "q05", "q95", "probability"}
    assert found["adaptivity"] == pytest.approx(found["bayes_value"] - found["plans"]["fixed sequence"]["mean"])


@pytest.mark.parametrize(("criterion", "alpha"), [("regret", 0.0), ("regret-cvar", 0.3)])
def test_regret_is_told_as_regret(fit, capsys, criterion, alpha):
    found = result_of(capsys, fit, "--schedule", "HRH", "--criterion", criterion, "--alpha", alpha or 0.1)
    schedule = Schedule.of(ModelDraws.from_models(people(12, 3, seed=2)), "HRH")
    wanted = cautious_plan(schedule, alpha, reference=own_plans(schedule).values)
    assert found["value"] == pytest.approx(-wanted.lower)
    assert found["value"] >= 0


def test_the_gain_over_never_helping_is_a_criterion(fit, capsys):
    found = result_of(capsys, fit, "--schedule", "HRH", "--criterion", "gain-cvar", "--alpha", 0.3)
    schedule = Schedule.of(ModelDraws.from_models(people(12, 3, seed=2)), "HRH")
    nothing = evaluate_schedule(never(PUBLISHED), schedule).values
    wanted = cautious_plan(schedule, 0.3, reference=nothing)
    assert found["value"] == pytest.approx(wanted.lower, abs=1e-9)
    assert found["value"] >= -1e-9  # never helping itself gains nothing
    plans = found["plans"]
    assert plans["cautious gain"]["gain"]["cvar"] == pytest.approx(wanted.lower, abs=1e-9)
    assert max(p["gain"]["cvar"] for p in plans.values()) <= wanted.lower + 1e-9
    assert min(p["cvar_regret"] for p in plans.values()) >= plans["cautious regret"]["cvar_regret"] - 1e-9


def test_who_will_not_draw_lots(tmp_path, capsys):
    fit = fit_file(tmp_path / "fit.nc", people(12, 3, seed=2))
    options = (fit, "--schedule", "HRHR", "--criterion", "regret", "--cost-help", "6", "--cost-signal", "1")
    lots, single = (result_of(capsys, *options, *more) for more in ((), ("--no-lots",)))
    assert len(single["mixture"]) == 1
    assert single["value"] >= lots["value"] - 1e-9
    assert single["value"] == pytest.approx(lots["without_lots"]) == single["without_lots"]
    assert single["gap"] == pytest.approx(single["value"] - lots["value"], abs=1e-6)
    # All plans are looked at here: 2 ** (1 + 2 + 2 + 4).
    assert lots["without_lots_proven"]
    assert lots["without_lots_plans"] == 512
    alone = ("Bayes-adaptive", "posterior mean", "best fixed model", "most common plan", "fixed sequence", "never",
             "always", "myopic", "reactive")  # fmt: skip
    assert sum(name in single["plans"] for name in alone) == 9
    for name in alone:
        if name in single["plans"]:
            assert single["value"] <= single["plans"][name]["max_regret"] + 1e-9
    assert run("robust", *options, "--no-lots") == 0
    assert "without lots:" in capsys.readouterr().out
    assert run("robust", *options) == 0
    assert "The best single plan (--no-lots): " in capsys.readouterr().out


def test_the_best_plan_looked_at_is_not_called_the_best(fit, capsys, monkeypatch):
    monkeypatch.setattr(single_plan, "MOST_VALUES", 0)
    options = (fit, "--schedule", "HRHR", "--criterion", "regret", "--cost-help", "6", "--cost-signal", "1")
    assert run("robust", *options, "--no-lots") == 0
    out = capsys.readouterr().out
    assert "Largest regret over the draws, the best of " in out
    assert " single plans looked at: " in out
    assert "Best " not in out
    assert run("robust", *options) == 0
    assert " single plans looked at (--no-lots): " in capsys.readouterr().out


def test_blocks_of_a_list_of_models_are_worth_what_telling_them_apart_is(tmp_path, capsys):
    """Every block differs in every model, so any of them tells which model it is."""
    path = json_file(tmp_path / "models.json", people(3, 2, seed=7), [0.5, 0.3, 0.2])
    options = (path, "--schedule", "HRHR", "--cost-help", "4", "--cost-signal", "1")
    found = result_of(capsys, *options)
    assert found["evppi_enough"]
    assert found["evpi"] > 0.01
    for row in found["evppi"].values():
        assert row["worth"] == pytest.approx(found["evpi"], abs=1e-9)
        assert row["se"] is None
    assert run("robust", *options) == 0
    assert "by itself be worth as much as perfect knowledge" in capsys.readouterr().out


def test_what_is_nothing_is_told_as_zero(fit, capsys):
    options = (fit, "--schedule", "HRH", "--criterion", "gain-cvar", "--cost-help", "1e4", "--cost-signal", "1e4")
    assert result_of(capsys, *options)["value"] == 0
    assert run("robust", *options) == 0
    assert "Best mean gain over never helping of the worst 10% of the draws: 0 " in capsys.readouterr().out


def test_every_decision_along_the_histories_is_told(fit, capsys):
    found = result_of(capsys, fit, "--schedule", "HRHR")["stability"]
    assert [row["event"] for row in found] == [1, 2, 2, 3, 3, 4, 4, 4, 4]
    for row in found:
        assert sum(row["shares"].values()) == pytest.approx(1)
        assert min(row["losses"].values()) >= -1e-9
    assert run("robust", fit, "--schedule", "HRHR") == 0
    out = capsys.readouterr().out
    assert "at each draw's own belief" in out
    assert "Where it acts, by the responses before:" in out


def test_the_chosen_plan_can_be_run(fit, tmp_path, capsys):
    out = tmp_path / "plan.json"
    found = result_of(capsys, fit, "--schedule", "HRHR", "--criterion", "regret", "--policy", out)
    policy = read_policy(out)
    schedule = Schedule.of(ModelDraws.from_models(people(12, 3, seed=2)), "HRHR")
    values = evaluate_schedule(policy, schedule).values
    assert (own_plans(schedule).values - values).max() == pytest.approx(found["value"], abs=1e-9)


def test_studies_frontier_and_estimate(fit, tmp_path, capsys):
    estimate = tmp_path / "estimate.json"
    write_model(people(1, 2, seed=9)[0], estimate)
    found = result_of(
        capsys, fit, "--schedule", "HRH", "--frontier", "--plug-in", estimate, "--evsi", "help+signal:HRHRH:5,10",
        "--evsi", "random:RH:4", "--served", "100", "--participant-cost", "0.5",
    )  # fmt: skip
    assert [(r["study"], r["participants"]) for r in found["evsi"]] == [
        ("help+signal over HRHRH", 5), ("help+signal over HRHRH", 10), ("random actions over RH", 4)
    ]  # fmt: skip
    for row in found["evsi"]:
        assert 0 <= row["worth"] <= found["evpi"] + 1e-9
        assert row["net"] == pytest.approx(100 * row["worth"] - 0.5 * row["participants"])
    assert "plug-in estimate" in found["plans"]
    settings = {row["setting"].split(" (")[0] for row in found["frontier"]}
    assert "these costs" in settings <= {"these costs", "contested costs"}
    assert all(row["certified"] for row in found["frontier"])


def test_words_for_people(fit, capsys):
    assert run("robust", fit, "--schedule", "HRH", "--criterion", "cvar") == 0
    out = capsys.readouterr().out
    for words in ("is right in", "certified", "Bayes-adaptive", "Perfect knowledge", "held out"):
        assert words in out
    assert run("robust", fit, "--schedule", "HRH", "--quiet") == 0
    assert capsys.readouterr().out == ""


def test_weighted_models_in_a_file(tmp_path, capsys):
    models = people(3, 2, seed=5)
    path = json_file(tmp_path / "models.json", models, [0.5, 0.5, 0.0])
    found = result_of(capsys, path, "--schedule", "HR")
    draws = ModelDraws.from_models(models, np.array([0.5, 0.5, 0.0]))
    assert found["bayes_value"] == pytest.approx(solve_schedule(Schedule.of(draws, "HR")).value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--criterion", "worst"], "one of bayes, cvar, gain-cvar, regret, regret-cvar"),
        (["--alpha", "0"], "--alpha: found 0.0, wanted a share of the draws above 0"),
        (["--alpha", "nan"], "--alpha: found nan"),
        (["--alpha", "1.5"], "alpha: found 1.5"),
        (["--mean-share", "2", "--criterion", "cvar"], "share of the mean"),
        (["--mean-share", "0.5"], "only cvar takes one"),
        (["--served", "0"], "people served: found 0.0, wanted a positive number"),
        (["--schedule", "HXH"], "X"),
        (["--evsi", "help+signal:HRH"], "CONDITION:SCHEDULE:N"),
        (["--evsi", "nobody:HRH:10"], "nobody"),
        (["--evsi", "help+signal:HRH:0"], "from 1 to"),
        (["--evsi", "random:HR:²"], "from 1 to"),
        (["--evsi", "help:HRH:10"], "arm, modes with an action"),
        (["--discount", "1.2"], "discount"),
        (["--draws", "0"], "--draws"),
        (["--cost", "dance=3"], "dance"),
        (["--evsi", "help+signal:HRH:9", "--participant-cost", "2"], "people served"),
    ],
)
def test_refusals(fit, capsys, options, words):
    assert run("robust", fit, *options) == 2
    # Before it may stand what a reader has to know of the file.
    assert words in capsys.readouterr().err.splitlines()[-1]


def test_a_fit_that_failed_its_gate_is_refused_unless_forced(tmp_path, capsys):
    path = fit_file(tmp_path / "bad.nc", people(6), gate=failed())
    assert run("robust", path, "--schedule", "HR") == 2
    assert "--force" in capsys.readouterr().err
    robot = tmp_path / "robot.json"
    assert run("robust", path, "--schedule", "HR", "--force", "--quiet", "--policy", robot) == 0
    assert "used although" in capsys.readouterr().err
    # Whoever gets the robot's file only is told all the same.
    assert read_policy(robot).cautions == ("the posterior failed its convergence gate",)
    good = fit_file(tmp_path / "good.nc", people(6))
    assert run("robust", good, "--schedule", "HR", "--quiet", "--policy", robot) == 0
    assert read_policy(robot).cautions == ()


@pytest.mark.parametrize(
    ("text", "words"), [("[]", "empty list"), ("[1]", "model 0"), ('{"a": 1}', ""), ("nonsense", "")]
)
def test_files_that_hold_no_models(tmp_path, capsys, text, words):
    path = tmp_path / "models.json"
    path.write_text(text)
    assert run("robust", path) == 2
    assert words in capsys.readouterr().err


def test_weights_that_do_not_sum_to_one(tmp_path, capsys):
    path = json_file(tmp_path / "models.json", people(2), [0.5, 0.2])
    assert run("robust", path) == 2
    assert "sum" in capsys.readouterr().err


def test_studies_as_they_are_written():
    asked = next_studies(["help+signal:HRH:10", "help+signal:HRH:5", "signal,help,no_signal:HRH:7"], PUBLISHED)
    assert [(a.study.name, a.sizes) for a in asked] == [
        ("help+signal over HRH", (5, 10)), ("signal, help, no_signal over HRH", (7,))
    ]  # fmt: skip
    assert [s.name for s in published_studies(PUBLISHED, "RH")][-1] == "random actions over RH"
    with pytest.raises(InputError, match="one an event"):
        next_studies(["signal,help:HRH:7"], PUBLISHED)
