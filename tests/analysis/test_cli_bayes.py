"""The command `bayes`: its JSON, its file, its errors, its banner."""

import json
import os
import subprocess
import sys
import warnings
from functools import partial
from pathlib import Path

import pytest

from analysis import fits
from analysis.cli import main
from models.posterior_files import read_posterior
from tests.analysis.command import run as status_of
from tests.analysis.event_text import text

ROOT = Path(__file__).resolve().parents[2]
FAST = ("--states", "2", "--draws", "40", "--tune", "60", "--chains", "2")


@pytest.fixture(autouse=True)
def own_store(tmp_path, monkeypatch):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")


run = partial(status_of, "bayes")


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
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert run("simulated_study1", *FAST, "--group", f"{ages}:age") == 0
        told = capsys.readouterr().err.splitlines()
        assert run("simulated_study1", *FAST, "--group", f"{ages}:age", "--quiet") == 0
    (line,) = [line for line in told if "40 groups" in line]
    assert line.startswith("prosocial: groups by age: 40 groups, more than 10; covariates are categories: a number")
    assert not [line for line in told if ".py:" in line]
    assert "40 groups" not in capsys.readouterr().err  # nothing but errors


def test_a_grouping_by_a_number_is_refused(tmp_path, capsys):
    scores = tmp_path / "scores.csv"
    scores.write_text("participant,score\n" + "".join(f"{p},{p / 7:.6f}\n" for p in range(0, 600)))
    assert run("simulated_study1", *FAST, "--group", f"{scores}:score") == 2
    error = capsys.readouterr().err
    assert "score, different values: found 540, wanted at most 54 for 540 people: every value is a group" in error


def test_fits_list_names_the_grouping(tmp_path, capsys):
    classes = tmp_path / "classes.csv"
    classes.write_text("participant,age_class\n" + "".join(f"{p},{p % 2}\n" for p in range(0, 600)))
    assert run("simulated_study1", *FAST, "--group", f"{classes}:age_class", "--quiet") == 0
    with pytest.raises(SystemExit):
        main(["fits", "list"])
    assert "tables by group of age_class" in capsys.readouterr().out


def process(*arguments, before="", size=None, **environment):
    """The command in a process of its own, with a limit on the size of files and something done before."""
    limit = "" if size is None else (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, resource.RLIM_INFINITY))\n"
    )  # fmt: skip
    return subprocess.run(
        [sys.executable, "-c", f"{limit}{before}from analysis.cli import main; main()", *arguments], cwd=ROOT,
        capture_output=True, text=True, timeout=400, env={**os.environ, **environment},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["direct", "pymc"])
def test_a_full_disk_with_a_cold_cache_costs_lines_not_the_run(engine, tmp_path):
    """Kernels run uncached; whatever cannot be kept is one line each, and the result is there."""
    # PyTensor has a cache of its own.
    own = {
        "PROSOCIAL_CACHE": str(tmp_path / "cache"), "PYTENSOR_FLAGS": f"base_compiledir={tmp_path / 'pytensor'}",
    }  # fmt: skip
    done = process("bayes", "simulated_study1", *FAST, "--engine", engine, size=16_000, **own)
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    assert all(line.startswith("prosocial: ") for line in lines), done.stderr
    assert sum("compiled code cannot be kept (File too large)" in line for line in lines) == 1
    assert sum("the result is not in the store" in line for line in lines) == 1
    assert len(lines) == 3  # and the gate
    assert "help_probability[signal,s1]" in done.stdout


HIDDEN = """
import importlib.metadata, importlib.util, sys
class Hide:
    def find_spec(self, name, *rest):
        if name.split(".")[0] == "nutpie":
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Hide())
version, spec = importlib.metadata.version, importlib.util.find_spec
def found(name):
    if name == "nutpie":
        raise importlib.metadata.PackageNotFoundError(name)
    return version(name)
importlib.metadata.version = found
importlib.util.find_spec = lambda name, *rest: None if name == "nutpie" else spec(name, *rest)
"""


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["direct", "pymc"])
def test_without_nutpie_the_fallback_goes_through_command_and_store(engine, tmp_path):
    run_it = ("bayes", "simulated_study1", *FAST, "--engine", engine, "--json", "-")
    store = {"before": HIDDEN, "PROSOCIAL_CACHE": str(tmp_path)}
    first, again = process(*run_it, **store), process(*run_it, **store)
    assert (first.returncode, again.returncode) == (0, 0), first.stderr + again.stderr
    assert [json.loads(d.stdout)["reused"] for d in (first, again)] == [False, True]
    assert ("nutpie is not installed: PyMC's own sampler takes its place" in first.stderr) == (engine == "direct")
    listed = process("fits", "list", **store)
    assert listed.returncode == 0, listed.stderr
    assert "ready" in listed.stdout


def test_a_failed_gate_is_a_banner_not_a_whisper(capsys):
    assert run("simulated_study1", *FAST, "--quiet") == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("prosocial: Convergence gate FAILED (")
    assert "Do not rely on these numbers" in captured.err
    assert run("simulated_study1", *FAST) == 0
    captured = capsys.readouterr()
    assert captured.out.count("Convergence gate FAILED: see the end.") == 1
    assert "Do not rely" not in captured.out
    assert captured.err.count("Do not rely on these numbers") == 1


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
