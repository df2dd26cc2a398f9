r"""Finite-state controllers of many draws: pruned to what they reach, equal nodes merged, equal controllers found.

Every solved draw leaves a policy graph. Two draws often ask for the same behaviour though their graphs differ: in
nodes never come to, in nodes that act alike for ever, in numbering. The smallest controller of the same behaviour,
numbered in the order in which nodes are met, is the same for both (Moore 1956: partition refinement).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.compiled import kernel
from models.errors import Phrase, located
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.batch import BatchSolution, DrawSolution
from models.planning.controller import FiniteStateController
from models.planning.latent import LatentBatch
from models.planning.policies import Vocabulary


@dataclass(frozen=True)
class Controller:
    """A policy whose memory is the node it is in; it may leave the action to chance.

    Attributes
    ----------
    mode : int64[n]
        Mode of each node.
    share : float64[n, c]
        Probability of each choice of the node's mode, zero beyond its choices.
    follow : int32[n, c, z]
        Node after each outcome of each choice; -1 where the choice is never taken or has no such outcome.
        Outcomes in the order of the problem's (`models.planning.arrays`).
    start : int64[x]
        Node to start with in each mode, -1 where nothing starts.
    name : str
    """

    mode: Index
    share: Array
    follow: NDArray[np.int32]
    start: Index
    name: str = ""

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.mode)

    @cached_property
    def key(self) -> bytes:
        """What tells behaviours apart, of controllers that are `compact`."""
        return b"".join(a.tobytes() for a in (self.start, self.mode, self.share, self.follow))

    @property
    def certain(self) -> bool:
        """Whether no action is left to chance."""
        return bool(np.all((self.share == 0) | (self.share == 1)))

    @cached_property
    def choice(self) -> Index:
        """The likeliest choice of each node, counted within its mode, shape ``[n]``."""
        return np.asarray(np.argmax(self.share, axis=1))

    def compact(self) -> Controller:
        """The smallest controller that behaves the same from every start, nodes in the order they are met."""
        rows = np.concatenate([self.mode[:, None], self.share], axis=1)
        kind = np.unique(rows, axis=0, return_inverse=True)[1].ravel().astype(np.int64)
        flat = self.follow.reshape(self.n_nodes, -1)
        kept, number = merged(kind, np.ascontiguousarray(flat), self.start)
        follow = np.append(number, -1).astype(np.int32)[flat[kept]].reshape(len(kept), *self.follow.shape[1:])
        return replace(
            self, mode=self.mode[kept], share=self.share[kept], follow=follow,
            start=np.append(number, -1)[self.start],
        )  # fmt: skip

    def policy(self, batch: LatentBatch) -> FiniteStateController:
        """The controller for the robot to run.

        Raises
        ------
        InputError
            If it leaves an action to chance.
        """
        place = f"controller {self.name}"
        if not self.certain:
            raise located(place, Phrase("actions left to chance"), "one action a node")
        t = batch.template
        words = Vocabulary.of(batch.draws.protocol)
        follow = np.full((self.n_nodes, len(words.modes), len(words.observations)), -1)
        for n in range(self.n_nodes):
            c = t.mode_choice[self.mode[n]] + self.choice[n]
            begin, end = t.choice_outcome[c : c + 2]
            for z in range(begin, end):
                after = self.follow[n, self.choice[n], z - begin]
                follow[n, t.outcome_mode[z], t.outcome_observation[z]] = after
        return FiniteStateController(words, self.mode, self.choice, follow, self.start, name=self.name)


def of_graph(
    problem: ProblemArrays, mode: ArrayLike, choice: ArrayLike, follow: ArrayLike, start: ArrayLike, name: str = ""
) -> Controller:
    """The compact controller of a policy graph.

    Parameters
    ----------
    problem : ProblemArrays
        Of any draw: only its shape counts.
    mode, choice : int[k]
        Choices counted within the mode.
    follow : int[k, z]
    start : int[x]
        Node to start with in each mode, -1 where nothing starts.
    """
    mode, choice = np.asarray(mode, dtype=np.int64), np.asarray(choice, dtype=np.int64)
    number = problem.mode_choice[mode] + choice
    outcomes = np.diff(problem.choice_outcome)
    width = int(outcomes.max())
    flat = np.where(np.arange(width) < outcomes[number, None], np.asarray(follow)[:, :width], -1).astype(np.int32)
    kept, place = merged(number, np.ascontiguousarray(flat), np.asarray(start, dtype=np.int64))
    place = np.append(place, -1)
    offered = int(np.diff(problem.mode_choice).max())
    share = np.zeros((len(kept), offered))
    share[np.arange(len(kept)), choice[kept]] = 1.0
    after = np.full((len(kept), offered, width), -1, dtype=np.int32)
    after[np.arange(len(kept)), choice[kept]] = place[flat[kept]]
    return Controller(mode[kept], share, after, place[np.asarray(start)], name)


def of_draw(batch: LatentBatch, d: int, solution: DrawSolution) -> Controller:
    """The controller of one draw's solution, started from its best vector."""
    start = np.full(len(batch.process.start), -1)
    for x in np.flatnonzero(batch.process.start > 0):
        own = np.flatnonzero(solution.mode == x)
        start[x] = own[np.argmax(solution.alpha[own] @ batch.draws.initial[d])]
    return of_graph(batch.template, solution.mode, solution.choice, solution.follow, start, f"draw {d}")


