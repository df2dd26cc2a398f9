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
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from models.errors import InputError, Phrase, located
from models.notebook_view import NotebookView
from models.planning.belief_model import BeliefModel
from models.planning.belief_policy import BeliefPolicy
from models.planning.policies import Array, Index, Policy, Vocabulary
from models.planning.problem import Problem
from models.reward import UNIT

MOST_MEMORIES = 20_000
"""Memories that are looked for before a policy is taken to have no end of them."""

MOST_SMALL = 1_000
"""Unknowns up to which the system is factorised whatever it looks like."""

MOST_FILL = 20_000_000
"""Entries that factors may have at most: 240 MB."""

MOST_WORK = 2_000_000_000
"""Multiplications that factorising a band may take: about a second."""

MOST_SWEEPS = 20_000
"""Terms that are summed before a system of moderate size is factorised after all."""


@dataclass(frozen=True)
class InfiniteValue(NotebookView):
    r"""What a policy is worth without horizon.

    Attributes
    ----------
    policy : str
    value : float
        In `unit`, before the first mode is seen.
    error : float
        `value` is off by no more than that (rounding, or the end of an iteration).
    by_start : dict of str to float
        By first mode.
    discount : float
    memories : int
        Memories that the policy can get into.
    frequencies : dict of str to float
        Discounted share of the steps, :math:`(1 - \gamma) \sum_k \gamma^k P(a_k = a)`, of each action.
    unit : str
        What the value is in: the word of the problem.
    cautions : tuple of str
        Those of the problem (`models.cautions`).
    """

    policy: str
    value: float
    error: float
    by_start: dict[str, float]
    discount: float
    memories: int
    frequencies: dict[str, float]
    unit: str = UNIT
    cautions: tuple[str, ...] = ()

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
            f"{self.policy} is worth {self.value:.4g} {self.unit} without horizon (discount {self.discount:g}), "
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
        dict(sorted(frequencies.items())), problem.unit, problem.cautions,
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
                    (z, number(_moved_on(policy, memory, c, z.observation, z.mode)))
                    for z in truth.outcomes[x][c]
                    if z.value.any()
                ]
                own.append((float(share), c, after))
        edges.append(own)
    return numbers, nodes, edges


def _moved_on(policy: Policy, memory: Any, choice: int, observation: int, mode: int) -> Any:
    """The memory after an outcome that has a probability in some hidden state; a belief may rule that state out."""
    try:
        return policy.observe(memory, choice, observation, mode)
    except InputError as error:
        if not isinstance(policy, BeliefPolicy):
            raise
        found = Phrase("beliefs, which rule out hidden states")
        wanted = "a finite memory; simulate it instead, or compile it to a controller"
        raise located(f"policy {policy.name}, memory", found, wanted) from error


def _solve(step: Any, known: Array, discount: float) -> tuple[Array, float]:
    r"""Solve :math:`v = r + \gamma P v`; also a bound on the error, where the rows of `P` sum to one."""
    if discount == 0:
        return known.copy(), 0.0
    size, order = len(known), _narrow(step)
    v: Array | None = None
    if order is not None:
        v = _factorised(step[order][:, order], known[order], discount, "NATURAL")[np.argsort(order)]
    elif size > MOST_SMALL:
        v = _summed(step, known, discount, MOST_SWEEPS if size**2 <= MOST_FILL else None)
    if v is None:
        v = _factorised(step, known, discount, "COLAMD")
    residual = float(np.abs(known + discount * (step @ v) - v).max())
    return v, residual / (1 - discount)


def _narrow(step: Any) -> Index | None:
    """An order of the unknowns in which the system is a narrow band, if one is found.

    Without pivoting, which a matrix with such a diagonal does not need, factors stay within the band.
    """
    size = step.shape[0]
    if size <= MOST_SMALL or not _bearable(size, int(np.diff(step.indptr).max())):
        return None
    order = reverse_cuthill_mckee(sparse.csr_matrix(step), symmetric_mode=False).astype(np.int64)
    place = np.empty(size, dtype=np.int64)
    place[order] = np.arange(size)
    entries = step.tocoo()
    width = int(np.abs(place[entries.row] - place[entries.col]).max())
    return order if _bearable(size, 2 * width + 1) else None


def _bearable(size: int, width: int) -> bool:
    """Whether a band of that width can be factorised."""
    return size * width <= MOST_FILL and size * width**2 <= MOST_WORK


def _factorised(step: Any, known: Array, discount: float, order: str) -> Array:
    matrix = (sparse.identity(len(known), format="csc") - discount * step).tocsc()
    return np.asarray(splu(matrix, permc_spec=order, diag_pivot_thresh=0.0).solve(known))


def _summed(step: Any, known: Array, discount: float, most: int | None) -> Array | None:
    r"""Sum :math:`\sum_k (\gamma P)^k r`; None where `most` terms are not enough.

    What is left after a term :math:`t` is nearly :math:`t \gamma / (1 - \gamma)` once the chain has forgotten where
    it was. With that added, the residual is the change from :math:`t` to :math:`P t`, times the same factor.
    """
    factor = discount / (1 - discount)
    # Sums of that many products are rounded: differences cannot be seen to be smaller.
    rounding = 8 * float(np.finfo(float).eps * np.sqrt(max(1, np.diff(step.indptr).max())))
    close = max(1e-13, rounding / (1 - discount))
    enough = int(np.ceil(np.log(1e-13 * (1 - discount)) / np.log(discount))) + 1
    term, total = known.copy(), known.copy()
    for k in range(enough):
        if most is not None and k >= most:
            return None
        reached = step @ term
        left = factor * float(np.abs(reached - term).max()) / (1 - discount)
        if left <= close * float(np.abs(total + factor * term).max()):
            return np.asarray(total + factor * term)
        term = discount * reached
        total += term
    return total
