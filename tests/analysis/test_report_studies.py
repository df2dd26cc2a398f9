"""What a report says of studies that differ: run lengths, designs, few or real people."""

import re
from dataclasses import replace

import numpy as np
import pytest

from analysis import datasets
from analysis.report.build import build_report
from analysis.report.registry import Entry
from analysis.report.sections import learned, learned_tables
from models.protocol import PUBLISHED
from tests.analysis.report_cases import data_set, log_of, random_log, small_study, some
from tests.analysis.report_page import Page

pytestmark = pytest.mark.usefixtures("short_reports")


@pytest.fixture
def small():
    return small_study()


def test_estimates_outside_their_own_interval_are_called_undetermined(small, tmp_path):
    def elsewhere(context):
        bootstrap = context.study.bootstraps[context.study.best_by_bic]
        moved = replace(bootstrap, emission=bootstrap.emission[:, :, ::-1])
        study = replace(context.study, bootstraps={context.study.best_by_bic: moved})
        return learned.make(replace(context, study=study))

    people = data_set(random_log(PUBLISHED, people=150), kind="simulated")
    made = build_report(people, states="2", quick=True, out=tmp_path, sections=[Entry("x", "X", elsewhere)])
    assert any("estimates lie outside their own interval" in s for s in made.sections[0].sentences)


def test_random_run_lengths_are_no_dropout(small, tmp_path):
    dataset = data_set(random_log(PUBLISHED, people=20, stop=0.3), run_length="random")
    only = some("flow")
    made = build_report(dataset, states="1", quick=True, out=tmp_path, sections=only)
    text = made.html.read_text(encoding="utf-8")
    assert "random by design" in text
    assert "runs cut short" not in text


PLANNED = [(i, 0, "c", [("signal", "help" if i % 2 else "no_help")] * (1 + i % 3)) for i in range(24)]


@pytest.mark.parametrize(
    ("run_length", "dropout"),
    [
        ("unstated", "run lengths differ by what may be design; say so on the data card or with --run-length"),
        ("random", "run lengths are random by design"),
        ("fixed", None),
    ],
)
def test_run_lengths_that_may_be_design_are_not_called_dropout(tmp_path, run_length, dropout):
    only = some("flow")
    dataset = data_set(log_of(PLANNED), run_length=run_length)
    made = build_report(dataset, states="1", quick=True, out=tmp_path, sections=only)
    text = made.html.read_text(encoding="utf-8")
    assert ("runs cut short" in text) == ("Mantel-Haenszel" in text) == (dropout is None)
    if dropout:
        assert dropout in " ".join(text.split())


def test_one_of_each_is_said_in_the_singular(tmp_path):
    only = some("provenance", "study", "flow", "states", "model", "limits")
    log = log_of([(0, 0, "c", [("signal", "help")])])
    made = build_report(data_set(log), states="1", quick=True, out=tmp_path, sections=only)
    text = " ".join(made.html.read_text(encoding="utf-8").split())
    for wanted in ("1 person in 1 condition, 1 run and 1 event", "1 person and 1 run.", "every run has 1 event,"):
        assert wanted in text
    assert not re.search(r"\b1 (people|runs|events|states|responses|rounds)\b", text)


def test_the_printed_value_stands_beside_its_own_design_only(tmp_path):
    only = some("states")
    people = small_study()
    made = build_report(people, states="1,4", quick=True, out=tmp_path, sections=only)
    assert "560.23" not in made.html.read_text(encoding="utf-8")
    (criteria,) = [t for t in made.sections[0].tables if t.key == "criteria"]
    assert "printed" not in criteria.frame


def test_what_a_chain_that_falls_apart_does_in_the_long_run_is_left_open(tmp_path):
    def pinned(context):
        return learned_tables.states(context, 2)

    people = data_set(random_log(PUBLISHED, people=40))
    made = build_report(
        people, states="2", quick=True, pins=["help"], out=tmp_path, sections=[Entry("x", "X", pinned)]
    )
    (table,) = made.sections[0].tables
    assert table.frame["stationary help"].isna().all()
    assert "not unique under" in table.caption
    assert "the chain falls apart" in table.caption


def test_dwell_times_at_the_edge_are_not_ranked():
    assert learned_tables.dwell_order(np.array([1.0, 2.0])) is None
    assert learned_tables.dwell_order(np.array([5.0, np.inf])) is None
    assert learned_tables.dwell_order(np.array([5.0, 1e9])) is None
    assert learned_tables.dwell_order(np.array([5.0, 1.2, 2.0])).tolist() == [1, 2, 0]


def test_real_people(shared, tmp_path, monkeypatch):
    monkeypatch.setenv("PROSOCIAL_DATA", str(shared / "data" / "real"))
    made = build_report(datasets.load("frd2012"), states="1,2", quick=True, out=tmp_path)
    text = made.html.read_text(encoding="utf-8")
    parsed = Page(text)
    assert "These data are REAL" in text
    assert "badge-simulated" not in {b for badges in parsed.captions for b in badges}
    assert "condition bc4_e8: 90 of 384 people" in text
    assert "random by design" in text
    assert "held fixed" in text
    assert "no evidence" in text
    assert made.study.fits[2].log_likelihood == pytest.approx(-1122.61, abs=0.01)
    # The printed log-likelihood belongs to four states, which were not asked for.
    assert "560.23" not in text
