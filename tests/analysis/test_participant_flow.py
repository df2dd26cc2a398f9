import numpy as np
import pytest
from scipy import stats

from analysis.participant_flow import dropout_after_response, flow_table, short_runs, still_going
from models.protocol import PUBLISHED
from tests.analysis.report_cases import CORRIDOR, log_of, random_log

HELP, REFUSE, SILENT, GONE = ("signal", "help"), ("signal", "no_help"), ("help", "none"), ("signal", "missing")


def test_counts_by_condition_and_everybody_once():
    log = log_of([(1, 0, "a", [HELP, SILENT, GONE]), (1, 1, "b", [HELP]), (2, 0, "a", [REFUSE, SILENT])])
    table = flow_table(log).set_index("condition")
    assert list(table.index) == ["a", "b", "all"]
    assert list(table["people"]) == [2, 1, 2]
    assert list(table["runs"]) == [2, 1, 3]
    assert list(table["events"]) == [5, 1, 6]
    assert list(table["recorded"]) == [2, 1, 3]
    assert list(table["missing"]) == [1, 0, 1]
    assert list(table["longest"]) == [3, 1, 3]
    # Short is said within a condition: the run of one event is the longest of b.
    assert list(table["short_runs"]) == [1, 0, 1]
    assert list(short_runs(log)) == [False, False, True]


def test_still_going_starts_at_one_and_falls():
    log = log_of([(i, 0, "c", [HELP] * n) for i, n in enumerate((1, 2, 2, 4))])
    assert list(still_going(log)["share"]) == [1.0, 0.75, 0.25, 0.25]


def test_dropout_counts_every_response_that_could_be_followed():
    log = log_of(
        [
            (0, 0, "c", [REFUSE]),  # stopped after refusing
            (1, 0, "c", [HELP, SILENT]),  # stopped after helping, although a silent event came between
            (2, 0, "c", [HELP, REFUSE, HELP]),  # complete: two went on, the last one could not
            (3, 0, "c", [HELP, HELP, SILENT]),  # complete: both were followed by something
        ]
    )
    found = dropout_after_response(log)
    table = found.table.set_index("response")
    assert list(table.loc["help", ["stopped", "went_on"]]) == [1, 3]
    assert list(table.loc["no_help", ["stopped", "went_on"]]) == [1, 1]
    assert found.p_value == pytest.approx(stats.fisher_exact([[1, 1], [1, 3]]).pvalue)
    assert "Fisher" in found.sentence


def test_leaving_after_refusing_is_found():
    rng = np.random.default_rng(1)
    runs = []
    for person in range(200):
        events = []
        for _ in range(6):
            events.append(HELP if rng.random() < 0.6 else REFUSE)
            if events[-1] is REFUSE and rng.random() < 0.5:
                break
        runs.append((person, 0, "c", events))
    found = dropout_after_response(log_of(runs))
    assert found.p_value < 1e-6
    assert "needs an argument" in found.sentence


def test_no_dropout_no_test():
    assert dropout_after_response(random_log(PUBLISHED)) is None
    assert dropout_after_response(log_of([(0, 0, "c", [HELP]), (1, 0, "c", [HELP, HELP])])) is None


def test_three_responses_are_tested_together():
    found = dropout_after_response(random_log(CORRIDOR, people=150, stop=0.1))
    assert list(found.table["response"]) == ["refused", "late", "helped"]
    assert np.isnan(found.odds_ratio)
    assert "chi-squared" in found.sentence
