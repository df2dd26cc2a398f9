"""A policy without horizon as a graph: the controller its vectors form, and how its time is spent."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from models.notebook_view import NotebookView
from models.planning.belief_model import BeliefModel
from models.planning.controller import FiniteStateController, controller_of
from models.planning.problem import Problem
from models.planning.solution import Solution

POSSIBLE = 1e-9
"""Responses less probable than that are not arrows."""


@dataclass(frozen=True)
class Arrow:
    """What follows a node: the observation and the mode reached, the node then, how probable that is."""

    observation: str
    mode: int
    node: int
    chance: float


@dataclass(frozen=True)
class PolicyGraph(NotebookView):
    r"""A controller with what happens in each of its nodes, where the problem it was made for is true.

    Attributes
    ----------
    controller : FiniteStateController
        Only nodes that are reached from the start belief; nodes that do the same for ever are one.
    visits : float64[n, y]
        :math:`(1 - \gamma) \sum_k \gamma^k P(\text{node } n, \text{hidden state } y)`; sums to one.
    follows : tuple of tuple of Arrow
        For each node.
    starts : tuple of int
        Nodes that it starts in.
    """

    controller: FiniteStateController
    visits: NDArray[np.float64]
    follows: tuple[tuple[Arrow, ...], ...]
    starts: tuple[int, ...]

    @cached_property
    def share(self) -> NDArray[np.float64]:
        """Discounted share of the time in each node."""
        return np.asarray(self.visits.sum(axis=1))

    @cached_property
    def expected_state(self) -> NDArray[np.float64]:
        """Expected number of the hidden state while the robot is in each node."""
        numbers = np.arange(self.visits.shape[1])
        return np.asarray(self.visits @ numbers / np.maximum(self.share, 1e-300))

    def busiest(self, most: int) -> NDArray[np.int64]:
        """Nodes with the largest shares, at most so many of each mode, those it starts in always; in order."""
        first = [*self.starts, *(int(n) for n in np.argsort(-self.share, kind="stable") if n not in self.starts)]
        chosen: list[int] = []
        for x in range(len(self.controller.vocabulary.modes)):
            own = [n for n in first if self.controller.mode[n] == x]
            begun = sum(n in self.starts for n in own)
            chosen += own[: max(most, begun)]
        return np.array(sorted(chosen), dtype=np.int64)

    @property
    def sentence(self) -> str:
        """What the policy does, in one sentence."""
        words, controller = self.controller.vocabulary, self.controller
        parts = []
        for x, mode in enumerate(words.modes):
            own = controller.mode == x
            total = self.share[own].sum()
            if total <= 0:
                continue
            done = {
                name: self.share[own & (controller.choice == c)].sum() / total
                for c, name in enumerate(words.actions[x])
            }
            ranked = sorted(done.items(), key=lambda entry: -entry[1])
            shown = [f"{_plain(name)} {_often(p)}" for name, p in ranked if p > 0]
            parts.append(f"when {_plain(mode)}: {', '.join(shown)}")
        size = f"{controller.n_nodes} node{'s' * (controller.n_nodes != 1)}"
        return f"The policy as a graph has {size}. In discounted time, {'; '.join(parts)}."


def policy_graph_of(solution: Solution) -> PolicyGraph:
    """The graph of a solution's policy, from its start belief.

    Raises
    ------
    InputError
        If the vectors do not form a controller.
    """
    problem = solution.problem
    controller = controller_of(solution.policy).merged()
    truth = BeliefModel.of_problem(problem)
    visits = _visits(controller, truth, problem)
    follows = []
    for n in range(controller.n_nodes):
        x = int(controller.mode[n])
        outcomes = truth.outcomes[x][int(controller.choice[n])]
        here = visits[n, : len(truth.states[x])]
        total = max(float(here.sum()), 1e-300)
        own = []
        for z in outcomes:
            chance = float(z.reached(here, len(truth.states[z.mode])).sum()) / total
            after = int(controller.follow[n, z.mode, z.observation])
            if chance > POSSIBLE and after >= 0:
                own.append(Arrow(controller.vocabulary.observations[z.observation], z.mode, after, chance))
        follows.append(tuple(own))
    starts = tuple(dict.fromkeys(int(controller.start[x]) for x, _, _ in problem.starts()))
    return PolicyGraph(controller, visits, tuple(follows), starts)


def _visits(controller: FiniteStateController, truth: BeliefModel, problem: Problem) -> NDArray[np.float64]:
    """Discounted share of the time in every node and hidden state, shape ``[n, y]``."""
    n, width = controller.n_nodes, max(map(len, truth.states))
    rows, columns, values = [], [], []
    for i in range(n):
        for z in truth.outcomes[int(controller.mode[i])][int(controller.choice[i])]:
            after = int(controller.follow[i, z.mode, z.observation])
            if after >= 0:
                rows.append(i * width + z.row)
                columns.append(after * width + z.column)
                values.append(z.value)
    size = n * width
    entries = (np.concatenate(values), (np.concatenate(columns), np.concatenate(rows)))
    step = sparse.csc_array(entries, shape=(size, size))
    start = np.zeros(size)
    for x, p, belief in problem.starts():
        first = int(controller.start[x]) * width
        start[first : first + len(belief)] += p * belief
    share = spsolve(sparse.identity(size, format="csc") - problem.discount * step, (1 - problem.discount) * start)
    return np.maximum(np.asarray(share).reshape(n, width), 0.0)


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _often(share: float) -> str:
    if share > 1 - 1e-9:
        return "always"
    return f"{share:.0%} of the time" if share >= 0.005 else "almost never"
