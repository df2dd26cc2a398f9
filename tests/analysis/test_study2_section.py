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
from analysis.study2_evidence import study2_evidence
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
        folder = tmp_path_factory.mktemp("evidence")
        patch.setattr(evidence, "FOLDER", folder)
        tiny = Study2Replicates(
            person(), replicates=4, worlds=2, people=5, study1=60, states=2, sampler=NutsSettings(50, 50, 2)
        )
        made = study2_evidence(tiny, published()).to_dict()
        content = evidence.record("Study 2: simulated.", "prosocial replicate study2", 1, made)
        (folder / "study2.json").write_text(json.dumps(plain(content)))
        yield folder


def section_of(data, out, states=(2,)):
    return build_report(data, states=states, quick=True, out=out, sections=ONLY, date="2026-01-31").sections[0]


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    return section_of(datasets.load("simulated_study1"), tmp_path_factory.mktemp("report"))


def table(shown, key):
    return next(t for t in shown.tables if t.key == key)


def test_ours_stands_beside_printed(shown):
    frame = table(shown, "study2-anova").frame.set_index(["outcome", "effect"])
    assert frame.loc[("team performance", "time"), "printed_f"] == 50.5082
    assert np.isfinite(frame.loc[("team performance", "time"), "simulated_f"])
    for key, printed in (("study2-anova", "printed_f"), ("study2-tukey", "printed_difference")):
        own = table(shown, key)
        assert printed in own.printed
        assert set(own.origin) == {Origin.SIMULATED, Origin.PRINTED}
    pairs = table(shown, "study2-tukey").frame.set_index(["outcome", "policy"])
    assert pairs.loc[("tokens a round", "never"), "printed_difference"] == -12.96


def test_every_policy_and_figure_is_there(shown):
    assert table(shown, "study2-means").frame["policy"].tolist() == [*PAPER, *MORE]
    keys = [f.key for f in shown.figures]
    assert keys == [
        "study2-panels", "study2-panels-more", "study2-claims-em", "study2-claims-truth", "study2-printed"
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
    monkeypatch.setattr(evidence, "FOLDER", tmp_path)
    other = section_of(data_set(simulate_study1(participants=60), kind="simulated"), tmp_path / "out")
    assert "another game" in " ".join(other.sentences)


def test_where_the_truth_is_not_known_only_evidence_is_shown(tmp_path):
    other = section_of(data_set(simulate_study1(participants=60), kind="simulated"), tmp_path)
    one = next(b for b in other.blocks if isinstance(b, Part))
    assert isinstance(one.blocks[0], Omitted)
    assert "here it is not" in one.blocks[0].reason
    assert "study2-claims-em" in {f.key for f in other.figures}


def test_one_state_and_no_evidence(tmp_path, monkeypatch):
    monkeypatch.setattr(evidence, "FOLDER", tmp_path)
    shown = section_of(datasets.load("simulated_study1"), tmp_path / "one", states=(1,))
    reasons = [b.reason for b in shown.flat() if isinstance(b, Omitted)]
    assert any("one state never acts" in r for r in reasons)
    assert any("no evidence is stored" in r for r in reasons)


def test_another_protocol_is_left_out(tmp_path):
    shown = section_of(data_set(random_log(CORRIDOR, people=30)), tmp_path)
    assert "the game plays the published rounds" in shown.omitted
