"""Shortest routes by A*: over cells, with doors passable by colour; ties are broken the same way every time.

The estimate of what is left is the distance to the nearest goal without walls. A step changes it by at most one, so
what a route is expected to cost grows by 0, 1 or 2 with every step: three stacks do for a priority queue, and a
cell taken from the lowest stack is final when it is taken first.

Source: Hart, Nilsson & Raphael (1968), A formal basis for the heuristic determination of minimum cost paths.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.game.layout import DOOR, ROOM, Layout, distance
from models.game.state import CELL, door_colour

_STACKS = 3
_PUSHES = 4
"""A cell is put on a stack at most once from each side."""

_FAR = np.int32(1 << 30)

# Rows of the scratch that a search needs.
_COST, _FROM, _STACK = 0, 1, 2
SCRATCH_ROWS = _STACK + _STACKS * _PUSHES


def route_scratch(layout: Layout) -> NDArray[np.int32]:
    """Room for searches on a map; nothing in it has to be kept."""
    return np.zeros((SCRATCH_ROWS, len(layout.cells)), dtype=np.int32)


@kernel(_nrt=False)
def find_route(state, cells, player, goals, n_goals, avoid, path, scratch):  # type: ignore[no-untyped-def]
    """Find a shortest route from where a player stands to the nearest goal.

    Parameters
    ----------
    state : int64[SIZE]
    cells : int32[cells, 9]
    player : int
        Doors let it pass that have its colour now.
    goals : int64[most]
        Cells, of which the first `n_goals` count.
    n_goals : int
    avoid : int
        A room whose doors are not taken, -1 if none.
    path : int32[cells]
        Filled with the moves of the route, the last one first.
    scratch : int32[SCRATCH_ROWS, cells]

    Returns
    -------
    int
        Steps of the route; -1 if there is none.
    """
    n = len(cells)
    cost, source = scratch[_COST], scratch[_FROM]
    stacks = scratch[_STACK:].reshape(_STACKS, _PUSHES * n)
    for cell in range(n):
        cost[cell] = _FAR
    if n_goals == 0:
        return -1
    start = state[CELL + player]
    size0, size1, size2 = 1, 0, 0
    stacks[0, 0] = start
    cost[start] = 0
    source[start] = 0
    lowest = 0
    # A cell that was put on a stack twice is final the first time: the second time leads nowhere new.
    while size0 + size1 + size2 > 0:
        while (size0 if lowest == 0 else size1 if lowest == 1 else size2) == 0:
            lowest = lowest + 1 if lowest < 2 else 0
        if lowest == 0:
            size0 -= 1
            here = stacks[0, size0]
        elif lowest == 1:
            size1 -= 1
            here = stacks[1, size1]
        else:
            size2 -= 1
            here = stacks[2, size2]
        estimate = _estimate(cells, goals, n_goals, here)
        if estimate == 0:
            return _trace(cells, source, start, here, path)
        for move in range(1, 5):
            there = cells[here, move]
            if there < 0 or cost[there] <= cost[here] + 1:
                continue
            if cells[there, DOOR] > 0 and (
                cells[there, ROOM] == avoid or door_colour(state, cells, there) != player
            ):
                continue
            cost[there] = cost[here] + 1
            source[there] = move
            onto = (lowest + 1 + _estimate(cells, goals, n_goals, there) - estimate) % _STACKS
            if onto == 0:
                stacks[0, size0] = there
                size0 += 1
            elif onto == 1:
                stacks[1, size1] = there
                size1 += 1
            else:
                stacks[2, size2] = there
                size2 += 1
    return -1


@kernel(_nrt=False)
def _estimate(cells, goals, n_goals, cell):  # type: ignore[no-untyped-def]
    """Distance to the nearest goal if there were no walls."""
    least = distance(cells, goals[0], cell)
    for i in range(1, n_goals):
        least = min(least, distance(cells, goals[i], cell))
    return least


@kernel(_nrt=False)
def _trace(cells, source, start, goal, path):  # type: ignore[no-untyped-def]
    """Write the moves of the route found, last first."""
    length = 0
    here = goal
    while here != start:
        move = source[here]
        path[length] = move
        length += 1
        # Up and down, left and right are neighbours in number: 1 and 2, 3 and 4.
        here = cells[here, ((move - 1) ^ 1) + 1]
    return length
