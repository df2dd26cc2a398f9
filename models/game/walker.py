"""What the robot and a simulated person have in common: their turn, going somewhere, and being interrupted.

A walker follows a shortest route until what the route depends on has changed. It is *interrupted* while it is
trapped, and from setting off to help until it has left the room in which it helped. The robot is a walker whose
attention never lapses and who never wanders.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from models.compiled import kernel
from models.game.chance import happens, random_below
from models.game.layout import INSIDE
from models.game.route import find_route, route_scratch
from models.game.state import CELL, GROUP_SIZE, MEMBER, TICK, TOKEN, TRAP_ROOM, TRAPPED, VERSION, may_step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from models.game.round import Round

# Places in a walker's memory.
PHASE = 0
SEEN = 1
"""Version of the state that the route was made for, -1 if there is no route."""
LEFT = 2
"""Steps left of the route, -1 if nowhere can be reached."""
EXPECTED = 3
"""Where the walker is if nobody else moved it."""
INTERRUPTED = 4
"""Ticks of interruption."""
SEED, DRAWS = 5, 6
"""Of the walker's own luck (`models.game.chance`)."""
PAUSES = 7
"""Tick until which attention has lapsed."""
OWN = 8
"""First place of what only one kind of walker remembers."""

COLLECTING, HELPING, LEAVING = 0, 1, 2


@kernel(_nrt=False)
def start_walking(memory):  # type: ignore[no-untyped-def]
    """Forget everything."""
    memory[:] = 0
    memory[SEEN] = -1


@kernel(_nrt=False)
def take_turn(  # type: ignore[no-untyped-def]
    state, cells, rooms, memory, player, helps, lapse, lapse_ticks, wander, goals, path, scratch
):
    """Choose a walker's move of this tick; to be called once a tick.

    `helps` says whether it is on its way to help now, `lapse` and `wander` are chances as `happens` takes them.
    Attention lapses while collecting only. Luck is drawn in the same order for everybody, at every step and at
    every choice between tokens, whatever the chances: one walker's parameters do not move the rest of its luck.
    """
    keep_phase(state, memory, player, helps)
    if not may_step(state, player):
        return 0
    if memory[PHASE] == COLLECTING:
        if state[TICK] < memory[PAUSES]:
            return 0
        if happens(memory, SEED, DRAWS, lapse):
            memory[PAUSES] = state[TICK] + lapse_ticks
            return 0
    if route_is_old(state, memory, player):
        left = remaining(state, player, goals)
        if left > 1 and happens(memory, SEED, DRAWS, wander):
            goals[0] = goals[random_below(memory, SEED, DRAWS, left)]
            left = 1
        find_way(state, cells, rooms, memory, player, goals, left, path, scratch)
    return next_move(state, cells, memory, player, path)


@kernel(_nrt=False)
def keep_phase(state, memory, player, helps):  # type: ignore[no-untyped-def]
    """Move from collecting to helping and back, and count interruptions; to be called once a tick.

    `helps` says whether the player is on its way to help now.
    """
    phase = memory[PHASE]
    if helps:
        phase = HELPING
    elif phase == HELPING:
        phase = LEAVING
    if phase == LEAVING and state[MEMBER + player] != state[TRAP_ROOM]:
        phase = COLLECTING
    if (phase == HELPING) != (memory[PHASE] == HELPING):
        memory[SEEN] = -1
    memory[PHASE] = phase
    memory[INTERRUPTED] += phase != COLLECTING or state[TRAPPED] == player


@kernel(_nrt=False)
def route_is_old(state, memory, player):  # type: ignore[no-untyped-def]
    """Whether a route has to be found before the next step."""
    return memory[SEEN] != state[VERSION + player] or memory[EXPECTED] != state[CELL + player]


@kernel(_nrt=False)
def remaining(state, player, goals):  # type: ignore[no-untyped-def]
    """Write the cells of a player's tokens into `goals`; how many there are."""
    first = TOKEN + GROUP_SIZE * player
    found = 0
    for i in range(first, first + GROUP_SIZE):
        if state[i] >= 0:
            goals[found] = state[i]
            found += 1
    return found


@kernel(_nrt=False)
def find_way(state, cells, rooms, memory, player, goals, n_goals, path, scratch):  # type: ignore[no-untyped-def]
    """Plan a route: to the trapped player when helping, otherwise to the nearest of the goals.

    Only who helps enters the room in which the other is trapped.
    """
    held = state[TRAP_ROOM] if state[TRAPPED] == 1 - player else -1
    if memory[PHASE] == HELPING:
        goals[0], goals[1] = rooms[held, INSIDE], rooms[held, INSIDE + 1]
        memory[LEFT] = find_route(state, cells, player, goals, 2, -1, path, scratch)
    else:
        memory[LEFT] = find_route(state, cells, player, goals, n_goals, held, path, scratch)
    memory[SEEN] = state[VERSION + player]
    memory[EXPECTED] = state[CELL + player]


@kernel(_nrt=False)
def next_move(state, cells, memory, player, path):  # type: ignore[no-untyped-def]
    """Take the next move of the route, 0 if there is none."""
    if memory[LEFT] <= 0:
        return 0
    memory[LEFT] -= 1
    move = path[memory[LEFT]]
    memory[EXPECTED] = cells[state[CELL + player], move]
    return move


class Walker(ABC):
    """A player of one `Round` whose moves a kernel chooses, tick by tick.

    Parameters
    ----------
    places : int
        Of its memory.
    """

    def __init__(self, places: int) -> None:
        self._memory: NDArray[np.int64] = np.zeros(places, dtype=np.int64)
        self._goals = np.zeros(GROUP_SIZE, dtype=np.int64)
        self._round: Round | None = None

    @abstractmethod
    def _begin(self, game: Round) -> None:
        """Write the memory of the start of a round."""

    @abstractmethod
    def _choose(self, *given: NDArray[np.integer]) -> int:
        """Call the kernel: state, cells, rooms, settings, memory, goals, path, scratch."""

    def move(self, game: Round) -> int:
        """Choose the move of this tick, 0 to 4; to be asked once a tick."""
        if self._round is not game:
            self._begin(game)
            self._path = np.zeros(len(game.layout.cells), dtype=np.int32)
            self._scratch = route_scratch(game.layout)
            self._round = game
        return self._choose(
            game.array, game.layout.cells, game.layout.rooms, game.parameters.settings, self._memory, self._goals,
            self._path, self._scratch,
        )  # fmt: skip

    @property
    def interruption_ticks(self) -> int:
        """Ticks so far in which the player was trapped or helping."""
        return int(self._memory[INTERRUPTED])
