"""What the robot and a simulated person have in common: going somewhere, and being interrupted.

A walker follows a shortest route until what the route depends on has changed. It is *interrupted* while it is
trapped, and from setting off to help until it has left the room in which it helped.
"""

from __future__ import annotations

from models.compiled import kernel
from models.game.layout import INSIDE
from models.game.route import find_route
from models.game.state import CELL, GROUP_SIZE, MEMBER, TOKEN, TRAP_ROOM, TRAPPED, VERSION

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
OWN = 5
"""First place of what only one kind of walker remembers."""

COLLECTING, HELPING, LEAVING = 0, 1, 2


@kernel(_nrt=False)
def start_walking(memory):  # type: ignore[no-untyped-def]
    """Forget everything."""
    memory[:] = 0
    memory[SEEN] = -1


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
