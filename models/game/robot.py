"""The robot: by A* to its nearest token at two cells a second; helps, if it does, 5 s after the trap."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models.compiled import kernel
from models.game.parameters import SETTING
from models.game.state import ACTS, HUMAN, ROBOT, TICK, TRAP_TICK, TRAPPED
from models.game.walker import OWN, Walker, start_walking, take_turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
    return take_turn(state, cells, rooms, memory, ROBOT, helps, 0, 0, 0, goals, path, scratch)


class RobotPlayer(Walker):
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
        super().__init__(ROBOT_MEMORY)

    def _begin(self, game: Round) -> None:
        start_walking(self._memory)

    def _choose(self, *given: NDArray[np.integer]) -> int:
        return int(robot_move(*given))
