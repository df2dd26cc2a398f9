"""Pictures of the token game: frames as arrays, or text.

A frame is the map without anything on it, and small pictures (`render_sprites`) put on it one after the other.
`Painter.things` and `Painter.players` say which and where, so whatever else shows a round, a page for example,
shows the same.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.game.layout import Layout
from models.game.parameters import TICKS_A_SECOND
from models.game.render_sprites import (
    BAR,
    BLUE,
    CORRIDOR,
    EDGE,
    INK,
    INSIDE,
    RED,
    RULE,
    WALL,
    Picture,
    sprite,
    words,
)
from models.game.state import GameState

Frame = NDArray[np.uint8]
"""``[row, column, 3]``: red, green, blue."""

Place = tuple[float, float]
"""Row and column; between two cells while a player walks."""

FLASH_TICKS = 4
"""Ticks that a flashing room is lit, and then dark, and so on: at 1.25 Hz, far below what can set off a seizure."""

HEADER_CELLS = 1.75
"""Height of the header in cells."""

GRID = 12
"""How much darker than the floor the lines between cells are."""

STARTS = {"H": RED, "R": BLUE}
SMALLEST_CELL = 12


class Placement(NamedTuple):
    """A small picture and where its upper left corner is, in pixels of the board."""

    sprite: str
    x: int
    y: int


class Painter:
    """Draws rounds on one map.

    Parameters
    ----------
    layout : Layout
    round_ticks : int
    cell : int
        Pixels a cell, even (films want even sizes).

    Attributes
    ----------
    board : uint8[height, width, 3]
        The map without doors, tokens and players; not to be written to.
    height, width : int
        Pixels of a frame: the board and the header above it.

    Examples
    --------
    >>> from models.game.round import Round
    >>> game = Round()
    >>> Painter(game.layout, game.parameters.round_ticks, cell=20).frame(game.view).shape
    (336, 300, 3)
    """

    def __init__(self, layout: Layout, round_ticks: int, cell: int = 32) -> None:
        if isinstance(cell, bool) or not isinstance(cell, int) or cell < SMALLEST_CELL or cell % 2:
            raise located("painter, cell", cell, f"an even number of pixels, at least {SMALLEST_CELL}")
        self.layout, self.round_ticks, self.cell = layout, round_ticks, cell
        self.board = _board(layout, cell)
        self.header = 2 * round(HEADER_CELLS * cell / 2)
        self.height, self.width = self.header + self.board.shape[0], self.board.shape[1]

    # -- what is where -----------------------------------------------------------------------------
    def things(self, view: GameState) -> list[Placement]:
        """Everything but the players, in the order in which it is drawn."""
        out = []
        if view.trapped_room is not None:
            floor = "flash" if self.lit(view) else "shut"
            out += [self._at(floor, cell) for cell in self.layout.inside(view.trapped_room)]
        out += [self._at(colour, cell) for cell, colour in view.doors]
        out += [self._at("human_token", cell) for cell in view.human_tokens]
        out += [self._at("robot_token", cell) for cell in view.robot_tokens]
        return out

    def players(self, view: GameState, human: Place | None = None, robot: Place | None = None) -> list[Placement]:
        """Both players, and a cage in front of the one that is trapped.

        Parameters
        ----------
        view : GameState
        human, robot : (row, column), optional
            Where to draw a player that is on its way from one cell to the next; in its cell by default.
        """
        at = {"robot": robot or view.robot, "human": human or view.human}
        (up, left), (down, right) = at["human"], at["robot"]
        if abs(up - down) < 0.5 and abs(left - right) < 0.5:
            # Side by side as far as the cell allows, or one would hide the other.
            apart = 0.2 * (1 - 2 * max(abs(up - down), abs(left - right)))
            at = {"robot": (down, right + apart), "human": (up, left - apart)}
        out = [self._at(name, place) for name, place in at.items()]
        if view.trapped is not None:
            out.append(self._at("cage", at[view.trapped]))
        return out

    def lit(self, view: GameState) -> bool:
        """Whether a room flashes and is in the bright half of its flashing."""
        if view.flashing_room is None or view.trapped_tick is None:
            return False
        return (view.tick - view.trapped_tick) // FLASH_TICKS % 2 == 0

    def _at(self, name: str, place: Place) -> Placement:
        return Placement(name, round(place[1] * self.cell), round(place[0] * self.cell))

    # -- frames ------------------------------------------------------------------------------------
    def frame(self, view: GameState, human: Place | None = None, robot: Place | None = None) -> Frame:
        """Draw one tick: header and board, ``uint8[height, width, 3]``."""
        out = np.empty((self.height, self.width, 3), dtype=np.uint8)
        self._draw_header(out[: self.header], view)
        board = out[self.header :]
        board[:] = self.board
        for name, x, y in [*self.things(view), *self.players(view, human, robot)]:
            put(board, sprite(name, self.cell), x, y)
        return out

    def _draw_header(self, out: Frame, view: GameState) -> None:
        cell, width = self.cell, self.width
        out[:] = BAR
        out[-2:] = EDGE
        middle = round(0.62 * cell)
        for name, count, left in (("human", view.human_collected, True), ("robot", view.robot_collected, False)):
            text = words(str(count), round(0.72 * cell))
            icon = round(0.3 * cell) if left else width - round(1.3 * cell)
            put(out, sprite(name, cell), icon, middle - cell // 2)
            beside = icon + round(1.2 * cell) if left else icon - round(0.2 * cell) - text.shape[1]
            put(out, text, beside, middle - text.shape[0] // 2)
        clock = words(clock_text(view, self.round_ticks), round(0.72 * cell))
        put(out, clock, (width - clock.shape[1]) // 2, middle - clock.shape[0] // 2)
        status = status_text(view)
        if status:
            line = words(status, round(0.44 * cell))
            put(out, line, (width - line.shape[1]) // 2, round(1.28 * cell) - line.shape[0] // 2)
        else:
            thick, start, end = max(2, cell // 8), round(0.3 * cell), width - round(0.3 * cell)
            # By whole seconds, as the clock: films are smaller for every frame that changes nothing.
            seconds = view.tick // TICKS_A_SECOND * TICKS_A_SECOND
            done = start + round((end - start) * min(1.0, seconds / self.round_ticks))
            at = round(1.28 * cell)
            out[at : at + thick, start:end] = RULE
            out[at : at + thick, start:done] = INK


def put(frame: Frame, picture: Picture, x: int, y: int) -> None:
    """Lay a picture over a frame, upper left corner at column `x` and row `y`; what sticks out is cut off."""
    top, left = max(0, y), max(0, x)
    bottom, right = min(frame.shape[0], y + picture.shape[0]), min(frame.shape[1], x + picture.shape[1])
    if top >= bottom or left >= right:
        return
    part = picture[top - y : bottom - y, left - x : right - x]
    under = frame[top:bottom, left:right]
    opacity = part[..., 3:].astype(np.uint16)
    under[:] = (part[..., :3] * opacity + under * (255 - opacity) + 127) // 255


def clock_text(view: GameState, round_ticks: int) -> str:
    """Time left, in whole seconds that have begun.

    Examples
    --------
    >>> from models.game.round import Round
    >>> clock_text(Round().view, 900)
    '1:30'
    """
    seconds = -(-max(0, round_ticks - view.tick) // TICKS_A_SECOND)
    return f"{seconds // 60}:{seconds % 60:02d}"


def status_text(view: GameState) -> str:
    """Who is trapped, in words; nothing while nobody is."""
    if view.trapped is None:
        return ""
    return f"{view.trapped} trapped" + (", signals" if view.flashing_room is not None else "")


def as_text(view: GameState, layout: Layout, round_ticks: int) -> str:
    """Draw a tick as text.

    As the map, with doors in their present colours (r, b), players H and R (& where both are), and tokens o (the
    human's) and x (the robot's); rooms as dots, with somebody trapped as :, flashing as !.
    """
    rows = [["#" if character == "#" else "." for character in line] for line in layout.lines]
    if view.trapped_room is not None:
        for row, column in layout.inside(view.trapped_room):
            rows[row][column] = ":" if view.flashing_room is None else "!"
    for (row, column), colour in view.doors:
        rows[row][column] = colour[0]
    for cells, letter in (
        (view.human_tokens, "o"),
        (view.robot_tokens, "x"),
        ((view.robot,), "R"),
        ((view.human,), "H"),
    ):
        for row, column in cells:
            rows[row][column] = letter
    if view.human == view.robot:
        rows[view.human[0]][view.human[1]] = "&"
    head = f"{clock_text(view, round_ticks)}  human {view.human_collected}  robot {view.robot_collected}"
    status = status_text(view)
    return "\n".join([f"{head}  {status}" if status else head, *("".join(row) for row in rows)])


@cache
def _board(layout: Layout, cell: int) -> Frame:
    out = np.empty((layout.height * cell, layout.width * cell, 3), dtype=np.uint8)
    line = max(1, cell // 24)
    for row, text in enumerate(layout.lines):
        for column, character in enumerate(text):
            here = out[row * cell : (row + 1) * cell, column * cell : (column + 1) * cell]
            if character == "#":
                here[:] = WALL
                continue
            here[:] = floor = INSIDE if character.isdigit() else CORRIDOR
            here[-line:] = here[:, -line:] = [shade - GRID for shade in floor]
            if character in STARTS:
                # A frame where a player starts; it means nothing to the rules.
                near, far = max(2, cell // 12), cell - max(2, cell // 12)
                inner = here[2 * near : cell - 2 * near, 2 * near : cell - 2 * near].copy()
                here[near:far, near:far] = STARTS[character]
                here[2 * near : cell - 2 * near, 2 * near : cell - 2 * near] = inner
    out.flags.writeable = False
    return out
