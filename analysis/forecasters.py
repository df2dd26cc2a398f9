"""The small interface of whoever predicts people who were left out of a study.

A `Contender` learns from the rest of a study and gives a `Forecaster`, which is asked about people it has not seen:
what their design makes it expect, responses drawn for them, how likely their real responses were, and what of all
that is the prior because the rest never showed it. `analysis.held_out` knows contenders by nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError
from models.events import EventLog
from models.joint_predictive import LogPredictive
from models.parameters import Array

Gap = tuple[str, NDArray[np.bool_]]
"""What was never seen, in words, and which events of a design it concerns."""


class CannotTakePart(InputError):
    """A contender cannot learn from the rest of a study; the message says why."""


class Forecaster(Protocol):
    """A contender that has learned, in a number of draws of its parameters."""

    @property
    def n_draws(self) -> int:
        """Draws of its parameters."""

    @property
    def gate(self) -> str:
        """``passed`` or ``failed`` (convergence of a sample or a fit), ``exact`` (independent draws)."""

    @property
    def doubts(self) -> list[str]:
        """Why what it learned is not to be relied on as it stands, in words; empty if nothing speaks against it."""

    def expected(self, design: EventLog) -> Array:
        """Expected response value at every event under every draw, ``[draw, event]``, in the unit of the measure.

        Given the actions and who they were, not given any response. Responses recorded in `design` say only where
        one is recorded. Events that show no response may hold anything.
        """

    def responses(self, design: EventLog, draw: int, rng: np.random.Generator) -> NDArray[np.int8]:
        """Responses of new people in this design under one draw, ``[event]``, where the design records one."""

    def log_predictive(self, held: EventLog) -> LogPredictive:
        """Log predictive of the responses of `held`."""

    def gaps(self, design: EventLog) -> list[Gap]:
        """What in its expectations for a design is the prior, because nothing could be learned about it."""


@dataclass(frozen=True)
class Contender:
    """A model that takes part.

    Attributes
    ----------
    name : str
    kind : str
        ``constant``, ``markov``, ``types``, ``mixed``, ``states``; ``traits`` and ``people`` where people differ,
        without and with states; or a kind of one's own.
    learn : callable
        From the rest of a study to a `Forecaster`; raises `CannotTakePart` where it cannot.
    """

    name: str
    kind: str
    learn: Callable[[EventLog], Forecaster]


def never(rest: EventLog, action: str, answers: bool, moves: bool) -> str:
    """What was never seen of an action, in words.

    Parameters
    ----------
    rest : EventLog
    action : str
    answers, moves : bool
        Whether its response table, its transition table is the prior.
    """
    if not (rest.action == rest.protocol.action(action)).any():
        return f"action {action} was never seen in the rest: its table is the prior"
    parts = ["no response to it was recorded"] * answers + ["it was never followed by another event"] * moves
    tables = ["response table"] * answers + ["transition table"] * moves
    return f"action {action}: in the rest {' and '.join(parts)}, so its {' and '.join(tables)} is the prior"
