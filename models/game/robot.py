"""The robot: by A* to its nearest token at two cells a second; helps, if it does, 5 s after the trap."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models.compiled import kernel
from models.game.parameters import SETTING
from models.game.route import route_scratch
from models.game.state import ACTS, HUMAN, ROBOT, TICK, TRAP_TICK, TRAPPED, may_step
from models.game.walker import (
    INTERRUPTED,
    OWN,
    find_way,
    keep_phase,
    next_move,
    remaining,
    route_is_old,
    start_walking,
)

if TYPE_CHECKING:
    from models.game.round import Round

ROBOT_MEMORY = OWN


@kernel(_nrt=False)
def robot_move(state, cells, rooms, settings, memory, goals, path, scratch):  # type: ignore[no-untyped-def]
    """Choose the robot's move of this tick; to be called once a tick."""
    helps = (
        state[TRAPPED] == HUMAN
        and state[ACTS] == 1
        and state[TICK] >= state[TRAP_TICK] + settings[SETTING.robot_help_delay]
    )
    keep_phase(state, memory, ROBOT, helps)
    if not may_step(state, ROBOT):
        return 0
    if route_is_old(state, memory, ROBOT):
        find_way(state, cells, rooms, memory, ROBOT, goals, remaining(state, ROBOT, goals), path, scratch)
    return next_move(state, cells, memory, ROBOT, path)


class RobotPlayer:
    """The robot as a player of one `Round`, tick by tick.

    Examples
    --------
    >>> from models.game.round import Round
    >>> game, robot = Round(trapped="human", seed=1), RobotPlayer()
    >>> while not game.done:
    ...     game.step(0, robot.move(game))
    >>> game.view.robot_collected > 10
    True
    """

    def __init__(self) -> None:
        self._memory = np.zeros(ROBOT_MEMORY, dtype=np.int64)
        self._goals = np.zeros(3, dtype=np.int64)
        self._round: Round | None = None

    def move(self, game: Round) -> int:
        """Choose the move of this tick, 0 to 4; to be asked once a tick."""
        if self._round is not game:
            start_walking(self._memory)
            self._path = np.zeros(len(game.layout.cells), dtype=np.int32)
            self._scratch = route_scratch(game.layout)
            self._round = game
        return int(
            robot_move(
                game.array, game.layout.cells, game.layout.rooms, game.parameters.settings, self._memory,
                self._goals, self._path, self._scratch,
            )
        )  # fmt: skip

    @property
    def interruption_ticks(self) -> int:
        """Ticks so far in which the robot was trapped or helping."""
        return int(self._memory[INTERRUPTED])
