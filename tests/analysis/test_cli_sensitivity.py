"""The command ``sensitivity``: JSON, words, options, refusals."""

import json

import pytest
import typer

from analysis.cli_sensitivity import _after_compiling, sensitivity_command
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.model_files import write_model
from models.protocol import PUBLISHED
from tests.analysis.draws_cases import failed, fit_file, json_file, people
from tests.analysis.report_cases import CORRIDOR
from tests.models.sensitivity.sensitivity_cases import some_draws


def run(*arguments):
    app = typer.Typer()
    app.command("sensitivity")(sensitivity_command)
    try:
        app([str(a) for a in arguments])
    except SystemExit as stop:
        return stop.code or 0
    return 0


def result_of(capsys, *arguments):
    assert run(*arguments, "--json", "-") == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture
def model(tmp_path):
    write_model(calibrated_truth(), tmp_path / "model.json")
    return tmp_path / "model.json"


@pytest.fixture
def fit(tmp_path):
    return fit_file(tmp_path / "fit.nc", people(8, 3, seed=2))


def test_a_model(model, capsys):
    found = result_of(capsys, model, "--r-grid", ".06,.08", "--cost-grid", "15,0")
    cells = found["cells"]
    assert len(cells) == 3 * 2 * 4 * 2
    for row in cells:
        assert {"reading", "r", "cost_help", "cost_signal", "k", "action", "share", "shares", "verdict"} <= set(row)
        assert row["share"] == 1
    starts = {
        (row["reading"], row["r"]): row["action"]
        for row in cells
        if row["k"] == 0 and (row["cost_help"], row["cost_signal"]) == (15, 15)
    }
    assert starts["two-step", 0.06] == "no_help"
    assert starts["two-step", 0.08] == starts["infinite", 0.06] == starts["two-step-terminal", 0.06] == "help"
    for key in ("critical", "findings", "discount", "x", "belief", "beside", "seconds", "compile_seconds", "seed"):
        assert key in found
    assert found["discounts"] == {"infinite": 0.95, "two-step": 1.0, "two-step-terminal": 1.0}
    flip = next(
        c for c in found["critical"] if (c["reading"], c["parameter"], c["k"]) == ("two-step", "cost_help", 0)
    )
    assert flip["flips"][0]["before"] == "help"
    assert 9 < flip["flips"][0]["low"] < flip["flips"][0]["high"] < 10
    assert len(found["findings"]) == 9


def test_one_reading_and_another_discount(model, capsys):
    found = result_of(
        capsys, model, "--reading", "two-step-terminal", "--discount", ".8", "--r-grid", ".06", "--cost-grid", "15"
    )
    assert {row["reading"] for row in found["cells"]} == {"two-step-terminal"}
    assert found["discounts"] == {"two-step-terminal": 0.8}
    assert found["cells"][0]["action"] == "no_help"


def test_a_fit(fit, tmp_path, capsys):
    other = json_file(tmp_path / "models.json", people(2, 2, seed=5), [0.5, 0.5])
    found = result_of(
        capsys, fit, "--endless-draws", 3, "--r-grid", ".06,.09", "--cost-grid", "5,15", "--beside", other
    )
    assert found["draws"] == 8
    assert found["asked"] == {"infinite": 3, "two-step": 8, "two-step-terminal": 8}
    for row in found["cells"]:
        assert sum(row["shares"].values()) == pytest.approx(1)
        assert row["share"] == max(v for name, v in row["shares"].items() if name != "undecided")
    assert "currencies" in found["beside_note"]
    asked = {name: {row["draws"] for row in found["belief"] if row["reading"] == name} for name in found["asked"]}
    assert asked == {"infinite": {3}, "two-step": {8}, "two-step-terminal": {8}}
    assert {c["draws"] for c in found["critical"] if c["reading"] == "infinite"} == {2}
    assert {f["draws"] for f in found["findings"] if f["reading"] == "infinite"} == {2, 3}
    grid = {
        (row["reading"], row["k"]): row["share"] for row in found["cells"]
        if (row["r"], row["cost_help"], row["cost_signal"]) == (0.06, 15, 15)
    }  # fmt: skip
    # The same question has one answer, wherever it stands.
    assert grid == {(r["reading"], r["k"]): r["share"] for r in found["belief"] if r["variant"] == "own"}
    agree = {row["agree"] for row in found["cells"] if row["reading"] == "infinite"}
    assert agree <= {"1 of 3 draws", "2 of 3 draws", "3 of 3 draws"}
    curve = next(c for c in found["critical"] if c["parameter"] == "r")
    assert curve["flips"] is None
    assert set(curve["quantiles"]) == {"q05", "q25", "q50", "q75", "q95"}


