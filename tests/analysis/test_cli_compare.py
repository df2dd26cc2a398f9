"""`prosocial compare --held-out`: its JSON, its words, its errors; figures and report section of the same."""

import json
from dataclasses import replace
from functools import partial

import pytest

from analysis import fits
from analysis.comparison import CompareSettings
from analysis.figures.held_out import held_out_by_round, held_out_rates
from analysis.figures.style import to_svg
from analysis.held_out import held_out
from analysis.held_out_contenders import standard_contenders
from analysis.report.build import build_report
from analysis.report.registry import Entry
from analysis.report.section import Figure, Origin, Table
from analysis.report.sections import held_out as section
from analysis.simulate import simulate_study1
from models.nuts import NutsSettings
from models.protocol import PUBLISHED
from models.smc import SmcSettings
from tests.analysis.command import run as status_of
from tests.analysis.report_cases import CORRIDOR, data_set, few_particles, little_effort, log_of, random_log

TINY = CompareSettings(
    8, 3, NutsSettings(draws=60, tune=60, chains=2), SmcSettings(60, 2, moves=1), SmcSettings(60, moves=1), 2, (2,)
)  # fmt: skip


@pytest.fixture(autouse=True)
def own_store(tmp_path, monkeypatch):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")
    monkeypatch.setattr(CompareSettings, "of", classmethod(lambda cls, quick, **k: replace(TINY, folds=k["folds"])))
    few_particles(monkeypatch)


run = partial(status_of, "compare")


@pytest.fixture(scope="module")
def result():
    log = simulate_study1(participants=100, seed=5)
    with pytest.MonkeyPatch.context() as patch:
        few_particles(patch)
        return held_out(
            log, standard_contenders(log, (2,), sampler=TINY.sampler, draws=100), draws=100, kind="simulated"
        )


def test_json_has_the_rows_and_the_sentence(capsys):
    arguments = ("simulated_study1", "--condition", "help+signal", "--condition", "no-help+signal", "--states", "2")
    assert run(*arguments, "--folds", "2", "--held-out", "condition", "--json", "-") == 0
    captured = capsys.readouterr()
    content = json.loads(captured.out)
    found = content["held_out"]
    assert (found["by"], found["level"], found["measure"]) == ("condition", 0.9, "help rate")
    wanted = {
        "cell", "part", "at", "contender", "responses", "people", "observed", "observed_low", "observed_high",
        "expected", "expected_low", "expected_high", "low", "high", "error", "inside", "crps", "prior",
    }  # fmt: skip
    assert wanted <= set(found["rows"][0])
    assert {row["contender"] for row in found["rows"]} == {
        "constant", "first-order Markov", "2 types", "mixed model", "2 states"
    }  # fmt: skip
    assert found["absent"] == []
    assert {row["cell"] for row in found["rows"]} == {"help+signal", "no-help+signal"}
    assert {"log_score", "log_score_error", "by_person", "gate"} <= set(found["scores"][0])
    assert found["ranking"][0]["log_score_diff"] == 0
    # Nobody is helped where help+signal is left out of these two conditions.
    assert any(
        "action help was never seen in the rest: its table is the prior" in row["prior"] for row in found["rows"]
    )
    assert found["sentence"] in captured.err
    assert "Left out by condition and predicted from the rest" in captured.err
    assert "missed the convergence gate" in captured.err


def test_without_the_option_nothing_is_left_out(capsys):
    assert (
        run("simulated_study1", "--condition", "help+signal", "--states", "2", "--folds", "2", "--json", "-") == 0
    )
    assert json.loads(capsys.readouterr().out)["held_out"] is None


