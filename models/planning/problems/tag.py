r"""Tag: a robot chases an opponent that runs away, its own cell seen, the opponent's only when they meet.

The 29 cells are two rows of ten and, on top of columns 5 to 7 of those, a block of three by three; they are
numbered by rows from the south-west corner::

                   26 27 28
                   23 24 25
                   20 21 22
    10 11 12 13 14 15 16 17 18 19
     0  1  2  3  4  5  6  7  8  9

The mode is the robot's cell, the hidden state the opponent's cell or ``tagged``. Actions: north, south, east, west
(certain; a wall stops the robot) at a cost of 1, and tag, worth 10 where the opponent is and costing 10 elsewhere.
The opponent sees the robot where it was: on each axis it moves away with probability .4, or to either side with .2
if it is level with the robot; it stays with .2, and wherever a wall stops it. While the robot tries to tag, it
stands still. Observations, after each step: ``yes`` if both are in one cell, ``no`` otherwise. Both cells are
uniform at first, and the robot sees its own before acting.

The file ``tag-avoid.pomdp`` in circulation is not quite this problem, so its values are a little different: its
opponent runs otherwise in four of the 870 states (robot and opponent at 19, 19; 25, 23; 27, 24; 27, 27), and moving
goes on costing 1 after the opponent is tagged.

References
----------
Pineau, J., Gordon, G., & Thrun, S. (2003). Point-based value iteration: an anytime algorithm for POMDPs. IJCAI,
1025-1030, section 5.2.
"""

from __future__ import annotations

from collections.abc import Hashable
from itertools import product
from typing import NamedTuple

from models.planning.problem import Problem
from models.planning.textbook import problem_from_functions

Cell = tuple[int, int]

CELLS: tuple[Cell, ...] = (
    *((x, y) for y in range(2) for x in range(10)),
    *((x, y) for y in range(2, 5) for x in range(5, 8)),
)
"""Cells in their order, x to the east and y to the north."""

MOVES: dict[str, Cell] = {"north": (0, 1), "south": (0, -1), "east": (1, 0), "west": (-1, 0)}


class Chase(NamedTuple):
    """A state: the robot's cell and the opponent's (None once tagged), by number; shown by the opponent's."""

    robot: int
    opponent: int | None

    def __str__(self) -> str:
        return "tagged" if self.opponent is None else f"at{self.opponent}"


def tag(discount: float = 0.95) -> Problem:
    """Tag on 29 cells; see the module.

    Examples
    --------
    >>> problem = tag()
    >>> problem.n_modes, problem.n_states
    (29, 30)
    """
    where = {cell: i for i, cell in enumerate(CELLS)}
    robots = range(len(CELLS))
    states = [Chase(r, o) for r in robots for o in (*robots, None)]

    def moved(cell: int, step: Cell) -> int:
        x, y = CELLS[cell]
        return where.get((x + step[0], y + step[1]), cell)

    def flight(robot: int, opponent: int) -> dict[int, float]:
        ends = {opponent: 0.2}
        for axis in range(2):
            distance = CELLS[opponent][axis] - CELLS[robot][axis]
            sides = [(1, 0.2), (-1, 0.2)] if distance == 0 else [(1 if distance > 0 else -1, 0.4)]
            for side, probability in sides:
                end = moved(opponent, (side, 0) if axis == 0 else (0, side))
                ends[end] = ends.get(end, 0.0) + probability
        return ends

    def transition(state: Chase, action: str) -> dict[Hashable, float]:
        if state.opponent is None:
            return {state: 1.0}
        if action == "tag":
            return {Chase(state.robot, None) if state.robot == state.opponent else state: 1.0}
        robot = moved(state.robot, MOVES[action])
        return {Chase(robot, o): p for o, p in flight(state.robot, state.opponent).items()}

    def observation(action: str, state: Chase) -> dict[str, float]:
        return {"yes" if state.robot == state.opponent else "no": 1.0}

    def reward(state: Chase, action: str) -> float:
        if state.opponent is None:
            return 0.0
        if action == "tag":
            return 10.0 if state.robot == state.opponent else -10.0
        return -1.0

    even = 1 / len(CELLS) ** 2
    return problem_from_functions(
        states, (*MOVES, "tag"), transition, observation, reward, discount,
        {Chase(r, o): even for r, o in product(robots, repeat=2)}, mode=lambda s: str(s.robot), name="tag",
    )  # fmt: skip
