"""The rules of the token game: one tick, as a function of the state and both moves.

* A player steps at most every so many ticks. Into a door it may step only while the door has its colour; off a door
  it may step either way. Players do not block each other.
* *Entering* a room is stepping off one of its doors to the inside while not in the room. It swaps the colours of
  both doors. One is in the room until one steps off a door to the corridor.
* Printed colours, the number of swaps and the trap give a door's colour: one door is red and one blue, whoever
  comes and goes, unless somebody is trapped.
* *Trap*: the first entry of the player whom the round names, from `trap_tick` on, with the other neither in the
  room nor on one of its doors, recolours the one door that still has this player's colour. It happens once a round.
* *Freeing*: when the other enters, doors swap as ever and the recolouring ends.
* Each player has a group of three tokens in one room and collects by standing on them; when the last is collected a
  group appears at random in another room, never in the one with the other's group (the paper: tokens "appeared in
  different rooms").

Kernels here and in the other modules of the game are compiled without numba's reference counts (`_nrt=False`):
nothing in them makes an array, whoever calls keeps all of them, and counting took four fifths of the time of a
tick.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.game.chance import mixed, random_below
from models.game.layout import DOOR, FIRST_PLACE, PLACES, ROOM, ROOMS
from models.game.parameters import SETTING
from models.game.state import (
    ACTS,
    BLUE,
    CELL,
    COUNT,
    DRAWS,
    FREED_TICK,
    GROUP,
    GROUP_SIZE,
    GROUPS,
    HUMAN,
    MEMBER,
    NAMED,
    PARITY,
    READY,
    RECOLOURED,
    RED,
    ROBOT,
    SEED,
    TICK,
    TOKEN,
    TRAP_ROOM,
    TRAP_TICK,
    TRAPPED,
    VERSION,
    door_colour,
    may_step,
)

_PLACES_STREAM = np.uint64(0x746F6B656E730001)
"""Keeps token places apart from other uses of a round's seed."""


@kernel(_nrt=False)
def begin(state, rooms, settings, starts, named, acts, seed):  # type: ignore[no-untyped-def]
    """Fill `state` with the first moment of a round.

    Parameters
    ----------
    state : int64[SIZE]
        Overwritten.
    rooms, settings : arrays of the layout and the parameters
    starts : (int, int)
    named : int
        Player whom the round traps.
    acts : bool
    seed : uint64
    """
    state[:] = 0
    state[SEED] = np.int64(mixed(np.uint64(seed) ^ _PLACES_STREAM))
    state[NAMED] = named
    state[ACTS] = 1 if acts else 0
    state[RECOLOURED] = state[TRAPPED] = state[TRAP_ROOM] = state[TRAP_TICK] = state[FREED_TICK] = -1
    for i in range(2 * GROUP_SIZE):
        state[TOKEN + i] = -1
    for player in (HUMAN, ROBOT):
        state[CELL + player] = starts[player]
        state[MEMBER + player] = -1
        state[GROUP + player] = -1
    for player in (HUMAN, ROBOT):
        new_group(state, rooms, settings, player)


@kernel(_nrt=False)
def advance(state, cells, rooms, settings, human, robot):  # type: ignore[no-untyped-def]
    """One tick: the human's move, the robot's, then both collect. Nothing happens once the round is over."""
    if state[TICK] >= settings[SETTING.round_ticks]:
        return
    _step(state, cells, rooms, settings, HUMAN, human)
    _step(state, cells, rooms, settings, ROBOT, robot)
    _collect(state, rooms, settings, HUMAN)
    _collect(state, rooms, settings, ROBOT)
    state[TICK] += 1


@kernel(_nrt=False)
def _step(state, cells, rooms, settings, player, move):  # type: ignore[no-untyped-def]
    if move == 0 or not may_step(state, player):
        return
    here = state[CELL + player]
    there = cells[here, move]
    if there < 0 or (cells[there, DOOR] > 0 and door_colour(state, cells, there) != player):
        return
    state[CELL + player] = there
    state[READY + player] = state[TICK] + settings[SETTING.human_step_ticks + player]
    if cells[here, DOOR] > 0:
        # Off a door it is either inside or out to the corridor: no door is beside another.
        if cells[there, ROOM] < 0:
            state[MEMBER + player] = -1
        elif state[MEMBER + player] < 0:
            _enter(state, cells, rooms, settings, player, cells[there, ROOM])


