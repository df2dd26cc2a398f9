"""The commands ``study2``, ``simulate study2`` and ``replicate study2``: their JSON, words and refusals."""

import errno
import io
import json

import numpy as np
import pytest

from analysis.event_files import read_events
from analysis.study2_claims import CLAIMS
from analysis.study2_outcomes import OUTCOMES
from analysis.study2_policies import MORE, PAPER
from models.model_files import write_model
from tests.analysis.command import result_of, run
from tests.analysis.study2_cases import instant_rounds
from tests.models.planning.policy_cases import person


@pytest.fixture(autouse=True)
def instant(monkeypatch):
    """Rounds that take no time, and a robot that learns from fewer restarts."""
    monkeypatch.setattr("models.game.rounds.play_rounds", instant_rounds())
    monkeypatch.setattr("analysis.study2_learning.RESTARTS", 8)
    monkeypatch.setattr("analysis.study2_beliefs.SEARCHES", 2)


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.json"
    write_model(person(), path)
    return path


def test_fields_of_the_study(capsys, model, tmp_path):
    out = tmp_path / "study2.csv.gz"
    found = result_of(capsys, "study2", "--truth", model, "--learned", "truth", "--participants", 60, "--out", out)
    assert found["participants"] == 60
    assert found["policies"] == list(PAPER)
    assert found["simulated"]
    assert found["seed"] == 1
    assert set(found["anova"]) == set(OUTCOMES)
    assert {"effect", "f", "p", "df1", "df2"} <= found["anova"]["team_performance"][0].keys()
    assert {"outcome", "policy", "n", "mean", "low", "high", "first", "last"} <= found["means"][0].keys()
    assert len(found["tukey"]) == 10 * len(OUTCOMES)
    assert len(found["dunnett"]) == 4 * len(OUTCOMES)
    assert {r["reference"] for r in found["dunnett"]} == {"ls-POMDP"}
    assert set(found["claims"]["ls-POMDP"]) == {c.key for c in CLAIMS}
    assert {r["printed_f"] for r in found["printed"]["anova"]} >= {9.8314, None}
    assert [r["round"] for r in found["rounds"] if r["outcome"] == "observation"][:5] == [1, 3, 5, 7, 9]
    log = read_events(out).log
    assert log.n_participants == 60
    costly = next(r["mean"] for r in found["means"] if r["outcome"] == "costly_actions" and r["policy"] == "always")
    assert costly == 9


def test_the_log_is_that_of_the_study(capsys, model, tmp_path):
    one, other = tmp_path / "a.csv", tmp_path / "b.csv"
    options = ("--truth", model, "--learned", "truth", "--participants", 30, "--seed", 4)
    assert run("study2", *options, "--out", one, "--quiet") == 0
    found = result_of(capsys, "simulate", "study2", *options, "--out", other)
    assert one.read_bytes() == other.read_bytes()
    assert (found["participants"], found["events"], found["seed"]) == (30, 270, 4)
    assert found["truth"] == str(model)
    tokens = read_events(other).log.tokens
    assert np.array_equal(tokens["human_tokens"] + tokens["robot_tokens"], tokens["team_tokens"])


def test_a_robot_that_learns_from_a_study_1(capsys, model):
    found = result_of(capsys, "study2", "--truth", model, "--participants", 20, "--states", 2)
    words = "Baum-Welch with 2 states on a study 1 of 540 simulated people (log-likelihood -"
    assert found["learned"].startswith(words)
    assert (found["belief"]["searches"], found["belief"]["models"][0]["below"]) == (2, 0)
    assert found["claims_on_the_robots_scale"] == ["belief"]


def test_what_is_on_the_robots_scale_is_not_answered(capsys, model):
    options = ("--truth", model, "--participants", 20)
    for learned, says in ((("--states", 2), False), (("--learned", model), False), (("--learned", "truth"), True)):
        assert run("study2", *options, *learned) == 0
        out = capsys.readouterr().out
        assert "Believed state is on the robot's own scale" in out
        assert "other fits give other numbers" in out
        (line,) = (line for line in out.splitlines() if "belief is at higher states" in line)
        assert (line.split()[0] in ("yes", "no")) == says
        assert ("not decidable" in line) != says


def test_groups_that_are_not_equal_are_named(capsys, model):
    for people, words in ((23, "Groups of 4 and 5."), (20, "seed 1.\n")):
        assert run("study2", "--truth", model, "--learned", "truth", "--participants", people) == 0
        assert words in capsys.readouterr().out


def test_one_policy_can_be_simulated(capsys, model, tmp_path):
    options = ("--truth", model, "--learned", "truth", "--policies", "always", "--participants", 2)
    found = result_of(capsys, "simulate", "study2", *options, "--out", tmp_path / "one.csv")
    assert (found["policies"], found["events"]) == (["always"], 18)
    assert run("simulate", "study2", *options[:-1], 1, "--out", tmp_path / "one.csv") == 2


def test_json_is_written_though_nobody_reads_on(tmp_path, model, monkeypatch):
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    told = tmp_path / "told.json"
    monkeypatch.setattr("sys.stdout", Closed())
    assert run("study2", "--truth", model, "--learned", "truth", "--participants", 20, "--json", told) == 1
    assert json.loads(told.read_text())["participants"] == 20


