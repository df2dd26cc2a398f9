"""The command ``solve-draws``: its JSON, its words, its refusals."""

import json

import pytest

from models.planning.latent import latent_problem
from models.planning.mode_process import alternating
from models.planning.solver import solve
from models.unseen import EVIDENCE
from tests.analysis import command
from tests.analysis.command import run
from tests.analysis.draws_cases import failed, fit_file, json_file, people

FIELDS = {
    "solved", "certified", "max_relative_gap", "median_ms", "q90_ms", "seconds", "action_shares", "compile_seconds",
    "action_losses", "values", "draws", "left_out", "seed",
}  # fmt: skip


def result_of(capsys, *arguments):
    return command.result_of(capsys, "solve-draws", *arguments)


@pytest.fixture
def models(tmp_path):
    return json_file(tmp_path / "m.json", people(), [0.1, 0.2, 0.3, 0.4])


def test_weighted_models(models, capsys):
    found = result_of(capsys, models)
    assert found.keys() >= FIELDS
    assert found["solved"] == found["certified"] == 4
    assert 0 <= found["max_relative_gap"] <= 1e-3
    assert 0 < found["median_ms"] <= found["q90_ms"]
    for shares in found["action_shares"].values():
        assert sum(shares.values()) == pytest.approx(1)
    by_hand = [solve(latent_problem(m, alternating(m.protocol)), 1e-4) for m in people()]
    low, high = (sum(w * v for w, v in zip((0.1, 0.2, 0.3, 0.4), bounds, strict=True))
                 for bounds in ([s.lower for s in by_hand], [s.upper for s in by_hand]))  # fmt: skip
    assert found["values"]["lower"]["mean"] <= high
    assert found["values"]["upper"]["mean"] >= low
    helping = [s.policy.action(m.initial, "human_needs_help") for s, m in zip(by_hand, people(), strict=True)]
    share = sum(w for w, a in zip((0.1, 0.2, 0.3, 0.4), helping, strict=True) if a == "help")
    own = found["action_shares"]["human_needs_help"]
    assert own["help"] - 1e-9 <= share <= own["help"] + own["undecided"] + 1e-9
    assert found["pool"] is None


def test_pool(models, capsys):
    found = result_of(capsys, models, "--pool", "--alpha", "0.3")["pool"]
    assert found["evpi_upper_bound"] >= 0
    names = [row["controller"] for row in found["controllers"]]
    assert {"posterior mean", "never", "always", "reactive", "random"} <= set(names)
    assert names[0] == found["best"]
    assert set(found["mixtures"]) == {"mean", "cvar", "worst", "regret", "regret-cvar"}
    for m in found["mixtures"].values():
        assert sum(m["shares"].values()) == pytest.approx(1)
        assert 0 <= m["gap"] <= 1e-6
    assert found["mixtures"]["mean"]["mean"] == pytest.approx(found["controllers"][0]["mean"])


def test_along_a_study(models, capsys):
    found = result_of(capsys, models, "--along", "HRH")["along"]
    assert found["schedule"] == "HRH"
    assert [row["event"] for row in found["decisions"]] == [1, 2, 2, 3, 3]
    for row in found["decisions"]:
        shares = [v for k, v in row.items() if k in ("no_help", "help", "no_signal", "signal", "undecided")]
        assert sum(shares) == pytest.approx(1)
    for k in (1, 2, 3):
        assert sum(r["probability"] for r in found["decisions"] if r["event"] == k) == pytest.approx(1)
    assert "the draws are most divided at event" in found["sentence"]
    assert run("solve-draws", models, "--along", "HRH") == 0
    assert "the draws are most divided" in capsys.readouterr().out


def test_words(models, capsys):
    assert run("solve-draws", models, "--pool") == 0
    text = capsys.readouterr().out
    for word in ("4 draws, 3 states", "4 of 4 draws solved", "human_needs_help, at each draw's own belief",
                 "undecided", "expected loss", "an upper bound on EVPI, not EVPI"):  # fmt: skip
        assert word in text
    assert run("solve-draws", models, "--quiet") == 0
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


def test_options(models, capsys):
    plain = result_of(capsys, models)
    dear = result_of(
        capsys, models, "--cost-help", "1000", "--cost-signal", "1000", "--discount", "0.8", "--draws", 2
    )
    assert dear["solved"] == 2
    assert dear["action_shares"]["human_needs_help"]["no_help"] == pytest.approx(1)
    assert dear["discount"] == 0.8
    assert plain["values"]["lower"]["mean"] > dear["values"]["lower"]["mean"]
    chance = result_of(capsys, models, "--mode-process", "bernoulli:0.4", "--start-mode", "H")
    assert "probability 0.4" in chance["mode_process"]
    flat = result_of(capsys, models, "--r", "0.01", "--precision", "0.1")
    assert flat["values"]["upper"]["mean"] < dear["values"]["lower"]["mean"]


def test_a_fit_without_signals(tmp_path, capsys):
    path = fit_file(tmp_path / "f.nc", people(), {EVIDENCE: {"no_help": 5, "help": 5, "no_signal": 5}})
    assert run("solve-draws", path, "--json", "-") == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert found["left_out"] == ["signal"]
    assert found["action_shares"]["robot_needs_help"] == {"no_signal": 1, "undecided": 0}
    assert "left out signal" in captured.err
    found = result_of(capsys, path, "--allow-unseen")
    assert found["left_out"] == []
    assert "signal" in found["action_shares"]["robot_needs_help"]


def test_a_failed_fit(tmp_path, capsys):
    path = fit_file(tmp_path / "f.nc", people(2), {EVIDENCE: {}}, failed())
    assert run("solve-draws", path) == 2
    error = capsys.readouterr().err
    assert "failed its gate" in error
    assert "--force" in error
    assert run("solve-draws", path, "--force", "--allow-unseen", "--quiet", "--precision", "0.01") == 0
    assert "used although" in capsys.readouterr().err


def test_draws_that_stay_open_are_told(models, capsys):
    assert (
        run("solve-draws", models, "--precision", "1e-13", "--time-limit", "0.01", "--json", "-", "--draws", 1) == 0
    )
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert found["certified"] == 0
    assert found["solved"] == 1
    assert "1 of 1 draws were not solved to a relative gap of 1e-13" in captured.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--discount", "1"), "discount of the batch: found 1.0"),
        (("--precision", "0"), "precision: found 0.0"),
        (("--draws", "0"), "--draws: found 0"),
        (("--alpha", "2"), "--alpha: found 2.0"),
        (("--alpha", "0"), "--alpha: found 0.0"),
        (("--along", "HXH"), "schedule 'HXH', letter 2"),
        (("--precision", "nan"), "precision: found nan"),
        (("--mode-process", "sometimes"), "--mode-process: found 'sometimes'"),
        (("--start-mode", "Q"), "first mode: found 'Q'"),
        (("--cost", "dance=3"), "cost of dance"),
        (("--r", "nan"), "--r: found nan"),
        (("--group", "x"), "--group: found 'x'"),
        (("--time-limit", "0"), "--time-limit: found 0.0"),
    ],
)
def test_refusals(models, capsys, options, words):
    assert run("solve-draws", models, *options) == 2
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error


def test_the_source_is_not_written_over(models, capsys):
    before = models.read_text()
    assert run("solve-draws", models, "--json", models) == 2
    assert "wanted another file" in capsys.readouterr().err
    assert models.read_text() == before
