r"""The best plan of many draws, draws in portions.

What every choice after every history adds to the worth of a plan is a sum over draws, so portions of draws that fit
the processor's cache are walked one by one, in threads, and their sums added up. The best choices then follow
backwards from the sums. The work is linear in the draws however many there are.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.planning.history_kernel import Array, history_sums
from models.planning.schedule_tree import ScheduleTree
from models.spread_out import threads_here

PORTION = 512
"""Draws at a time."""

MOST_SUMS = 4_000_000
"""Sums that are held, and the threads' own: beyond that the walk must do without."""


class Chosen(NamedTuple):
    """Value, values of the first actions, best action after each history, plan after each last response."""

    value: float
    first_values: Array
    decision: NDArray[np.int8]
    picks: NDArray[np.int16]


def row_counts(tree: ScheduleTree) -> tuple[list[int], list[int]]:
    """Histories of each event up to the leaf, and sums of each."""
    s, leaf = tree.schedule, tree.leaf
    actions = [len(s.mode(k).actions) for k in range(leaf + 1)]
    histories = [1]
    for k in range(leaf):
        histories.append(histories[-1] * actions[k] * s.n_outcomes(k))
    sums = [histories[k] * actions[k] for k in range(leaf)]
    return histories, [*sums, histories[leaf] * actions[leaf] * (1 + s.n_outcomes(leaf) * tree.n_plans)]


def pays(tree: ScheduleTree) -> bool:
    """Whether there are so many draws, and so few histories, that portions pay."""
    return tree.schedule.draws.n_draws > 2 * PORTION and sum(row_counts(tree)[1]) <= MOST_SUMS


def summed_walk(tree: ScheduleTree) -> Chosen:
    """Walk portions of the draws, and choose by the sums."""
    histories, sums = row_counts(tree)
    begin = np.concatenate([[0], np.cumsum(sums)[:-1]]).astype(np.int64)
    draws, start = tree.schedule.draws.n_draws, tree.start
    spans = [slice(i, min(i + PORTION, draws)) for i in range(0, draws, PORTION)]

    def portion(span: slice) -> Array:
        own = tree.some(span, start[span])
        totals = np.empty(sum(sums))
        history_sums(own.tables, tree.leaf, own.leaf_vectors, begin, totals)
        return totals

    total = np.zeros(sum(sums))
    with ThreadPoolExecutor(threads_here()) as threads:
        # Added in the order of the draws: the sums do not depend on who is first.
        for totals in threads.map(portion, spans):
            total += totals
    return _backward(tree, total, histories, begin)


def _backward(tree: ScheduleTree, total: Array, histories: list[int], begin: NDArray[np.int64]) -> Chosen:
    s, leaf = tree.schedule, tree.leaf
    actions, outcomes = len(s.mode(leaf).actions), s.n_outcomes(leaf)
    last = total[begin[leaf] :].reshape(histories[leaf], -1)
    follow = last[:, actions:].reshape(len(last), actions, outcomes, tree.n_plans)
    worth = last[:, :actions] + follow.max(axis=3).sum(axis=2)
    best = worth.argmax(axis=1)
    picks = follow.argmax(axis=3)[np.arange(len(last)), best].astype(np.int16)
    decisions = [best]
    for k in range(leaf - 1, -1, -1):
        actions, outcomes = len(s.mode(k).actions), s.n_outcomes(k)
        rows = total[begin[k] : begin[k] + histories[k] * actions].reshape(histories[k], actions)
        worth = rows + worth.max(axis=1).reshape(histories[k], actions, outcomes).sum(axis=2)
        decisions.append(worth.argmax(axis=1))
    decision = np.concatenate(decisions[::-1]).astype(np.int8)
    return Chosen(float(worth[0].max()), np.ascontiguousarray(worth[0]), decision, picks)
