"""Kernels over many draws: constrain unconstrained points, log-likelihood of runs and people under every draw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.forward_backward import forward
from models.histories import HistoryTree
from models.hmm_density import HmmDensity, constrain, tables
from models.parameters import Array, Layout
from models.people_kernel import PeopleArrays, people_forward, person_evidence, run_evidence, tilt


def constrained(density: HmmDensity, x: Array) -> Array:
    """Theta of every unconstrained point; ``x[..., coordinate]`` to ``[..., theta]``."""
    flat = np.ascontiguousarray(x.reshape(-1, density.dimension))
    out = np.tile(density.template, (len(flat), 1))
    _constrain_all(flat, density.arrays, out)
    return out.reshape(*x.shape[:-1], -1)


def history_log_likelihoods(tree: HistoryTree, layout: Layout, theta: Array) -> Array:
    """Log-likelihood of each distinct history under each draw; ``theta[..., p]`` to ``[..., history]``."""
    flat = np.ascontiguousarray(theta.reshape(-1, layout.size))
    out = np.empty((len(flat), tree.n_histories))
    _score_all(flat, tree.arrays, tree.terminals, layout.sizes, layout.index, layout.emission_index, out)
    return out.reshape(*theta.shape[:-1], -1)


def person_log_likelihoods(
    density: HmmDensity, theta: Array, person: NDArray[np.int64], people: PeopleArrays | None = None
) -> Array:
    """Log-likelihood of each person under each draw, offsets integrated out where people differ.

    Parameters
    ----------
    density : HmmDensity
    theta : float64[..., p]
        Sigma last where people differ.
    person : int64[runs]
        Person of each run of the density's tree, numbered from 0.
    people : PeopleArrays, optional
        One person each, in order (`models.person_offset.each_person`), where people differ.

    Returns
    -------
    float64[..., person]
    """
    layout, tree = density.layout, density.tree
    if people is None:
        history = np.searchsorted(tree.terminals, tree.run_node)
        by_run = history_log_likelihoods(tree, layout, theta)[..., history[np.argsort(person, kind="stable")]]
        return np.add.reduceat(by_run, np.append(0, np.cumsum(np.bincount(person)))[:-1], axis=-1)
    flat = np.ascontiguousarray(theta.reshape(-1, layout.size + 1))
    out = np.empty((len(flat), len(people.weight)))
    _score_people(flat, tree.arrays, people, layout.sizes, layout.index, layout.emission_index, out)
    return out.reshape(*theta.shape[:-1], -1)


@kernel
def _constrain_all(x, study, out):  # type: ignore[no-untyped-def]
    for i in range(len(x)):
        constrain(x[i], study, out[i])


@kernel
def _score_all(theta, tree, terminals, sizes, index, emission_index, out):  # type: ignore[no-untyped-def]
    states, nodes = sizes[0], len(tree.action)
    work = np.empty((2, nodes, states))
    scale = np.empty((2, nodes))
    for i in range(len(theta)):
        initial, transition, emission = tables(theta[i][index], sizes)
        forward(tree, initial, transition, emission, emission_index, work, scale)
        for h in range(len(terminals)):
            total = 0.0
            for s in range(states):
                total += work[0, terminals[h], s]
            out[i, h] = np.log(total) + scale[1, terminals[h]]


@kernel
def _score_people(theta, tree, people, sizes, index, emission_index, out):  # type: ignore[no-untyped-def]
    states, nodes, points = sizes[0], len(tree.action), len(people.z)
    work = np.empty((2, nodes, states, points))
    scale = np.empty((2, nodes, points))
    joint = np.empty(points)
    for i in range(len(theta)):
        initial, transition, emission = tables(theta[i][index], sizes)
        tilted = tilt(emission, people.scores, theta[i, -1], people.z)
        people_forward(tree, initial, transition, tilted, emission_index, work, scale)
        evidence = run_evidence(tree, work, scale)
        for person in range(len(people.weight)):
            out[i, person] = person_evidence(people, evidence, person, joint)
