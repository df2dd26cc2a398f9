r"""What actions are worth without horizon, in every draw: one step, and the committed controller afterwards.

Alpha vectors that know what follows them are a controller. In draw `d` its node `n` is worth

.. math:: V_d(n, s) = R(s, a_n) + \gamma \sum_{x', o, s'} P(x' \mid x)\, O_d(o \mid s, a_n)\, T_d(s' \mid s, a_n)\,
   V_d(f(n, x', o), s')

which is solved once, where the policy is made; the robot only adds one step to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from models.errors import InputError, Phrase, located
from models.model_draws import ModelDraws
from models.planning.alpha_policy import AlphaPolicy
from models.planning.controller import FiniteStateController
from models.planning.mode_process import ModeProcess
from models.planning.policies import Array, Policy, Vocabulary
from models.reward import Reward, default_x
from models.safeguards.worth import Worth, WorthSource


@dataclass(frozen=True, eq=False)
class DrawState:
    """Probability of draw and state given the history, ``[d, s]``."""

    joint: Array


class ControllerWorth(WorthSource):
    """One step, and the committed controller afterwards, in every draw.

    Alpha vectors go on with the best vector for the belief reached, and with what follows it.

    Parameters
    ----------
    policy : AlphaPolicy or FiniteStateController
    draws : ModelDraws
    table : float64[m, m']
        How the mode moves.
    discount : float
        From 0 to below 1.
    vectors : float64[d, n, s]
        What the nodes (of alpha vectors: the vectors) are worth, as `controller_vectors` finds it.

    Raises
    ------
    InputError
        On a policy without nodes, other names, or arrays that do not fit.
    """

    def __init__(
        self, policy: Policy, draws: ModelDraws, table: ArrayLike, discount: float, vectors: ArrayLike
    ) -> None:
        place = f"worth by policy {policy.name}"
        if not isinstance(policy, AlphaPolicy | FiniteStateController):
            raise located(place, Phrase(type(policy).__name__), "alpha vectors or a controller")
        if policy.vocabulary != Vocabulary.of(draws.protocol):
            wanted = str(Vocabulary.of(draws.protocol))
            raise located(f"{place}, modes, actions and observations", policy.vocabulary, wanted)
        if not 0 <= discount < 1:
            raise located(f"{place}, discount", discount, "from 0 to below 1: there is no horizon")
        self.policy, self.draws, self.discount = policy, draws, float(discount)
        self.states: tuple[str, ...] = draws.model(0).state_names
        self.n_draws = draws.n_draws
        self.table = ModeProcess(np.asarray(table), np.eye(len(policy.vocabulary.modes))[0], "").table
        self.vectors = np.asarray(vectors, dtype=np.float64)
        shape = (draws.n_draws, len(policy.mode), draws.n_states)
        if self.vectors.shape != shape or not np.isfinite(self.vectors).all():
            raise located(f"{place}, vectors, shape", self.vectors.shape, f"finite numbers {shape}")
        self._reward = (draws.reward or Reward(default_x(draws.n_states))).table(draws.protocol)

    @classmethod
    def of(cls, policy: Policy, draws: ModelDraws, process: ModeProcess, discount: float) -> ControllerWorth:
        """Solve for the vectors (needs scipy)."""
        nodes = _nodes(policy)
        vectors = controller_vectors(nodes, draws, process.table, discount)
        return cls(policy, draws, process.table, discount, vectors)

    # -- the run -----------------------------------------------------------------------------------
    def begin(self, memory: Any) -> DrawState:
        """Nothing has happened."""
        return DrawState(self.draws.weight[:, None] * self.draws.initial)

    def observe(
        self, state: DrawState, mode: int, choice: int, observation: int | None, memory: Any
    ) -> DrawState:  # fmt: skip
        """What one more event says; a response that is impossible in every draw is passed over."""
        a, row = self._action(mode, choice)
        shown = 1.0 if row < 0 or not observation else self.draws.emission[:, row, :, observation - 1]
        moved = self.draws.transition[:, a]
        for joint in (state.joint * shown, state.joint):
            if joint.sum() > 0:
                break
        joint = np.matmul(joint[:, None, :], moved)[:, 0, :]
        return DrawState(joint / joint.sum())

    def worth(self, state: DrawState, memory: Any) -> Worth:
        """One step, and the vectors."""
        mode = self.policy.mode_of(memory)
        weight = state.joint.sum(axis=1)
        belief = np.divide(
            state.joint, weight[:, None], out=self.draws.initial.copy(), where=weight[:, None] > 0
        )  # fmt: skip
        values = [
            (belief * self._choice(mode, c, memory)).sum(axis=1)
            for c in range(len(self.policy.vocabulary.actions[mode]))
        ]
        return Worth(np.stack(values, axis=1), weight, belief)

    def _action(self, mode: int, choice: int) -> tuple[int, int]:
        a = self.draws.protocol.mode_of_action.index(mode) + choice
        return a, self.draws.protocol.emission_index[a]

    def _choice(self, mode: int, choice: int, memory: Any) -> Array:
        """Worth of a choice by draw and state, shape ``[d, s]``."""
        a, row = self._action(mode, choice)
        moved = self.draws.transition[:, a]
        follows = np.zeros((self.n_draws, self.draws.n_states))
        for o in range(1 if row < 0 else self.draws.protocol.n_responses):
            shown = None if row < 0 else self.draws.emission[:, row, :, o]
            if shown is not None and not shown.any():
                continue
            after = sum(
                p * self.vectors[:, self._node(memory, choice, 0 if row < 0 else o + 1, int(x))]
                for x, p in enumerate(self.table[mode])
                if p > 0
            )
            value = np.matmul(moved, np.asarray(after)[:, :, None])[:, :, 0]
            follows += value if shown is None else shown * value
        return self._reward[a] + self.discount * follows

    def _node(self, memory: Any, choice: int, observation: int, next_mode: int) -> int:
        """Node that a step leads to."""
        policy = self.policy
        if isinstance(policy, FiniteStateController):
            return int(policy.observe(memory, choice, observation, next_mode).node)
        return policy.vector(policy.observe(memory, choice, observation, next_mode).belief, next_mode)

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        from models.safeguards.schedule_worth import draws_to_list

        return {
            "kind": "controller", "models": draws_to_list(self.draws), "table": self.table.tolist(),
            "discount": self.discount, "vectors": self.vectors.tolist(),
        }  # fmt: skip


def controller_vectors(
    controller: FiniteStateController, draws: ModelDraws, table: ArrayLike, discount: float
) -> Array:
    """What every node is worth in every draw and state, by one sparse system a draw.

    Parameters
    ----------
    controller : FiniteStateController
    draws : ModelDraws
    table : float64[m, m']
    discount : float
        From 0 to below 1.

    Returns
    -------
    float64[d, n, s]

    Raises
    ------
    InputError
        If nothing follows a step that is possible in some draw.
    """
    from scipy import sparse
    from scipy.sparse.linalg import splu

    protocol, n, s = draws.protocol, controller.n_nodes, draws.n_states
    reward = (draws.reward or Reward(default_x(s))).table(protocol)
    process = np.asarray(table, dtype=np.float64)
    first = [protocol.mode_of_action.index(m) for m in range(len(protocol.modes))]
    actions = [first[int(m)] + int(c) for m, c in zip(controller.mode, controller.choice, strict=True)]
    edges = [list(_steps(controller, i, a, draws, process)) for i, a in enumerate(actions)]
    state, state_after = (v.ravel() for v in np.indices((s, s)))
    rows = np.concatenate([i * s + state for i, own in enumerate(edges) for _ in own])
    columns = np.concatenate([j * s + state_after for own in edges for *_, j in own])
    known = np.concatenate([reward[a] for a in actions])
    out = np.empty((draws.n_draws, n, s))
    for d in range(draws.n_draws):
        entries = np.concatenate(
            [
                (p * draws.transition[d, a] * (1.0 if o < 0 else draws.emission[d, row, :, o, None])).ravel()
                for a, own in zip(actions, edges, strict=True)
                for p, row, o, _ in own
            ]
        )
        step = sparse.csc_array((entries, (rows, columns)), shape=(n * s, n * s))
        system = (sparse.identity(n * s, format="csc") - discount * step).tocsc()
        out[d] = splu(system).solve(known).reshape(n, s)
    return out


def _steps(
    controller: FiniteStateController, node: int, action: int, draws: ModelDraws, table: Array
) -> Sequence[tuple[float, int, int, int]]:
    """Outcomes of a node: probability of the next mode, emission row, response (-1: none), node that follows."""
    row, out = draws.protocol.emission_index[action], []
    for o in range(-1, 0) if row < 0 else range(draws.protocol.n_responses):
        if row >= 0 and not draws.emission[:, row, :, o].any():
            continue
        for x, p in enumerate(table[int(controller.mode[node])]):
            if p > 0:
                out.append((float(p), row, o, _follower(controller, node, o + 1, x)))
    return out


def _follower(controller: FiniteStateController, node: int, observation: int, mode: int) -> int:
    after = int(controller.follow[node, mode, observation])
    if after < 0:
        from models.planning.controller import NodeMemory

        own = NodeMemory(int(controller.mode[node]), node)
        after = controller.observe(own, int(controller.choice[node]), observation, mode).node
    return after


def _nodes(policy: Policy) -> FiniteStateController:
    """The controller of a policy, its nodes numbered as the policy's own."""
    if isinstance(policy, FiniteStateController):
        return policy
    if not isinstance(policy, AlphaPolicy) or policy.follow is None:
        wanted = "a controller, or alpha vectors that know what follows them"
        raise located(f"worth by policy {policy.name}", Phrase(type(policy).__name__), wanted)
    words = policy.vocabulary
    follow = np.full((len(policy.alpha), len(words.modes), len(words.observations)), -1)
    for i, (m, c) in enumerate(zip(policy.mode.tolist(), policy.choice.tolist(), strict=True)):
        for z, (x, o) in enumerate(policy.keys[m][c]):
            if follow[i, x, o] not in (-1, int(policy.follow[i, z])):
                raise InputError(f"policy {policy.name}, vector {i}: two vectors follow the same outcome")
            follow[i, x, o] = policy.follow[i, z]
    start = [int(np.flatnonzero(policy.mode == x)[0]) for x in range(len(words.modes))]
    return FiniteStateController(words, policy.mode, policy.choice, follow, start, "keep", policy.name)
