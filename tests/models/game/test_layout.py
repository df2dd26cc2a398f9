"""Maps: those that come along, and everything a map can be wrong about."""

import numpy as np
import pytest
from hypothesis import given

from models.errors import InputError
from models.game.layout import DOOR, FIRST_PLACE, PLACES, ROOM, Layout, packaged, packaged_names
from tests.models.game.cases import layouts

GOOD = packaged().text


def changed(*edits):
    """The default map with some cells changed: (line, column, character), counted from 1."""
    lines = [list(line) for line in GOOD.splitlines()]
    for line, column, character in edits:
        lines[line - 1][column - 1] = character
    return "\n".join("".join(line) for line in lines)


def test_the_maps_that_come_along():
    assert "four_rooms" in packaged_names()
    for name in packaged_names():
        layout = packaged(name)
        # Players start in opposite corners, as published.
        (top, left), (bottom, right) = (layout.cell(c) for c in layout.starts)
        assert (top, left, bottom, right) == (1, 1, layout.height - 2, layout.width - 2)


def test_a_map_that_does_not_come_along():
    with pytest.raises(InputError, match=r"map: found .castle., wanted one of .*four_rooms"):
        packaged("castle")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (changed((2, 3, "x")), "line 2, column 3: found 'x', wanted one of #"),
        (GOOD.replace("#...", "#..", 1), "line 8: found 14 characters, wanted 15, as in line 1"),
        ("\n" + GOOD, "line 1: found an empty line"),
        (changed((2, 2, ".")), "map t: found no H"),
        (changed((8, 9, "H")), "line 8, column 9: found 'H', wanted one H only; the first is in line 2"),
        (changed((3, 2, "R")), "line 14, column 14: found 'R', wanted one R only; the first is in line 3"),
        (changed((5, 7, "#")), "room 1: found no red door, wanted one of each colour"),
        (changed((3, 5, "#")), "room 1: found no blue door, wanted one of each colour"),
        (changed((4, 7, "#"), (6, 7, "r")), "line 6, column 7: found 'r', wanted no door beside another door"),
        (changed((7, 5, "r")), "line 7, column 5: found 'r', wanted one red door only for room 1"),
        (changed((7, 3, "r")), "line 7, column 3: found a door of no room, wanted a door that touches one room"),
        (changed((5, 8, "#"), (5, 9, "#"), (5, 7, "#"), (7, 5, "r"), (8, 5, "#")),
         "line 7, column 5: found a door away from the corridor"),
        (changed((4, 7, ".")), "line 4, column 7: found '.', wanted a wall or a door beside the inside of room 1"),
        (changed((4, 7, "2")), "wanted a wall or a door beside the inside of room 1"),
        (changed((2, 3, "#"), (3, 2, "#")), "wanted corridor that can be reached from where the human starts"),
        (changed((4, 6, "#"), (5, 5, "#"), (5, 4, "#")),
         "line 4, column 4: found '1', wanted a cell that can be reached from the door in line 5, column 7"),
        (changed((5, 4, "#"), (5, 5, "#"), (6, 6, "#")), "line 6, column 4: found '1', wanted a cell that can be"),
        (GOOD.replace("1", "#"), "found a door of no room"),
        (changed(*((r, c, "#") for r in (4, 5, 6) for c in (4, 5, 6) if (r, c) not in ((4, 5), (5, 6)))),
         "room 1: found 2 cells, wanted at least 3"),
        (changed((4, 4, "5")), "line 4, column 4: found '5', wanted one of"),
        ("", "line 1: found an empty line"),
    ],
)  # fmt: skip
def test_malformed_maps_are_refused_with_the_place(text, message):
    with pytest.raises(InputError) as error:
        Layout.from_text(text, "t")
    assert message in str(error.value)
    assert str(error.value).startswith("map t")


def test_files_are_named(tmp_path):
    path = tmp_path / "mine.txt"
    with pytest.raises(InputError, match=r"mine\.txt: found No such file"):
        Layout.from_file(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match=r"mine\.txt, byte 0: found no UTF-8"):
        Layout.from_file(path)
    path.write_text(changed((2, 3, "x")))
    with pytest.raises(InputError, match=r"mine\.txt, line 2, column 3: found 'x'"):
        Layout.from_file(path)
    path.write_text(GOOD.replace("\n", "\r\n"), newline="")
    assert Layout.from_file(path).lines == packaged().lines


@given(layouts())
def test_arrays_say_what_the_text_says(layout):
    again = Layout.from_text(layout.text, layout.name)
    assert again == layout
    assert (again.cells == layout.cells).all()
    assert again.digest == layout.digest
    for number, row in enumerate(layout.cells):
        r, c = layout.cell(number)
        character = layout.lines[r][c]
        assert row[DOOR] == "rb".find(character) + 1
        if character in "1234":
            assert row[ROOM] == int(character) - 1
        for move, (dr, dc) in enumerate([(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)]):
            blocked = character == "#" or layout.lines[r + dr][c + dc] == "#"
            assert row[move] == (-1 if blocked else layout.number((r + dr, c + dc)))
    for room, row in enumerate(layout.rooms):
        places = row[FIRST_PLACE : FIRST_PLACE + row[PLACES]]
        assert sorted(layout.inside(room + 1)) == sorted(layout.cell(int(p)) for p in places)
        assert all(layout.lines[r][c] == str(room + 1) for r, c in layout.inside(room + 1))
        assert [layout.cells[row[i], DOOR] for i in (0, 1)] == [1, 2]
        for door, behind in zip(row[:2], row[2:4], strict=True):
            assert behind in layout.cells[door, 1:5]
            assert behind in places
    assert not layout.cells.flags.writeable
    assert np.all(layout.cells[list(layout.starts), ROOM] == -1)
