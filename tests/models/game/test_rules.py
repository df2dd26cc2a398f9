"""The rules of the token game: held to a slow twin at every tick, and to what they promise."""

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st

from models.errors import InputError
from models.game.human import HumanPlayer
from models.game.layout import packaged
from models.game.parameters import GameParameters
from models.game.round import Round
from models.game.state import GROUP_SIZE, GROUPS, PLAYERS
from tests.models.game.cases import games, play
from tests.reference.game import COLOUR, OTHER, SlowRound

SENSE = st.sampled_from([0.3, 0.8, 0.95, 1.0])


def slow_view(slow):
    def number(room):
        return None if room is None else int(room)

    return {
        "human": slow.at["human"], "robot": slow.at["robot"],
        "human_room": number(slow.room["human"]), "robot_room": number(slow.room["robot"]),
        "doors": dict(slow.colour), "trapped": slow.trapped,
        "trapped_room": number(slow.trap_room) if slow.trapped else None,
        "trapped_tick": slow.trapped_tick, "freed_tick": slow.freed_tick,
        "human_tokens": sorted(slow.tokens["human"]), "robot_tokens": sorted(slow.tokens["robot"]),
        "human_collected": slow.collected["human"], "robot_collected": slow.collected["robot"],
    }  # fmt: skip


def fast_view(view):
    out = {name: getattr(view, name) for name in view.__dataclass_fields__ if name not in ("tick", "done")}
    del out["flashing_room"]
    return {
        **out, "doors": dict(view.doors),
        "human_tokens": sorted(view.human_tokens), "robot_tokens": sorted(view.robot_tokens),
    }  # fmt: skip


@given(games(), SENSE, st.integers(0, 2**32))
def test_every_tick_is_that_of_the_slow_rules(game, sense, seed):
    slow = SlowRound(game.layout.lines, game.parameters, game.named, game.acts, game.seed)
    for moves in play(game, np.random.default_rng(seed), sense):
        assert fast_view(game.view) == slow_view(slow)
        slow.step(*moves)
    assert fast_view(game.view) == slow_view(slow)


def doors_of(layout, view):
    """Present door colours by room."""
    out = {room: [] for room in range(1, 5)}
    for cell, colour in view.doors:
        number = layout.cells[layout.number(cell), 5] + 1
        out[int(number)].append(colour)
    return out


@given(games(), SENSE, st.integers(0, 2**32), st.booleans())
def test_what_the_rules_promise_holds_at_every_tick(game, sense, seed, willing):
    before, traps = None, 0
    for _ in play(game, np.random.default_rng(seed), sense, willing):
        now = game.view
        doors = doors_of(game.layout, now)
        for i, player in enumerate(PLAYERS):
            lying, collected = getattr(now, f"{player}_tokens"), getattr(now, f"{player}_collected")
            assert 1 <= len(lying) <= GROUP_SIZE
            assert collected + len(lying) == GROUP_SIZE * game.array[GROUPS + i]
            assert len({int(game.layout.cells[game.layout.number(c), 5]) for c in lying}) == 1
            room = getattr(now, f"{player}_room")
            shut_in = room is not None and set(doors[room]) == {COLOUR[OTHER[player]]}
            assert shut_in == (now.trapped == player)
        assert not set(now.human_tokens) & set(now.robot_tokens)
        held = now.trapped_room
        if held is not None and game.parameters.clear_trapped_room:
            inside = game.layout.inside(held)
            assert not set(inside) & set(getattr(now, f"{OTHER[now.trapped]}_tokens"))
        for room in doors:
            assert room == held or sorted(doors[room]) == ["blue", "red"]
        if now.trapped == "robot" and game.acts:
            assert now.flashing_room == held
        else:
            assert now.flashing_room is None
        if before is not None:
            old = doors_of(game.layout, before)
            entered = {
                player: getattr(now, f"{player}_room")
                for player in PLAYERS
                if getattr(before, f"{player}_room") is None and getattr(now, f"{player}_room") is not None
            }
            for player in PLAYERS:
                gained = getattr(now, f"{player}_collected") - getattr(before, f"{player}_collected")
                assert gained in (0, 1)
                # Tokens may have moved under a player in the tick in which the trap happened.
                if gained and now.trapped_tick == before.trapped_tick:
                    assert getattr(now, player) in getattr(before, f"{player}_tokens")
            sprung = now.trapped is not None and before.trapped is None
            freed = now.trapped is None and before.trapped is not None
            assert not sprung or entered.get(now.trapped) == now.trapped_room
            assert freed == (
                before.trapped is not None and entered.get(OTHER[before.trapped]) == before.trapped_room
            )
            traps += sprung
            if not sprung and not freed and before.trapped_tick == now.trapped_tick:
                for room in doors:
                    swaps = list(entered.values()).count(room)
                    assert (doors[room] != old[room]) == (swaps == 1)
        before = now
    event(f"trapped: {game.sprung}, freed: {game.helped}")
    assert traps <= 1
    if traps:
        assert game.view.trapped_tick >= game.parameters.trap_tick


def test_entering_swaps_and_leaving_does_not():
    game = Round(packaged(), GameParameters(trap_tick=10**6, human_step_ticks=1), seed=3)
    route = ["right"] * 6 + ["down"] * 3 + ["left"] * 2
    for move in route:
        game.step(move)
    colours = dict(game.doors)
    assert game.human == (4, 5)
    assert (colours[4, 6], colours[2, 4]) == ("blue", "red")
    game.step("right")
    assert game.human == (4, 5)  # the door one came in by has the other's colour now
    for move in ("left", "up", "up", "up"):
        game.step(move)
    assert game.human == (1, 4)
    assert dict(game.doors) == colours


