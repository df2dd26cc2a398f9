"""A recorded round in a notebook or page: a small player with a slider, exact at every tick.

The page knows no rules and draws nothing of its own: it is given the map, the small pictures, and for every tick
which of them are where (`models.game.render.Painter`). It fetches nothing. Where scripts are not run, a picture of
one moment stays.
"""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from analysis.report.section import Origin
from models.errors import located
from models.game.parameters import TICKS_A_SECOND
from models.game.record import RoundRecord, replay
from models.game.render import FLASH_TICKS, Painter, Placement, clock_text, status_text
from models.game.render_sprites import SPRITES, sprite
from models.game.render_walks import glides

TEMPLATE = Path(__file__).with_suffix(".html")

NAMES = tuple(SPRITES)


def player_html(played: RoundRecord, *, cell: int = 40, shown: int | None = None) -> str:
    """Make the player: one element of HTML that can stand in any page, any number of times.

    Parameters
    ----------
    played : RoundRecord
    cell : int
        Pixels a cell, even; shown at half that size, so that they are enough for fine screens.
    shown : int, optional
        Tick that is shown at first, and where scripts are not run; a little after the trap by default.

    Raises
    ------
    InputError
        On a record that does not replay, or a tick that it does not have.
    """
    painter = Painter(played.layout, played.parameters.round_ticks, cell)
    views = list(replay(played))
    end, trap = len(views) - 1, played.outcome["trapped_tick"]
    # The state before a tick is that in which it is played: a trap shows one tick after its own.
    trap = min(end, trap + 1) if trap >= 0 else -1
    # By default in a bright part of the flashing, if any.
    first = min(end, trap + 4 * FLASH_TICKS if trap >= 0 else 0) if shown is None else shown
    if not 0 <= first <= end:
        raise located("player, tick shown", first, f"0 to {end}")
    parameters = played.parameters
    ways = glides(views, (parameters.human_step_ticks, parameters.robot_step_ticks))
    things: dict[tuple[int, ...], int] = {}
    states: dict[str, int] = {}
    players = []
    for view, (human, robot) in zip(views, ways.tolist(), strict=True):
        state = states.setdefault(status_text(view), len(states))
        still = (view.human_collected, view.robot_collected, state, *_numbers(painter.things(view)))
        index = things.setdefault(still, len(things))
        players.append([index, *_numbers(painter.players(view, tuple(human), tuple(robot)))])
    data = {
        "cell": cell, "width": painter.board.shape[1], "height": painter.board.shape[0], "end": end, "trap": trap,
        "last": parameters.round_ticks, "a_second": TICKS_A_SECOND, "states": list(states), "things": list(things),
        "players": players, "board": _png(painter.board),
        "pictures": _png(np.hstack([sprite(name, cell) for name in NAMES])),
    }  # fmt: skip
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    view = views[first]
    poster = painter.frame(view)[painter.header :]
    words = {
        "@ID@": "round-" + hashlib.sha256(text.encode()).hexdigest()[:12],
        "@WIDTH@": str(painter.board.shape[1] // 2),
        "@HUMAN@": str(view.human_collected),
        "@ROBOT@": str(view.robot_collected),
        "@CLOCK@": clock_text(view, parameters.round_ticks),
        "@STATE@": html.escape(status_text(view)),
        "@ALT@": f"The round after {first / TICKS_A_SECOND:.1f} s",
        "@POSTER@": _png(poster),
        "@LAST@": str(end),
        "@SHOWN@": str(first),
        "@DATA@": text,
    }
    out = TEMPLATE.read_text(encoding="utf-8")
    for mark, content in words.items():
        out = out.replace(mark, content)
    return out.rstrip("\n")


def show_round(played: RoundRecord, kind: str, caption: str) -> None:
    """Display the player in a notebook, with the caption below and whose round it is.

    Parameters
    ----------
    played : RoundRecord
    kind : str
        ``real`` (a person played), ``simulated`` or ``unstated``.
    caption : str
        Markdown.
    """
    from IPython.display import HTML, Markdown, display

    shown: Any = display
    origin = Origin.of_kind(kind)
    shown(HTML(player_html(played)))
    shown(Markdown(f"*{origin.label.capitalize()}.* {caption}"))


def _numbers(placements: list[Placement]) -> list[int]:
    return [number for name, x, y in placements for number in (NAMES.index(name), x, y)]


def _png(picture: np.ndarray) -> str:
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
