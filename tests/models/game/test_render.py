"""Frames: against another compositor, without colour, at every tick of played rounds; text; walks; speed."""

import time

import numpy as np
import pytest
from PIL import Image

from models.errors import InputError
from models.game.human import HumanPlayer
from models.game.layout import packaged
from models.game.parameters import TICKS_A_SECOND
from models.game.render import FLASH_TICKS, Painter, as_text, clock_text, put, status_text
from models.game.render_sprites import BLUE, RED, SPRITES, WHITE, sprite, words
from models.game.render_walks import glides
from models.game.robot import RobotPlayer
from models.game.round import Round


@pytest.fixture(scope="module")
def signalled():
    """Every state of a round in which the robot signals and is freed, and the round's length."""
    return views_of("robot", True)


def views_of(trapped, acts, willing=True):
    game, human, robot = Round(trapped=trapped, acts=acts, seed=3), HumanPlayer(willing), RobotPlayer()
    views = [game.view]
    while not game.done:
        game.step(human.move(game), robot.move(game))
        views.append(game.view)
    return game, views


# -- small pictures --------------------------------------------------------------------------------
@pytest.mark.parametrize(("ours", "theirs"), [("human", "robot"), ("human_token", "robot_token"), ("red", "blue")])
@pytest.mark.parametrize("side", [12, 24, 40])
def test_what_is_told_by_colour_is_told_by_shape_too(ours, theirs, side):
    shapes = []
    for name, colour in ((ours, RED), (theirs, BLUE)):
        picture = sprite(name, side).astype(int)
        near = np.abs(picture[..., :3] - colour).sum(axis=-1) < np.abs(picture[..., :3] - WHITE).sum(axis=-1)
        shapes.append(np.where(picture[..., 3] < 128, 2, near))
    assert np.mean(shapes[0] != shapes[1]) > 0.04


def test_small_pictures_are_shared_and_cannot_be_written():
    assert sprite("human", 20) is sprite("human", 20)
    with pytest.raises(ValueError, match="read-only"):
        sprite("human", 20)[0, 0] = 1
    assert words("1:09", 20).shape[2] == 4
    assert words("1:09", 20)[..., 3].max() == 255


@pytest.mark.parametrize("at", [(3, 5), (-4, 2), (9, -7), (35, 25), (100, 3), (-20, -20)])
def test_put_agrees_with_another_compositor(at):
    rng = np.random.default_rng(1)
    frame = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    picture = rng.integers(0, 256, (12, 10, 4), dtype=np.uint8)
    wanted = Image.fromarray(frame)
    wanted.paste(Image.fromarray(picture), at, Image.fromarray(picture[..., 3]))
    put(frame, picture, *at)
    assert np.abs(frame.astype(int) - np.asarray(wanted)).max() <= 1


# -- frames ----------------------------------------------------------------------------------------
def test_every_cell_of_every_tick_shows_what_is_there(signalled):
    game, views = signalled
    painter = Painter(game.layout, game.parameters.round_ticks, 16)
    tile = painter.cell
    for view in views[::7]:
        board = painter.frame(view)[painter.header :]
        shown = {cell: [colour] for cell, colour in view.doors}
        for owner in ("human", "robot"):
            shown |= {cell: [f"{owner}_token"] for cell in getattr(view, f"{owner}_tokens")}
        alone = {view.human, view.robot} if view.human != view.robot else set()
        for row, column in np.ndindex(game.layout.height, game.layout.width):
            if not alone and row == view.human[0] and abs(column - view.human[1]) <= 1:
                continue  # both in one cell stand side by side, and reach into its neighbours
            here = np.s_[row * tile : (row + 1) * tile, column * tile : (column + 1) * tile]
            names = list(shown.get((row, column), []))
            if view.trapped_room and (row, column) in game.layout.inside(view.trapped_room):
                names.insert(0, "flash" if painter.lit(view) else "shut")
            for owner in ("robot", "human"):
                if getattr(view, owner) == (row, column):
                    names += [owner] + (["cage"] if view.trapped == owner else [])
            wanted = Image.fromarray(painter.board[here])
            for name in names:
                picture = Image.fromarray(sprite(name, tile))
                wanted.paste(picture, (0, 0), picture.getchannel("A"))
            if alone or not names:
                assert np.abs(board[here].astype(int) - np.asarray(wanted)).max() <= 2


def test_sizes_are_even_whatever_the_map():
    layout = packaged()
    for cell in (12, 14, 32, 50):
        painter = Painter(layout, 900, cell)
        frame = painter.frame(Round(layout).view)
        assert frame.shape == (painter.height, painter.width, 3)
        assert frame.dtype == np.uint8
        assert painter.height % 2 == painter.width % 2 == 0


@pytest.mark.parametrize("cell", [10, 13, 32.0, True])
def test_unusable_cells(cell):
    with pytest.raises(
        InputError, match=r"^painter, cell: found .*, wanted an even number of pixels, at least 12$"
    ):
        Painter(packaged(), 900, cell)


