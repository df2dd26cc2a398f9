"""A round in play between a person at a keyboard and the robot, and what the page is told of it."""

from __future__ import annotations

from typing import Any

from models.game.robot import RobotPlayer
from models.game.round import Round
from models.game.state import HUMAN, READY


class LiveRound:
    """One round, tick by tick.

    The player walks in the direction of the key that is held. A key that was only tapped counts until the player
    may take the next step, so that no keystroke between two ticks, or during a step, is lost.

    Parameters
    ----------
    game : Round
    k : int
        Number of the round, from 0.
    action : str
        The robot's.

    Attributes
    ----------
    paused : bool
        Whether the person left in the middle of it.
    """

    def __init__(self, game: Round, k: int, action: str) -> None:
        self.game, self.k, self.action = game, k, action
        self.robot = RobotPlayer()
        self.paused = False
        self._held = self._tapped = 0

    def key(self, move: int, pressed: bool) -> None:
        """Take in which direction is held now (0: none), and whether its key was pressed just now."""
        self._held = move
        if pressed:
            self._tapped = move

    def release(self) -> None:
        """No key is held."""
        self._held = self._tapped = 0

    def tick(self) -> None:
        """Play a tenth of a second."""
        may_step = self.game.array[READY + HUMAN] <= self.game.tick
        move = self._tapped or self._held
        self.game.step(move, self.robot.move(self.game))
        if may_step:
            self._tapped = 0

    @property
    def done(self) -> bool:
        """Whether the round is over."""
        return self.game.done

    @property
    def observation(self) -> str:
        """What the log says of the response.

        Whoever never saw the robot trapped had no occasion to help: that is no refusal, but not recorded.
        """
        if self.game.response != "none" and not self.game.sprung:
            return "missing"
        return self.game.response

    # -- what the page is told ---------------------------------------------------------------------
    def start(self, of: int, countdown: float, tick_seconds: float) -> dict[str, Any]:
        """Everything that stays the same during the round, and how it stands."""
        layout, parameters = self.game.layout, self.game.parameters
        step = {"you": parameters.human_step_ticks, "robot": parameters.robot_step_ticks}
        rooms = [[list(cell) for cell in layout.inside(room + 1)] for room in range(layout.n_rooms)]
        return {
            "type": "round", "k": self.k, "of": of, "map": list(layout.lines), "rooms": rooms,
            "doors": [list(cell) for cell, _ in self.game.view.doors], "countdown": countdown,
            "seconds": parameters.round_ticks * tick_seconds, "tick_seconds": tick_seconds,
            "step_seconds": {who: ticks * tick_seconds for who, ticks in step.items()}, "state": self.state(),
        }  # fmt: skip

    def state(self) -> dict[str, Any]:
        """What can be seen at this tick, and nothing else: not whether somebody has been trapped, but the doors."""
        view = self.game.view
        return {
            "tick": view.tick, "left": self.game.parameters.round_ticks - view.tick,
            "you": list(view.human), "robot": list(view.robot),
            "ready": max(0, int(self.game.array[READY + HUMAN]) - view.tick),
            "doors": "".join(colour[0] for _, colour in view.doors),
            "yours": [list(cell) for cell in view.human_tokens],
            "robots": [list(cell) for cell in view.robot_tokens],
            "score": [view.human_collected, view.robot_collected], "flash": view.flashing_room,
        }  # fmt: skip
