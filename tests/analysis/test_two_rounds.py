"""A study of the paper's people and conditions but of two rounds a run: what a report must not say of it."""

import matplotlib.pyplot as plt
import pandas as pd
import pytest

from analysis import datasets
from analysis.design import published
from analysis.figures.held_out import held_out_by_round
from analysis.report.context import ReportContext
from analysis.report.effort import Effort
from analysis.report.section import NotSupported
from analysis.report.sections import anova, evidence, power, regression_coverage
from analysis.study_selection import select
from models.events import EventLog
from models.histories import UNSEEN
from tests.analysis.report_cases import data_set


def context_of(log):
    chosen = select(data_set(log, kind="simulated"), None, "2", None)
    return ReportContext(chosen, None, 1, Effort.of(True), published(), "", "2026-01-01")


@pytest.fixture(scope="module")
def whole():
    return datasets.load("simulated_study1").log


@pytest.fixture(scope="module")
def two(whole):
    frame = whole.to_frame()
    return EventLog.from_frame(frame[frame["k"] < 2], whole.protocol)


def test_what_was_simulated_for_five_rounds_is_not_shown(whole, two):
    five, short = context_of(whole), context_of(two)
    assert five.is_published_schedule
    assert five.is_published_design
    assert not short.is_published_schedule
    assert not short.is_published_design, "though there are 540 people under its four conditions"
    for make in (evidence.make, regression_coverage.coverage, power._simulated):
        make(five)
        with pytest.raises(NotSupported, match="this study has another"):
            make(short)


def test_fewer_people_of_the_design_have_its_evidence_and_not_its_numbers(whole):
    some = context_of(whole.select(participants=range(300)))
    assert some.is_published_schedule
    assert not some.is_published_design


def test_people_without_any_response_are_counted(two):
    words = " ".join(text for part in anova._own(context_of(two)) for text in texts(part))
    times = pd.Series(two.participant[two.run_of_event[two.response != UNSEEN]]).value_counts()
    silent, once = two.n_participants - len(times), int((times == 1).sum())
    assert silent > 0
    assert f"Left out: {once} people without a value at some time" in words
    assert f"Left out too: {silent} people without any response." in words


def texts(part):
    return [block.text for block in part.blocks if hasattr(block, "text")]


def test_one_round_has_one_tick():
    row = {"contender": "constant", "at": "1", "expected": 0.5, "low": 0.3, "high": 0.7, "observed": 0.4}
    table = pd.DataFrame([{**row, "observed_low": 0.3, "observed_high": 0.5}])
    ax = held_out_by_round(
        table, shown="constant", order=["constant"], measure="helping rate", limits=(0.0, 1.0), title="HR"
    )
    assert ax.get_xticks().tolist() == [1]
    plt.close(ax.figure)
