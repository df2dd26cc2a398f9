"""One's own arms again, as a next study."""

import numpy as np
import pytest

from analysis.design import study1_design
from analysis.next_studies import FEW_HISTORIES, next_rounds, own_studies, published_studies, same_arms
from analysis.simulate import simulate_study1
from models.protocol import PUBLISHED
from models.robust.study_design import Arm
from models.unseen import without_actions
from tests.analysis.report_cases import CORRIDOR, log_of, random_log


def test_the_published_arms_come_out_of_published_data():
    log = simulate_study1(participants=200, seed=5)
    again = same_arms(log, PUBLISHED, "HRHRH")
    arms = {Arm.constant(PUBLISHED, "HRHRH", c.actions) for c in study1_design().conditions}
    assert set(again.arms) == arms
    people = {c: len(np.unique(log.participant[log.condition == i])) for i, c in enumerate(log.conditions)}
    assert sorted(again.shares) == pytest.approx(sorted(n / 200 for n in people.values()))
    assert again.name == f"the same {len(arms)} arms over HRHRH"
    singly = {study.arms[0] for study in published_studies(PUBLISHED, "HRHRH")}
    assert arms < singly


def test_arms_whose_actions_varied_are_drawn_as_often_as_they_were_met():
    runs = [
        (1, 0, "varied", [("signal", "help"), ("no_signal", "help"), ("help", "none")]),
        (2, 0, "varied", [("signal", "no_help"), ("signal", "help")]),
        (3, 0, "plain", [("no_help", "none"), ("no_signal", "no_help")]),
    ]
    again = same_arms(log_of(runs), PUBLISHED, "HR")
    found = dict(zip(again.arms, again.shares, strict=True))
    varied = Arm.random(PUBLISHED, "HR", {"signal": 0.75, "no_signal": 0.25, "help": 1.0})
    plain = Arm.random(PUBLISHED, "HR", {"no_signal": 1.0, "no_help": 1.0})
    assert found == {varied: pytest.approx(2 / 3), plain: pytest.approx(1 / 3)}


def test_a_mode_that_nobody_met_gets_its_null_action():
    runs = [(1, 0, "a", [("signal", "help")]), (2, 0, "a", [("no_signal", "help")])]
    again = same_arms(log_of(runs), PUBLISHED, "RH")
    assert {arm.words for arm in again.arms} == {"RH, no_help signal", "RH, no_help no_signal"}


def test_arms_with_an_action_that_is_left_out_are_left_out():
    from analysis.simulate import calibrated_truth
    from models.model_draws import ModelDraws

    smaller = without_actions(ModelDraws.from_models([calibrated_truth()]), ["signal"]).protocol
    log = simulate_study1(participants=80)
    again = same_arms(log, smaller, "HR")
    assert len(again.arms) == 2
    only = log.select(conditions=[c for c in log.conditions if c.endswith("+signal")])
    assert same_arms(only, smaller, "HR") is None
    (varied,) = own_studies(only, smaller, "HR")
    assert varied.name == "random actions over HR"


def test_random_actions_stand_beside():
    log = random_log(CORRIDOR)
    again, varied = own_studies(log, CORRIDOR, "SPD")
    assert (len(again.arms), len(varied.arms)) == (2, 1)
    assert again.history_probabilities is not None


def test_rounds_are_as_many_as_can_be_valued():
    assert next_rounds(PUBLISHED, "HRHRHRHRH") == "HRHRHR"
    assert Arm.random(PUBLISHED, "HRHRHR").n_histories <= FEW_HISTORIES
    assert next_rounds(CORRIDOR, "SDSDSDSD") == "SDSD"
    assert next_rounds(CORRIDOR, "SD", histories=1) == "S"
