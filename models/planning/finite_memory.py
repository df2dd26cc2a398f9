r"""Exact values without horizon of policies whose memory is finite: controllers, baselines.

Memory `n` and hidden state `y` together are a Markov chain whatever the model, so the values solve

.. math:: V(n, y) = \sum_a \pi(a \mid n) \Big[ R(y, a)
   + \gamma \sum_{x', o, y'} P(x', o, y' \mid x, y, a)\, V(n'(n, a, x', o), y') \Big]

a sparse linear system. The model may be another one than the policy was made for, as long as modes, actions and
observations are called the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from models.errors import Phrase, located
from models.planning.belief_model import BeliefModel
from models.planning.policies import Array, Policy, Vocabulary
from models.planning.problem import Problem

MOST_MEMORIES = 20_000
"""Memories that are looked for before a policy is taken to have no end of them."""

MOST_DIRECT = 20_000
"""Unknowns up to which the system is factorised; larger ones are iterated on."""


@dataclass(frozen=True)
class InfiniteValue:
    r"""What a policy is worth without horizon.

    Attributes
    ----------
    policy : str
    value : float
        In reward units, before the first mode is seen.
    error : float
        `value` is off by no more than that (rounding, or the end of an iteration).
    by_start : dict of str to float
        By first mode.
    discount : float
    memories : int
        Memories that the policy can get into.
    frequencies : dict of str to float
        Discounted share of the steps, :math:`(1 - \gamma) \sum_k \gamma^k P(a_k = a)`, of each action.
    """

    policy: str
    value: float
    error: float
    by_start: dict[str, float]
    discount: float
    memories: int
    frequencies: dict[str, float]

    @property
    def table(self) -> Any:
        """The result as a data frame of one row."""
        import pandas as pd

        row = {"policy": self.policy, "value": self.value, "discount": self.discount, "memories": self.memories}
        return pd.DataFrame([{**row, **{f"share of {a}": v for a, v in self.frequencies.items()}}])

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        return (
            f"{self.policy} is worth {self.value:.4g} reward units without horizon (discount {self.discount:g}), "
            f"exactly up to {self.error:.1g}."
        )


def infinite_value(policy: Policy, problem: Problem) -> InfiniteValue:
    """Value of a policy with finite memory.

    Parameters
    ----------
    policy : Policy
        May randomise. Beliefs are no finite memory: simulate them (`models.planning.rollouts`), or compile the
        policy to a controller.
    problem : Problem
        What is true; its discount and initial belief are used.

    Raises
    ------
    InputError
        If the discount is 1, names differ, the memory does not end, or a step is possible that the policy takes for
        impossible.
    """
    if problem.discount >= 1:
        raise located(
            f"{problem.name}, discount", problem.discount, "below 1: without horizon the value may not exist"
        )
    words = Vocabulary.of(problem)
    if policy.vocabulary != words:
        raise located(f"policy {policy.name}, modes, actions and observations", policy.vocabulary, str(words))
    truth = BeliefModel.of_problem(problem)
    numbers, nodes, edges = _explore(policy, truth, problem)
    sizes = np.array([len(truth.states[policy.mode_of(m)]) for m in nodes])
    base = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    rewards = np.zeros(base[-1])
    rows, columns, data = [], [], []
    for i, memory in enumerate(nodes):
        x = policy.mode_of(memory)
        for share, c, after in edges[i]:
            rewards[base[i] : base[i + 1]] += share * truth.rewards[x][c]
            for z, j in after:
                rows.append(base[i] + z.row)
                columns.append(base[j] + z.column)
                data.append(share * z.value)
    size = int(base[-1])
    entries = (np.concatenate(data), (np.concatenate(rows), np.concatenate(columns)))
    step = sparse.csr_array(entries, shape=(size, size))
    start = np.zeros(size)
    begun = []
    for x, p, belief in problem.starts():
        i = numbers[policy.begin(x)]
        start[base[i] : base[i + 1]] += p * belief
        begun.append((words.modes[x], i, belief))
    values, error = _solve(step, rewards, problem.discount)
    visits, _ = _solve(step.T.tocsr(), start, problem.discount)
    frequencies: dict[str, float] = {}
    for i, memory in enumerate(nodes):
        for share, c, _ in edges[i]:
            name = words.actions[policy.mode_of(memory)][c]
            mass = float(visits[base[i] : base[i + 1]].sum()) * share * (1 - problem.discount)
            frequencies[name] = frequencies.get(name, 0.0) + mass
    by_start = {name: float(belief @ values[base[i] : base[i + 1]]) for name, i, belief in begun}
    return InfiniteValue(
        policy.name, float(start @ values), error, by_start, problem.discount, len(nodes),
        dict(sorted(frequencies.items())),
    )  # fmt: skip


def _explore(policy: Policy, truth: BeliefModel, problem: Problem) -> tuple[dict[Any, int], list[Any], list[Any]]:
    """Memories that can be reached; for each its choices: share, choice, and outcomes with the memory after."""
    numbers: dict[Any, int] = {}
    nodes: list[Any] = []
    edges: list[list[tuple[float, int, list[tuple[Any, int]]]]] = []

    def number(memory: Any) -> int:
        if memory not in numbers:
            if len(nodes) >= MOST_MEMORIES:
                found = Phrase(f"more than {MOST_MEMORIES} memories")
                raise located(f"policy {policy.name}", found, "a finite memory; simulate it instead")
            numbers[memory] = len(nodes)
            nodes.append(memory)
        return numbers[memory]

    for x, _, _ in problem.starts():
        number(policy.begin(x))
    while len(edges) < len(nodes):
        memory = nodes[len(edges)]
        x = policy.mode_of(memory)
        own = []
        for c, share in enumerate(policy.probabilities(memory)):
            if share > 0:
                after = [
                    (z, number(policy.observe(memory, c, z.observation, z.mode)))
                    for z in truth.outcomes[x][c]
                    if z.value.any()
                ]
                own.append((float(share), c, after))
        edges.append(own)
    return numbers, nodes, edges


def _solve(step: Any, known: Array, discount: float) -> tuple[Array, float]:
    r"""Solve :math:`v = r + \gamma P v`; also a bound on the error, where the rows of `P` sum to one."""
    size = len(known)
    if size <= MOST_DIRECT:
        v = splu(sparse.identity(size, format="csc") - discount * step.tocsc()).solve(known)
    else:
        scale = max(float(np.abs(known).max()), 1e-300)
        v = np.zeros(size)
        for _ in range(int(np.ceil(np.log(1e-13) / np.log(discount)))):
            new = known + discount * (step @ v)
            done = np.abs(new - v).max() <= 1e-13 * scale / (1 - discount)
            v = new
            if done:
                break
    residual = float(np.abs(known + discount * (step @ v) - v).max())
    return v, residual / (1 - discount)
