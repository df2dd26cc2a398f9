"""Designs of a next study: their histories against sums over state paths, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.design import study1_design
from models.errors import InputError
from models.protocol import PUBLISHED
from models.robust import study_design
from models.robust.draw_groups import DrawGroups
from models.robust.study_data import history_probabilities, simulated_weights
from models.robust.study_design import Arm, NextStudy
from tests.models.robust.information_cases import constant, contested, next_studies
from tests.reference.information import arm_histories, history_probability

ACTIONS = {"human_needs_help": "help", "robot_needs_help": "signal"}


@given(next_studies(max_events=4), st.integers(0, 99))
def test_histories_equal_sums_over_paths(study, seed):
    draws = contested(seed, 3)
    found = study.history_probabilities(draws)
    wanted = [
        [share * history_probability(draws, d, arm, h) for arm, share in zip(study.arms, study.shares, strict=True)
         for h in arm_histories(arm)]
        for d in range(3)
    ]  # fmt: skip
    assert found == pytest.approx(np.array(wanted), rel=1e-12, abs=1e-15)
    assert found.sum(axis=1) == pytest.approx(np.ones(3))


def test_kinds_of_people_are_averaged():
    draws = contested(2, 6)
    groups, study = DrawGroups.of(draws, 3), constant("HRH")
    each = study.history_probabilities(draws)
    wanted = [groups.share[u] @ each[3 * u : 3 * u + 3] for u in range(2)]
    assert history_probabilities(study, draws, groups) == pytest.approx(np.array(wanted))
    assert history_probabilities(study, draws, groups, np.array([1])) == pytest.approx(np.array(wanted[1:]))


def test_published_conditions():
    for condition in study1_design().conditions:
        for schedule in study1_design().schedules:
            arm = Arm.constant(PUBLISHED, schedule, condition.actions)
            assert arm.n_histories == 2 ** schedule.count("H")
    assert Arm.constant(PUBLISHED, "HRHRHRHRH", ACTIONS).words == "HRHRHRHRH, signal help"
    assert Arm.random(PUBLISHED, "HRHRH").n_histories == 4**3 * 2**2
    assert Arm.random(PUBLISHED, "HR", {"help": 0.25, "no_help": 0.75}).words == (
        "HR, (no_signal or signal) (no_help 0.75 or help 0.25)"
    )
    varying = Arm.listed(PUBLISHED, "HRHR", ["signal", "help", "no_signal", "help"])
    assert varying.words == "HRHR, signal help no_signal help"
    assert varying.events == 3
    both = NextStudy.of_arms("both", [varying, Arm.random(PUBLISHED, "H")], [3, 1])
    assert both.shares == (0.75, 0.25)
    assert both.words.startswith("HRHR, signal help no_signal help; H, ")


def test_data_are_bayes_rule():
    """Weights after data: likelihood of the counts times what was believed, one participant after the other."""
    draws, study = contested(6, 4), constant("HRH")
    groups = DrawGroups.of(draws)
    weight = simulated_weights(study, draws, groups, (1, 5), range(40), seed=3).weight
    chance = study.history_probabilities(draws)
    after_one = draws.weight[:, None] * chance
    after_one /= after_one.sum(axis=0)
    seen = [int(np.argmin(np.abs(after_one.T - w).sum(axis=1))) for w in weight[:, 0]]
    assert weight[:, 0] == pytest.approx(after_one.T[seen], rel=1e-9)
    assert weight.sum(axis=2) == pytest.approx(np.ones((40, 2)))
    # A replicate depends on nothing but itself, and a smaller study is the beginning of a larger one.
    again = simulated_weights(study, draws, groups, (1, 2, 5, 60), range(17, 19), seed=3).weight
    assert again[:, [0, 2]] == pytest.approx(weight[17:19], rel=1e-12)


def test_data_come_from_what_is_believed():
    """The mean of what would be believed is what is believed; so is the mean over 2,000 data sets."""
    draws, study = contested(6, 4), constant("HRH")
    weight = simulated_weights(study, draws, DrawGroups.of(draws), (3, 30), range(2000), seed=1).weight
    error = weight.std(axis=0) / np.sqrt(2000)
    assert np.all(np.abs(weight.mean(axis=0) - draws.weight) < 4 * error)
    assert weight[:, 1].std() > 1.1 * weight[:, 0].std()


def test_a_response_that_cannot_be_rules_a_draw_out():
    draws = contested(1, 2)
    emission = draws.emission.copy()
    emission[0, :, :, :] = (1.0, 0.0)
    draws = type(draws)(
        draws.protocol, draws.initial, draws.transition, emission, draws.weight, reward=draws.reward
    )  # fmt: skip
    weight, truth = simulated_weights(constant("H"), draws, DrawGroups.of(draws), (200,), range(60), seed=1)
    weight = weight[:, 0, 0]
    assert np.all((weight == 0) | (weight > 0.9))
    assert np.array_equal(weight > 0, truth == 0)
    assert 0 < np.mean(weight == 0) < 1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Arm.constant(PUBLISHED, "HR", {"nap": "help"}), r"arm, mode: found 'nap', wanted one of human_"),
        (lambda: Arm.constant(PUBLISHED, "HR", {"human_needs_help": "signal"}),
         r"action in mode human_needs_help: found 'signal', wanted one of no_help, help"),
        (lambda: Arm.constant(PUBLISHED, "HR", {"human_needs_help": "help"}),
         r"modes with an action: found human_needs_help, wanted robot_needs_help too"),
        (lambda: Arm.listed(PUBLISHED, "HR", ["signal"]), r"arm, actions: found 1, wanted 2, one an event"),
        (lambda: Arm.listed(PUBLISHED, "HR", ["signal", "signal"]), r"event 2, action: found 'signal'"),
        (lambda: Arm.listed(PUBLISHED, "HX", ["signal", "signal"]), r"letter 2: found 'X'"),
        (lambda: Arm.random(PUBLISHED, "HR", {"help": 0.4}), r"event 2 \(human_needs_help\), probabilities of act"),
        (lambda: Arm.random(PUBLISHED, "HR", {"hug": 1}), r"arm, action: found 'hug'"),
        (lambda: Arm(PUBLISHED, (), ()), r"arm, events: found 0 modes, 0 actions"),
        (lambda: NextStudy("x", ()), r"a name and at least one arm"),
        (lambda: NextStudy("x", (Arm.random(PUBLISHED, "H"),), (0.5,)), r"sum of the shares: found 0.5, wanted 1"),
        (lambda: NextStudy("x", (Arm.random(PUBLISHED, "H"),), (0.5, 0.5)), r"shares: found \(0.5, 0.5\)"),
        (lambda: NextStudy.of_arms("x", [Arm.random(PUBLISHED, "H")], [0]), r"people by arm: found \[0.0\]"),
    ],
)  # fmt: skip
def test_what_is_no_design(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_too_many_histories(monkeypatch):
    monkeypatch.setattr(study_design, "MOST_HISTORIES", 100)
    with pytest.raises(InputError, match=r"study 'wide': found 256 histories, wanted at most 100"):
        NextStudy("wide", (Arm.random(PUBLISHED, "HRHRH"),))