@dataclass(frozen=True)
class OwnControllers:
    """The controllers that solved draws ask for.

    Attributes
    ----------
    controllers : tuple of Controller
        Distinct ones, the most believed first.
    which : int64[d]
        Controller of each draw.
    shares : float64[c]
        Share of the draws, by weight, whose solution each is.
    """

    controllers: tuple[Controller, ...]
    which: Index
    shares: Array


def own_controllers(solution: BatchSolution) -> OwnControllers:
    """Controllers of all draws, equal ones found once."""
    batch = solution.batch
    known: dict[bytes, int] = {}
    distinct: list[Controller] = []
    which = np.empty(len(batch), dtype=np.int64)
    for d, own in enumerate(solution.solutions):
        controller = of_draw(batch, d, own)
        number = known.setdefault(controller.key, len(distinct))
        if number == len(distinct):
            distinct.append(controller)
        which[d] = number
    share = np.bincount(which, weights=batch.draws.weight, minlength=len(distinct))
    order = np.argsort(-share, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return OwnControllers(tuple(distinct[i] for i in order), place[which], share[order])


def by_mode(problem: ProblemArrays, shares: Mapping[int, ArrayLike], start: Array, name: str) -> Controller:
    """A controller that looks at the mode only.

    Parameters
    ----------
    problem : ProblemArrays
    shares : mapping of int to float64[c]
        Probability of each choice, by mode.
    start : float64[x]
        Probability of each first mode.
    name : str
    """
    n, offered = len(problem.mode_size), np.diff(problem.mode_choice)
    outcomes = np.diff(problem.choice_outcome)
    share = np.zeros((n, int(offered.max())))
    follow = np.full((*share.shape, int(outcomes.max())), -1, dtype=np.int32)
    for x in range(n):
        share[x, : offered[x]] = shares[x]
        for c in np.flatnonzero(share[x]):
            begin, end = problem.choice_outcome[problem.mode_choice[x] + c :][:2]
            follow[x, c, : end - begin] = problem.outcome_mode[begin:end]
    first = np.where(np.asarray(start) > 0, np.arange(n), -1)
    return Controller(np.arange(n), share, follow, first, name).compact()


@kernel
def merged(kind: Index, follow: NDArray[np.int32], start: Index) -> tuple[Index, Index]:
    """Merge nodes that behave the same for ever, and leave out those never come to.

    Parameters
    ----------
    kind : int64[n]
        Nodes that act alike have the same number.
    follow : int32[n, w]
        Nodes that may come next, -1 for none.
    start : int64[x]
        -1 for none.

    Returns
    -------
    kept : int64[m]
        One node of each class, in the order in which classes are met from the starts.
    number : int64[n]
        Class of each node; -1 where it is never come to.
    """
    n, width = follow.shape
    left = np.empty(n, dtype=np.int64)
    place = np.full(n, -1, dtype=np.int64)
    count = 0
    for x in range(len(start)):
        if start[x] >= 0 and place[start[x]] < 0:
            left[count] = start[x]
            place[start[x]] = count
            count += 1
    at = 0
    while at < count:
        for z in range(width):
            after = follow[left[at], z]
            if after >= 0 and place[after] < 0:
                left[count] = after
                place[after] = count
                count += 1
        at += 1
    own = np.empty(count, dtype=np.int64)
    for a in range(count):
        own[a] = kind[left[a]]
    classes = _ranked(own)
    code = np.empty(count, dtype=np.int64)
    while True:
        code[:] = own
        before = classes
        for z in range(width):
            # Both factors are numbers of classes, so that different pairs have different codes.
            for a in range(count):
                after = follow[left[a], z]
                code[a] = code[a] * (before + 1) + (own[place[after]] + 1 if after >= 0 else 0)
            classes = _ranked(code)
        own[:] = code
        # Classes only split: as many as before are the same as before.
        if classes == before:
            break
    # Nodes were met breadth first, so the first of each class come in the order in which classes are met.
    first = np.full(classes, -1, dtype=np.int64)
    kept = np.empty(classes, dtype=np.int64)
    found = 0
    number = np.full(n, -1, dtype=np.int64)
    for a in range(count):
        if first[own[a]] < 0:
            first[own[a]] = found
            kept[found] = left[a]
            found += 1
        number[left[a]] = first[own[a]]
    return kept, number


@kernel
def _ranked(code: Index) -> int:
    """Replace numbers by their ranks, equal ones by the same; returns how many different ones there are."""
    order = np.argsort(code, kind="mergesort")
    rank = -1
    last = 0
    for i in order:
        if rank < 0 or code[i] != last:
            rank += 1
            last = code[i]
        code[i] = rank
    return rank + 1
