"""Random maps and random play for the tests of the token game."""

import numpy as np
from hypothesis import strategies as st

from models.errors import InputError
from models.game.human import HumanPlayer
from models.game.layout import Layout
from models.game.parameters import GameParameters
from models.game.robot import RobotPlayer
from models.game.round import Round

SEEDS = st.integers(0, 2**64 - 1)


def random_map(rng):
    """Four rooms of random sizes with random doors, walls here and there, players starting anywhere."""
    widths, heights = rng.integers(1, 5, (2, 2))
    heights = np.where(heights * widths.min() < 3, 3, heights)
    middle_row, middle_column = rng.integers(1, 3, 2)
    tops = [2, 2 + heights[0] + 2 + middle_row]
    lefts = [2, 2 + widths[0] + 2 + middle_column]
    height, width = tops[1] + heights[1] + 4, lefts[1] + widths[1] + 4
    grid = np.full((height, width), ".", dtype="<U1")
    grid[[0, -1]] = grid[:, [0, -1]] = "#"
    for room in range(4):
        top, left, tall, wide = tops[room // 2], lefts[room % 2], heights[room // 2], widths[room % 2]
        grid[top : top + tall + 2, left : left + wide + 2] = "#"
        grid[top + 1 : top + tall + 1, left + 1 : left + wide + 1] = str(room + 1)
        ring = [(top + r, left + c) for r in range(1, tall + 1) for c in (0, wide + 1)]
        ring += [(top + r, left + c) for c in range(1, wide + 1) for r in (0, tall + 1)]
        while True:
            red, blue = (ring[i] for i in rng.choice(len(ring), 2, replace=False))
            if abs(red[0] - blue[0]) + abs(red[1] - blue[1]) > 1:
                break
        grid[red], grid[blue] = "r", "b"
    corridor = np.argwhere(grid == ".")
    for letter, cell in zip("HR", rng.choice(corridor, 2, replace=False), strict=True):
        grid[tuple(cell)] = letter
    layout = Layout.from_text("\n".join("".join(row) for row in grid))
    for _ in range(rng.integers(0, 12)):
        # A wall more, where the map stays one that can be played.
        there = tuple(rng.integers(1, (height - 1, width - 1)))
        before = grid[there]
        if before not in "rbHR":
            grid[there] = "#"
            try:
                layout = Layout.from_text("\n".join("".join(row) for row in grid))
            except InputError:
                grid[there] = before
    return layout


def layouts():
    return st.integers(0, 2**32).map(lambda seed: random_map(np.random.default_rng(seed)))


@st.composite
def parameters(draw):
    return GameParameters(
        round_ticks=draw(st.integers(200, 800)),
        human_step_ticks=draw(st.integers(1, 4)),
        robot_step_ticks=draw(st.integers(1, 4)),
        trap_tick=draw(st.integers(0, 100)),
        robot_help_delay=draw(st.integers(0, 60)),
        clear_trapped_room=draw(st.booleans()),
        human_wander=draw(st.sampled_from([0.0, 0.3, 1.0])),
        human_lapse=draw(st.sampled_from([0.0, 0.05])),
        human_lapse_ticks=draw(st.integers(1, 20)),
        human_notice_ticks=draw(st.integers(0, 20)),
        human_notice_spread=draw(st.integers(0, 20)),
        signal_notice_share=draw(st.sampled_from([0.0, 0.5, 1.0])),
    )


@st.composite
def games(draw):
    """A round that has not begun."""
    return Round(
        draw(layouts()),
        draw(parameters()),
        draw(st.sampled_from(["human", "robot"])),
        draw(st.booleans()),
        draw(SEEDS),
    )


def play(game, rng, sense=0.7, willing=True):
    """Play to the end, yielding the round before every tick, moves half sensible and half at random."""
    human, robot = HumanPlayer(willing), RobotPlayer()
    while not game.done:
        sensible = human.move(game), robot.move(game)
        moves = [m if rng.random() < sense else int(rng.integers(5)) for m in sensible]
        yield moves
        game.step(*moves)
