r"""Finite-state controllers: policies that need no belief, only the node they are in.

Alpha vectors that know which vector follows each outcome are one. A controller can run where no belief can be
computed, and what it is worth can be computed exactly in *any* model with the same modes, actions and observations
(`models.planning.finite_memory`), the one it was made for or another.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from models.errors import InputError, Phrase, located
from models.planning.policies import Array, Policy, Vocabulary, certain

if TYPE_CHECKING:
    from models.planning.alpha_policy import AlphaPolicy
    from models.planning.belief_model import Impossible


class NodeMemory(NamedTuple):
    """The mode, and the node of the controller."""

    mode: int
    node: int


class FiniteStateController(Policy):
    """A finite-state controller.

    Parameters
    ----------
    vocabulary : Vocabulary
    mode, choice : int[n]
        Mode of each node and the action taken there, by its place among those of the mode.
    follow : int[n, x', o]
        Node that follows, by the mode reached and the observation; -1 where there is none.
    start : int[x]
        Node to start with in each mode; -1 where it cannot start.
    impossible : {"error", "keep", "reset"}
        What to do where no node follows: raise, go on as after another observation of that mode, or start anew.
    name : str

    Raises
    ------
    InputError
        On arrays that do not fit together.
    """

    def __init__(
        self, vocabulary: Vocabulary, mode: ArrayLike, choice: ArrayLike, follow: ArrayLike, start: ArrayLike,
        impossible: Impossible = "error", name: str = "controller",
    ) -> None:  # fmt: skip
        self.vocabulary, self.name, self.impossible = vocabulary, name, impossible
        self.mode = np.asarray(mode, dtype=np.int64)
        self.choice = np.asarray(choice, dtype=np.int64)
        self.follow = np.asarray(follow, dtype=np.int64)
        self.start = np.asarray(start, dtype=np.int64)
        self._check()

    def _check(self) -> None:
        place, words, n = f"policy {self.name}", self.vocabulary, len(self.mode)
        if self.impossible not in ("error", "keep", "reset"):
            raise located(f"{place}, impossible observations", self.impossible, "error, keep or reset")
        shape = (n, len(words.modes), len(words.observations))
        if n == 0 or self.follow.shape != shape or self.choice.shape != (n,):
            found = Phrase(f"{n} nodes, {len(self.choice)} choices, followers {self.follow.shape}")
            raise located(place, found, f"at least one node, a choice each and followers {shape}")
        if self.start.shape != (len(words.modes),):
            raise located(f"{place}, start nodes", self.start.tolist(), f"{len(words.modes)}, one a mode")
        for i, (x, c) in enumerate(zip(self.mode.tolist(), self.choice.tolist(), strict=True)):
            if not 0 <= x < len(words.modes):
                raise located(f"{place}, node {i}, mode", x, f"0 to {len(words.modes) - 1}")
            if not 0 <= c < len(words.actions[x]):
                raise located(f"{place}, node {i}, choice", c, f"0 to {len(words.actions[x]) - 1}")
        for x, name in enumerate(words.modes):
            for what, nodes in (("start node", self.start[x : x + 1]), ("followers", self.follow[:, x].ravel())):
                own = nodes[nodes != -1]
                bad = own[(own < 0) | (own >= n) | (self.mode[np.clip(own, 0, n - 1)] != x)]
                if bad.size:
                    raise located(f"{place}, {what} in mode {name}", int(bad[0]), "a node of that mode, or -1")

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.mode)

    # -- the interface -----------------------------------------------------------------------------
    def begin(self, mode: int) -> NodeMemory:
        """The start node of a mode."""
        m = self.vocabulary.mode(mode)
        if self.start[m] < 0:
            starts = [name for x, name in enumerate(self.vocabulary.modes) if self.start[x] >= 0]
            raise located(f"policy {self.name}, first mode", self.vocabulary.modes[m], f"one of {starts[:20]}")
        return NodeMemory(m, int(self.start[m]))

    def mode_of(self, memory: NodeMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def probabilities(self, memory: NodeMemory) -> Array:
        """One at the node's action."""
        return certain(int(self.choice[memory.node]), len(self.vocabulary.actions[memory.mode]))

    def observe(self, memory: NodeMemory, choice: int, observation: int | None, next_mode: int) -> NodeMemory:
        """The node that follows. A controller cannot tell what was done in its stead: it assumes its own action.

        Raises
        ------
        InputError
            Where no node follows, if `impossible` is ``error``.
        """
        self.check_step(memory, choice, observation, next_mode)
        after = -1 if observation is None else int(self.follow[memory.node, next_mode, observation])
        if after >= 0:
            return NodeMemory(int(next_mode), after)
        if self.impossible == "error":
            seen = "a response not recorded" if observation is None else self.vocabulary.observations[observation]
            raise InputError(
                f"policy {self.name}, node {memory.node}: nothing follows {seen!r} with mode "
                f"{self.vocabulary.modes[next_mode]!r}, which had probability zero where the controller was made; "
                "choose impossible='keep' or 'reset' to go on"
            )
        others = self.follow[memory.node, next_mode]
        if self.impossible == "keep" and np.any(others >= 0):
            return NodeMemory(int(next_mode), int(others[others >= 0][0]))
        return self.begin(next_mode)

    # -- variants ----------------------------------------------------------------------------------
    def reachable(self) -> FiniteStateController:
        """The same controller without nodes that it never gets to from its start nodes."""
        seen = np.zeros(self.n_nodes, dtype=bool)
        left = [int(n) for n in self.start if n >= 0]
        while left:
            node = left.pop()
            if not seen[node]:
                seen[node] = True
                left += [int(m) for m in np.unique(self.follow[node]) if m >= 0]
        number = np.append(np.where(seen, np.cumsum(seen) - 1, -1), -1)
        return FiniteStateController(
            self.vocabulary, self.mode[seen], self.choice[seen], number[self.follow[seen]], number[self.start],
            self.impossible, self.name,
        )  # fmt: skip

    def merged(self) -> FiniteStateController:
        """The same controller with nodes made one that act alike for ever, whatever is seen.

        Nodes are told apart by their mode and action, then by which of the classes found so far follow each
        outcome, until no class splits (Moore's minimisation). Where nothing follows counts as a class of its own.
        """
        kind = np.unique(np.stack([self.mode, self.choice], axis=1), axis=0, return_inverse=True)[1]
        while True:
            after = np.where(self.follow >= 0, np.asarray(kind)[self.follow], -1).reshape(self.n_nodes, -1)
            split = np.unique(np.column_stack([kind, after]), axis=0, return_inverse=True)[1]
            if split.max() == kind.max():
                break
            kind = split
        _, first = np.unique(kind, return_index=True)
        # Classes are numbered by their first node, so that a controller without twins comes back as it was.
        order = np.argsort(np.argsort(first))
        number = np.append(order[kind], -1)
        kept = np.sort(first)
        return FiniteStateController(
            self.vocabulary, self.mode[kept], self.choice[kept], number[self.follow[kept]], number[self.start],
            self.impossible, self.name,
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy."""
        return {
            "kind": "controller", "name": self.name, "vocabulary": self.vocabulary.to_dict(),
            "impossible": self.impossible, "mode": self.mode.tolist(), "choice": self.choice.tolist(),
            "start": self.start.tolist(), "follow": self.follow.tolist(),
        }  # fmt: skip


def controller_of(
    policy: AlphaPolicy, starts: Mapping[int, ArrayLike] | None = None, *, impossible: Impossible = "error",
    name: str = "",
) -> FiniteStateController:  # fmt: skip
    """Compile alpha vectors into the controller that they form, pruned to what it can reach.

    From its start node it is worth at least as much as that node's vector says.

    Parameters
    ----------
    policy : AlphaPolicy
        With `follow`.
    starts : mapping of int to float64[y], optional
        Belief to start from, by mode; the problem's own initial beliefs by default.
    impossible : {"error", "keep", "reset"}
    name : str

    Raises
    ------
    InputError
        If the vectors do not know what follows them, or the same outcome is followed by different ones.
    """
    place = f"policy {policy.name}"
    if policy.follow is None:
        raise located(f"{place}, follow", None, "the vector that follows each outcome")
    words = policy.vocabulary
    if starts is None:
        starts = {x: policy.model.initial[x] for x in policy.model.starts}
    start = np.full(len(words.modes), -1)
    for x, belief in starts.items():
        start[x] = policy.vector(belief, x)
    follow = np.full((len(policy.alpha), len(words.modes), len(words.observations)), -1)
    for i in range(len(policy.alpha)):
        for z, (x, o) in enumerate(policy.keys[int(policy.mode[i])][int(policy.choice[i])]):
            after = int(policy.follow[i, z])
            if follow[i, x, o] not in (-1, after):
                found = Phrase(f"vectors {int(follow[i, x, o])} and {after} after the same outcome")
                raise located(f"{place}, vector {i}", found, "one: nobody can tell these outcomes apart")
            follow[i, x, o] = after
    name = name or f"{policy.name} controller"
    return FiniteStateController(words, policy.mode, policy.choice, follow, start, impossible, name).reachable()
