"""The map of a token game: text in, arrays for the kernels out, and everything that a map can be wrong about.

A map is text, one character a cell::

    #  wall         .  corridor      1 2 3 4  inside of a room
    r  red door     b  blue door     H R      where human and robot start

Every room has one red and one blue door, which lead from the corridor into it. Players move up,
down, left and right.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.errors import Phrase, located

Cell = tuple[int, int]
"""Row and column, from 0 at the top left."""

MAPS = Path(__file__).resolve().parent / "maps"
DEFAULT_MAP = "four_rooms"

ROOMS = 4
LEAST_PLACES = 3
"""Cells a room needs: those of a group of tokens."""

STEPS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
"""Row and column of each move: stay, up, down, left, right."""

# Columns of `Layout.cells` after the five cells that moves lead to (-1: into a wall).
ROOM, DOOR, ROW, COLUMN = 5, 6, 7, 8
# Columns of `Layout.rooms`: red and blue door, a cell behind each, how many cells there are inside, those cells.
INSIDE, PLACES, FIRST_PLACE = 2, 4, 5

KNOWN = "#.1234rbHR"
CORRIDOR = ".HR"


@dataclass(frozen=True)
class Layout:
    """A checked map.

    Attributes
    ----------
    name : str
    lines : tuple of str
        The map as text.
    cells : int32[cells, 9]
        Cells are numbered row by row. Columns: the cell that each move leads to (-1: a wall), the room (-1: none;
        a door has that of its room), the door (0 none, 1 printed red, 2 printed blue), row, column.
    rooms : int32[4, 5 + most]
        Red door, blue door, the cell behind each, the number of cells inside, those cells.
    starts : (int, int)
        Cells where human and robot start.
    """

    name: str
    lines: tuple[str, ...]
    cells: NDArray[np.int32] = field(repr=False, compare=False)
    rooms: NDArray[np.int32] = field(repr=False, compare=False)
    starts: tuple[int, int]

    # -- construction ------------------------------------------------------------------------------
    @classmethod
    def from_text(cls, text: str, name: str = "map", place: str | None = None) -> Layout:
        """Read a map; lines that are empty at the end are left out.

        Parameters
        ----------
        text : str
        name : str
        place : str, optional
            Named in errors; the map's name by default.

        Raises
        ------
        InputError
            With line and column, for anything that rules or players could trip over.
        """
        lines = tuple(line.rstrip("\r") for line in text.rstrip("\n").split("\n"))
        return _Reader(lines, place or f"map {name}").layout(name)

    @classmethod
    def from_file(cls, path: str | Path) -> Layout:
        """Read a map from a text file, named after it."""
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise located(str(path), Phrase(error.strerror or "no file"), "a text file with a map") from None
        except UnicodeDecodeError as error:
            raise located(f"{path}, byte {error.start}", Phrase("no UTF-8"), "a text file with a map") from None
        return cls.from_text(text, path.stem, str(path))

    # -- views -------------------------------------------------------------------------------------
    @property
    def height(self) -> int:
        """Number of rows."""
        return len(self.lines)

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.lines[0])

    @property
    def n_rooms(self) -> int:
        """Number of rooms."""
        return len(self.rooms)

    @property
    def text(self) -> str:
        """The map as a file holds it."""
        return "\n".join(self.lines) + "\n"

    @property
    def digest(self) -> str:
        """Short digest of the map, by which a record knows it."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]

    def cell(self, number: int) -> Cell:
        """Row and column of a numbered cell."""
        return divmod(number, self.width)

    def number(self, cell: Cell) -> int:
        """Number of a cell given by row and column."""
        return cell[0] * self.width + cell[1]

    def inside(self, room: int) -> tuple[Cell, ...]:
        """Cells inside a room, which is numbered from 1 as in the map."""
        entry = self.rooms[room - 1]
        return tuple(self.cell(int(c)) for c in entry[FIRST_PLACE : FIRST_PLACE + entry[PLACES]])


