"""Where to draw players that walk: the rules move them from cell to cell at once, pictures need the way between."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from models.game.state import GameState


def glides(views: Sequence[GameState], step_ticks: tuple[int, int]) -> NDArray[np.float64]:
    """Return rows and columns of both players at every tick, ``[tick, player, 2]``.

    A step that the rules take at some tick is spread over the ticks before it, so that a player is seen in a cell
    exactly when the rules have it there, and tokens vanish when they are reached. That needs the future: it is for
    replays.

    Parameters
    ----------
    views : sequence of GameState
        Every tick of a round, in order.
    step_ticks : (int, int)
        Ticks that a step of the human and of the robot takes.

    Examples
    --------
    >>> from models.game.round import Round
    >>> game, views = Round(), []
    >>> for move in ("right", "stay", "stay", "stay", "stay", "right", "stay"):
    ...     game.step(move)
    ...     views.append(game.view)
    >>> glides(views, (5, 5))[:, 0, 1].tolist()
    [2.0, 2.2, 2.4, 2.6, 2.8, 3.0, 3.0]
    """
    cells = np.array([(view.human, view.robot) for view in views], dtype=np.float64).reshape(-1, 2, 2)
    out = cells.copy()
    for player, wanted in enumerate(step_ticks):
        way = cells[:, player]
        last = 0
        for tick in np.flatnonzero((way[1:] != way[:-1]).any(axis=1)) + 1:
            taken = min(wanted, int(tick) - last)
            share = np.arange(1, taken)[:, None] / taken
            out[tick - taken + 1 : tick, player] = way[tick - 1] + share * (way[tick] - way[tick - 1])
            last = int(tick)
    return out
