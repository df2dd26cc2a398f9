"""Which states are which where nobody met both actions."""

import numpy as np
import pytest

from analysis.design import study1_design
from analysis.simulate import simulate_study1
from models.arm_matching import Unmatched, unmatched_actions
from models.baum_welch import BaumWelch
from models.events import EventLog
from models.identification import identification
from models.inference import log_likelihood
from models.lspomdp import LatentStatePOMDP
from models.protocol import PUBLISHED


@pytest.fixture(scope="module")
def study() -> EventLog:
    return simulate_study1(participants=80, seed=6)


def test_arms_of_the_published_design_are_held_together_by_the_other_mode(study):
    (found,) = unmatched_actions(study)
    assert found == Unmatched((("no_signal",), ("signal",)), ("no_help", "help"))
    assert found.sentence == (
        "Nobody met both no_signal and signal. That a state under one of them is the same as under the other rests "
        "on what these people share: how frequent states are at the start, and how people move after no_help and "
        "help."
    )
    assert len(study1_design().conditions) == 4


def test_with_one_arm_nothing_has_to_be_matched(study):
    one = study.select(conditions=[study.conditions[0]])
    assert unmatched_actions(one) == ()


def test_one_person_who_met_both_links_them(study):
    action = study.action.copy()
    names = np.array(PUBLISHED.action_names)
    first = np.flatnonzero((study.run_of_event == 0) & study.shows & (study.response >= 0))
    other = {"signal": "no_signal", "no_signal": "signal"}[str(names[action[first[0]]])]
    action[first[-1]] = PUBLISHED.action(other)
    assert len(first) > 1
    assert unmatched_actions(_with_actions(study, action)) == ()


def test_types_are_matched_by_their_shares_alone(study):
    """The likelihood of types does not change if they swap under one action, where they are equally frequent."""
    fit = BaumWelch(2, restarts=3, finalists=2, pins=dict.fromkeys(PUBLISHED.action_names)).fit(study)
    (found,) = identification(fit, study).unmatched
    assert found.shared == ()
    assert "rests on shares at the start alone" in found.sentence
    assert found.sentence in identification(fit, study).sentences()

    def of_shares(share: float, swapped: bool) -> float:
        emission = np.array([[[0.8, 0.2], [0.3, 0.7]], [[0.6, 0.4], [0.1, 0.9]]])
        if swapped:
            emission[1] = emission[1, ::-1]
        stay = np.tile(np.eye(2), (4, 1, 1))
        return log_likelihood(LatentStatePOMDP([share, 1 - share], stay, emission, PUBLISHED), study)

    assert of_shares(0.5, False) == pytest.approx(of_shares(0.5, True), abs=1e-9)
    assert abs(of_shares(0.7, False) - of_shares(0.7, True)) > 1


def _with_actions(log: EventLog, action: np.ndarray) -> EventLog:
    frame = log.to_frame().astype({"action": str})
    frame["action"] = np.array(PUBLISHED.action_names)[action]
    return EventLog.from_frame(frame, PUBLISHED)
