r"""The one masked forward-backward recursion: likelihood, its exact gradient, smoothed states, best path.

With :math:`e_k(s) = O(o_k \mid s, a_k)` where a response was seen and 1 otherwise, the recursion of the model
page is :math:`\alpha_0 = b_0`, :math:`w_k = \alpha_k e_k`, :math:`\alpha_{k+1} = w_k T_{a_k}`, and a run of
`K` events has likelihood :math:`L = \sum_s w_{K-1}(s)`: the last action carries no evidence on `T`.

On the prefix tree (`models.histories`) the forward pass runs once a node. Backwards, each node carries the
sum over all runs through it of count / L times the backward message, so that the gradient of the weighted
log-likelihood is assembled in the same sweep; expected counts are ``parameter * gradient``
(:math:`\xi = T\,\partial\ell/\partial T`). Work is proportional to the nodes of the tree, not to the events.

Probabilities are rescaled only when a forward vector falls below `TINY`, so runs of thousands of events
neither underflow nor pay for logarithms. One limit remains: a state whose share of the forward vector falls below
1e-308 within a run is lost even if later events would favour it, which takes states that cannot reach each other
and evidence beyond those odds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.histories import HistoryTree

TINY = 1e-20

Array = NDArray[np.float64]


class Likelihood(NamedTuple):
    """Weighted log-likelihood and its gradient.

    Attributes
    ----------
    log_likelihood : float
        Sum over runs; ``-inf`` if a run with positive weight is impossible (gradients are then zero).
    initial : float64[s]
        Derivative with respect to `initial`, every entry taken as free.
    transition : float64[a, s, s']
    emission : float64[e, s, o]
    """

    log_likelihood: float
    initial: Array
    transition: Array
    emission: Array


class Smoothed(NamedTuple):
    r"""State probabilities given the whole run, one row an event of each distinct history.

    Attributes
    ----------
    offsets : int64[histories + 1]
        Rows of history h are ``offsets[h] : offsets[h + 1]``.
    probability : float64[rows, s]
        :math:`\gamma_k(s) = P(s_k = s \mid o_0, ..., o_{K-1})`.
    """

    offsets: NDArray[np.int64]
    probability: Array


class Decoded(NamedTuple):
    """Most probable state path of each distinct history (Viterbi).

    Attributes
    ----------
    offsets : int64[histories + 1]
    state : int64[rows]
    log_probability : float64[histories]
        Joint log-probability of path and responses.
    """

    offsets: NDArray[np.int64]
    state: NDArray[np.int64]
    log_probability: Array


def log_likelihood_and_gradient(
    tree: HistoryTree,
    initial: Array,
    transition: Array,
    emission: Array,
    emission_index: NDArray[np.int64],
) -> Likelihood:
    """Evaluate the likelihood of all runs and its exact gradient.

    Parameters
    ----------
    tree : HistoryTree
    initial : float64[s] or float64[g, s]
        A row a group where people are grouped.
    transition : float64[a, s, s']
    emission : float64[e, s, o]
        One table for each action under which a response can show.
    emission_index : int64[a]
        Table of each action, -1 for silent modes (`Protocol.emission_index`).

    Returns
    -------
    Likelihood
    """
    g_initial = np.zeros_like(initial)
    g_transition = np.zeros_like(transition)
    g_emission = np.zeros_like(emission)
    work = np.empty((2, tree.n_nodes, initial.shape[-1]))
    scale = np.empty((2, tree.n_nodes))
    value = sweep(
        tree.arrays, np.atleast_2d(initial), transition, emission, emission_index,
        np.atleast_2d(g_initial), g_transition, g_emission, work, scale,
    )  # fmt: skip
    return Likelihood(value, g_initial, g_transition, g_emission)


def history_log_likelihoods(
    tree: HistoryTree, initial: Array, transition: Array, emission: Array, emission_index: NDArray[np.int64]
) -> Array:
    """Log-likelihood of each distinct history, in the order of ``tree.terminals`` (unweighted)."""
    work = np.empty((2, tree.n_nodes, len(initial)))
    scale = np.empty((2, tree.n_nodes))
    forward(tree.arrays, np.atleast_2d(initial), transition, emission, emission_index, work, scale)
    with np.errstate(divide="ignore"):
        return np.log(work[0].sum(axis=1)[tree.terminals]) + scale[1][tree.terminals]


def smooth(
    tree: HistoryTree, initial: Array, transition: Array, emission: Array, emission_index: NDArray[np.int64]
) -> Smoothed:
    """Smoothed state probabilities of every event of every distinct history; NaN where it is impossible."""
    work = np.empty((2, tree.n_nodes, len(initial)))
    scale = np.empty((2, tree.n_nodes))
    forward(tree.arrays, np.atleast_2d(initial), transition, emission, emission_index, work, scale)
    offsets = _row_offsets(tree)
    rows = np.empty((offsets[-1], len(initial)))
    _smooth_paths(
        tree.arrays, tree.parent, tree.terminals, offsets, transition, emission, emission_index, work, rows
    )
    return Smoothed(offsets, rows)


def decode(
    tree: HistoryTree, initial: Array, transition: Array, emission: Array, emission_index: NDArray[np.int64]
) -> Decoded:
    """Most probable state path of every distinct history (Viterbi, in log space)."""
    offsets = _row_offsets(tree)
    path = np.empty(offsets[-1], dtype=np.int64)
    best = np.empty(tree.n_histories)
    with np.errstate(divide="ignore"):
        _viterbi(
            tree.arrays, tree.parent, tree.terminals, offsets,
            np.log(initial), np.log(transition), np.log(emission), emission_index, path, best,
        )  # fmt: skip
    return Decoded(offsets, path, best)


def _row_offsets(tree: HistoryTree) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(tree.depth[tree.terminals])])


@kernel
def forward(tree, initial, transition, emission, emission_index, work, scale, unit=()):  # type: ignore[no-untyped-def]
    """Fill work[0] = w (event included), work[1] = alpha of the children, scale[0] factor, scale[1] its log sum.

    A node's vectors are true values divided by exp(scale[1]). ``initial[g, s]`` has a row a group of people;
    actions are coded by group, ``g * actions + a`` (`models.groups`), and plain models have one group.

    `unit` may be a tuple of as many zeros as there are states: its length is known to the compiler, which then
    unrolls the loops over states (twice as fast). Empty, the number of states is read from the arrays.
    """
    states = len(unit) if len(unit) > 0 else initial.shape[1]
    per_group = len(emission_index) // len(initial)
    weighted, predicted = work[0], work[1]
    scale[0, 0], scale[1, 0] = 1.0, 0.0
    for s in range(states):
        predicted[0, s] = 0.0
        weighted[0, s] = 0.0
    for node in range(len(tree.action)):
        children = tree.n_children[node]
        if children == 0:
            continue
        if node > 0:
            a = tree.action[node]
            for t in range(states):
                predicted[node, t] = 0.0
            for s in range(states):
                mass = weighted[node, s]
                for t in range(states):
                    predicted[node, t] += mass * transition[a, s, t]
        first = tree.first_child[node]
        for child in range(first, first + children):
            if node == 0:
                group = tree.action[child] // per_group
                for s in range(states):
                    predicted[0, s] = initial[group, s]
            o = tree.response[child]
            total = 0.0
            if o >= 0:
                e = emission_index[tree.action[child]]
                for s in range(states):
                    mass = predicted[node, s] * emission[e, s, o]
                    weighted[child, s] = mass
                    total += mass
            else:
                for s in range(states):
                    mass = predicted[node, s]
                    weighted[child, s] = mass
                    total += mass
            scale[0, child] = 1.0
            scale[1, child] = scale[1, node]
            if total < TINY and total > 0.0:
                scale[0, child] = total
                scale[1, child] += np.log(total)
                for s in range(states):
                    weighted[child, s] /= total


@kernel
def sweep(  # type: ignore[no-untyped-def]
    tree, initial, transition, emission, emission_index, g_initial, g_transition, g_emission, work, scale, unit=()
):
    """Forward, then backward with gradients added into g_*; returns the weighted log-likelihood."""
    forward(tree, initial, transition, emission, emission_index, work, scale, unit)
    states = len(unit) if len(unit) > 0 else initial.shape[1]
    per_group = len(emission_index) // len(initial)
    weighted, predicted = work[0], work[1]
    value = 0.0
    for node in range(1, len(tree.action)):
        count = tree.ends[node]
        if count > 0.0:
            total = 0.0
            for s in range(states):
                total += weighted[node, s]
            if not total > 0.0:
                return -np.inf
            value += count * (np.log(total) + scale[1, node])
    below = np.empty(states)
    message = np.empty(states)
    after = np.empty((len(tree.action), states))
    # `after[node]` is this node's backward message per unit of forward mass; children come after parents.
    for node in range(len(tree.action) - 1, 0, -1):
        children = tree.n_children[node]
        count = tree.ends[node]
        start = 0.0
        if count > 0.0:
            total = 0.0
            for s in range(states):
                total += weighted[node, s]
            start = count / total
        for s in range(states):
            message[s] = start
        if children > 0:
            for s in range(states):
                below[s] = 0.0
            first = tree.first_child[node]
            for child in range(first, first + children):
                shrink = 1.0 / scale[0, child]
                o = tree.response[child]
                if o >= 0:
                    e = emission_index[tree.action[child]]
                    for s in range(states):
                        back = after[child, s] * shrink
                        g_emission[e, s, o] += predicted[node, s] * back
                        below[s] += emission[e, s, o] * back
                else:
                    for s in range(states):
                        below[s] += after[child, s] * shrink
            a = tree.action[node]
            for s in range(states):
                mass = weighted[node, s]
                back = 0.0
                for t in range(states):
                    g_transition[a, s, t] += mass * below[t]
                    back += transition[a, s, t] * below[t]
                message[s] += back
        for s in range(states):
            after[node, s] = message[s]
    # The first event: each child of the root starts from the initial distribution of its own group.
    first = tree.first_child[0]
    for child in range(first, first + tree.n_children[0]):
        group = tree.action[child] // per_group
        shrink = 1.0 / scale[0, child]
        o = tree.response[child]
        e = emission_index[tree.action[child]]
        for s in range(states):
            back = after[child, s] * shrink
            if o >= 0:
                g_emission[e, s, o] += initial[group, s] * back
                back *= emission[e, s, o]
            g_initial[group, s] += back
    return value


@kernel
def _smooth_paths(tree, parent, terminals, offsets, transition, emission, emission_index, work, rows):  # type: ignore[no-untyped-def]
    states = rows.shape[1]
    weighted = work[0]
    back = np.empty(states)
    incoming = np.empty(states)
    for h in range(len(terminals)):
        node = terminals[h]
        for s in range(states):
            back[s] = 1.0
        for row in range(offsets[h + 1] - 1, offsets[h] - 1, -1):
            total = 0.0
            for s in range(states):
                rows[row, s] = weighted[node, s] * back[s]
                total += rows[row, s]
            for s in range(states):
                rows[row, s] /= total
            above = parent[node]
            if above <= 0:
                break
            o = tree.response[node]
            for t in range(states):
                incoming[t] = back[t]
                if o >= 0:
                    incoming[t] *= emission[emission_index[tree.action[node]], t, o]
            a = tree.action[above]
            largest = 0.0
            for s in range(states):
                value = 0.0
                for t in range(states):
                    value += transition[a, s, t] * incoming[t]
                back[s] = value
                largest = max(largest, value)
            if largest > 0.0:
                for s in range(states):
                    back[s] /= largest
            node = above


@kernel
def _viterbi(  # type: ignore[no-untyped-def]
    tree, parent, terminals, offsets, log_initial, log_transition, log_emission, emission_index, path, best
):
    nodes, states = len(parent), len(log_initial)
    score = np.empty((nodes, states))
    came_from = np.empty((nodes, states), np.int64)
    for node in range(1, nodes):
        above = parent[node]
        o = tree.response[node]
        for t in range(states):
            if above == 0:
                value, source = log_initial[t], -1
            else:
                a = tree.action[above]
                value, source = -np.inf, 0
                for s in range(states):
                    candidate = score[above, s] + log_transition[a, s, t]
                    if candidate > value:
                        value, source = candidate, s
            if o >= 0:
                value += log_emission[emission_index[tree.action[node]], t, o]
            score[node, t] = value
            came_from[node, t] = source
    for h in range(len(terminals)):
        node = terminals[h]
        state = 0
        for s in range(1, states):
            if score[node, s] > score[node, state]:
                state = s
        best[h] = score[node, state]
        for row in range(offsets[h + 1] - 1, offsets[h] - 1, -1):
            path[row] = state
            state = came_from[node, state]
            node = parent[node]
