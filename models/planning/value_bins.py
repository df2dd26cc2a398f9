r"""Values of beliefs predicted from those of similar beliefs: same mode, upper bound and entropy, compiled.

Two levels of bins, a coarse and a fine one; the one that has erred less so far is asked (Kurniawati, Hsu & Lee
2008).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.belief_tree import Tree

COARSE, FINE = 5, 10
"""Bins a side of the two levels of prediction."""


class Bins(NamedTuple):
    """Predictions of values by bins of similar beliefs, on two levels.

    Attributes
    ----------
    total, error : float64[x, 2, f]
        Sum of members' lower bounds; sum of squared errors of predictions made when members came in.
    members : int64[x, 2, f]
    lowest, highest : float64[x]
        Range of the fast informed bound over the corners of each mode.
    bin : int32[i, 2]
        Bins of each node, -1 before it has been visited.
    counted : float64[i]
        The lower bound with which a node is part of the sums.
    trial : int64[i]
        The last trial that came by.
    """

    total: Array
    error: Array
    members: Index
    lowest: Array
    highest: Array
    bin: NDArray[np.int32]
    counted: Array
    trial: Index


def empty_bins(problem: ProblemArrays, tree: Tree) -> Bins:
    """Bins without members, for the nodes there is room for."""
    modes = len(problem.mode_size)
    corner = [tree.corner[x, : problem.mode_size[x]] for x in range(modes)]
    shape = (modes, 2, FINE * FINE)
    return Bins(
        np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.int64), np.array([c.min() for c in corner]),
        np.array([c.max() for c in corner]), np.full((len(tree.mode), 2), -1, dtype=np.int32),
        np.zeros(len(tree.mode)), np.zeros(len(tree.mode), dtype=np.int64),
    )  # fmt: skip


def grown_bins(bins: Bins, capacity: int) -> Bins:
    """The same bins for more nodes."""
    old = len(bins.counted)
    wide = np.full((capacity, 2), -1, dtype=np.int32)
    wide[:old] = bins.bin
    return bins._replace(
        bin=wide, counted=np.concatenate([bins.counted, np.zeros(capacity - old)]),
        trial=np.concatenate([bins.trial, np.zeros(capacity - old, dtype=np.int64)]),
    )  # fmt: skip


@kernel
def predict(tree: Tree, problem: ProblemArrays, bins: Bins, i: int) -> float:
    """Predicted value of a node; its part in the bins is brought up to date."""
    x = tree.mode[i]
    size = problem.mode_size[x]
    if bins.bin[i, 0] < 0:
        entropy = 0.0
        for y in range(size):
            b = tree.belief[i, y]
            if b > 0.0:
                entropy -= b * np.log(b)
        flat = entropy / np.log(size) if size > 1 else 0.0
        span = bins.highest[x] - bins.lowest[x]
        height = (tree.upper[i] - bins.lowest[x]) / span if span > 0.0 else 0.0
        flat = min(max(flat, 0.0), 1.0 - 1e-12)
        height = min(max(height, 0.0), 1.0 - 1e-12)
        bins.bin[i, 0] = int(flat * COARSE) * COARSE + int(height * COARSE)
        bins.bin[i, 1] = int(flat * FINE) * FINE + int(height * FINE)
        for level in range(2):
            place = bins.bin[i, level]
            if bins.members[x, level, place] > 0:
                guess = bins.total[x, level, place] / bins.members[x, level, place]
                bins.error[x, level, place] += (guess - tree.lower[i]) ** 2
            bins.members[x, level, place] += 1
            bins.total[x, level, place] += tree.lower[i]
        bins.counted[i] = tree.lower[i]
    elif tree.lower[i] != bins.counted[i]:
        for level in range(2):
            bins.total[x, level, bins.bin[i, level]] += tree.lower[i] - bins.counted[i]
        bins.counted[i] = tree.lower[i]
    level = 1 if bins.error[x, 1, bins.bin[i, 1]] < bins.error[x, 0, bins.bin[i, 0]] else 0
    place = bins.bin[i, level]
    if bins.members[x, level, place] <= 1:
        return tree.upper[i]
    return min(tree.upper[i], max(tree.lower[i], bins.total[x, level, place] / bins.members[x, level, place]))
