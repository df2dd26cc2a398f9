"""Robot and simulated person: what they do about a trap, and how fast they are."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.game.human import HumanPlayer
from models.game.layout import packaged
from models.game.parameters import GameParameters
from models.game.robot import RobotPlayer
from models.game.round import Round
from models.game.rounds import play_rounds
from models.game.route import find_route, route_scratch
from models.game.state import ACTS, HUMAN, ROBOT, may_step
from models.game.walker import HELPING, LEFT, PHASE
from tests.models.game.cases import games, layouts, play
from tests.reference.game import shortest

ATTENTIVE = {"human_wander": 0.0, "human_lapse": 0.0}


@given(games(), st.integers(0, 2**32))
def test_who_does_not_help_never_enters_the_trap(game, seed):
    game.acts = False
    game.array[ACTS] = 0
    rng = np.random.default_rng(seed)
    moves = play(game, rng, 1.0, willing=False)
    for _ in moves:
        assert not game.helped
    assert not game.helped


@given(layouts(), st.sampled_from(["human", "robot"]), st.booleans(), st.integers(0, 2**64 - 1))
def test_who_helps_always_arrives_on_any_map(layout, trapped, acts, seed):
    # Longer rounds than by default: random maps can be larger than the one that rounds were made for.
    game = Round(layout, GameParameters(round_ticks=2_000), trapped, acts, seed)
    for _ in play(game, np.random.default_rng(0), 1.0, willing=True):
        pass
    assert game.sprung
    assert game.helped == (trapped == "robot" or acts)


@pytest.mark.parametrize(("trapped", "acts", "willing"), [*product((0, 1), (False, True), (False, True))])
def test_by_default_help_comes_before_the_round_is_over(trapped, acts, willing):
    p = GameParameters()
    played = play_rounds(packaged(), p, trapped, acts, willing, np.arange(3_000))
    assert (played.trapped_tick >= p.trap_tick).all()
    assert (played.helped == (willing if trapped else acts)).all()
    assert not played.unseen_willingness.any()
    # Not by a hair: the latest help leaves a quarter of the round.
    assert played.freed_tick.max() < 0.75 * p.round_ticks
    assert "did not get to help" not in played.sentence


def test_the_robot_sets_off_five_seconds_after_the_trap():
    # A robot that helps plays like one that does not until then, and differently from then on.
    for seed in range(20):
        one, two = Round(trapped="human", acts=True, seed=seed), Round(trapped="human", acts=False, seed=seed)
        players = [(HumanPlayer(), RobotPlayer()) for _ in range(2)]
        while not one.done:
            for game, (human, robot) in zip((one, two), players, strict=True):
                game.step(human.move(game), robot.move(game))
            trap = one.view.trapped_tick
            if trap is not None and one.tick == trap + 50:
                assert one.robot == two.robot
                assert players[0][1].interruption_ticks == 0
            if trap is not None and one.tick == trap + 51:
                assert players[0][1].interruption_ticks == 1
        assert one.helped
        assert not two.helped


def test_helping_interrupts_until_one_is_out_of_the_room_again():
    for seed in range(10):
        game, human, robot, out = Round(trapped="human", acts=True, seed=seed), HumanPlayer(), RobotPlayer(), None
        while not game.done:
            game.step(human.move(game), robot.move(game))
            if game.helped and out is None and game.view.robot_room is None:
                out = game.tick
        assert out > game.view.freed_tick + 5
        assert robot.interruption_ticks == out - (game.view.trapped_tick + 50)
        assert human.interruption_ticks == game.view.freed_tick - game.view.trapped_tick


def test_attention_never_lapses_on_the_way_to_help():
    p = GameParameters(human_lapse=0.3, human_lapse_ticks=60)
    for seed in range(10):
        game, human, robot, helping, steps = Round(parameters=p, seed=seed), HumanPlayer(), RobotPlayer(), 0, 0
        while not game.helped:
            before = game.human
            game.step(human.move(game), robot.move(game))
            helping += human.interruption_ticks > 0
            steps += human.interruption_ticks > 0 and game.human != before
        # A step every five ticks from the first to the last.
        assert 5 * (steps - 1) < helping <= 5 * steps


def meddle(game, rng):
    """Walk to the robot's tokens, now and then anywhere: swaps the doors that the robot is about to take."""
    layout = game.layout
    goals = np.array([layout.number(cell) for cell in game.view.robot_tokens])
    path = np.zeros(len(layout.cells), dtype=np.int32)
    steps = find_route(game.array, layout.cells, HUMAN, goals, len(goals), -1, path, route_scratch(layout))
    return int(rng.integers(5)) if steps < 1 or rng.random() < 0.3 else int(path[steps - 1])