def test_words(model, capsys):
    assert run(model, "--r-grid", ".06,.08", "--cost-grid", "15,0") == 0
    said = capsys.readouterr()
    for words in (
        "Policy without a horizon", "flips: human_needs_help, r from", "Printed in the paper, and found here",
        "points are missed", "Initial belief", "at both ends of a bracket are proven", "no flip of any step: ",
    ):  # fmt: skip
        assert words in said.out
    assert said.err == ""
    assert run(model, "--quiet", "--reading", "two-step") == 0
    assert capsys.readouterr().out == ""


def test_actions_left_out_have_no_cost(tmp_path, capsys):
    settings = {"evidence_of_actions": {"no_help": 5, "help": 5, "no_signal": 5, "signal": 0}}
    fit = fit_file(tmp_path / "fit.nc", people(4, 3, seed=2), settings)
    found = result_of(capsys, fit, "--reading", "two-step", "--r-grid", ".06", "--cost-grid", "15")
    assert found["left_out"] == ["signal"]
    assert [row["cost_signal"] for row in found["cells"]] == [None, None]
    assert found["findings"] == []
    kept = result_of(capsys, fit, "--reading", "two-step", "--r-grid", ".06", "--cost-grid", "15", "--allow-unseen")
    assert kept["cells"][0]["cost_signal"] == 15


def test_another_protocol(tmp_path, capsys, model):
    toml = tmp_path / "protocol.toml"
    toml.write_text(PUBLISHED.to_toml().replace("15.0", "4.0"))
    content = json.loads(model.read_text())
    model.write_text(json.dumps({k: v for k, v in content.items() if k not in ("protocol", "reward")}))
    found = result_of(
        capsys, model, "--reading", "two-step", "--r-grid", ".06", "--protocol", toml, "--cost-grid", "4"
    )
    assert {row["cost_help"] for row in found["cells"]} == {4}
    assert found["reward"]["costs"]["help"] == 4


def test_three_modes(tmp_path, capsys):
    write_model(some_draws(2, 1, 3, CORRIDOR).model(0), tmp_path / "corridor.json")
    found = result_of(capsys, tmp_path / "corridor.json", "--r-grid", ".02", "--cost-grid", "5", "--discount", ".6")
    assert [row["k"] for row in found["cells"]] == [0, 1, 2] * 3
    assert {"cost_ask", "cost_assist", "cost_open"} <= set(found["cells"][0])
    assert found["findings"] == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--r-grid", ".06,high"], "--r-grid: found 'high'"), (["--r-grid", ".06,.06"], "every number once"),
        (["--cost-grid", "-3"], "--cost-grid: found -3"), (["--r-grid", "-.06,.06"], "--r-grid: found -0.06"),
        (["--cost-grid", "inf"], "finite numbers"),
        (["--reading", "three"], "--reading: found 'three'"), (["--discount", "1"], "--discount: found 1"),
        (["--endless-draws", "0"], "--endless-draws: found 0"), (["--draws", "0"], "--draws: found 0"),
        (["--stored"], "--stored: found"), (["--person", "1"], "--person: found"),
        (["--cost", "smile=3"], "smile"), (["--beside", "none.json"], "none.json: no such file"),
    ],
)  # fmt: skip
def test_refused(model, arguments, words, monkeypatch):
    with pytest.raises(InputError) as error:
        run(model, *arguments)
    assert words in str(error.value)


def test_no_such_file_and_failed_gates(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        run(tmp_path / "none.json")
    bad = fit_file(tmp_path / "bad.nc", people(4, 2), gate=failed())
    with pytest.raises(InputError, match="gate"):
        run(bad)
    assert run(bad, "--force", "--quiet", "--reading", "two-step") == 0


def test_somebody_who_watches_is_told_of_compiling_at_once():
    seen = []
    told = _after_compiling(lambda *step: seen.append(step))
    assert [step[1:] for step in seen] == [(0, 1)]
    told("grid", 3, 9)
    assert seen[1:] == [(seen[0][0], 1, 1), ("grid", 3, 9)]
