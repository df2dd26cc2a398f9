"""What a round is worth by hidden state, against sums by hand."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.game_study import play_study1
from analysis.simulate import calibrated_truth, simulate_study1
from analysis.state_scores import state_scores
from models.errors import InputError
from models.inference import smoothed
from models.lspomdp import LatentStatePOMDP


@pytest.fixture(scope="module")
def played():
    return play_study1(participants=200, seed=3)


def test_scores_are_weighted_means(played):
    log, truth = played.log, calibrated_truth()
    weight, tokens = smoothed(truth, log), log.tokens["team_tokens"]
    scores = state_scores(truth, log)
    for s in range(4):
        assert scores[s] == pytest.approx(
            sum(w * t for w, t in zip(weight[:, s], tokens, strict=True)) / sum(weight[:, s]), rel=1e-12
        )
    one = LatentStatePOMDP(
        np.ones(1), np.ones((4, 1, 1)), truth.emission.mean(axis=1, keepdims=True), truth.protocol
    )
    assert state_scores(one, log) == pytest.approx([tokens.mean()])


def test_scores_want_tokens(played):
    with pytest.raises(InputError, match=r"simulated_study1.*team_tokens"):
        state_scores(calibrated_truth(), simulate_study1(participants=20))
    gone = {"team_tokens": np.where(np.arange(played.log.n_events) == 3, np.nan, 1.0)}
    with pytest.raises(InputError, match="the team's tokens at every event"):
        state_scores(calibrated_truth(), replace(played.log, tokens=gone))