@settings(max_examples=15)
@given(games(), st.integers(0, 2**32))
def test_the_robot_is_always_on_a_shortest_route(game, seed):
    """Whatever the person does to the doors, and whoever else moves the robot; by networkx at every step."""
    robot, rng = RobotPlayer(), np.random.default_rng(seed)
    while not game.done:
        move, view = robot.move(game), game.view
        if may_step(game.array, ROBOT):
            helping = robot._memory[PHASE] == HELPING
            goals = game.layout.inside(view.trapped_room) if helping else view.robot_tokens
            avoid = view.trapped_room if view.trapped == "human" and not helping else None
            wanted = shortest(view, game.layout.lines, "robot", goals, avoid)
            assert (move > 0) == (wanted is not None)
            assert not move or robot._memory[LEFT] + 1 == wanted
        game.step(meddle(game, rng), int(rng.integers(5)) if rng.random() < 0.05 else move)


def test_the_robot_walks_two_cells_a_second_and_never_rests():
    game, robot, steps = Round(trapped="human", acts=False, seed=2), RobotPlayer(), []
    before = game.robot
    while not game.done:
        game.step(0, robot.move(game))
        if game.robot != before:
            steps.append(game.tick)
            before = game.robot
    assert {b - a for a, b in pairwise(steps)} == {5}


def test_a_signal_shortens_the_delay_by_its_share():
    p = GameParameters(human_notice_ticks=100, human_notice_spread=0, signal_notice_share=0.3, **ATTENTIVE)
    for acts, delay in ((False, 100), (True, 30)):
        game, human, robot = Round(parameters=p, acts=acts, seed=4), HumanPlayer(), RobotPlayer()
        while human.interruption_ticks == 0:
            game.step(human.move(game), robot.move(game))
        assert game.tick == game.view.trapped_tick + delay + 1


def test_delays_are_spread_evenly():
    p = GameParameters(human_notice_ticks=10, human_notice_spread=4, **ATTENTIVE)
    waits = []
    for seed in range(400):
        game, human, robot = Round(parameters=p, acts=False, seed=seed), HumanPlayer(), RobotPlayer()
        while human.interruption_ticks == 0:
            game.step(human.move(game), robot.move(game))
        waits.append(game.tick - 1 - game.view.trapped_tick)
    counts = np.bincount(waits, minlength=15)[10:15]
    assert counts.sum() == 400
    assert (np.abs(counts - 80) < 4 * np.sqrt(400 * 0.2 * 0.8)).all()


def test_lapses_and_wandering_cost_tokens():
    base = play_rounds(packaged(), GameParameters(**ATTENTIVE), 1, False, True, np.arange(500)).human_tokens.mean()
    for less in ({"human_lapse": 0.1}, {"human_wander": 1.0}):
        p = GameParameters(**{**ATTENTIVE, **less})
        assert play_rounds(packaged(), p, 1, False, True, np.arange(500)).human_tokens.mean() < base - 1


def test_a_player_begins_anew_with_another_round():
    human, robot, seen = HumanPlayer(), RobotPlayer(), []
    for _ in range(2):
        game = Round(seed=9)
        while not game.done:
            game.step(human.move(game), robot.move(game))
        seen.append((game.array.tolist(), human.interruption_ticks, robot.interruption_ticks))
    assert seen[0] == seen[1]