@pytest.mark.slow
def test_people_who_differ_are_left_out_too(capsys):
    conditions = ("--condition", "help+signal", "--condition", "no-help+no-signal")
    arguments = ("simulated_study1", *conditions, "--states", "2", "--people-differ", "--person-nodes", "15")
    assert run(*arguments, "--folds", "2", "--held-out", "condition", "--json", "-") == 0
    captured = capsys.readouterr()
    content = json.loads(captured.out)
    assert content["people_differ"] == {"scale": 1.5, "nodes": 15}
    ranked = [row["contender"] for row in content["held_out"]["ranking"]]
    assert {"people differ, no states", "2 states, people differ"} <= set(ranked)
    # Whoever is helped is signalled to in both cells, so each is learned from one kind of robot only.
    mixed = [row for row in content["held_out"]["rows"] if row["contender"] == "mixed model"]
    assert {row["prior"] for row in mixed if row["part"] == "overall"} == {
        "factor robot_help never varied in the rest: no effect is assumed; "
        "factor signal never varied in the rest: no effect is assumed"
    }
    sentence = content["held_out"]["sentence"]
    assert all(f"{name} by" in sentence or f"{name} is best" in sentence for name in ranked)
    assert "no effect is assumed" in sentence


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--person-scale", "4"), "--person-scale: found 4.0, wanted --people-differ with it"),
        (("--person-nodes", "21"), "--person-nodes: found 21, wanted --people-differ with it"),
        (
            ("--held-out", "people"),
            "--held-out: found 'people', wanted one of condition, schedule, condition",
        ),
        (
            ("--held-out", "condition", "--condition", "help+signal"),
            "--held-out condition, selected: found 'help+signal', wanted several, or --condition all",
        ),
    ],
)
def test_what_cannot_be_left_out_is_refused_before_any_work(arguments, message, capsys, monkeypatch):
    monkeypatch.setattr("analysis.comparison.compare", None)
    assert run("simulated_study1", "--states", "2", *arguments) == 2
    assert capsys.readouterr().err.startswith(f"prosocial: {message}")


# -- figures and section -----------------------------------------------------------------------------------
def test_figures_are_the_same_bytes_every_time_and_show_what_is_the_prior(result):
    flagged = result.overall.assign(prior=["something", *[""] * (len(result.overall) - 1)])

    def drawn(table):
        return held_out_rates(table, measure="help rate", limits=(0, 1), level=0.9)

    assert to_svg(drawn(result.overall)) == to_svg(drawn(result.overall))
    labels = [tick.get_text() for tick in drawn(flagged).get_yticklabels()]
    assert labels[0] == "constant \N{DAGGER}"
    assert labels[1:5] == ["first-order Markov", "2 types", "mixed model", "2 states"]
    rows = result.by_round[result.by_round["cell"] == "help+signal"]
    ax = held_out_by_round(rows, shown="2 states", order=result.contenders, measure="help rate", limits=(0, 1))
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [*result.contenders, "observed"]
    markers = {line.get_marker() for line in ax.get_lines()[:5]}
    assert len(markers) == 5  # not by colour alone


def test_blocks_state_their_origin_and_say_everything(result):
    made = section.blocks(result, PUBLISHED, Origin.SIMULATED)
    shown = [b for b in made if isinstance(b, Figure | Table)]
    assert all(b.origin == (Origin.SIMULATED,) for b in shown)
    assert made[0].text == result.sentence
    figures = [b for b in shown if isinstance(b, Figure)]
    assert [len(f.panels) for f in figures] == [1, 4]
    ranking = next(b for b in shown if isinstance(b, Table))
    assert "an intercept for every person" in ranking.caption
    assert "Where people differ" not in ranking.caption
    assert all("help+signal" in alt for alt in figures[0].alt)
    assert all(f.svgs() for f in figures)


def build(log, out, quick=False):
    entry = Entry("held-out", "Not seen", section.make)
    made = build_report(data_set(log), states="1,2", quick=quick, out=out, sections=[entry])
    return made.sections[0], made.html.read_text(encoding="utf-8")


def test_report_leaves_out_what_it_can(tmp_path, monkeypatch):
    monkeypatch.setattr(section, "MOST_SHOWN", 2)
    little_effort(monkeypatch)
    made, text = build(random_log(CORRIDOR, people=40), tmp_path)
    assert made.omitted is None
    assert [f.key for f in made.figures] == ["held-out-condition", "held-out-condition-rounds"]
    assert "mean response score" in text
    assert "2 states, people differ" in text or "people differ, no states" in text
    assert "the mixed model takes no part" in text
    assert "it is for two responses" in text
    assert "schedules are more than the 2 for which a report refits its models" in text


def test_report_says_why_nothing_is_left_out(tmp_path, monkeypatch):
    little_effort(monkeypatch)
    quick, _ = build(random_log(PUBLISHED, people=20), tmp_path, quick=True)
    assert "prosocial compare --quick --held-out condition" in quick.omitted
    same, _ = build(
        log_of([(i, 0, "c", [("signal", "help" if i % 2 else "no_help")]) for i in range(12)]), tmp_path
    )
    assert same.omitted == "there is one condition and one schedule, so without it nothing is left to learn from"
    both = [
        (i, j, name, [("signal", "help" if i % 3 else "no_help")]) for i in range(12) for j, name in enumerate("ab")
    ]
    within, text = build(log_of(both), tmp_path)
    assert within.omitted is None
    assert "everybody has a run in it, so nobody is left to learn from" in text
    assert "there is only one schedule" in text
