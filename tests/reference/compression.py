"""Prefix compression as a dict of tuples."""

from collections import Counter


def compress(runs):
    """All beginnings of all runs, shortest first and then in dictionary order, and how many runs end at each.

    The first beginning is the empty one: node 0 of the tree.
    """
    beginnings = {tuple(run[:k]) for run in runs for k in range(len(run) + 1)}
    ends = Counter(tuple(run) for run in runs)
    ordered = sorted(beginnings, key=lambda b: (len(b), b))
    return ordered, [ends[b] for b in ordered]
