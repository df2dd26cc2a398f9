"""Small pictures that the game is drawn with: everything has a shape of its own, so colour is never needed.

Round is the human's, square the robot's: players, tokens, and the sign on the doors that let a player pass. Colours
are the vermillion and blue of Okabe and Ito, which people with any colour vision tell apart.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Picture = NDArray[np.uint8]
"""``[row, column, 4]``: red, green, blue, opacity."""

RED, BLUE = (213, 94, 0), (0, 114, 178)
INK, WALL, EDGE = (27, 31, 36), (62, 71, 84), (44, 51, 61)
CORRIDOR, INSIDE = (246, 244, 239), (226, 232, 238)
WHITE, YELLOW, SHADE = (255, 255, 255), (255, 214, 51), (196, 203, 211)
BAR, RULE = (244, 241, 234), (213, 218, 225)

OVERSAMPLING = 6
"""Pictures are drawn so many times larger and averaged down: smooth edges from PIL's hard ones."""


class _Pen:
    """Draws on a square of side 1, whatever the number of pixels."""

    def __init__(self, draw: ImageDraw.ImageDraw, side: int) -> None:
        self.draw, self.side = draw, side

    def _box(self, x: float, y: float, width: float, height: float) -> tuple[float, float, float, float]:
        s = self.side
        return (x - width / 2) * s, (y - height / 2) * s, (x + width / 2) * s - 1, (y + height / 2) * s - 1

    def disc(self, x: float, y: float, across: float, colour: tuple[int, ...]) -> None:
        self.draw.ellipse(self._box(x, y, across, across), fill=colour)

    def box(self, x: float, y: float, width: float, height: float, colour: tuple[int, ...], r: float = 0.0) -> None:
        self.draw.rounded_rectangle(self._box(x, y, width, height), r * self.side, fill=colour)

    def smile(self, x: float, y: float, across: float, colour: tuple[int, ...], thick: float) -> None:
        self.draw.arc(self._box(x, y, across, across), 25, 155, fill=colour, width=round(thick * self.side))

    def stripe(self, at: float, thick: float, colour: tuple[int, ...]) -> None:
        """Diagonal from the lower left to the upper right, its middle meeting the upper edge at `at`."""
        s = self.side
        half = thick / 2
        corners = [(at - half, 0), (at + half, 0), (at + half - 1, 1), (at - half - 1, 1)]
        self.draw.polygon([(x * s, y * s) for x, y in corners], fill=colour)


def _human(pen: _Pen) -> None:
    pen.disc(0.5, 0.5, 0.9, INK)
    pen.disc(0.5, 0.5, 0.8, RED)
    for x in (0.37, 0.63):
        pen.disc(x, 0.42, 0.13, WHITE)
    pen.smile(0.5, 0.5, 0.42, WHITE, 0.07)


def _robot(pen: _Pen) -> None:
    pen.box(0.5, 0.12, 0.07, 0.2, INK)
    pen.disc(0.5, 0.08, 0.15, INK)
    pen.box(0.5, 0.56, 0.84, 0.78, INK, 0.12)
    pen.box(0.5, 0.56, 0.74, 0.68, BLUE, 0.08)
    for x in (0.35, 0.65):
        pen.box(x, 0.47, 0.15, 0.15, WHITE)
    pen.box(0.5, 0.73, 0.42, 0.09, WHITE)


def _human_token(pen: _Pen) -> None:
    pen.disc(0.5, 0.5, 0.52, INK)
    pen.disc(0.5, 0.5, 0.42, RED)
    pen.disc(0.5, 0.5, 0.2, WHITE)


def _robot_token(pen: _Pen) -> None:
    pen.box(0.5, 0.5, 0.54, 0.54, INK)
    pen.box(0.5, 0.5, 0.44, 0.44, BLUE)
    pen.box(0.5, 0.5, 0.3, 0.1, WHITE)


def _door(pen: _Pen, colour: tuple[int, ...]) -> None:
    pen.box(0.5, 0.5, 1, 1, EDGE)
    pen.box(0.5, 0.5, 0.86, 0.86, colour)


def _red_door(pen: _Pen) -> None:
    _door(pen, RED)
    pen.disc(0.5, 0.5, 0.56, WHITE)
    pen.disc(0.5, 0.5, 0.28, RED)


def _blue_door(pen: _Pen) -> None:
    _door(pen, BLUE)
    for x in (0.34, 0.66):
        for y in (0.34, 0.66):
            pen.box(x, y, 0.2, 0.2, WHITE)


def _cage(pen: _Pen) -> None:
    # Dark with a light rim: to be seen before both players and every floor.
    for colour, more in ((WHITE, 0.06), (INK, 0.0)):
        for x in (0.1, 0.5, 0.9):
            pen.box(x, 0.5, 0.08 + more, 0.92, colour)
        for y in (0.06, 0.94):
            pen.box(0.5, y, 0.94, 0.08 + more, colour)


def _shut(pen: _Pen) -> None:
    """Floor of the room in which somebody is trapped."""
    pen.box(0.5, 0.5, 1, 1, SHADE)


def _flash(pen: _Pen) -> None:
    """Floor of a room that flashes: stripes, which a grey print shows too."""
    pen.box(0.5, 0.5, 1, 1, YELLOW)
    for at in (0.0, 0.5, 1.0, 1.5, 2.0):
        pen.stripe(at, 0.2, WHITE)


SPRITES: dict[str, Callable[[_Pen], None]] = {
    "shut": _shut,
    "flash": _flash,
    "red": _red_door,
    "blue": _blue_door,
    "human_token": _human_token,
    "robot_token": _robot_token,
    "human": _human,
    "robot": _robot,
    "cage": _cage,
}


@cache
def sprite(name: str, side: int) -> Picture:
    """One of `SPRITES` as a square of `side` pixels; not to be written to.

    Examples
    --------
    >>> sprite("cage", 20).shape
    (20, 20, 4)
    """
    large = Image.new("RGBA", (side * OVERSAMPLING, side * OVERSAMPLING), (0, 0, 0, 0))
    SPRITES[name](_Pen(ImageDraw.Draw(large), side * OVERSAMPLING))
    # Averaged with the opacity multiplied in, or edges would take on the colour of what is transparent.
    small = large.convert("RGBa").reduce(OVERSAMPLING).convert("RGBA")
    return _frozen(np.array(small))


@cache
def words(text: str, height: int, colour: tuple[int, int, int] = INK) -> Picture:
    """A line of text in letters of `height` pixels; not to be written to."""
    font = ImageFont.load_default(size=height)
    left, _, right, _ = font.getbbox(text)
    ascent, descent = font.getmetrics()  # type: ignore[union-attr]
    picture = Image.new("RGBA", (max(1, round(right - left) + 2), ascent + descent), (*colour, 0))
    ImageDraw.Draw(picture).text((1 - left, 0), text, font=font, fill=(*colour, 255))
    return _frozen(np.array(picture))


def _frozen(picture: Picture) -> Picture:
    picture.flags.writeable = False
    return picture
