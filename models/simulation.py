"""Drawing responses from a model under the design of an event log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.errors import located
from models.events import EventLog
from models.histories import UNSEEN
from models.lspomdp import LatentStatePOMDP


def simulate_responses(
    model: LatentStatePOMDP, design: EventLog, rng: np.random.Generator
) -> tuple[EventLog, NDArray[np.int8]]:
    """Draw states and responses for the runs of a log, keeping its actions and what was missing.

    Every draw is one uniform number compared with cumulative probabilities, so a seed gives the same study
    with every version of numpy.

    Parameters
    ----------
    model : LatentStatePOMDP
    design : EventLog
        Its actions are kept; a response is drawn exactly where the design records one.
    rng : numpy.random.Generator

    Returns
    -------
    log : EventLog
    states : int8[events]
        The latent state in which each event happened.
    """
    if model.protocol != design.protocol:
        raise located("simulation, protocol of the model", model.protocol.name, repr(design.protocol.name))
    uniform = rng.random((design.n_events, 2))
    state = np.empty(design.n_events, dtype=np.int8)
    response = np.empty(design.n_events, dtype=np.int8)
    _draw(
        design.offsets, design.action, design.response, model.initial, model.transition, model.emission,
        model.emission_index, uniform, state, response,
    )  # fmt: skip
    return design.with_responses(response), state


@kernel
def _draw(  # type: ignore[no-untyped-def]
    offsets, action, recorded, initial, transition, emission, emission_index, uniform, state, response
):
    for run in range(len(offsets) - 1):
        row = initial
        for event in range(offsets[run], offsets[run + 1]):
            s = pick(row, uniform[event, 0])
            state[event] = s
            if recorded[event] == UNSEEN:
                response[event] = UNSEEN
            else:
                response[event] = pick(emission[emission_index[action[event]], s], uniform[event, 1])
            row = transition[action[event], s]


@kernel
def pick(probability, uniform):  # type: ignore[no-untyped-def]
    """Index drawn with the given probabilities by one uniform number."""
    total = 0.0
    last = 0
    for i in range(len(probability)):
        if probability[i] > 0.0:
            last = i
            total += probability[i]
            if uniform < total:
                return i
    return last
