r"""The best plan's worth under many weights of the same draws, exactly and at once.

One Bayes tree answers one set of weights. What it sums over draws is linear in them: with `G` the worth of every
choice after every history in every draw (`models.robust.weights_kernel`), :math:`G w` holds all that the tree needs
for weights `w`, and a matrix of weights costs a product of matrices, a fraction of as many trees.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.planning.schedule import Array, Schedule
from models.planning.schedule_tree import ScheduleTree, schedule_tree
from models.robust.plan_table import unweighted
from models.robust.weights_kernel import history_rows
from models.spread_out import chunks

ROOM = 8_000_000
"""Numbers that one block of work holds."""

CHUNK = 512
"""Draws at a time at most, so that their vectors stay in the processor's cache."""


class Optima(NamedTuple):
    """What the best plan is worth under each set of weights.

    Attributes
    ----------
    values : float64[m]
    first_values : float64[m, a]
        Of each action at the first event, followed by the best plan.
    scored : float64[m]
        What the best plan is worth under the weights that it is scored with; its own if no others are given.
    """

    values: Array
    first_values: Array
    scored: Array


class ManyWeights:
    """Bayes trees of one schedule for many weights of its draws.

    Parameters
    ----------
    schedule : Schedule
        The weights of its own draws do not matter here.

    Raises
    ------
    InputError
        If there are too many histories to visit.
    """

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule
        self._tree: ScheduleTree = schedule_tree(unweighted(schedule))
        t, leaf = self._tree.tables, self._tree.leaf
        counts = [1]
        for k in range(leaf):
            counts.append(counts[-1] * int(t.actions[k] * t.outcomes[k]))
        self._counts = counts
        sizes = [counts[k] * int(t.actions[k]) for k in range(leaf)]
        sizes.append(counts[leaf] * self._tree.leaf_vectors.shape[2])
        self._begin = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        self.n_rows = int(sum(sizes))

    def optima(self, weights: Array, score: Array | None = None) -> Optima:
        """Worth of the best plan under each of many weights.

        Parameters
        ----------
        weights : float64[m, d]
            Non-negative; they need not sum to one, and worth is proportional to them.
        score : float64[m, d], optional
            Other weights that each best plan is scored with.

        Raises
        ------
        InputError
            If they do not fit the draws, or are negative.
        """
        self._check(weights)
        if score is not None:
            self._check(score, len(weights))
        parts = []
        for some in chunks(len(weights), max(1, ROOM // self.n_rows)):
            total = np.zeros((self.n_rows, some.stop - some.start))
            other = None if score is None else np.zeros_like(total)
            for span, rows in self._rows(1):
                total += rows @ weights[some, span].T
                if score is not None and other is not None:
                    other += rows @ score[some, span].T
            parts.append(self._backward(total, other))
        return self._joined(parts)

    def crossed(self, weights: Array, part: NDArray[np.int64], left_out: NDArray[np.int64]) -> Optima:
        """Worth of best plans under each of many weights, and of those chosen without one part of the draws there.

        Parameters
        ----------
        weights : float64[m, d]
            Non-negative; they need not sum to one, and worth is proportional to them.
        part : int64[d]
            Part that each draw belongs to.
        left_out : int64[m]
            The part that a second plan is chosen without.

        Returns
        -------
        Optima
            `scored` is what the second plan is worth under the weights of the part left out, the others being zero.

        Raises
        ------
        InputError
            If weights do not fit the draws, or are negative.
        """
        self._check(weights)
        parts = np.unique(part)
        found = []
        for some in chunks(len(weights), max(1, ROOM // (self.n_rows * len(parts)))):
            sums = np.zeros((len(parts), self.n_rows, some.stop - some.start))
            for span, rows in self._rows(1):
                for i, number in enumerate(parts):
                    own = np.flatnonzero(part[span] == number)
                    if own.size:
                        sums[i] += rows[:, own] @ weights[some, span][:, own].T
            # Sums of the other parts, and not the difference of two sums: the part left out may have nearly all
            # of the weight.
            chosen, score = np.zeros_like(sums[0]), np.zeros_like(sums[0])
            for i, number in enumerate(parts):
                out = left_out[some] == number
                score[:, out] = sums[i][:, out]
                chosen[:, ~out] += sums[i][:, ~out]
            best, other = self._backward(sums.sum(axis=0)), self._backward(chosen, score)
            found.append(best._replace(scored=other.scored))
        return self._joined(found)

    def group_optima(self, share: Array) -> Optima:
        r"""Best plan's worth within each group of neighbouring draws.

        Parameters
        ----------
        share : float64[u, k]
            Weights of the `k` draws of each group: draw `i` of group `u` is draw `u k + i` of the schedule.

        Returns
        -------
        Optima
            :math:`\max_\pi \sum_i \text{share}_{u i} V_{u i}(\pi)` of every group.
        """
        size = share.shape[1]
        if share.size != self.schedule.draws.n_draws:
            raise located("groups of draws", share.shape, f"{self.schedule.draws.n_draws} draws in all")
        parts = []
        for span, rows in self._rows(size):
            units = slice(span.start // size, span.stop // size)
            summed = np.einsum("ruk,uk->ru", rows.reshape(len(rows), -1, size), share[units])
            parts.append(self._backward(summed))
        return Optima(*(np.concatenate(p) for p in zip(*parts, strict=True)))

    def _check(self, weights: Array, rows: int | None = None) -> None:
        n = self.schedule.draws.n_draws
        if weights.ndim != 2 or weights.shape[1] != n or rows not in (None, len(weights)):
            wanted = f"[{'any number' if rows is None else rows}, {n}], one a draw"
            raise located("weights, shape", weights.shape, wanted)
        if np.any(~(weights >= 0)):
            raise located("weights", float(weights[~(weights >= 0)][0]), "numbers of at least 0")

    def _joined(self, parts: list[Optima]) -> Optima:
        if not parts:
            return Optima(np.zeros(0), np.zeros((0, len(self.schedule.mode(0).actions))), np.zeros(0))
        return Optima(*(np.concatenate(p) for p in zip(*parts, strict=True)))

    def _rows(self, multiple: int) -> Iterator[tuple[slice, Array]]:
        """Worth of every choice after every history, shape ``[r, d]``, for some draws after the others."""
        t, leaf = self._tree.tables, self._tree.leaf
        at_once = max(1, min(CHUNK, ROOM // self.n_rows) // multiple) * multiple
        for span in chunks(self.schedule.draws.n_draws, at_once):
            own = t._replace(
                start=np.ascontiguousarray(self.schedule.draws.initial[span].T),
                transition=np.ascontiguousarray(t.transition[..., span]),
                emission=np.ascontiguousarray(t.emission[..., span]),
                reward=np.ascontiguousarray(t.reward[:, span]),
            )
            vectors = np.ascontiguousarray(self._tree.leaf_vectors[:, span].transpose(0, 2, 1))
            rows = np.zeros((self.n_rows, span.stop - span.start))
            history_rows(own, leaf, vectors, self._begin, rows)
            yield span, rows

    def _backward(self, total: Array, other: Array | None = None) -> Optima:
        """Maxima over choices and sums over responses, from the last histories back to the first.

        The rows of `other` follow the choices that are made for `total`.
        """
        tree, t, m = self._tree, self._tree.tables, total.shape[1]
        leaf, actions, outcomes = tree.leaf, int(t.actions[tree.leaf]), int(t.outcomes[tree.leaf])
        sides = [total] if other is None else [total, other]
        last = [side[self._begin[leaf] :].reshape(self._counts[leaf], -1, m) for side in sides]
        follow = [x[:, actions:].reshape(len(x), actions, outcomes, -1, m) for x in last]
        worth = [x[:, :actions] + f.sum(axis=2) for x, f in zip(last, _best(follow, 3), strict=True)]
        for k in range(leaf - 1, -1, -1):
            actions, outcomes = int(t.actions[k]), int(t.outcomes[k])
            here = slice(self._begin[k], self._begin[k] + self._counts[k] * actions)
            shape = self._counts[k], actions
            worth = [
                side[here].reshape(*shape, m) + after.reshape(*shape, outcomes, m).sum(axis=2)
                for side, after in zip(sides, _best(worth, 1), strict=True)
            ]
        values = [x[0] for x in _best(worth, 1)]
        return Optima(values[0], np.ascontiguousarray(worth[0][0].T), values[-1])


def _best(sides: list[Array], axis: int) -> list[Array]:
    """Maxima of the first along an axis, and the entries of the others at the same places."""
    if len(sides) == 1:
        return [sides[0].max(axis=axis)]
    place = np.expand_dims(sides[0].argmax(axis=axis), axis)
    return [np.take_along_axis(side, place, axis).squeeze(axis) for side in sides]
