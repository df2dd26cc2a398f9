"""The hierarchical likelihood person by person and node by node, in plain numpy."""

import numpy as np
from scipy.special import logsumexp

from tests.reference import recursions


def tilted(emission, scores, offset):
    """Every row times exp(offset * score), renormalised."""
    table = emission * np.exp(offset * np.asarray(scores))
    return table / table.sum(axis=-1, keepdims=True)


def person_log_likelihood(runs, initial, transition, emission, emission_index, scores, spread, z, log_weight):
    """Of one person with these runs, summed over the nodes."""
    by_node = []
    for q, lw in zip(z, log_weight, strict=True):
        moved = tilted(emission, scores, spread * q)
        by_node.append(
            lw + sum(recursions.log_likelihood(run, initial, transition, moved, emission_index) for run in runs)
        )
    return logsumexp(by_node)


def person_log_likelihood_by_integration(runs, tables, emission_index, scores, spread):
    """The same by adaptive integration over the offset, without nodes of ours."""
    from scipy.integrate import quad

    initial, transition, emission = tables

    def integrand(z):
        moved = tilted(emission, scores, spread * z)
        total = sum(recursions.log_likelihood(run, initial, transition, moved, emission_index) for run in runs)
        return np.exp(total - 0.5 * z * z) / np.sqrt(2 * np.pi)

    return np.log(quad(integrand, -9, 9, epsabs=1e-14, epsrel=1e-11, limit=400)[0])
