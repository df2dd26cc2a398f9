"""What a player sees of a round, as arrays: one plane a kind of thing, one's own things before the other's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.game.layout import DOOR, FIRST_PLACE, INSIDE, PLACES, ROOM, Layout
from models.game.state import (
    ACTS,
    CELL,
    COUNT,
    GROUP_SIZE,
    MOVES,
    PARITY,
    PLAYERS,
    READY,
    RECOLOURED,
    ROBOT,
    TICK,
    TOKEN,
    TRAP_ROOM,
    TRAPPED,
)

PLANES = (
    "walls",
    "doors that let one pass",
    "doors that let the other pass",
    "oneself",
    "the other",
    "own tokens",
    "tokens of the other",
    "inside of the room in which somebody is trapped",
    "inside of the room that flashes",
)


class Views:
    """Views of rounds on one map.

    Parameters
    ----------
    layout : Layout
    round_ticks : int
    """

    def __init__(self, layout: Layout, round_ticks: int) -> None:
        self.layout, self.round_ticks = layout, round_ticks
        self._walls = np.array([[character == "#" for character in line] for line in layout.lines], dtype=np.int8)
        self._doors = layout.rooms[:, :INSIDE].astype(np.int64)
        self._inside = [entry[FIRST_PLACE : FIRST_PLACE + entry[PLACES]] for entry in layout.rooms]

    def planes(self, state: NDArray[np.int64], player: int) -> NDArray[np.int8]:
        """Return 0s and 1s, ``[plane, row, column]``, planes as in `PLANES`."""
        other = 1 - player
        out = np.zeros((len(PLANES), *self._walls.shape), dtype=np.int8)
        flat = out.reshape(len(PLANES), -1)
        out[0] = self._walls
        colours = self.door_colours(state)
        flat[1, self._doors[colours == player]] = 1
        flat[2, self._doors[colours == other]] = 1
        flat[3, state[CELL + player]] = 1
        flat[4, state[CELL + other]] = 1
        for plane, owner in ((5, player), (6, other)):
            cells = state[TOKEN + GROUP_SIZE * owner : TOKEN + GROUP_SIZE * (owner + 1)]
            flat[plane, cells[cells >= 0]] = 1
        if state[TRAPPED] >= 0:
            inside = self._inside[state[TRAP_ROOM]]
            flat[7, inside] = 1
            if state[TRAPPED] == ROBOT and state[ACTS]:
                flat[8, inside] = 1
        return out

    def door_colours(self, state: NDArray[np.int64]) -> NDArray[np.int64]:
        """Present colour of every door, as the number of whom it lets pass, ``[room, printed colour]``."""
        printed = np.arange(len(PLAYERS))[None, :]
        return printed ^ state[PARITY : PARITY + len(self._doors), None] ^ (self._doors == state[RECOLOURED])

    def open_moves(self, state: NDArray[np.int64], player: int) -> NDArray[np.int8]:
        """Which moves lead neither into a wall nor into a door that is closed to the player, ``[move]``."""
        cells = self.layout.cells
        there = cells[state[CELL + player], : len(MOVES)]
        out = (there >= 0).astype(np.int8)
        colours = self.door_colours(state)
        for move, cell in enumerate(there):
            # The first move is to stay, which doors allow whatever their colour.
            if move and cell >= 0 and cells[cell, DOOR]:
                out[move] = colours[cells[cell, ROOM], cells[cell, DOOR] - 1] == player
        return out

    def observation(self, state: NDArray[np.int64], player: int) -> dict[str, NDArray]:
        """Everything that a player sees; see `models.game.env.TokenGame`."""
        both = [player, 1 - player]
        trapped = state[TRAPPED]
        left = (self.round_ticks - state[TICK]) / self.round_ticks
        return {
            "planes": self.planes(state, player),
            "time_left": np.array([left], dtype=np.float32),
            "wait": np.maximum(state[[READY + p for p in both]] - state[TICK], 0).astype(np.int32),
            "collected": state[[COUNT + p for p in both]].astype(np.int32),
            "trapped": np.array([trapped == p for p in both], dtype=np.int8),
            "action_mask": self.open_moves(state, player),
        }
