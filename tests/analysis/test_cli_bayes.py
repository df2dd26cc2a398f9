"""The command `bayes`: its JSON, its file, its errors, its banner."""

import json

import pytest

from analysis import fits
from analysis.cli import main
from models.groups import ManyGroupsWarning
from models.posterior_files import read_posterior
from tests.analysis.event_text import text

FAST = ("--states", "2", "--draws", "40", "--tune", "60", "--chains", "2")


@pytest.fixture(autouse=True)
def own_store(tmp_path, monkeypatch):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")


def run(*arguments):
    try:
        main(["bayes", *arguments])
    except SystemExit as stop:
        return stop.code or 0
    return 0


def test_json_has_the_fields_of_the_contract(tmp_path, capsys):
    out = tmp_path / "fit.nc"
    assert run("simulated_study1", *FAST, "--out", str(out), "--json", "-") == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    wanted = {
        "divergences", "max_rhat", "min_ess_bulk", "min_ess_tail", "cpu_seconds", "sampling_seconds",
        "compile_seconds", "contraction", "summary", "gate",
    }  # fmt: skip
    assert wanted <= set(result)
    assert set(result["gate"]) == {"passed", "reasons"}
    entry = result["summary"]["help_probability[signal,s1]"]
    assert set(entry) == {"mean", "sd", "q05", "q50", "q95"}
    assert entry["q05"] < entry["q50"] < entry["q95"]
    assert set(result["contraction"]) == set(result["summary"])
    fit = read_posterior(out)
    assert fit.gate.max_rhat == pytest.approx(result["max_rhat"])
    for name in ("cpu_seconds", "sampling_seconds", "compile_seconds"):
        assert getattr(fit, name) == pytest.approx(result[name])
        assert result[name] >= 0


def test_one_chain_is_told_why_there_is_no_rhat(capsys):
    arguments = [*FAST[:-1], "1", "--quiet", "--json", "-"]
    assert run("simulated_study1", *arguments) == 0
    captured = capsys.readouterr()
    assert "r-hat needs at least two chains, found one" in captured.err
    result = json.loads(captured.out)
    assert result["max_rhat"] is None
    assert "r-hat needs at least two chains, found one" in result["gate"]["reasons"]


def test_a_covariate_with_very_many_values_is_told(tmp_path, capsys):
    ages = tmp_path / "ages.csv"
    rows = "".join(f"{p},{20 + p % 40}\n" for p in range(0, 600))
    ages.write_text(f"participant,age\n{rows}")
    with pytest.warns(ManyGroupsWarning, match="40 groups, more than 10; covariates are categories"):
        run("simulated_study1", *FAST, "--group", f"{ages}:age", "--quiet")


def test_a_failed_gate_is_a_banner_not_a_whisper(capsys):
    assert run("simulated_study1", *FAST, "--quiet") == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("prosocial: Convergence gate FAILED (")
    assert "Do not rely on these numbers" in captured.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--engine", "stan"), "--engine: found 'stan', wanted direct or pymc"),
        (("--pin", "wave"), "--pin: found 'wave', wanted one of no_help, help, no_signal, signal, or none"),
        (("--condition", "none+such"), "--condition: found 'none+such', wanted one of help+no-signal"),
        (("--out", "/"), "--out /: found a folder, wanted the name of a file"),
    ],
)
def test_unusable_arguments(arguments, message, capsys):
    assert run("simulated_study1", *FAST, *arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(f"prosocial: {message}")
    assert captured.out == ""


def test_data_and_protocol_are_never_overwritten(tmp_path, capsys):
    path = tmp_path / "two.csv"
    path.write_text(text())
    for option in ("--json", "--out"):
        assert run(str(path), *FAST, option, str(path)) == 2
        assert capsys.readouterr().err == f"prosocial: {option}: found '{path}', wanted another file than DATA\n"
    assert path.read_text() == text()
    assert run("simulated_study1", *FAST, "--protocol", str(path), "--json", str(path)) == 2
    assert "wanted another file than --protocol" in capsys.readouterr().err


@pytest.mark.parametrize("engine", ["direct", "pymc"])
def test_interruption_says_that_chains_are_kept(engine, capsys, monkeypatch):
    def stop(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(fits, "stored_fit", stop)
    assert run("simulated_study1", *FAST, "--engine", engine) == 130
    assert "completed chains are kept, the same command goes on" in capsys.readouterr().err
