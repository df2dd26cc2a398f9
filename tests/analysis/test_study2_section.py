"""The report's section on study 2."""

import json

import numpy as np
import pytest

from analysis import datasets, evidence
from analysis.cli_options import plain
from analysis.design import published
from analysis.report.build import build_report
from analysis.report.registry import Entry
from analysis.report.section import Omitted, Origin, Part
from analysis.report.sections import study2 as section
from analysis.simulate import simulate_study1
from analysis.study2_evidence import game_settings, study2_evidence
from analysis.study2_policies import MORE, PAPER
from analysis.study2_replicates import Study2Replicates
from models.nuts import NutsSettings
from tests.analysis.report_cases import CORRIDOR, data_set, little_effort, random_log
from tests.analysis.study2_cases import instant_rounds
from tests.models.planning.policy_cases import person

ONLY = [Entry("study2", "Study 2", section.make)]


@pytest.fixture(scope="module", autouse=True)
def little(tmp_path_factory):
    """Little effort, rounds that take no time, and evidence of two worlds."""
    with pytest.MonkeyPatch.context() as patch:
        little_effort(patch)
        patch.setattr("models.game.rounds.play_rounds", instant_rounds())
        patch.setattr("analysis.study2_beliefs.SEARCHES", 2)
        folder = tmp_path_factory.mktemp("evidence")
        patch.setattr(evidence, "FOLDER", folder)
        tiny = Study2Replicates(
            person(), replicates=4, worlds=2, people=5, study1=60, states=2, sampler=NutsSettings(50, 50, 2)
        )
        made = study2_evidence(tiny, published()).to_dict()
        content = evidence.record("Study 2: simulated.", "prosocial replicate study2", 1, made)
        (folder / "study2.json").write_text(json.dumps(plain(content)))
        (folder / "game.json").write_text(json.dumps(plain(measured())))
        yield folder


def measured():
    """Evidence of the game as the command stores it, with numbers that nothing else has."""
    quantities = [(f"x_s{s}", "tokens") for s in range(4)]
    quantities += [(cost, unit) for cost in ("C_help", "C_signal") for unit in ("seconds", "tokens")]
    printed = [*published()["reward"]["x"], 15, 15, 15, 15]
    rows = [
        {
            "quantity": q, "unit": unit, "printed": p, "measured": p + i + 0.25, "se": 0.125, "sd": 0.5,
            "difference": i + 0.25, "percent": 100 * (i + 0.25) / p,
        }
        for i, ((q, unit), p) in enumerate(zip(quantities, printed, strict=True))
    ]  # fmt: skip
    tried = {
        "setting": "default", "map": "four_rooms", "seconds": 173.0, "human_step_ticks": 5, "human_lapse": 0.45,
        **{f"x_s{s}": 40.5 + s for s in range(4)}, "brackets": True, "rms": 6.5, "largest": 9.5, "C_help": 6.25,
        "C_signal": 28.5, "C_help_tokens": 3.5, "C_signal_tokens": 9.25, "freed": 68.0, "not_freed": 46.0,
        "unseen": 0,
    }  # fmt: skip
    rates = [{"condition": "help+signal", "truth": 0.9, "direct simulation": 0.8, "game": 0.7}]
    result = {
        "table": rows, "studies": 20, "participants": 540, "game": game_settings(), "search": [tried],
        "search_studies": 10, "learning": {"rates": rates}, "sentence": "The game was measured.",
    }  # fmt: skip
    return evidence.record("The game: simulated.", "prosocial replicate game", 1, result, ("models.game.rounds",))


def section_of(data, out, states=(2,)):
    return build_report(data, states=states, quick=True, out=out, sections=ONLY, date="2026-01-31").sections[0]


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def shown(pages):
    return section_of(datasets.load("simulated_study1"), pages)


def table(shown, key):
    return next(t for t in shown.tables if t.key == key)


def test_ours_stands_beside_printed(shown):
    frame = table(shown, "study2-anova").frame.set_index(["outcome", "effect"])
    assert frame.loc[("team performance", "time"), "printed_f"] == 50.5082
    assert np.isfinite(frame.loc[("team performance", "time"), "simulated_f"])
    tukey = "study2-tukey-team-performance"
    for key, printed in (("study2-anova", "printed_f"), (tukey, "printed_difference")):
        own = table(shown, key)
        assert printed in own.printed
        assert set(own.origin) == {Origin.SIMULATED, Origin.PRINTED}
    assert table(shown, tukey).frame.set_index("policy").loc["never", "printed_difference"] == -12.96
    help_rates = table(shown, "study2-tukey-observation").frame.set_index("policy")
    assert help_rates.loc["never", "printed_difference"] == -0.17


def test_beliefs_are_said_to_be_on_the_robots_scale(shown):
    said = " ".join(shown.sentences)
    assert "tests of it differ with the fit and say nothing about people" in said
    assert "2 further searches of the same data found" in said
    assert "other fits give other numbers" in said
    for key in ("study2-anova", "study2-means", "study2-policies", "study2-tukey-belief"):
        assert "own scale" in table(shown, key).caption


def test_what_the_fit_decides_has_no_share(shown):
    frame = table(shown, "study2-claims-table").frame.set_index("conclusion")
    own = frame.loc["BELIEF RISES FASTER"]
    assert np.isnan(own["em"])
    assert 0 <= own["truth"] <= 1
    assert not frame.drop(index="BELIEF RISES FASTER").isna().any().any()
    assert frame.loc["above reactive, p < .01", "paper"] == "in the text; .01 in the table"
    figure = next(f for f in shown.figures if f.key == "study2-claims-em")
    assert "own scale: not decidable" in " ".join(figure.alt)
    assert {f.origin for f in shown.figures if "claims" in f.key} == {(Origin.SIMULATED,)}