@kernel(_nrt=False)
def _enter(state, cells, rooms, settings, player, room):  # type: ignore[no-untyped-def]
    other = 1 - player
    state[MEMBER + player] = room
    state[PARITY + room] ^= 1
    for p in (HUMAN, ROBOT):
        if state[MEMBER + p] == room or state[GROUP + p] == room:
            state[VERSION + p] += 1
    if state[TRAPPED] == other and state[TRAP_ROOM] == room:
        state[TRAPPED] = -1
        state[RECOLOURED] = -1
        state[FREED_TICK] = state[TICK]
        state[VERSION + HUMAN] += 1
        state[VERSION + ROBOT] += 1
    elif (
        state[NAMED] == player
        and state[TRAP_TICK] < 0
        and state[TICK] >= settings[SETTING.trap_tick]
        # Whoever is in a room stands in it or on one of its doors.
        and cells[state[CELL + other], ROOM] != room
    ):
        state[TRAPPED] = player
        state[TRAP_ROOM] = room
        state[TRAP_TICK] = state[TICK]
        for printed in (RED, BLUE):
            if door_colour(state, cells, rooms[room, printed]) == player:
                state[RECOLOURED] = rooms[room, printed]
                break
        if settings[SETTING.clear_trapped_room] and state[GROUP + other] == room:
            _move_group(state, rooms, settings, other)
        state[VERSION + HUMAN] += 1
        state[VERSION + ROBOT] += 1


@kernel(_nrt=False)
def _collect(state, rooms, settings, player):  # type: ignore[no-untyped-def]
    first = TOKEN + GROUP_SIZE * player
    here = state[CELL + player]
    for i in range(first, first + GROUP_SIZE):
        if state[i] == here:
            state[i] = -1
            state[COUNT + player] += 1
            state[VERSION + player] += 1
            left = 0
            for j in range(first, first + GROUP_SIZE):
                left += state[j] >= 0
            if left == 0:
                new_group(state, rooms, settings, player)
            return


@kernel(_nrt=False)
def new_group(state, rooms, settings, player):  # type: ignore[no-untyped-def]
    """Three tokens for a player, in a room other than that of its last ones and of the other's."""
    room = _other_room(state, settings, player)
    state[GROUP + player] = room
    state[GROUPS + player] += 1
    state[VERSION + player] += 1
    first = TOKEN + GROUP_SIZE * player
    for i in range(first, first + GROUP_SIZE):
        state[i] = _free_place(state, rooms, room)


@kernel(_nrt=False)
def _move_group(state, rooms, settings, player):  # type: ignore[no-untyped-def]
    """What is left of a group appears in another room."""
    room = _other_room(state, settings, player)
    state[GROUP + player] = room
    first = TOKEN + GROUP_SIZE * player
    for i in range(first, first + GROUP_SIZE):
        if state[i] >= 0:
            state[i] = -1
            state[i] = _free_place(state, rooms, room)


@kernel(_nrt=False)
def _other_room(state, settings, player):  # type: ignore[no-untyped-def]
    """A room drawn from those that hold no group and are not closed to new tokens: at least one of four."""
    closed = -1
    if settings[SETTING.clear_trapped_room] and state[TRAPPED] == 1 - player:
        closed = state[TRAP_ROOM]
    choices = 0
    for room in range(ROOMS):
        choices += room != state[GROUP] and room != state[GROUP + ROBOT] and room != closed
    chosen = random_below(state, SEED, DRAWS, choices)
    for room in range(ROOMS):
        if room != state[GROUP] and room != state[GROUP + ROBOT] and room != closed:
            if chosen == 0:
                return room
            chosen -= 1
    return -1


@kernel(_nrt=False)
def _free_place(state, rooms, room):  # type: ignore[no-untyped-def]
    """A cell of a room without a token on it, all equally likely; other rooms' tokens are never in the way."""
    free = rooms[room, PLACES]
    for i in range(rooms[room, PLACES]):
        free -= _occupied(state, rooms[room, FIRST_PLACE + i])
    chosen = random_below(state, SEED, DRAWS, free)
    for i in range(rooms[room, PLACES]):
        place = rooms[room, FIRST_PLACE + i]
        if not _occupied(state, place):
            if chosen == 0:
                return place
            chosen -= 1
    return -1


@kernel(_nrt=False)
def _occupied(state, cell):  # type: ignore[no-untyped-def]
    tokens = 0
    for i in range(2 * GROUP_SIZE):
        tokens += state[TOKEN + i] == cell
    return tokens > 0
