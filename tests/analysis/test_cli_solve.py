"""The command `solve` as people and programs use it."""

import json

import numpy as np
import pytest

from analysis.bench import planning as bench
from models.planning.formats import write_problem
from models.planning.policy_files import read_policy
from models.planning.problems import PROBLEMS, problem
from tests.analysis.command import result_of, run_captured


@pytest.fixture
def solved(capsys):
    return lambda *words: result_of(capsys, "solve", *words)


def test_tiger_is_worth_what_was_published(tmp_path, solved):
    policy = tmp_path / "policy.json"
    found = solved("tiger", "--precision", "1e-5", "--policy", str(policy))
    assert found["status"] == "converged"
    assert found["lower"] <= 19.3714 + 5e-5
    assert found["upper"] >= 19.3714 - 5e-5
    assert found["gap"] == pytest.approx(found["upper"] - found["lower"])
    assert found["relative_gap"] <= 1e-5
    assert {"seconds", "compile_seconds", "alpha_vectors", "beliefs"} <= found.keys()
    lower = [point["lower"] for point in found["trace"]]
    upper = [point["upper"] for point in found["trace"]]
    assert lower == sorted(lower)
    assert upper == sorted(upper, reverse=True)
    read = read_policy(policy)
    assert read.action(np.array([0.5, 0.5]), 0) == "listen"
    assert read.action(np.array([0.99, 0.01]), 0) == "open-right"


@pytest.mark.parametrize("suffix", [".pomdp", ".pomdpx", ".pomdp.gz"])
def test_a_file_is_solved_like_the_problem_it_holds(tmp_path, suffix, solved):
    path = tmp_path / f"baby{suffix}"
    write_problem(problem("crying_baby"), path)
    found, known = solved(str(path)), solved("crying_baby")
    assert found["lower"] <= known["upper"] + 1e-9
    assert known["lower"] <= found["upper"] + 1e-9


def test_a_time_limit_gives_the_best_so_far(capsys):
    status, out, err = run_captured(capsys, "solve", "tag", "--time-limit", "0.05", "--json", "-")
    assert status == 0
    found = json.loads(out)
    assert found["status"] == "time limit"
    assert found["lower"] < found["upper"]
    assert "time limit" in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing.pomdp"], "nothing.pomdp"),
        (["tigre"], "'tigre', wanted a file that ends in .pomdp, .pomdpx"),
        (["tigre"], "or one of crying_baby, rock_sample_4_4"),
        (["model.json"], "a model file is for the command plan"),
        (["tiger", "--precision", "-1"], "precision"),
        (["tiger", "--time-limit", "0"], "time limit"),
    ],
)
def test_what_cannot_be_solved_is_named(words, message, capsys):
    status, _, err = run_captured(capsys, "solve", *words)
    assert status == 2
    assert message in err


# -- the benchmark ---------------------------------------------------------------------------------
def test_the_benchmark_judges_bounds_over_time(tmp_path, monkeypatch):
    reached = bench.Reached(((0.1, 0.0, 10.0), (0.5, 4.0, 6.0)))
    assert reached.gap_at(0.05) == np.inf
    assert reached.gap_at(0.2) == 10.0
    assert reached.time_to(2.0) == 0.5
    assert reached.time_to(1.0) == np.inf
    path = tmp_path / "tiger.pomdp"
    write_problem(problem("tiger"), path)
    monkeypatch.setattr(bench.shutil, "which", lambda _: None)
    rows, ratio = bench.against_peer(path, 1.0)
    assert ratio is None
    assert "not on the PATH" in rows[0].note


def test_the_peers_table_is_read(tmp_path):
    script = tmp_path / "pomdpsol"
    script.write_text(
        "#!/bin/sh\necho ' Time   |#Trial |#Backup |LBound    |UBound    |Precision  |#Alphas |#Beliefs'\n"
        "echo ' 0.04    0       0        -1.5e+01  1.35742    1.31036     5        1'\n"
        "echo ' 0.5     2       61       0.25      1.25       1.0         49       31'\n"
    )
    script.chmod(0o755)
    found = bench.peer(str(script), tmp_path / "any.pomdp", 1.0, 1e-3)
    assert found.points == ((0.04, -15.0, 1.35742), (0.5, 0.25, 1.25))


def test_many_models_are_judged_by_the_targets():
    rows = list(bench.many_models("sticky", bench.sticky_models(3)))
    assert rows[0].ours == 3
    assert rows[0].met
    assert [row.unit for row in rows[1:]] == ["ms CPU", "ms CPU", "s wall"]


def test_help_names_every_standard_problem(capsys):
    words = run_captured(capsys, "solve", "--help")[1].replace(".", " ").replace(",", " ").split()
    assert set(PROBLEMS) <= set(words)
