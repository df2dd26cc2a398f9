"""Room made in the belief tree, compiled: sawtooth points given up and vectors that are best nowhere go."""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.planning.arrays import ProblemArrays
from models.planning.belief_tree import TINY, Tree
from models.planning.vectors import Vectors, keep_useful


@kernel
def tidy_points(tree: Tree, problem: ProblemArrays) -> None:
    """Drop sawtooth points that have been given up."""
    before = tree.counts[1]
    kept = 0
    rank = np.empty(before + 1, dtype=np.int64)
    tree.point_last[:] = -1
    for j in range(before):
        rank[j] = kept
        i = tree.point_node[j]
        if tree.point_of[i] == j:
            if tree.point_depth[j] >= -TINY * problem.largest:
                tree.point_of[i] = -1
                continue
            tree.point_of[i] = kept
            tree.point_node[kept] = i
            tree.point_depth[kept] = tree.point_depth[j]
            tree.point_previous[kept] = tree.point_last[tree.mode[i]]
            tree.point_last[tree.mode[i]] = kept
            kept += 1
    tree.counts[1] = kept
    rank[before] = kept
    for i in range(tree.counts[0]):
        tree.seen_points[i] = rank[tree.seen_points[i]]


@kernel
def tidy_vectors(tree: Tree, problem: ProblemArrays, vectors: Vectors) -> None:
    """Drop vectors that are best at no node and followed by none that is."""
    before = vectors.counts[0]
    useful = np.zeros(before, dtype=np.bool_)
    for i in range(tree.counts[0]):
        if tree.best[i] >= 0:
            useful[tree.best[i]] = True
    number = keep_useful(vectors, problem, useful)
    for i in range(tree.counts[0]):
        if tree.best[i] >= 0:
            tree.best[i] = number[tree.best[i]]
        tree.seen_vectors[i] = vectors.counts[0] if tree.seen_vectors[i] == before else 0
