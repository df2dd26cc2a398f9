"""Brute force: every state path of a run with its probability, summed exactly.

The independent oracle of the recursions; only for runs with few paths.
"""

import math
from itertools import product


def path_probabilities(run, initial, transition, emission, emission_index):
    """Mapping of every state path to the joint probability of path and responses."""
    states = range(len(initial))
    seen = [[float(emission[emission_index[a], s, o]) if o >= 0 else 1.0 for s in states] for a, o in run]
    moves = [transition[a].tolist() for a, _ in run]
    joint = {}
    for path in product(states, repeat=len(run)):
        p = float(initial[path[0]]) * seen[0][path[0]]
        for k in range(1, len(path)):
            p *= moves[k - 1][path[k - 1]][path[k]] * seen[k][path[k]]
        joint[path] = p
    return joint


def likelihood(joint):
    return math.fsum(joint.values())


def smoothed(joint, n_states):
    """gamma[k][s] = P(s_k = s | all responses)."""
    total = likelihood(joint)
    length = len(next(iter(joint)))
    return [
        [math.fsum(p for path, p in joint.items() if path[k] == s) / total for s in range(n_states)]
        for k in range(length)
    ]
