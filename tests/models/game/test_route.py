"""Routes by A*: as short as those of networkx, walkable, and always the same."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from models.game.route import find_route, route_scratch
from models.game.state import CELL, PLAYERS
from tests.models.game.cases import games, play
from tests.reference.game import shortest


def route(game, player, goals, avoid):
    """Steps of the route and its moves in order."""
    layout = game.layout
    path, scratch = np.zeros(len(layout.cells), dtype=np.int32), route_scratch(layout)
    scratch[:] = 77  # nothing in it matters
    numbers = np.array([layout.number(g) for g in goals] or [0], dtype=np.int64)
    blocked = -1 if avoid is None else avoid - 1
    n = find_route(game.array, layout.cells, PLAYERS.index(player), numbers, len(goals), blocked, path, scratch)
    return n, path[: max(n, 0)][::-1].tolist()


@given(games(), st.integers(0, 2**32))
def test_routes_are_shortest_and_can_be_walked(game, seed):
    rng = np.random.default_rng(seed)
    floor = [(r, c) for r, line in enumerate(game.layout.lines) for c, ch in enumerate(line) if ch in ".HR1234"]
    for _ in play(game, rng, 0.8):
        if rng.random() > 0.04:
            continue
        view = game.view
        for player in PLAYERS:
            goals = [floor[i] for i in rng.choice(len(floor), rng.integers(1, 4), replace=False)]
            avoid = [None, 1, 2, 3, 4][rng.integers(5)]
            steps, moves = route(game, player, goals, avoid)
            wanted = shortest(view, game.layout.lines, player, goals, avoid)
            assert steps == (-1 if wanted is None else wanted)
            here = int(game.array[CELL + PLAYERS.index(player)])
            colours = dict(view.doors)
            for move in moves:
                here = int(game.layout.cells[here, move])
                assert here >= 0
                assert colours.get(game.layout.cell(here), "own") in ("own", ("red", "blue")[PLAYERS.index(player)])
            assert not moves or game.layout.cell(here) in goals
            assert route(game, player, goals, avoid) == (steps, moves)


@given(games())
def test_no_goals_no_route(game):
    assert route(game, "human", [], None) == (-1, [])


@given(games())
def test_standing_on_the_goal_is_a_route_of_no_steps(game):
    assert route(game, "robot", [game.robot], None) == (0, [])