@cache
def packaged(name: str = DEFAULT_MAP) -> Layout:
    """One of the maps that come along.

    Examples
    --------
    >>> packaged().n_rooms
    4
    """
    if name not in packaged_names():
        raise located("map", name, f"one of {', '.join(packaged_names())}")
    return Layout.from_file(MAPS / f"{name}.txt")


def packaged_names() -> tuple[str, ...]:
    """Names of the maps that come along."""
    return tuple(sorted(path.stem for path in MAPS.glob("*.txt")))


@kernel(_nrt=False)
def distance(cells, one, other):  # type: ignore[no-untyped-def]
    """Steps between two cells if there were no walls."""
    return abs(cells[one, ROW] - cells[other, ROW]) + abs(cells[one, COLUMN] - cells[other, COLUMN])


class _Reader:
    """One map while it is checked."""

    def __init__(self, lines: tuple[str, ...], place: str) -> None:
        self.lines, self.place = lines, place
        self.height, self.width = len(lines), len(lines[0])

    def at(self, cell: Cell) -> str:
        return f"{self.place}, line {cell[0] + 1}, column {cell[1] + 1}"

    def character(self, cell: Cell) -> str:
        return self.lines[cell[0]][cell[1]]

    def all(self, wanted: str) -> Iterator[Cell]:
        for row, line in enumerate(self.lines):
            for column, character in enumerate(line):
                if character in wanted:
                    yield row, column

    def beside(self, cell: Cell) -> Iterator[Cell]:
        """Cells one step away that are no walls."""
        for down, right in STEPS[1:]:
            there = cell[0] + down, cell[1] + right
            if 0 <= there[0] < self.height and 0 <= there[1] < self.width and self.character(there) != "#":
                yield there

    def reached(self, start: Cell, through: str) -> set[Cell]:
        found, left = {start}, [start]
        while left:
            for there in self.beside(left.pop()):
                if there not in found and self.character(there) in through:
                    found.add(there)
                    left.append(there)
        return found

    def layout(self, name: str) -> Layout:
        self.check_characters()
        starts = [self.only_start(letter) for letter in "HR"]
        corridor = self.reached(starts[0], CORRIDOR)
        for cell in self.all(CORRIDOR):
            if cell not in corridor:
                raise located(
                    self.at(cell), self.character(cell), "corridor that can be reached from where the human starts"
                )
        self.check_insides()
        doors = self.doors()
        places = [self.places(room, doors[room]) for room in range(ROOMS)]
        return Layout(
            name, self.lines, self.cell_table(doors), self.room_table(doors, places), self.numbers(starts)
        )

    def check_characters(self) -> None:
        if not self.width:
            raise located(f"{self.place}, line 1", Phrase("an empty line"), "a row of the map")
        for row, line in enumerate(self.lines):
            if len(line) != self.width:
                raise located(f"{self.place}, line {row + 1}", Phrase(f"{len(line)} characters"),
                              f"{self.width}, as in line 1")  # fmt: skip
            for column, character in enumerate(line):
                if character not in KNOWN:
                    raise located(self.at((row, column)), character, f"one of {' '.join(KNOWN)}")

    def only_start(self, letter: str) -> Cell:
        found = list(self.all(letter))
        if not found:
            raise located(self.place, Phrase(f"no {letter}"), f"one cell {letter}, where a player starts")
        if len(found) > 1:
            raise located(self.at(found[1]), letter, f"one {letter} only; the first is in line {found[0][0] + 1}")
        return found[0]

    def check_insides(self) -> None:
        for cell in self.all("1234"):
            own = self.character(cell)
            for there in self.beside(cell):
                if self.character(there) not in own + "rb":
                    raise located(
                        self.at(there), self.character(there), f"a wall or a door beside the inside of room {own}"
                    )

    def doors(self) -> list[list[Cell]]:
        """Red and blue door of every room."""
        found: list[list[Cell | None]] = [[None, None] for _ in range(ROOMS)]
        for cell in self.all("rb"):
            letter = self.character(cell)
            beside = [self.character(there) for there in self.beside(cell)]
            rooms = sorted({c for c in beside if c.isdigit()})
            if len(rooms) != 1:
                touched = Phrase("a door of rooms " + " and ".join(rooms)) if rooms else Phrase("a door of no room")
                raise located(self.at(cell), touched, "a door that touches one room")
            for there in self.beside(cell):
                if self.character(there) in "rb":
                    raise located(self.at(there), self.character(there), "no door beside another door")
            if not any(c in CORRIDOR for c in beside):
                raise located(self.at(cell), Phrase("a door away from the corridor"), "a door that touches it")
            room, kind = int(rooms[0]) - 1, "rb".index(letter)
            if found[room][kind] is not None:
                colour = ("red", "blue")[kind]
                raise located(self.at(cell), letter, f"one {colour} door only for room {room + 1}")
            found[room][kind] = cell
        out = []
        for room, pair in enumerate(found):
            for kind, colour in enumerate(("red", "blue")):
                if pair[kind] is None:
                    raise located(
                        f"{self.place}, room {room + 1}", Phrase(f"no {colour} door"), "one of each colour"
                    )
            out.append([cell for cell in pair if cell is not None])
        return out

    def places(self, room: int, doors: list[Cell]) -> list[Cell]:
        """Cells inside a room, reachable from both of its doors."""
        inside = list(self.all(str(room + 1)))
        if len(inside) < LEAST_PLACES:
            raise located(f"{self.place}, room {room + 1}", Phrase(f"{len(inside)} cells"),
                          f"at least {LEAST_PLACES}, for a group of tokens")  # fmt: skip
        for door in doors:
            reached = self.reached(door, str(room + 1))
            for cell in inside:
                if cell not in reached:
                    raise located(self.at(cell), self.character(cell),
                                  f"a cell that can be reached from the door in line {door[0] + 1}, "
                                  f"column {door[1] + 1}")  # fmt: skip
        return inside

    def numbers(self, cells: list[Cell]) -> tuple[int, int]:
        return cells[0][0] * self.width + cells[0][1], cells[1][0] * self.width + cells[1][1]

    def cell_table(self, doors: list[list[Cell]]) -> NDArray[np.int32]:
        table = np.full((self.height * self.width, COLUMN + 1), -1, dtype=np.int32)
        room_of = {door: room for room, pair in enumerate(doors) for door in pair}
        for number in range(len(table)):
            cell = divmod(number, self.width)
            character = self.character(cell)
            table[number, ROW], table[number, COLUMN] = cell
            table[number, DOOR] = "rb".find(character) + 1
            table[number, ROOM] = room_of.get(cell, int(character) - 1 if character.isdigit() else -1)
            if character != "#":
                near = set(self.beside(cell)) | {cell}
                for move, (down, right) in enumerate(STEPS):
                    there = cell[0] + down, cell[1] + right
                    if there in near:
                        table[number, move] = there[0] * self.width + there[1]
        table.flags.writeable = False
        return table

    def room_table(self, doors: list[list[Cell]], places: list[list[Cell]]) -> NDArray[np.int32]:
        most = max(len(cells) for cells in places)
        table = np.full((ROOMS, FIRST_PLACE + most), -1, dtype=np.int32)
        for room, (pair, inside) in enumerate(zip(doors, places, strict=True)):
            behind = [next(c for c in self.beside(door) if self.character(c) == str(room + 1)) for door in pair]
            numbers = [row * self.width + column for row, column in [*pair, *behind]]
            table[room, :PLACES] = numbers
            table[room, PLACES] = len(inside)
            table[room, FIRST_PLACE : FIRST_PLACE + len(inside)] = [r * self.width + c for r, c in inside]
        table.flags.writeable = False
        return table
