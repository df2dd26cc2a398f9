import numpy as np
import pytest
from scipy import stats

from analysis.participant_flow import (
    dropout_after_response,
    flow_table,
    lengths_by_design,
    mantel_haenszel,
    short_runs,
    still_going,
)
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
    # One informative round (the first): 1 of 1 against 1 of 3, an excess of half a person.
    assert found.p_value == pytest.approx(1.0)
    assert found.odds_ratio == np.inf
    assert "Mantel-Haenszel" in found.sentence


def admissions():
    """Berkeley 1973, the example of R's `mantelhaen.test`: six departments, men and women, admitted or not."""
    men = [(512, 313), (353, 207), (120, 205), (138, 279), (53, 138), (22, 351)]
    women = [(89, 19), (17, 8), (202, 391), (131, 244), (94, 299), (24, 317)]
    return np.array([[m, w] for m, w in zip(men, women, strict=True)])


def test_mantel_haenszel_of_a_published_example():
    found = mantel_haenszel(admissions())
    assert found.df == 1
    assert found.statistic == pytest.approx(1.4269, abs=5e-5)
    assert found.p_value == pytest.approx(0.2323, abs=5e-5)
    assert found.odds_ratio == pytest.approx(0.9046968, abs=5e-8)


def test_general_form_is_the_uncorrected_one_with_two_rows():
    tables = admissions()
    split = np.concatenate([tables, np.zeros((6, 1, 2), dtype=int)], axis=1)  # a third row that is never used
    found = mantel_haenszel(split)
    assert (found.df, found.statistic) == (1, pytest.approx(1.5246, abs=5e-5))


def test_general_form_of_one_stratum_is_pearsons():
    table = np.array([[10, 20], [15, 5], [8, 12]])
    found = mantel_haenszel(table[None])
    pearson = stats.chi2_contingency(table, correction=False)
    n = table.sum()
    assert found.df == pearson.dof
    assert found.statistic == pytest.approx(pearson.statistic * (n - 1) / n)


def test_strata_without_contrast_tell_nothing():
    assert mantel_haenszel(np.array([[[3, 0], [2, 0]], [[0, 1], [0, 0]]])) is None
    assert mantel_haenszel(np.array([[[3, 0], [2, 0], [1, 0]]])) is None


def test_leaving_late_and_refusing_late_is_not_leaving_after_refusing():
    """Both rise with the round, independently within it: pooled over rounds it looks like an effect."""
    rng = np.random.default_rng(1)
    runs = []
    for person in range(600):
        events = []
        for k in range(4):
            events.append(REFUSE if rng.random() < (0.1, 0.1, 0.8, 0.8)[k] else HELP)
            if k < 3 and rng.random() < (0.02, 0.02, 0.4)[k]:
                break
        runs.append((person, 0, "c", events))
    found = dropout_after_response(log_of(runs))
    counts = found.table[["stopped", "went_on"]].to_numpy()
    assert stats.fisher_exact(counts).pvalue < 1e-6
    assert found.p_value > 0.05


def test_planned_lengths_are_told_from_stragglers():
    planned = [(i, 0, "c", [HELP] * (3 if i % 2 else 6)) for i in range(20)]
    assert lengths_by_design(log_of(planned)) == ("c",)
    straggling = [(i, 0, "c", [HELP] * (i + 1 if i < 3 else 6)) for i in range(40)]
    assert lengths_by_design(log_of(straggling)) == ()
    assert lengths_by_design(log_of([(0, 0, "c", [HELP]), (1, 0, "c", [HELP] * 2)])) == ()


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
    assert "generalised Mantel-Haenszel" in found.sentence
