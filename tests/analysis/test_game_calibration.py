"""The game beside the paper's numbers."""

import numpy as np
import pytest

from analysis import game_calibration as calibration
from analysis.game_study import PlayedStudy, play_study1
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.game.parameters import GameParameters
from models.game.rounds import RoundOutcomes
from models.lspomdp import LatentStatePOMDP

PEOPLE = 200


@pytest.fixture(scope="module")
def played():
    return play_study1(participants=PEOPLE, seed=3)


def test_interruptions_by_hand(played):
    # Rounds: free, free, helping, signalling, signalling, trapped in silence.
    named, acts = np.array([0, 0, 0, 1, 1, 1], np.int8), np.array([0, 0, 1, 1, 1, 0], bool)
    robot, ticks = np.array([30, 32, 28, 20, 10, 0], np.int32), np.array([0, 0, 70, 100, 300, 900], np.int32)
    nothing = np.zeros(6, np.int32)
    rounds = RoundOutcomes(named, acts, acts, nothing, robot, nothing, nothing, ticks, nothing)
    study = PlayedStudy(played.log, acts, rounds)
    assert calibration.interruptions(study) == (7.0, 3.0, 20.0, 16.0)
    with pytest.raises(InputError, match="no round with the robot helping"):
        calibration.interruptions(PlayedStudy(played.log, acts, rounds.some((named == 1) | ~acts)))


def test_calibration_beside_print():
    found = calibration.calibrate_game(studies=3, participants=PEOPLE, seed=2)
    again = calibration.calibrate_game(studies=3, participants=PEOPLE, seed=2, threads=1)
    assert found.table.equals(again.table)
    table = found.table.set_index(["quantity", "unit"])
    assert table["printed"].tolist() == [45, 48, 56, 67, 15, 15, 15, 15]
    assert (table["difference"] == table["measured"] - table["printed"]).all()
    assert table["se"].to_numpy() == pytest.approx(table["sd"].to_numpy() / np.sqrt(3))
    assert found.tolerance == table["difference"].iloc[:4].abs().max()
    assert found.unseen == 0
    assert "3 simulated studies of 200 people" in found.sentence
    assert "came too late" not in found.sentence


def test_the_default_game_brackets_the_printed_scores():
    # What the defaults were chosen for: states in the printed order, from below 45 to above 67.
    found = calibration.calibrate_game(studies=4, seed=5)
    x, se = found.scores, found.table["se"].to_numpy()
    assert (np.diff(x) > 0).all()
    assert x[0] + 2 * se[0] <= 45
    assert x[3] - 2 * se[3] >= 67
    assert found.margins == pytest.approx((45 - x[0] - 2 * se[0], x[3] - 67 - 2 * se[3]))
    assert found.brackets
    assert "They bracket 45 and 67" in found.sentence
    # And no further from the printed ones than their shape demands: help gets likelier most between the truth's
    # lower states, so there tokens rise most, where printed scores rise least.
    assert found.rms < 7
    assert found.rms == pytest.approx(np.sqrt(np.mean((x - [45, 48, 56, 67]) ** 2)))
    ways = (x[1:3] - x[0]) / (x[3] - x[0])
    assert (
        f"lie {ways[0]:.0%} and {ways[1]:.0%} of the way from lowest to highest, printed 14% and 50%"
        in found.sentence
    )
    assert found.unseen == 0


def test_a_short_round_does_not_bracket():
    found = calibration.calibrate_game(parameters=GameParameters(round_ticks=1_000), studies=2, participants=PEOPLE)
    assert not found.brackets
    assert found.margins[1] < 0 < found.margins[0]
    assert "They do not bracket 45 and 67" in found.sentence


def test_another_smoother_has_no_printed_scores():
    truth = calibrated_truth()
    one = LatentStatePOMDP(
        np.ones(1), np.ones((4, 1, 1)), truth.emission.mean(axis=1, keepdims=True), truth.protocol
    )
    found = calibration.calibrate_game(smoother=one, studies=2, participants=40)
    assert found.table["printed"].isna().tolist() == [True, False, False, False, False]
    assert "nan" not in found.sentence
    assert not found.brackets
    assert "bracket" not in found.sentence
    content = found.to_dict()
    assert content["table"][0]["printed"] is None


def test_too_few_studies():
    with pytest.raises(InputError, match="calibration of the game, studies: found 1, wanted at least 2"):
        calibration.calibrate_game(studies=1)
