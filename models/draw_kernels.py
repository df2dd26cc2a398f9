"""Kernels over many draws: constrain unconstrained points, log-likelihood of every history under every draw."""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.forward_backward import forward
from models.histories import HistoryTree
from models.hmm_density import HmmDensity, constrain
from models.parameters import Array, Layout


def constrained(density: HmmDensity, x: Array) -> Array:
    """Theta of every unconstrained point; ``x[..., coordinate]`` to ``[..., theta]``."""
    flat = np.ascontiguousarray(x.reshape(-1, density.dimension))
    out = np.tile(density.template, (len(flat), 1))
    _constrain_all(flat, density.plan, out)
    return out.reshape(*x.shape[:-1], -1)


def history_log_likelihoods(tree: HistoryTree, layout: Layout, theta: Array) -> Array:
    """Log-likelihood of each distinct history under each draw; ``theta[..., p]`` to ``[..., history]``."""
    flat = np.ascontiguousarray(theta.reshape(-1, layout.size))
    out = np.empty((len(flat), tree.n_histories))
    _score_all(flat, tree.arrays, tree.terminals, layout.sizes, layout.emission_index, out)
    return out.reshape(*theta.shape[:-1], -1)


@kernel
def _constrain_all(x, plan, out):  # type: ignore[no-untyped-def]
    for i in range(len(x)):
        constrain(x[i], plan, out[i])


@kernel
def _score_all(theta, tree, terminals, sizes, emission_index, out):  # type: ignore[no-untyped-def]
    states, actions, tables, responses = sizes
    first, second = states, states + actions * states * states
    nodes = len(tree.action)
    work = np.empty((2, nodes, states))
    scale = np.empty((2, nodes))
    for i in range(len(theta)):
        row = theta[i]
        forward(
            tree,
            row[:first],
            row[first:second].reshape(actions, states, states),
            row[second:].reshape(tables, states, responses),
            emission_index,
            work,
            scale,
        )
        for h in range(len(terminals)):
            total = 0.0
            for s in range(states):
                total += work[0, terminals[h], s]
            out[i, h] = np.log(total) + scale[1, terminals[h]]
