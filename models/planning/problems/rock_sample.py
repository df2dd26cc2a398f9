r"""Rock sample: a rover among rocks of unknown worth, its own position seen.

The grid is `size` x `size`, x to the east, y to the north. The mode is the rover's cell (``3,1``) or ``exit``, the
hidden state says of each rock whether it is good (``GBBG``: rocks in their order). Actions: north, south, east,
west (certain), sample, check0, check1, ... Leaving the grid to the east ends everything for a reward of 10.
Sampling a good rock gives 10 and leaves it bad, sampling a bad one costs 10. Checking rock `i` from a distance
:math:`d` tells the truth with probability :math:`(1 + 2^{-d/20}) / 2`; every other action shows nothing
(``none``).

Moves off the other edges and sampling where there is no rock are not offered. Some versions offer them at a
penalty of 100, which no good plan ever takes, so that the best values are the same.

References
----------
Smith, T., & Simmons, R. (2004). Heuristic search value iteration for POMDPs. UAI, 520-527.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import NamedTuple

from models.errors import Phrase, located
from models.planning.problem import Problem
from models.planning.textbook import problem_from_functions

Cell = tuple[int, int]

HALF_DISTANCE = 20.0
"""Distance at which the sensor's efficiency is a half."""

LAYOUTS: Mapping[tuple[int, int], tuple[Cell, ...]] = {
    (4, 4): ((3, 1), (2, 1), (1, 3), (1, 0)),
    (5, 5): ((2, 4), (0, 4), (3, 3), (2, 2), (4, 1)),
    (5, 7): ((1, 0), (2, 1), (1, 2), (2, 2), (4, 2), (0, 3), (3, 4)),
    (7, 8): ((2, 0), (0, 1), (3, 1), (6, 3), (2, 4), (3, 4), (5, 5), (1, 6)),
}
"""Rocks of the sizes on which values are published. The paper prints no cells; these are the ones that solvers are
compared on, those of the rock sample files that come with ZMDP, APPL and DESPOT."""

MOVES: Mapping[str, Cell] = {"north": (0, 1), "south": (0, -1), "east": (1, 0), "west": (-1, 0)}

EXIT = "exit"


class Rocks(NamedTuple):
    """A state: the rover's cell (None after leaving) and which rocks are good; shown by the rocks."""

    cell: Cell | None
    good: tuple[bool, ...]

    def __str__(self) -> str:
        return "".join("G" if g else "B" for g in self.good) or "over"


def rock_sample(
    size: int, n_rocks: int, rocks: Sequence[Cell] | None = None, start: Cell | None = None, discount: float = 0.95
) -> Problem:
    """Rock sample on a grid; see the module.

    Parameters
    ----------
    size, n_rocks : int
    rocks : sequence of (x, y), optional
        Where the rocks are; `LAYOUTS` has those of the usual sizes.
    start : (x, y), optional
        West edge, middle row ``size // 2`` by default.
    discount : float

    Raises
    ------
    InputError
        On a size without a layout, or rocks that do not fit.

    Examples
    --------
    >>> rock_sample(2, 1, rocks=[(0, 0)]).modes
    ('0,0', '0,1', '1,0', '1,1', 'exit')
    """
    place = f"rock_sample({size}, {n_rocks})"
    if rocks is None:
        if (size, n_rocks) not in LAYOUTS:
            known = ", ".join(map(str, LAYOUTS))
            raise located(f"{place}, rocks", Phrase("none"), f"their cells: layouts are known for {known}")
        rocks = LAYOUTS[size, n_rocks]
    cells = [(int(x), int(y)) for x, y in rocks]
    first = (0, size // 2) if start is None else start
    grid = set(product(range(size), repeat=2))
    if len(cells) != n_rocks or len(set(cells)) != n_rocks or not set(cells) <= grid:
        raise located(f"{place}, rocks", cells, f"{n_rocks} different cells of the grid")
    if first not in grid:
        raise located(f"{place}, start", first, "a cell of the grid")
    worths = list(product([False, True], repeat=n_rocks))
    over = Rocks(None, ())
    states = [Rocks((x, y), good) for x in range(size) for y in range(size) for good in worths] + [over]
    checks = {f"check{i}": i for i in range(n_rocks)}
    rock_at = {cell: i for i, cell in enumerate(cells)}

    def mode(state: Rocks) -> str:
        return EXIT if state.cell is None else f"{state.cell[0]},{state.cell[1]}"

    cell_of = {f"{x},{y}": (x, y) for x, y in grid}

    def available(label: str, action: str) -> bool:
        if label == EXIT:
            return action == "north"
        x, y = cell_of[label]
        if action in MOVES:
            dx, dy = MOVES[action]
            return action == "east" or (x + dx, y + dy) in grid
        return action in checks or (x, y) in rock_at

    def transition(state: Rocks, action: str) -> dict[Hashable, float]:
        if state.cell is None or action in checks:
            return {state: 1.0}
        if action == "sample":
            i = rock_at[state.cell]
            return {Rocks(state.cell, (*state.good[:i], False, *state.good[i + 1 :])): 1.0}
        x, y = state.cell[0] + MOVES[action][0], state.cell[1] + MOVES[action][1]
        return {over if x == size else Rocks((x, y), state.good): 1.0}

    def observation(action: str, state: Rocks) -> dict[str, float]:
        if action not in checks or state.cell is None:
            return {"none": 1.0}
        i = checks[action]
        right = (1 + 2 ** (-_distance(state.cell, cells[i]) / HALF_DISTANCE)) / 2
        seen, other = ("good", "bad") if state.good[i] else ("bad", "good")
        return {seen: right, other: 1 - right} if right < 1 else {seen: 1.0}

    def reward(state: Rocks, action: str) -> float:
        if state.cell is None:
            return 0.0
        if action == "sample":
            return 10.0 if state.good[rock_at[state.cell]] else -10.0
        return 10.0 if action == "east" and state.cell[0] == size - 1 else 0.0

    return problem_from_functions(
        states, (*MOVES, "sample", *checks), transition, observation, reward, discount,
        {Rocks(first, good): 1 / len(worths) for good in worths}, mode=mode, available=available,
        name=f"rock_sample_{size}_{n_rocks}",
    )  # fmt: skip


def _distance(one: Cell, other: Cell) -> float:
    return float(((one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2) ** 0.5)
