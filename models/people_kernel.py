r"""Likelihood of the hierarchical model, in which people differ, and its exact gradient.

Person i has an offset :math:`\sigma z_i`, :math:`z_i \sim N(0, 1)`, that tilts every observation row by the
scores :math:`c_o` of the responses:

.. math:: O_z(o \mid e, s) = \frac{O(o \mid e, s)\, e^{\sigma z c_o}}{\sum_j O(j \mid e, s)\, e^{\sigma z c_j}},

which with two responses scored 0 and 1 is an offset on the helping log-odds. The offset is the same in all runs of
a person while the latent state starts anew in each, so with nodes :math:`z_q` and weights :math:`w_q` person i has
likelihood :math:`L_i = \sum_q w_q \prod_{h \in i} L_h(z_q)`.

The recursion of `models.forward_backward` is carried out for all nodes at once: the quadrature node is the
innermost index of every array, so that the compiler turns the loops over it into vector instructions. Backwards
each node of the tree carries counts weighted by the responsibility of each :math:`z_q` for each person,
:math:`r_{iq} = w_q \prod_h L_h(z_q) / L_i`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.forward_backward import TINY


class PeopleArrays(NamedTuple):
    """Distinct people (by the histories of their runs) and the quadrature over their offsets.

    Attributes
    ----------
    offset : int64[people + 1]
        Runs of distinct person p are ``offset[p] : offset[p + 1]``; none at all where people do not differ.
    node : int64[runs of distinct people]
        Node of the tree at which each run ends.
    weight : float64[people]
        How many people have these histories.
    z, log_weight : float64[q]
        Quadrature nodes and the logarithm of their weights.
    scores : float64[o]
    prior_scale : float64[1]
        Standard deviation of the half-normal prior of sigma.
    """

    offset: NDArray[np.int64]
    node: NDArray[np.int64]
    weight: NDArray[np.float64]
    z: NDArray[np.float64]
    log_weight: NDArray[np.float64]
    scores: NDArray[np.float64]
    prior_scale: NDArray[np.float64]


NOBODY = PeopleArrays(
    np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0), np.ones(1)
)
"""People who do not differ: the plain model."""


@kernel
def tilt(emission, scores, spread, z):  # type: ignore[no-untyped-def]
    """Observation tables of every quadrature node, ``[e, s, o, q]``."""
    tables, states, responses = emission.shape
    out = np.empty((tables, states, responses, len(z)))
    for e in range(tables):
        for s in range(states):
            for q in range(len(z)):
                largest = -np.inf
                for o in range(responses):
                    if emission[e, s, o] > 0.0:
                        largest = max(largest, spread * z[q] * scores[o])
                total = 0.0
                for o in range(responses):
                    out[e, s, o, q] = 0.0  # not zero times an overflow
                    if emission[e, s, o] > 0.0:
                        out[e, s, o, q] = emission[e, s, o] * np.exp(spread * z[q] * scores[o] - largest)
                    total += out[e, s, o, q]
                for o in range(responses):
                    out[e, s, o, q] /= total
    return out


@kernel
def tilt_pullback(emission, tilted, scores, spread, z, g_tilted, g_emission):  # type: ignore[no-untyped-def]
    """Add the gradient with respect to the untilted tables; return the derivative with respect to sigma."""
    tables, states, responses = emission.shape
    g_spread = 0.0
    for e in range(tables):
        for s in range(states):
            for q in range(len(z)):
                largest = -np.inf
                for o in range(responses):
                    if emission[e, s, o] > 0.0:
                        largest = max(largest, spread * z[q] * scores[o])
                total, mean_slope, mean_score = 0.0, 0.0, 0.0
                for o in range(responses):
                    total += emission[e, s, o] * np.exp(spread * z[q] * scores[o] - largest)
                    mean_slope += g_tilted[e, s, o, q] * tilted[e, s, o, q]
                    mean_score += scores[o] * tilted[e, s, o, q]
                for o in range(responses):
                    ratio = np.exp(spread * z[q] * scores[o] - largest) / total
                    g_emission[e, s, o] += ratio * (g_tilted[e, s, o, q] - mean_slope)
                    g_spread += g_tilted[e, s, o, q] * tilted[e, s, o, q] * z[q] * (scores[o] - mean_score)
    return g_spread


@kernel
def people_forward(tree, initial, transition, tilted, emission_index, work, scale):  # type: ignore[no-untyped-def]
    """As `models.forward_backward.forward`, all points at once: ``work[2, node, s, q]``, ``scale[2, node, q]``."""
    states, points = initial.shape[1], tilted.shape[3]
    per_group = len(emission_index) // len(initial)
    weighted, predicted = work[0], work[1]
    total = np.empty(points)
    for q in range(points):
        scale[0, 0, q], scale[1, 0, q] = 1.0, 0.0
    for s in range(states):
        for q in range(points):
            weighted[0, s, q] = 0.0
            predicted[0, s, q] = 0.0
    for node in range(len(tree.action)):
        children = tree.n_children[node]
        if children == 0:
            continue
        if node > 0:
            a = tree.action[node]
            for t in range(states):
                for q in range(points):
                    predicted[node, t, q] = 0.0
                for s in range(states):
                    move = transition[a, s, t]
                    for q in range(points):
                        predicted[node, t, q] += weighted[node, s, q] * move
        first = tree.first_child[node]
        for child in range(first, first + children):
            if node == 0:
                g = tree.action[child] // per_group
                for s in range(states):
                    for q in range(points):
                        predicted[0, s, q] = initial[g, s]
            o = tree.response[child]
            for q in range(points):
                total[q] = 0.0
            if o >= 0:
                e = emission_index[tree.action[child]]
                for s in range(states):
                    for q in range(points):
                        mass = predicted[node, s, q] * tilted[e, s, o, q]
                        weighted[child, s, q] = mass
                        total[q] += mass
            else:
                for s in range(states):
                    for q in range(points):
                        mass = predicted[node, s, q]
                        weighted[child, s, q] = mass
                        total[q] += mass
            smallest = 1.0
            for q in range(points):
                scale[0, child, q] = 1.0
                scale[1, child, q] = scale[1, node, q]
                smallest = min(smallest, total[q])
            if smallest < TINY:
                for q in range(points):
                    if total[q] < TINY and total[q] > 0.0:
                        scale[0, child, q] = total[q]
                        scale[1, child, q] += np.log(total[q])
                        for s in range(states):
                            weighted[child, s, q] /= total[q]


@kernel
def run_evidence(tree, work, scale):  # type: ignore[no-untyped-def]
    """Log-likelihood of the history ending at each node, ``[node, q]``; 0 where no run ends."""
    nodes, states, points = work.shape[1:]
    out = np.zeros((nodes, points))
    for node in range(1, nodes):
        if tree.ends[node] > 0.0:
            for q in range(points):
                total = 0.0
                for s in range(states):
                    total += work[0, node, s, q]
                out[node, q] = np.log(total) + scale[1, node, q]
    return out


@kernel
def person_evidence(people, evidence, person, joint):  # type: ignore[no-untyped-def]
    """Log-likelihood of one distinct person; `joint` is filled with the responsibilities."""
    points = len(people.z)
    for q in range(points):
        joint[q] = people.log_weight[q]
    for run in range(people.offset[person], people.offset[person + 1]):
        node = people.node[run]
        for q in range(points):
            joint[q] += evidence[node, q]
    largest = -np.inf
    for q in range(points):
        largest = max(largest, joint[q])
    if not largest > -np.inf:
        return -np.inf
    total = 0.0
    for q in range(points):
        joint[q] = np.exp(joint[q] - largest)
        total += joint[q]
    for q in range(points):
        joint[q] /= total
    return largest + np.log(total)


@kernel
def people_sweep(  # type: ignore[no-untyped-def]
    tree, people, initial, transition, emission, emission_index, spread, g_initial, g_transition, g_emission
):
    """Weighted log-likelihood and its derivative with respect to sigma; the other gradients are added into g_*."""
    states, points, nodes = initial.shape[1], len(people.z), len(tree.action)
    per_group = len(emission_index) // len(initial)
    tilted = tilt(emission, people.scores, spread, people.z)
    work = np.empty((2, nodes, states, points))
    scale = np.empty((2, nodes, points))
    people_forward(tree, initial, transition, tilted, emission_index, work, scale)
    weighted, predicted = work[0], work[1]
    evidence = run_evidence(tree, work, scale)
    ends = np.zeros((nodes, points))
    joint = np.empty(points)
    value = 0.0
    for person in range(len(people.weight)):
        weight = people.weight[person]
        if weight > 0.0:
            found = person_evidence(people, evidence, person, joint)
            if not found > -np.inf:
                return -np.inf, 0.0
            value += weight * found
            for run in range(people.offset[person], people.offset[person + 1]):
                node = people.node[run]
                for q in range(points):
                    ends[node, q] += weight * joint[q]
    lanes = np.zeros((len(transition), states, states, points))
    g_tilted = np.zeros(tilted.shape)
    after = np.empty((nodes, states, points))
    below = np.empty((states, points))
    message = np.empty((states, points))
    for node in range(nodes - 1, 0, -1):
        for q in range(points):
            start = 0.0
            if ends[node, q] > 0.0:
                total = 0.0
                for s in range(states):
                    total += weighted[node, s, q]
                start = ends[node, q] / total
            for s in range(states):
                message[s, q] = start
        if tree.n_children[node] > 0:
            _gather_children(tree, node, predicted[node], tilted, emission_index, scale, after, below, g_tilted)
            a = tree.action[node]
            for s in range(states):
                for t in range(states):
                    move = transition[a, s, t]
                    for q in range(points):
                        lanes[a, s, t, q] += weighted[node, s, q] * below[t, q]
                        message[s, q] += move * below[t, q]
        for s in range(states):
            for q in range(points):
                after[node, s, q] = message[s, q]
    # The first event: groups may start differently, so each child of the root has its own prediction.
    first = tree.first_child[0]
    for child in range(first, first + tree.n_children[0]):
        g = tree.action[child] // per_group
        o = tree.response[child]
        e = emission_index[tree.action[child]]
        for s in range(states):
            for q in range(points):
                back = after[child, s, q] / scale[0, child, q]
                if o >= 0:
                    g_tilted[e, s, o, q] += initial[g, s] * back
                    back *= tilted[e, s, o, q]
                g_initial[g, s] += back
    for a in range(len(transition)):
        for s in range(states):
            for t in range(states):
                g_transition[a, s, t] += np.sum(lanes[a, s, t])
    return value, tilt_pullback(emission, tilted, people.scores, spread, people.z, g_tilted, g_emission)


@kernel
def _gather_children(  # type: ignore[no-untyped-def]
    tree, node, predicted, tilted, emission_index, scale, after, below, g_tilted
):
    """Backward messages of a node's children, summed into `below`; observations enter `g_tilted`."""
    states, points = below.shape
    for s in range(states):
        for q in range(points):
            below[s, q] = 0.0
    first = tree.first_child[node]
    for child in range(first, first + tree.n_children[node]):
        o = tree.response[child]
        if o >= 0:
            e = emission_index[tree.action[child]]
            for s in range(states):
                for q in range(points):
                    back = after[child, s, q] / scale[0, child, q]
                    g_tilted[e, s, o, q] += predicted[s, q] * back
                    below[s, q] += tilted[e, s, o, q] * back
        else:
            for s in range(states):
                for q in range(points):
                    below[s, q] += after[child, s, q] / scale[0, child, q]
