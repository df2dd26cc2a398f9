"""Study 1 in the game: the people of the direct simulation, with tokens."""

import numpy as np
import pytest

from analysis.game_study import (
    DIRECT,
    GAME,
    SHORT,
    implied_rates,
    learn_from_both,
    play_study1,
)
from analysis.simulate import calibrated_truth, simulate_study1
from models.baum_welch import BaumWelch
from models.errors import InputError
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
    same = play_study1(participants=PEOPLE, seed=3, threads=1).log
    assert all((same.tokens[name] == tokens[name]).all() for name in tokens)
    other = play_study1(participants=PEOPLE, seed=4).log
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
    log = play_study1(participants=n, seed=11).log
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


@pytest.fixture(scope="module")
def learned():
    return learn_from_both(participants=PEOPLE, seed=3, states=2, restarts=8)


def test_the_games_log_teaches_what_the_direct_simulation_does(learned):
    rows = learned.table.set_index("log")
    assert rows.index.tolist() == [DIRECT, GAME, SHORT]
    assert rows.loc[GAME, "different"] == 0
    assert rows.loc[GAME, "entries"] == 0
    assert rows.loc[GAME, "log_likelihood"] == rows.loc[DIRECT, "log_likelihood"]
    own = BaumWelch(2, restarts=8, finalists=30, rounds=1, seed=3).fit(simulate_study1(participants=PEOPLE, seed=3))
    assert (learned.models[GAME].transition == own.model.transition).all()
    assert "all 600 responses are those of the direct simulation" in learned.sentence


def test_short_rounds_teach_something_else(learned):
    short = play_study1(participants=PEOPLE, seed=3, parameters=GameParameters(round_ticks=350))
    row = learned.table.set_index("log").loc[SHORT]
    n = int(short.rounds.unseen_willingness.sum())
    assert row["different"] == n > 50
    assert row["entries"] > 0.02
    assert row["rates"] > 2 * learned.table["rates"][0]
    rates = learned.rates.set_index("condition")
    assert (rates[SHORT] < rates["truth"] - 0.05).all()
    assert (rates[GAME] == rates[DIRECT]).all()
    assert f"{n} of 600 responses differ" in learned.sentence


def test_implied_rates_are_those_of_many_people():
    truth = calibrated_truth()
    log = simulate_study1(participants=20_000, seed=6)
    conditions = np.repeat(log.condition, np.diff(log.offsets))
    for c, rate in enumerate(implied_rates(truth, log)):
        seen = log.response[log.shows & (conditions == c)]
        # Three responses a person, which agree more than chance has them: at the most as if they were one.
        assert abs((seen == 1).mean() - rate) < 4 * np.sqrt(rate * (1 - rate) / (len(seen) / 3))


def test_learning_from_nobody():
    with pytest.raises(InputError, match="learning from both, participants: found 1, wanted at least 2"):
        learn_from_both(participants=1)
