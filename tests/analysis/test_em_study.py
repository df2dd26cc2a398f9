"""Choosing a number of states, and what is said about the published procedure."""

from types import SimpleNamespace

import pytest

from analysis.em_study import EmStudy, fewest, parse_states
from analysis.study_selection import select
from models.errors import InputError
from models.protocol import PUBLISHED
from tests.analysis.report_cases import CORRIDOR, data_set, random_log


def fit(log_likelihood, bic=0.0):
    optimum = SimpleNamespace(log_likelihood=log_likelihood, restarts=30, converged=30)
    return SimpleNamespace(log_likelihood=log_likelihood, bic=bic, optima=(optimum,), runs_in_final_stage=30)


def study(own, paper, protocol=PUBLISHED):
    log = SimpleNamespace(protocol=protocol)
    return EmStudy(log, {k: fit(v) for k, v in own.items()}, {k: fit(v) for k, v in paper.items()})


def test_ties_go_to_fewer_states():
    assert fewest({2: -9.0, 3: -5.009, 4: -5.0}) == 3
    assert fewest({4: -5.0, 3: -5.009}) == 3
    assert fewest({3: -5.02, 4: -5.0}) == 4
    assert study({3: -5.001, 4: -5.0}, {}).best_by_log_likelihood == 3
    tied = EmStudy(None, {2: fit(-9, 100.0), 3: fit(-8, 99.995), 4: fit(-7, 120.0)})
    assert tied.best_by_bic == 2


def test_the_papers_criterion_is_spoken_of_where_it_applies():
    both = {4: -5.0, 5: -4.0}
    said = study(both, {4: -5.0, 5: -5.5}).restarts_sentence
    assert "published procedure is highest at 4 states" in said
    assert "highest at the largest number fitted, 5, as it must be, up to ties" in said
    assert "highest log-likelihood at 4 states" in said
    assert "highest log-likelihood" not in study(both, both, CORRIDOR).restarts_sentence
    assert "highest log-likelihood" not in study({3: -5.0, 4: -4.0}, {3: -5.0, 4: -4.0}).restarts_sentence
    alone = study({5: -4.0}, {5: -4.0}).restarts_sentence
    assert "highest" not in alone
    assert alone.endswith("5 states: -4.00 against -4.00 (0 of 30 runs hit the cap).")


def test_a_longer_search_that_missed_a_maximum_is_not_praised():
    assert "missed the maximum" in study({2: -5.0, 3: -6.0}, {2: -5.0, 3: -5.0}).restarts_sentence


def test_one_state_is_one():
    assert "1 state: " in study({1: -5.0}, {1: -5.0}).restarts_sentence
    assert "highest at 1 state." in study({1: -5.0, 2: -5.0}, {1: -5.0, 2: -5.0}).restarts_sentence


@pytest.mark.parametrize("text", ["", " ", "4-2", "0-3", "2-13", "1-" + "9" * 30, "9" * 9999, "2,,3", "-3", "2-"])
def test_numbers_of_states_that_are_none(text):
    with pytest.raises(InputError, match="--states"):
        parse_states(text)


def test_an_empty_choice_is_not_the_default():
    dataset = data_set(random_log(PUBLISHED, people=8))
    assert select(dataset).states == (2, 3, 4, 5)
    with pytest.raises(InputError, match="--states: found ''"):
        select(dataset, states="")