def test_a_posterior_that_failed_is_laid_at_the_door_of_those_who_use_it(shown):
    (note,) = (s for s in shown.sentences if "Convergence gate FAILED" in s and "study 1:" in s)
    assert note.startswith("About Bayes-adaptive and cautious alone")


def test_outcomes_that_the_paper_does_not_compare_have_no_empty_columns(shown):
    own = table(shown, "study2-tukey-belief")
    assert (own.printed, own.origin) == ((), (Origin.SIMULATED,))
    assert not own.frame.isna().any().any()


def test_the_game_beside_the_paper(shown):
    own = table(shown, "study2-game-table")
    assert own.printed == ("printed",)
    assert set(own.origin) == {Origin.SIMULATED, Origin.PRINTED}
    frame = own.frame.set_index("quantity")
    assert frame["printed"].tolist() == [45, 48, 56, 67, 15, 15, 15, 15]
    assert frame.loc["x of state 2, tokens", "simulated"] == 58.25
    assert frame.loc["C_signal, seconds", "difference"] == 6.25
    tried = table(shown, "study2-game-settings").frame
    assert tried.iloc[0].to_dict() == {
        "setting": "default", "round": 173.0, "step": 0.5, "lapses": 45.0, "x0": 40.5, "x1": 41.5, "x2": 42.5,
        "x3": 43.5, "brackets": True, "rms": 6.5, "help": 6.25, "signal": 28.5,
    }  # fmt: skip
    assert table(shown, "study2-game-learning").frame["game"].tolist() == [0.7]
    assert "both by 2 standard errors" in table(shown, "study2-game-settings").caption
    assert "The game was measured." in shown.sentences


def test_tables_are_no_wider_than_a_narrow_page(browser, shown, pages):
    tab = browser.new_page(viewport={"width": 904, "height": 800})
    tab.goto((pages / "report.html").as_uri())
    tab.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true })")
    widths = tab.evaluate(
        "Array.from(document.querySelectorAll('.table .scroll'), "
        "part => [part.parentNode.id, part.scrollWidth, part.clientWidth])"
    )
    keys = {own.key for own in shown.tables}
    assert keys <= {key for key, *_ in widths}
    assert not [key for key, table_width, room in widths if key in keys and table_width > room]
    tab.set_viewport_size({"width": 390, "height": 800})
    assert tab.evaluate("document.documentElement.scrollWidth") == 390  # tables scroll, the page does not
    tab.close()


def test_every_policy_and_figure_is_there(shown):
    assert table(shown, "study2-means").frame["policy"].tolist() == [*PAPER, *MORE]
    keys = [f.key for f in shown.figures]
    assert keys == [
        "study2-game-scores", "study2-panels", "study2-panels-more", "study2-claims-em", "study2-claims-truth",
        "study2-printed",
    ]  # fmt: skip
    assert all(svg.startswith("<svg") for f in shown.figures for svg in f.svgs())


def test_what_is_said(shown):
    said = " ".join(shown.sentences)
    for words in (
        "SIMULATED people", "imply a standard error", "Mixed ANOVA of team performance", "mean belief moves",
        "so many lead to the paper's conclusions", "lie outside the middle 90% of simulated studies",
        "calibrated to study 1's printed statistics",
    ):  # fmt: skip
        assert words in said


def test_evidence_of_another_game_is_called_so(shown, little, tmp_path, monkeypatch):
    assert "another game" not in " ".join(shown.sentences)
    content = json.loads((little / "study2.json").read_text())
    content["game"]["parameters"]["round_ticks"] += 1
    (tmp_path / "study2.json").write_text(json.dumps(content))
    game = json.loads((little / "game.json").read_text())
    game["game"]["map"][1] = game["game"]["map"][1][::-1]
    (tmp_path / "game.json").write_text(json.dumps(game))
    monkeypatch.setattr(evidence, "FOLDER", tmp_path)
    other = section_of(data_set(simulate_study1(participants=60), kind="simulated"), tmp_path / "out")
    assert sum("another game" in sentence for sentence in other.sentences) == 2


def test_where_the_truth_is_not_known_only_evidence_is_shown(tmp_path):
    other = section_of(data_set(simulate_study1(participants=60), kind="simulated"), tmp_path)
    one = next(b for b in other.blocks if isinstance(b, Part) and b.key == "study2-one")
    assert isinstance(one.blocks[0], Omitted)
    assert "here it is not" in one.blocks[0].reason
    assert "study2-claims-em" in {f.key for f in other.figures}


def test_one_state_and_no_evidence(tmp_path, monkeypatch):
    monkeypatch.setattr(evidence, "FOLDER", tmp_path)
    shown = section_of(datasets.load("simulated_study1"), tmp_path / "one", states=(1,))
    reasons = [b.reason for b in shown.flat() if isinstance(b, Omitted)]
    assert any("one state never acts" in r for r in reasons)
    assert sum("no evidence is stored" in r for r in reasons) == 2


def test_another_protocol_is_left_out(tmp_path):
    shown = section_of(data_set(random_log(CORRIDOR, people=30)), tmp_path)
    assert "the game plays the published rounds" in shown.omitted