def test_flashing_is_slow_and_only_while_the_robot_signals(signalled):
    game, views = signalled
    painter = Painter(game.layout, game.parameters.round_ticks)
    lit = np.array([painter.lit(view) for view in views])
    signals = np.array([view.flashing_room is not None for view in views])
    assert lit.any()
    assert not np.any(lit & ~signals)
    changes = np.flatnonzero(np.diff(lit[signals].astype(int)))
    assert np.all(np.diff(changes) == FLASH_TICKS)
    assert TICKS_A_SECOND / (2 * FLASH_TICKS) < 3  # flashes a second that WCAG 2.3.1 allows
    for trapped, acts in (("robot", False), ("human", True)):
        quiet, others = views_of(trapped, acts)
        painter = Painter(quiet.layout, quiet.parameters.round_ticks)
        assert any(view.trapped for view in others)
        assert not any(painter.lit(view) for view in others)


def test_two_players_in_one_cell_are_both_seen():
    painter = Painter(packaged(), 900, 24)
    view = Round().view
    together = painter.frame(view, (7.0, 7.0), (7.0, 7.0))[painter.header :].reshape(-1, 3)
    for colour in (RED, BLUE):
        apart = painter.frame(view)[painter.header :].reshape(-1, 3)
        pixels = [np.all(frame == colour, axis=1).sum() for frame in (together, apart)]
        assert pixels[0] > 0.5 * pixels[1] > 0
    (_, x, _), (_, other, _) = painter.players(view, (7.0, 7.0), (7.0, 7.0))
    assert x > other


def test_thirty_frames_a_second(signalled):
    game, views = signalled
    painter = Painter(game.layout, game.parameters.round_ticks)
    painter.frame(views[0])
    took = []
    for view in views[150:300]:
        started = time.perf_counter()
        painter.frame(view)
        took.append(time.perf_counter() - started)
    assert np.median(took) < 1 / 30


# -- text ------------------------------------------------------------------------------------------
def test_text_shows_what_is_there(signalled):
    game, views = signalled
    flashed = 0
    for view in views[::3]:
        head, *lines = as_text(view, game.layout, game.parameters.round_ticks).split("\n")
        assert head.startswith(clock_text(view, game.parameters.round_ticks))
        assert head.endswith(status_text(view))
        walls = [[c == "#" for c in line] for line in lines]
        assert walls == [[c == "#" for c in line] for line in game.layout.lines]
        players = {view.human, view.robot}
        for (row, column), colour in view.doors:
            assert (row, column) in players or lines[row][column] == colour[0]
        for owner, letter in (("human", "o"), ("robot", "x")):
            count = sum(line.count(letter) for line in lines)
            assert count == len(set(getattr(view, f"{owner}_tokens")) - players)
        assert "".join(lines).count("H") + "".join(lines).count("&") == 1
        flashed += "!" in "".join(lines)
    assert flashed


@pytest.mark.parametrize(("ticks", "shown"), [(0, "0:00"), (1, "0:01"), (10, "0:01"), (11, "0:02"), (605, "1:01")])
def test_clock(ticks, shown):
    assert clock_text(Round().view, ticks) == shown


# -- walks -----------------------------------------------------------------------------------------
def test_walks_arrive_when_the_rules_say_and_never_jump(signalled):
    _, views = signalled
    ways = glides(views, (5, 5))
    cells = np.array([(view.human, view.robot) for view in views], dtype=float)
    changed = (cells[1:] != cells[:-1]).any(axis=2)
    for player in (0, 1):
        arrivals = np.flatnonzero(changed[:, player]) + 1
        assert len(arrivals) > 50
        assert np.array_equal(ways[arrivals, player], cells[arrivals, player])
        steps = np.abs(np.diff(ways[:, player], axis=0)).sum(axis=1)
        # Only the first step of a round has no time before it.
        assert steps[arrivals[0] :].max() == pytest.approx(0.2)
        # Never farther from where the rules have the player than the step that it is taking.
        assert np.abs(ways[:, player] - cells[:, player]).sum(axis=1).max() == pytest.approx(0.8)


def test_walks_of_steps_faster_than_they_should_be():
    class Seen:
        def __init__(self, column):
            self.human, self.robot = (1, column), (1, 1)

    ways = glides([Seen(c) for c in (1, 1, 2, 3, 3, 3, 4)], (3, 5))
    assert ways[:, 0, 1] == pytest.approx([1, 1.5, 2, 3, 3 + 1 / 3, 3 + 2 / 3, 4])
    assert glides([], (5, 5)).shape == (0, 2, 2)


def test_every_small_picture_is_used(signalled):
    game, views = signalled
    painter = Painter(game.layout, game.parameters.round_ticks)
    used = {p.sprite for view in views for p in (*painter.things(view), *painter.players(view))}
    assert used == set(SPRITES)
