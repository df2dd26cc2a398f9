"""Many rounds at once: the same as one by one, whatever the threads, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.game.human import HumanPlayer
from models.game.layout import packaged
from models.game.parameters import GameParameters
from models.game.robot import RobotPlayer
from models.game.round import Round
from models.game.rounds import RoundOutcomes, play_rounds
from models.game.state import PLAYERS
from tests.models.game.cases import layouts, parameters


def one_by_one(layout, p, trapped, acts, willing, seed):
    game, human, robot = Round(layout, p, PLAYERS[trapped], acts, seed), HumanPlayer(willing), RobotPlayer()
    while not game.done:
        game.step(human.move(game), robot.move(game))
    v = game.view
    moments = [-1 if t is None else t for t in (v.trapped_tick, v.freed_tick)]
    return [v.human_collected, v.robot_collected, *moments, robot.interruption_ticks, human.interruption_ticks]


def columns(played):
    return np.column_stack(
        [
            played.human_tokens, played.robot_tokens, played.trapped_tick, played.freed_tick,
            played.robot_interruption_ticks, played.human_interruption_ticks,
        ]
    )  # fmt: skip


@settings(max_examples=20)
@given(layouts(), parameters(), st.integers(0, 2**32))
def test_the_same_rounds_as_one_by_one(layout, p, luck):
    rng = np.random.default_rng(luck)
    n = 6
    given_ = rng.integers(0, 2, (3, n))
    seeds = rng.integers(0, 2**64, n, dtype=np.uint64)
    played = play_rounds(layout, p, given_[0], given_[1] == 1, given_[2] == 1, seeds)
    for i, row in enumerate(columns(played)):
        assert row.tolist() == one_by_one(
            layout, p, given_[0, i], bool(given_[1, i]), bool(given_[2, i]), int(seeds[i])
        )


def test_threads_and_company_do_not_matter():
    rng = np.random.default_rng(1)
    n = 1_700
    given_ = rng.integers(0, 2, n), rng.random(n) < 0.5, rng.random(n) < 0.5, rng.integers(0, 2**64, n, np.uint64)
    p = GameParameters(round_ticks=400)
    whole = columns(play_rounds(packaged(), p, *given_, threads=1))
    assert (whole == columns(play_rounds(packaged(), p, *given_, threads=3))).all()
    backwards = play_rounds(packaged(), p, *(column[::-1] for column in given_))
    assert (whole == columns(backwards)[::-1]).all()
    some = play_rounds(packaged(), p, *given_).some(slice(3, 9))
    assert (columns(some) == whole[3:9]).all()


def test_what_an_outcome_says():
    played = play_rounds(packaged(), GameParameters(), [1, 1, 0], [True, False, True], [True, False, False], 5)
    assert isinstance(played, RoundOutcomes)
    assert len(played) == 3
    assert played.helped.tolist() == [True, False, True]
    assert (played.team_tokens == played.human_tokens + played.robot_tokens).all()
    # Nobody frees the robot in the second round: it is interrupted to the end.
    assert played.robot_interruption_ticks[1] == GameParameters().round_ticks - played.trapped_tick[1] - 1
    assert played.human_interruption_ticks[1] == 0
    assert "2 players freed" in played.sentence


def test_too_short_a_round_is_said():
    played = play_rounds(packaged(), GameParameters(round_ticks=250), 1, False, True, np.arange(200))
    assert played.unseen_willingness.sum() > 100
    assert not played.helped[played.unseen_willingness].any()
    assert f"{int(played.unseen_willingness.sum())} willing people did not get to help" in played.sentence
    assert "nobody got trapped" in played.sentence


def test_no_rounds():
    empty = np.zeros(0, dtype=int)
    played = play_rounds(packaged(), GameParameters(), empty, empty, empty, empty)
    assert len(played) == 0
    assert played.sentence == "0 rounds; 0 players freed."


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        (([0, 2], True, True, 1), "rounds, trapped, entry 1: found 2, wanted 0 (human) or 1 (robot)"),
        (([0, -1], True, True, 1), "rounds, trapped, entry 1: found -1"),
        ((0, [0.5], True, 1), "rounds, acts: found values of type float64"),
        ((0, True, ["yes"], 1), "rounds, willing: found values of type"),
        ((0, True, True, [-3]), "rounds, seed, entry 0: found -3"),
        ((0, True, True, [2**64]), "rounds, seed, entry 0: found 18446744073709551616"),
        ((0, True, True, [[1]]), "rounds, seed: found 2 dimensions"),
        (([0, 1], [True] * 3, True, 1), "rounds: found entries of lengths 2, 3, wanted one length"),
    ],
)
def test_unusable_entries_are_named(given_, message):
    with pytest.raises(InputError) as error:
        play_rounds(packaged(), GameParameters(), *given_)
    assert message in str(error.value)


def test_threads_are_checked():
    with pytest.raises(InputError, match="rounds, threads: found 0, wanted at least 1"):
        play_rounds(packaged(), GameParameters(), 0, True, True, 1, threads=0)


def test_large_seeds_are_seeds():
    large = [2**63 + 5, 7]
    played = play_rounds(packaged(), GameParameters(), 1, True, True, large)
    assert columns(played)[0].tolist() == one_by_one(packaged(), GameParameters(), 1, True, True, 2**63 + 5)