def test_words(capsys, model):
    assert run("study2", "--truth", model, "--learned", "truth", "--participants", 40, "--seed", 2) == 0
    out = capsys.readouterr().out
    for words in (
        "SIMULATED: 40 people under 5 policies play 9 rounds (HRHRHRHRH)", "seed 2", "tokens in all",
        "with ls-POMDP as the planner", "Mixed ANOVA of team performance",
    ):  # fmt: skip
        assert words in out
    lines = out.splitlines()
    for title, heads in (
        ("Mixed ANOVA, first against last round", "outcome effect df1 df2 F p printed F printed p"),
        (
            "Less ls-POMDP, one value a person",
            "outcome policy difference low high p p, Dunnett printed difference printed p",
        ),
    ):
        at = next(i for i, line in enumerate(lines) if line.startswith(title))
        assert "SIMULATED but for the printed columns" in lines[at]
        assert " ".join(lines[at + 1].split()) == heads
        assert max(map(len, lines[at + 1 : at + 13])) <= 110
    never = next(line for line in lines if line.split()[:4] == ["tokens", "a", "round", "never"])
    assert never.split()[-2:] == ["-12.96", "0"]
    assert run("study2", "--truth", model, "--learned", "truth", "--participants", 40, "--quiet") == 0
    assert capsys.readouterr() == ("", "")


def test_other_policies(capsys, model):
    found = result_of(
        capsys, "study2", "--truth", model, "--learned", "truth", "--participants", 30, "--policies",
        "never, exact plan,always",
    )  # fmt: skip
    assert found["policies"] == ["never", "exact plan", "always"]
    assert found["reference"] == "never"
    assert found["claims"] == {}
    assert found["printed"] == {"anova": [], "comparisons": []}
    more = result_of(
        capsys, "study2", "--truth", model, "--learned", "truth", "--participants", 60, "--policies",
        ",".join((*PAPER, MORE[0])),
    )  # fmt: skip
    # Beside the printed tests stand those of the same five policies.
    assert {(r["df1"], r["df2"]) for r in more["printed"]["anova"]} == {(4, 45), (1, 45)}
    assert {(r["df1"], r["df2"]) for r in more["anova"]["observation"]} == {(5, 54), (1, 54)}
    assert set(more["claims"]) == {"ls-POMDP", MORE[0]}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--participants", "9"), "participants: found 9 under 5 policies, wanted at least 10"),
        (("--policies", "kind,never"), "policy: found 'kind', wanted one of ls-POMDP"),
        (("--policies", "never"), "policies: found never, wanted at least two, to be compared, of"),
        (("--policies", "all", "--learned", "truth"), "posterior: found none"),
        (("--learned", "absent.json"), "absent.json: no such file"),
        (("--truth", "absent.json"), "absent.json: no such file"),
        (("--alpha", "0"), "--alpha: found 0.0"),
        (("--out", "study2.txt"), "a name that ends in .csv, .csv.gz or .parquet"),
    ],
)
def test_refusals(capsys, monkeypatch, tmp_path, options, words):
    monkeypatch.chdir(tmp_path)
    assert run("study2", "--states", "1", *options) == 2
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error


def test_a_model_file_has_no_posterior(capsys, model):
    assert run("study2", "--learned", model, "--policies", ",".join((PAPER[0], MORE[1]))) == 2
    assert "some policies need a posterior" in capsys.readouterr().err


def test_nothing_that_is_read_is_written_over(capsys, model):
    for option in ("--truth", "--learned"):
        assert run("simulate", "study2", "--out", model, option, model) == 2
        assert "wanted another file than" in capsys.readouterr().err


def test_replicates_say_how_they_are_repeated(capsys, tmp_path, model):
    out = tmp_path / "study2.json"
    options = ("--replicates", 4, "--worlds", 2, "--people", 4, "--study1", 40, "--states", 1)
    assert run("replicate", "study2", *options, "--truth", model, "--out", out, "--seed", 5) == 0
    content = json.loads(out.read_text())
    assert content["command"] == (
        f"prosocial replicate study2 --replicates 4 --worlds 2 --people 4 --study1 40 --states 1 --truth {model} "
        "--seed 5"
    )
    assert "simulated people" in content["what"]
    assert "models.game.rounds" in content["modules"]
    assert content["sentence"] in capsys.readouterr().out
    assert run("replicate", "study2", "--replicates", 5, "--worlds", 2, "--quiet") == 2
    assert "wanted a multiple of 2 worlds (--worlds)" in capsys.readouterr().err
    assert run("replicate", "study2", "--replicates", 29, "--quiet") == 2
    assert "--replicates: found 29, wanted a multiple of some number of worlds" in capsys.readouterr().err
    options = ("--replicates", 3, "--people", 4, "--study1", 40, "--states", 1, "--truth", model)
    assert run("replicate", "study2", *options, "--out", out) == 0
    assert " --replicates 3 --worlds 3 " in json.loads(out.read_text())["command"]
    assert "not decidable" in capsys.readouterr().out
