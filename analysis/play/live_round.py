"""A round in play between a person at a keyboard and the robot, and what the page is told of it."""

from __future__ import annotations

from typing import Any

from analysis.play.journal import TOO_LATE, UNTRAPPED
from analysis.play.settings import MODES
from models.game.robot import RobotPlayer
from models.game.round import Round
from models.game.state import CELL, HUMAN, PLAYERS, READY, TRAP_ROOM
from models.protocol import MISSING, PUBLISHED

_MODE_OF = {player: mode for mode, player in MODES.items()}


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
        The robot's, as its policy chose it.

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
        self._no_time = False

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
        free = not self.game.sprung
        self.game.step(move, self.robot.move(self.game))
        if may_step:
            self._tapped = 0
        if free and self.game.sprung:
            self._no_time = self._out_of_reach()

    @property
    def done(self) -> bool:
        """Whether the round is over."""
        return self.game.done

    # -- what the log says -------------------------------------------------------------------------
    @property
    def odd(self) -> str:
        """`UNTRAPPED` or `TOO_LATE` where what was to happen did not; empty otherwise.

        Too late is a robot that was to help and had not done so when the round ended, and a human who could not
        have been there by then even if there were no walls.
        """
        game = self.game
        if not game.sprung:
            return UNTRAPPED
        robot_late = game.named == PLAYERS[HUMAN] and game.acts
        return TOO_LATE if not game.helped and (robot_late or self._no_time) else ""

    @property
    def shown(self) -> str:
        """The robot's action as the person saw it: no help or signal that there was no occasion or time for.

        Beliefs move by what people experience, so this is what the log holds and what learning goes by.
        """
        unseen = self.odd == UNTRAPPED or (self.odd == TOO_LATE and self.game.named == PLAYERS[HUMAN])
        return PUBLISHED.mode(_MODE_OF[self.game.named]).null_action if unseen else self.action

    @property
    def observation(self) -> str:
        """The human's response.

        Whoever never saw the robot trapped, or could not get to it any more, did not refuse: that is not recorded.
        """
        return MISSING if self.game.response != "none" and self.odd else self.game.response

    def _out_of_reach(self) -> bool:
        """Whether the robot was trapped just now and the round ends before the human could be in that room."""
        game, array = self.game, self.game.array
        if game.named == PLAYERS[HUMAN]:
            return False
        row, column = game.layout.cell(int(array[CELL + HUMAN]))
        inside = game.layout.inside(int(array[TRAP_ROOM]) + 1)
        steps = min(abs(row - r) + abs(column - c) for r, c in inside)
        first = max(game.tick, int(array[READY + HUMAN]))
        return first + (steps - 1) * game.parameters.human_step_ticks >= game.parameters.round_ticks

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
