"""A round of the token game at one tick: one flat array of whole numbers, and a readable view of it.

Numbers that are compiled into kernels stand in modules with kernels of their own, here as in `models.game.layout`
and `models.game.parameters`: the digest of compiled code (`models.compiled`) covers such modules only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.game.layout import DOOR, ROOM, Cell, Layout

HUMAN, ROBOT = 0, 1
PLAYERS = ("human", "robot")
RED, BLUE = 0, 1
"""Colours: red is the human's, blue the robot's, so a colour is the number of the player whom it lets pass."""

GROUP_SIZE = 3
"""Tokens appear in groups of three (printed)."""

MOVES = ("stay", "up", "down", "left", "right")

# Places in the array. Those of two players follow each other, human first.
TICK = 0
SEED = 1
DRAWS = 2
"""Random numbers used so far: with the seed, all there is to the generator."""
NAMED = 3
"""The player whom this round traps."""
ACTS = 4
"""Whether the robot helps (human trapped) or signals (robot trapped)."""
CELL = 5
MEMBER = 7
"""Room that a player is in, -1 if none: from stepping off a door into it until stepping off one to the corridor."""
READY = 9
"""First tick at which a player may step again."""
PARITY = 11
"""Whether a room's doors have swapped an odd number of times; four places."""
RECOLOURED = 15
"""Cell of the door that the trap recoloured, -1 if none."""
TRAPPED = 16
"""Player trapped now, -1 if none."""
TRAP_ROOM = 17
TRAP_TICK = 18
FREED_TICK = 19
GROUP = 20
"""Room of a player's tokens."""
TOKEN = 22
"""Cells of a player's tokens, -1 once collected; three places a player."""
COUNT = 28
"""Tokens that a player has collected."""
GROUPS = 30
"""Groups that have appeared for a player."""
VERSION = 32
"""Changes whenever what a player's route depends on does."""
SIZE = 34


@kernel(_nrt=False)
def door_colour(state, cells, cell):  # type: ignore[no-untyped-def]
    """Present colour of a door: printed colour, swapped with its room, changed by the trap."""
    colour = (cells[cell, DOOR] - 1) ^ state[PARITY + cells[cell, ROOM]]
    return colour ^ 1 if cell == state[RECOLOURED] else colour


@kernel(_nrt=False)
def may_step(state, player):  # type: ignore[no-untyped-def]
    """Whether the player's last step is long enough ago."""
    return state[TICK] >= state[READY + player]


@dataclass(frozen=True)
class GameState:
    """Everything there is to see of a round at one tick. Cells are (row, column) from the top left.

    Attributes
    ----------
    tick : int
        Tenths of a second since the round began.
    done : bool
    human, robot : (int, int)
    human_room, robot_room : int or None
        Number of the room (1 to 4) a player is in.
    doors : tuple of (cell, str)
        Every door's cell and present colour, ``"red"`` or ``"blue"``.
    human_tokens, robot_tokens : tuple of cells
        Tokens lying on the floor.
    human_collected, robot_collected : int
    trapped : str or None
        ``"human"``, ``"robot"``, or None while nobody is trapped.
    trapped_room : int or None
        The room that holds the trapped player.
    flashing_room : int or None
        The room that flashes: the robot is trapped in it and signals.
    trapped_tick, freed_tick : int or None
    """

    tick: int
    done: bool
    human: Cell
    robot: Cell
    human_room: int | None
    robot_room: int | None
    doors: tuple[tuple[Cell, str], ...]
    human_tokens: tuple[Cell, ...]
    robot_tokens: tuple[Cell, ...]
    human_collected: int
    robot_collected: int
    trapped: str | None
    trapped_room: int | None
    flashing_room: int | None
    trapped_tick: int | None
    freed_tick: int | None

    @property
    def team_collected(self) -> int:
        """Tokens of both."""
        return self.human_collected + self.robot_collected


def readable(state: NDArray[np.int64], layout: Layout, round_ticks: int) -> GameState:
    """Put the array into words."""
    values = state.tolist()

    def tokens(player: int) -> tuple[Cell, ...]:
        first = TOKEN + GROUP_SIZE * player
        return tuple(layout.cell(c) for c in values[first : first + GROUP_SIZE] if c >= 0)

    def room(number: int) -> int | None:
        return number + 1 if number >= 0 else None

    def moment(tick: int) -> int | None:
        return tick if tick >= 0 else None

    doors = []
    for number in range(layout.n_rooms):
        for printed in (RED, BLUE):
            at = int(layout.rooms[number, printed])
            colour = printed ^ values[PARITY + number] ^ (at == values[RECOLOURED])
            doors.append((layout.cell(at), "blue" if colour else "red"))
    trapped = values[TRAPPED]
    held = room(values[TRAP_ROOM]) if trapped >= 0 else None
    return GameState(
        tick=values[TICK],
        done=values[TICK] >= round_ticks,
        human=layout.cell(values[CELL]),
        robot=layout.cell(values[CELL + ROBOT]),
        human_room=room(values[MEMBER]),
        robot_room=room(values[MEMBER + ROBOT]),
        doors=tuple(doors),
        human_tokens=tokens(HUMAN),
        robot_tokens=tokens(ROBOT),
        human_collected=values[COUNT],
        robot_collected=values[COUNT + ROBOT],
        trapped=PLAYERS[trapped] if trapped >= 0 else None,
        trapped_room=held,
        flashing_room=held if trapped == ROBOT and values[ACTS] else None,
        trapped_tick=moment(values[TRAP_TICK]),
        freed_tick=moment(values[FREED_TICK]),
    )
