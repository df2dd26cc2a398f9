"""Study 1 in the game: the people of the direct simulation, with tokens."""

import numpy as np
import pytest

from analysis.game_study import play_study1, simulate_study1_in_game
from analysis.simulate import calibrated_truth, simulate_study1
from models.events import EventLog
from models.game.parameters import GameParameters

PEOPLE = 200


@pytest.fixture(scope="module")
def played():
    return play_study1(participants=PEOPLE, seed=3)


def test_people_and_responses_are_those_of_the_direct_simulation(played):
    direct = simulate_study1(participants=PEOPLE, seed=3)
    log = played.log
    assert not played.rounds.unseen_willingness.any()
    for name in ("offsets", "participant", "condition", "action", "response"):
        assert (getattr(log, name) == getattr(direct, name)).all()
    assert (played.willing == (direct.response == 1)).all()
    assert log.study == "simulated_study1_in_game"


def test_tokens_are_those_of_the_rounds(played):
    tokens = played.log.tokens
    assert (tokens["team_tokens"] == tokens["human_tokens"] + tokens["robot_tokens"]).all()
    assert (tokens["human_tokens"] == played.rounds.human_tokens).all()
    again = EventLog.from_frame(played.log.to_frame())
    assert (again.response == played.log.response).all()
    assert all((again.tokens[name] == tokens[name]).all() for name in tokens)
    same = simulate_study1_in_game(participants=PEOPLE, seed=3, threads=1)
    assert all((same.tokens[name] == tokens[name]).all() for name in tokens)
    other = simulate_study1_in_game(participants=PEOPLE, seed=4)
    assert (other.tokens["team_tokens"] != tokens["team_tokens"]).any()


def test_a_response_is_what_was_seen():
    short = play_study1(participants=PEOPLE, seed=3, parameters=GameParameters(round_ticks=260))
    unseen = short.rounds.unseen_willingness
    assert unseen.sum() > 50
    assert (short.log.response[unseen] == 0).all()
    assert (short.log.response == simulate_study1(participants=PEOPLE, seed=3).response)[~unseen].all()


def test_help_in_the_game_is_as_frequent_as_the_truth_says():
    """Every condition, schedule and round against the exact probability, and against another direct simulation."""
    truth, n = calibrated_truth(), 5_000
    log = simulate_study1_in_game(participants=n, seed=11)
    direct = simulate_study1(participants=n, seed=12)
    cells = 0
    schedules, direct_schedules = log.schedules(), direct.schedules()
    for condition in log.conditions:
        for schedule in np.unique(schedules):
            runs = (schedules == schedule) & (np.array(log.conditions)[log.condition] == condition)
            same = (direct_schedules == schedule) & (np.array(direct.conditions)[direct.condition] == condition)
            belief = truth.initial
            for k in range(len(schedule)):
                events, others = log.offsets[:-1][runs] + k, direct.offsets[:-1][same] + k
                action = log.action[events[0]]
                if log.shows[events[0]]:
                    p = float(belief @ truth.emission[truth.emission_index[action], :, 1])
                    seen, m = float((log.response[events] == 1).mean()), len(events)
                    assert abs(seen - p) < 4.5 * np.sqrt(p * (1 - p) / m)
                    drawn = float((direct.response[others] == 1).mean())
                    assert abs(seen - drawn) < 4.5 * np.sqrt(p * (1 - p) * (1 / m + 1 / len(others)))
                    cells += 1
                belief = belief @ truth.transition[action]
    assert cells == 4 * 6 * 3  # conditions, schedules, and the rounds of each in which the robot needs help
