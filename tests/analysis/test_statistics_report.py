"""Report sections on analysis of variance and numbers of people, coverage, and what is printed of study 2."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from analysis import evidence
from analysis.anova import mixed_anova
from analysis.datasets import load
from analysis.design import published
from analysis.first_and_last import first_and_last, plain_condition
from analysis.power_formulas import FTestDesign, power
from analysis.power_printed import printed_sizes
from analysis.printed_anova import anova_consistency, printed_anova, printed_tukey
from analysis.report.build import build_report
from analysis.report.context import ReportContext
from analysis.report.registry import SECTIONS
from analysis.report.section import NotSupported, Omitted, Origin, Section
from analysis.report.sections import regression_coverage
from models.errors import InputError
from models.protocol import PUBLISHED
from tests.analysis.report_cases import CORRIDOR, data_set, log_of, random_log

KEYS = ("anova", "power")


def report_of(dataset, out, keys=KEYS):
    entries = [entry for entry in SECTIONS if entry.key in keys]
    made = build_report(dataset, states=(1,), quick=True, out=out, sections=entries)
    return {section.key: section for section in made.sections}, made.html.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def bundled(tmp_path_factory):
    return report_of(load("simulated_study1"), tmp_path_factory.mktemp("bundled"))


# -- first and last ------------------------------------------------------------------------------------
def test_first_and_last_responses_are_those_of_the_log():
    log = load("simulated_study1").log
    data = first_and_last(log)
    assert (data.times, data.times_by, data.dv, data.binary) == (("first", "last"), "asked", "help", True)
    run = int(np.argmax(np.bincount(log.run_of_event[log.response >= 0]) == 3))
    events = np.flatnonzero((log.run_of_event == run) & (log.response >= 0))
    person = data.people.index(str(log.participant[run]))
    names = [log.protocol.response_names[r] for r in log.response[events]]
    assert data.score[person].tolist() == [float(names[0] == "help"), float(names[-1] == "help")]
    assert data.groups[data.group[person]] == log.conditions[log.condition[run]]


def test_several_runs_are_averaged_and_single_responses_left_out():
    yes, no, other = ("no_signal", "help"), ("no_signal", "no_help"), ("help", "none")
    log = log_of(
        [
            (1, 0, "a", [yes, other, no, no]), (1, 1, "a", [no, no, yes]),
            (2, 0, "a", [yes, other]),  # one response only
            (3, 0, "a", [yes, no]), (3, 1, "a", [yes]),  # the second run has one only
            (4, 0, "b", [no, yes]), (5, 0, "b", [yes, no]), (6, 0, "b", [no, no]),
        ]
    )  # fmt: skip
    data = first_and_last(log)
    assert data.people == ("1", "3", "4", "5", "6")
    assert data.score.tolist() == [[0.5, 0.5], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 0.0]]
    assert data.left_out == ("2",)


def test_the_condition_without_acts_is_the_reference():
    assert plain_condition(load("simulated_study1").log) == "no-help+no-signal"
    assert plain_condition(random_log(PUBLISHED)) is None
    with pytest.raises(InputError, match="one level"):
        first_and_last(load("simulated_study1").log.select(conditions=["help+signal"]))


# -- as printed ----------------------------------------------------------------------------------------
def test_what_the_printed_tests_imply():
    table = printed_anova(published())
    assert (table["df2"] == 95).all()
    np.testing.assert_allclose(table["p_implied"], stats.f.sf(table["f"], table["df1"], 95), rtol=1e-9)
    np.testing.assert_allclose(table["cohens_f"] ** 2, table["f"] * table["df1"] / 95)
    assert table["agrees"].all()
    assert anova_consistency(table) == "All 9 printed p values follow from the printed F with 95 residual df."
    wrong = published()
    wrong = {
        "study2": {**wrong["study2"], "mixed_anova": {"observation": {"time": {"df": 1, "F": 4.0, "p": 0.01}}}}
    }
    assert "observed help, time: F(1, 95) = 4.0 implies p = 0.0484, 0.01 is printed" in anova_consistency(
        printed_anova(wrong)
    )
    assert len(printed_tukey(published())) == 8


# -- the sections --------------------------------------------------------------------------------------
def test_the_anova_section_is_that_of_the_log(bundled):
    section = bundled[0]["anova"]
    tables = {table.key: table for table in section.tables}
    assert set(tables) == {"anova-printed", "anova-printed-tukey", "anova-table", "anova-logistic", "anova-pairs"}
    result = mixed_anova(first_and_last(load("simulated_study1").log))
    pd.testing.assert_series_equal(tables["anova-table"].frame["f"], result.table["f"])
    assert result.sentence in section.sentences
    assert tables["anova-printed"].origin == (Origin.PRINTED, Origin.DEFINITION)
    assert tables["anova-table"].origin == (Origin.SIMULATED,)
    assert "(Type III)" in tables["anova-logistic"].caption
    assert [len(figure.svgs()) for figure in section.figures] == [1, 2]
    text = " ".join(section.sentences)
    assert "Its people are not part of this report" in text
    assert "This is not the paper's analysis of study 2" in text
    assert "Dunnett, help at response last" in text


def test_the_power_section_names_every_assumption(bundled):
    section = bundled[0]["power"]
    tables = {table.key: table for table in section.tables}
    frame = tables["power-sizes"].frame
    assert sorted(set(frame["printed"])) == [90, 200]
    frame = tables["power-matching"].frame
    row = frame[(frame["study"] == "study1") & frame["test"].str.startswith("effect between")].iloc[0]
    matched = FTestDesign("between", 4, times=5, rho=row["matching_rho"])
    assert power(matched, 200) == pytest.approx(0.95, abs=1e-9)
    assert printed_sizes().sentence in section.sentences
    figures = {figure.key: figure for figure in section.figures}
    assert [len(figures[key].svgs()) for key in figures] == [1, 2, 1, 1]
    assert figures["power-curves"].origin == (Origin.DEFINITION, Origin.PRINTED)
    assert figures["power-contraction-figure"].origin == (Origin.SIMULATED,)
    for name in ("power_mixed_model", "power_contraction"):
        assert evidence.read_evidence(name).sentence in section.sentences


def test_curves_are_power_by_formula():
    curves = printed_sizes().curves()
    assert len(curves.groupby(["study", "test"])) == 8
    part = curves[curves["test"] == "fixed effects, 4 groups, numerator df 1"]
    assert power(FTestDesign("fixed", 4, df=1), 200) == pytest.approx(
        np.interp(200, part["people"], part["power"]), abs=1e-3
    )


def test_other_protocols_have_no_printed_numbers(tmp_path):
    sections, page = report_of(data_set(random_log(CORRIDOR, people=40)), tmp_path)
    assert "this protocol is another" in sections["power"].omitted
    assert sections["anova"].omitted is None
    assert not [table for table in sections["anova"].tables if table.printed]
    assert "mean response score" in page


def test_one_condition_is_said(tmp_path):
    log = load("simulated_study1").log.select(conditions=["help+signal"])
    sections, _ = report_of(data_set(log), tmp_path)
    (left_out,) = [block for block in sections["anova"].flat() if isinstance(block, Omitted)]
    assert left_out.what == "the same tests on the people of this report"
    assert "one level (help+signal)" in left_out.reason


def test_evidence_that_is_absent_or_stale_is_said(tmp_path, monkeypatch):
    old = json.loads((evidence.FOLDER / "power_mixed_model.json").read_text()) | {"kernel_digest": "0123"}
    (tmp_path / "power_mixed_model.json").write_text(json.dumps(old))
    monkeypatch.setattr(evidence, "FOLDER", tmp_path)
    sections, _ = report_of(load("simulated_study1"), tmp_path / "out", ("power",))
    section = sections["power"]
    assert [b.what for b in section.flat() if isinstance(b, Omitted)] == [
        "evidence of expected contraction by number of people"
    ]
    (warned,) = [b.text for b in section.flat() if getattr(b, "kind", "") == "warning"]
    assert "STALE" in warned


# -- coverage, in the regression's section -------------------------------------------------------------
class Context:
    is_published_schedule = ReportContext.is_published_schedule

    def __init__(self, log):
        self.log, self.published = log, published()
        self.is_published_protocol = log.protocol == PUBLISHED


def test_coverage_is_shown_for_the_design_it_was_made_for():
    made = Section("t", "k", regression_coverage.coverage(Context(load("simulated_study1").log)))
    (table,) = made.tables
    stored = evidence.read_evidence("mixed_model")
    assert len(table.frame) == len(stored.content["table"])
    assert stored.sentence in made.sentences
    assert [len(figure.svgs()) for figure in made.figures] == [2, 2]
    assert {origin for block in (table, *made.figures) for origin in block.origin} == {Origin.SIMULATED}
    with pytest.raises(NotSupported, match="this study has another"):
        regression_coverage.coverage(Context(random_log(CORRIDOR)))
