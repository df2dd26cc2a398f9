"""Study 1 played in the token game: tokens beside every response, and a response that is what was seen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from analysis.simulate import DEFAULT_SEED, simulate_study1
from models.events import EventLog
from models.game.layout import Layout, packaged
from models.game.parameters import GameParameters
from models.game.rounds import RoundOutcomes, play_rounds
from models.game.state import HUMAN, ROBOT
from models.histories import UNSEEN
from models.lspomdp import LatentStatePOMDP
from models.protocol import Protocol

GAME_STUDY1_NAME = "simulated_study1_in_game"

_TASK = 103
"""First number of the spawn key of the rounds' seeds; then 0."""


@dataclass(frozen=True)
class PlayedStudy:
    """A study whose every round was played in the game.

    Attributes
    ----------
    log : EventLog
        With token columns; a response is what was seen: `help` where the person freed the trapped robot.
    willing : bool[events]
        Whether the person would have helped; False where the human was trapped.
    rounds : RoundOutcomes
        One round an event.
    """

    log: EventLog
    willing: NDArray[np.bool_] = field(repr=False)
    rounds: RoundOutcomes = field(repr=False)


def simulate_study1_in_game(
    truth: LatentStatePOMDP | None = None,
    participants: int = 540,
    seed: int = DEFAULT_SEED,
    *,
    layout: Layout | None = None,
    parameters: GameParameters | None = None,
    study: str = GAME_STUDY1_NAME,
    threads: int | None = None,
) -> EventLog:
    """Simulate the published study 1 with every round played in the token game.

    People, conditions, schedules and willingness are those of `simulate_study1` with the same seed; the game adds
    tokens, and makes the response what was seen in it.

    Parameters
    ----------
    truth : LatentStatePOMDP, optional
        Under the published protocol; `calibrated_truth` unless given.
    participants, seed : int
    layout : Layout, optional
        `packaged()` unless given.
    parameters : GameParameters, optional
    study : str
        The study column.
    threads : int, optional
        No result depends on it.

    Returns
    -------
    EventLog
        With columns `team_tokens, human_tokens, robot_tokens`.

    Raises
    ------
    InputError
        If `participants` is below 1, the seed negative, or the truth has another protocol.

    Examples
    --------
    >>> simulate_study1_in_game(participants=20)
    EventLog('simulated_study1_in_game': 20 people, 20 runs, 100 events, 60 responses, 4 conditions)
    """
    return play_study1(truth, participants, seed, layout, parameters, study, threads).log


def play_study1(
    truth: LatentStatePOMDP | None = None,
    participants: int = 540,
    seed: int = DEFAULT_SEED,
    layout: Layout | None = None,
    parameters: GameParameters | None = None,
    study: str = GAME_STUDY1_NAME,
    threads: int | None = None,
) -> PlayedStudy:
    """Play study 1 as `simulate_study1_in_game` does, and keep the rounds."""
    design = simulate_study1(truth, participants, seed, study)
    helps = int(np.argmax(design.protocol.scores))
    willing = design.response == helps
    seeds = np.random.SeedSequence(seed, spawn_key=(_TASK, 0)).generate_state(design.n_events, np.uint64)
    rounds = play_rounds(
        packaged() if layout is None else layout, GameParameters() if parameters is None else parameters,
        np.where(design.shows, ROBOT, HUMAN), ~_null(design.protocol)[design.action], willing, seeds, threads,
    )  # fmt: skip
    seen = np.where(rounds.helped, helps, int(np.argmin(design.protocol.scores)))
    log = replace(
        design,
        response=np.where(design.shows, seen, UNSEEN).astype(np.int8),
        tokens={
            "team_tokens": rounds.team_tokens.astype(np.float64),
            "human_tokens": rounds.human_tokens.astype(np.float64),
            "robot_tokens": rounds.robot_tokens.astype(np.float64),
        },
    )
    return PlayedStudy(log, willing, rounds)


def _null(protocol: Protocol) -> NDArray[np.bool_]:
    """Whether each action leaves the person alone."""
    null = {mode.null_action for mode in protocol.modes}
    return np.array([name in null for name in protocol.action_names])