def test_stepping_on_a_door_and_back_is_no_entering():
    game = Round(packaged(), GameParameters(trap_tick=0, human_step_ticks=1), trapped="human", seed=3)
    for move in ["right"] * 6 + ["down"] * 3 + ["left", "right"]:
        game.step(move)
    assert game.human == (4, 7)
    assert game.view.human_room is None
    assert not game.sprung


@pytest.mark.parametrize("first", [10, 11])
def test_the_trap_comes_from_its_tick_on(first):
    # The eleventh step, at tick 10, enters the room.
    game = Round(packaged(), GameParameters(trap_tick=first, human_step_ticks=1), trapped="human", seed=3)
    for move in ["right"] * 6 + ["down"] * 3 + ["left"] * 2:
        game.step(move)
    assert game.view.human_room == 1
    assert game.sprung == (first == 10)
    assert game.view.trapped_tick == (10 if first == 10 else None)


@pytest.mark.parametrize("clear", [True, False])
def test_tokens_of_the_other_leave_the_trap(clear):
    layout, p = packaged(), GameParameters(trap_tick=0, human_step_ticks=1, clear_trapped_room=clear)
    inside = set(layout.inside(1))
    seeds = [s for s in range(60) if set(Round(layout, p, "human", False, s).view.robot_tokens) <= inside]
    assert len(seeds) > 5
    for seed in seeds:
        game = Round(layout, p, "human", False, seed)
        before = game.view
        for move in ["right"] * 6 + ["down"] * 3 + ["left"] * 2:
            game.step(move)
        assert (game.trapped, game.view.trapped_room) == ("human", 1)
        if clear:
            assert not set(game.view.robot_tokens) & inside
            assert len(game.view.robot_tokens) == 3
            assert not set(game.view.robot_tokens) & set(game.view.human_tokens)
        else:
            assert game.view.robot_tokens == before.robot_tokens


def test_the_trap_waits_while_the_other_is_near():
    # The robot stands on the blue door of the room that the human enters: no trap, but at its next entry.
    game = Round(packaged(), GameParameters(trap_tick=0, human_step_ticks=1, robot_step_ticks=1),
                 trapped="human", acts=False, seed=3)  # fmt: skip
    for move in ["left"] * 12 + ["up"] * 12 + ["right"] * 3 + ["down"]:
        game.step("stay", move)
    assert game.robot == (2, 4)
    for move in ["right"] * 6 + ["down"] * 3 + ["left"] * 2:
        game.step(move)
    assert game.view.human_room == 1
    assert not game.sprung
    assert {cell: colour for cell, colour in game.doors if cell in ((4, 6), (2, 4))} == {
        (4, 6): "blue",
        (2, 4): "red",
    }
    for move in ["up"] * 3 + ["right"]:
        game.step("stay", move)
    for move in ["right", "up", "left", "up", "up", "down", "down"]:
        game.step(move)
    assert (game.trapped, game.view.trapped_room) == ("human", 1)
    assert {colour for cell, colour in game.doors if cell in ((4, 6), (2, 4))} == {"blue"}


def test_a_player_steps_only_so_often_and_never_through_walls():
    game = Round(seed=1)
    for _ in range(11):
        game.step("up", "left")
    assert game.human == (1, 1)
    assert game.robot == (13, 10)  # at ticks 0, 5 and 10


def test_the_state_is_a_function_of_what_the_round_was_given():
    one, two = (Round(trapped="human", acts=True, seed=5) for _ in range(2))
    other = Round(trapped="human", acts=True, seed=6)
    for round_ in (one, two, other):
        list(play(round_, np.random.default_rng(1), 1.0))
    assert (one.array == two.array).all()
    assert (one.array != other.array).any()


def test_tokens_appear_everywhere_alike():
    # 4,000 first groups: rooms and cells within four standard errors of equal shares.
    rooms, cells = np.zeros(4), {}
    n = 4_000
    for seed in range(n):
        tokens = Round(seed=seed).view.human_tokens
        rooms[packaged().cells[packaged().number(tokens[0]), 5]] += 1
        for cell in tokens:
            cells[cell] = cells.get(cell, 0) + 1
    assert (np.abs(rooms - n / 4) < 4 * np.sqrt(n * 3 / 16)).all()
    counts = np.array(list(cells.values()))
    assert len(counts) == 36
    assert (np.abs(counts - n / 12) < 4 * np.sqrt(n / 12)).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Round(trapped="person"), "round, trapped: found 'person', wanted one of human, robot"),
        (lambda: Round(seed=-1), "round, seed: found -1"),
        (lambda: Round(seed=2**64), "round, seed"),
        (lambda: Round(acts="yes"), "round, acts: found 'yes', wanted true or false"),
        (lambda: HumanPlayer(seed=-1), "simulated person, seed: found -1"),
        (lambda: Round().step(5), "move of the human: found 5, wanted 0 to 4"),
        (lambda: Round().step(0, "north"), "move of the robot: found 'north'"),
        (lambda: Round().step(True), "move of the human: found True"),
    ],
)
def test_misuse_is_named(call, message):
    with pytest.raises(InputError) as error:
        call()
    assert message in str(error.value)


def test_nothing_is_played_after_the_end():
    game = Round(parameters=GameParameters(round_ticks=2))
    game.step()
    game.step()
    assert game.done
    with pytest.raises(InputError, match="round, tick"):
        game.step()
