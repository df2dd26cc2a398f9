"""Drawing responses: one uniform number a draw, compared with cumulative probabilities."""

import numpy as np


def pick(probability, uniform):
    """First index whose cumulative probability exceeds `uniform`; rounding cannot reach an impossible one."""
    index = int(np.searchsorted(np.cumsum(probability), uniform, side="right"))
    return min(index, int(np.flatnonzero(probability)[-1]))


def simulate(runs, initial, transition, emission, emission_index, uniform):
    """States and responses of all events; `uniform` has two numbers an event."""
    states, responses = [], []
    for run in runs:
        row = initial
        for a, recorded in run:
            for_state, for_response = uniform[len(states)]
            s = pick(row, for_state)
            responses.append(pick(emission[emission_index[a], s], for_response) if recorded >= 0 else -1)
            states.append(s)
            row = transition[a, s]
    return np.array(states), np.array(responses)
