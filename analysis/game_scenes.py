"""Rounds of the token game to look at: one simulated round as a record, and the moments that the paper shows."""

from __future__ import annotations

from dataclasses import dataclass

from models.errors import Phrase, located
from models.game.human import HumanPlayer
from models.game.layout import Layout
from models.game.parameters import GameParameters
from models.game.record import RoundRecord, record, replay
from models.game.render import FLASH_TICKS
from models.game.robot import RobotPlayer
from models.game.round import Round
from models.game.state import GameState


@dataclass(frozen=True)
class Scene:
    """A moment of a round.

    Attributes
    ----------
    title, caption : str
    view : GameState
    layout : Layout
    round_ticks : int
    """

    title: str
    caption: str
    view: GameState
    layout: Layout
    round_ticks: int


def simulated_round(
    trapped: str = "robot",
    acts: bool = True,
    willing: bool = True,
    seed: int = 1,
    *,
    layout: Layout | None = None,
    parameters: GameParameters | None = None,
) -> RoundRecord:
    """Play one round with the robot and a simulated person.

    The same round as `models.game.rounds.play_rounds` plays with these arguments.

    Parameters
    ----------
    trapped : str
        ``"human"`` or ``"robot"``.
    acts : bool
        Whether the robot helps, or signals.
    willing : bool
        Whether the person helps a trapped robot.
    seed : int
    layout : Layout, optional
    parameters : GameParameters, optional

    Examples
    --------
    >>> simulated_round("robot", willing=False).outcome["freed_tick"]
    -1
    """
    game = Round(layout, parameters, trapped, acts, seed)
    human, robot = HumanPlayer(willing), RobotPlayer()
    while not game.done:
        game.step(human.move(game), robot.move(game))
    return record(game)


def paper_scenes(
    seed: int = 1, *, layout: Layout | None = None, parameters: GameParameters | None = None
) -> tuple[Scene, ...]:
    """Find the paper's three panels: the human trapped, the robot trapped, the robot trapped and signalling.

    Each is the moment a second before help arrives, in a bright half of the flashing where there is any.

    Raises
    ------
    InputError
        If nobody is helped in a round of this seed.
    """
    out = []
    for trapped, acts, title, caption in (
        (
            "human",
            True,
            "Human needs help",
            "Both doors are blue, with squares: the human cannot leave. The robot comes.",
        ),
        (
            "robot",
            False,
            "Robot needs help",
            "Both doors are red (drawn orange-red, with rings): the robot cannot leave. A person comes.",
        ),
        ("robot", True, "Robot needs help, signals", "The same, and the room flashes."),
    ):
        played = simulated_round(trapped, acts, True, seed, layout=layout, parameters=parameters)
        views = list(replay(played))
        sprung, freed = played.outcome["trapped_tick"], played.outcome["freed_tick"]
        if freed < 0:
            place = f"scene {title!r}, seed {seed}"
            raise located(place, Phrase("nobody helped"), "a map and parameters with which help comes in time")
        # The state before a tick is that in which it is played: the trap shows from the tick after its own.
        shown = max(sprung + 1, freed - 10)
        if acts and trapped == "robot":
            shown = sprung + max(1, (shown - sprung) // (2 * FLASH_TICKS) * 2 * FLASH_TICKS)
        out.append(Scene(title, caption, views[shown], played.layout, played.parameters.round_ticks))
    return tuple(out)
