"""Decisions asked for under many rewards: cases in, actions out, whatever the reading of the plan.

A *case* is one model with one reward and one discount. The robot goes through steps whose modes are known, by its
own plan; where a mode shows a response, the next step is looked at after each of its responses, with the chance
that it is met. The published steps, human-needs-help and then robot-needs-help, have one history each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol as Interface

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.model_draws import ModelDraws
from models.protocol import Protocol
from models.reward import Reward
from models.sensitivity.endless_kernel import OPEN

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Cases:
    """What decisions are asked for.

    Attributes
    ----------
    draw : int64[m]
        The model of each case.
    reward : float64[m, a, s]
        :math:`R(s, a)`.
    prosocial : float64[m, s]
        The part of it that depends on the state, paid once more after the last step where a reading says so.
    discount : float64[m]
    """

    draw: Index
    reward: Array
    prosocial: Array
    discount: Array

    def __len__(self) -> int:
        return len(self.draw)

    @classmethod
    def of(cls, draws: int, rewards: Sequence[Reward], protocol: Protocol, discount: float) -> Cases:
        """Every draw under every reward, rewards outside: case ``g * draws + d``."""
        tables = np.stack([r.table(protocol) for r in rewards])
        states = np.stack([r.prosocial() for r in rewards])
        g = np.repeat(np.arange(len(rewards)), draws)
        return cls(
            np.tile(np.arange(draws), len(rewards)), tables[g], states[g], np.full(len(g), float(discount))
        )  # fmt: skip

    def some(self, keep: Index | slice) -> Cases:
        """Some of the cases."""
        return replace(
            self, draw=self.draw[keep], reward=self.reward[keep], prosocial=self.prosocial[keep],
            discount=self.discount[keep],
        )  # fmt: skip


@dataclass(frozen=True)
class Answers:
    """What is done in every case.

    Attributes
    ----------
    nodes : Nodes
        Steps and the response histories of each.
    choice : int8[m, n]
        Action at each node, counted within the mode of its step; `OPEN` where the bounds leave it open.
    chance : float64[m, n]
        Probability of the node's responses under the plan; sums to one over the nodes of a step.
    lower, upper : float64[m, n, c]
        Bounds of what each action is worth there, equal where the reading is exact; nan beyond a mode's actions.
    """

    nodes: Nodes
    choice: NDArray[np.int8]
    chance: Array
    lower: Array
    upper: Array

    def shares(self, k: int) -> Array:
        """How often a case takes each action at step `k`, the last column being open, shape ``[m, c + 1]``."""
        at = self.nodes.of_step(k)
        count = self.nodes.actions[k]
        out = np.zeros((len(self.choice), count + 1))
        for n in at:
            place = np.where(self.choice[:, n] == OPEN, count, self.choice[:, n])
            np.add.at(out, (np.arange(len(out)), place), self.chance[:, n])
        return out

    def label(self, k: int) -> Index:
        """One number for all that is decided at step `k`, whatever the responses before; `OPEN` if any is open."""
        out = np.zeros(len(self.choice), dtype=np.int64)
        for n in self.nodes.of_step(k):
            out = out * self.nodes.actions[k] + self.choice[:, n]
        return np.where((self.choice[:, self.nodes.of_step(k)] == OPEN).any(axis=1), OPEN, out)


@dataclass(frozen=True)
class Nodes:
    """Steps by mode, each with the histories of responses that may lead there.

    Attributes
    ----------
    protocol : Protocol
    modes : tuple of int
        Mode of each step.
    """

    protocol: Protocol
    modes: tuple[int, ...]

    def __post_init__(self) -> None:
        if not self.modes:
            raise located("steps", 0, "at least one")

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.modes)

    @property
    def actions(self) -> tuple[int, ...]:
        """Number of actions of each step."""
        return tuple(len(self.protocol.modes[m].actions) for m in self.modes)

    def outcomes(self, k: int) -> int:
        """Responses that a step may show; 1 where it shows none."""
        return self.protocol.n_responses if self.protocol.modes[self.modes[k]].shows_response else 1

    def first_action(self, k: int) -> int:
        """Number of a step's first action among all of the protocol."""
        return self.protocol.mode_of_action.index(self.modes[k])

    def null_choice(self, k: int) -> int:
        """The null action of a step, counted within its mode."""
        mode = self.protocol.modes[self.modes[k]]
        return [a.name for a in mode.actions].index(mode.null_action)

    def action_names(self, k: int) -> tuple[str, ...]:
        """Names of the actions of a step."""
        return tuple(a.name for a in self.protocol.modes[self.modes[k]].actions)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of histories of each step."""
        out = [1]
        for k in range(self.n_steps - 1):
            out.append(out[-1] * self.outcomes(k))
        return tuple(out)

    @property
    def n_nodes(self) -> int:
        """Number of nodes over all steps."""
        return sum(self.counts)

    def of_step(self, k: int) -> range:
        """Nodes of a step, earlier responses counting most."""
        first = sum(self.counts[:k])
        return range(first, first + self.counts[k])

    def histories(self, k: int) -> list[tuple[str, ...]]:
        """Responses that lead to each node of a step."""
        out: list[tuple[str, ...]] = [()]
        for j in range(k):
            if self.outcomes(j) > 1:
                out = [(*h, o) for h in out for o in self.protocol.response_names]
        return out

    def words(self, k: int, label: int) -> str:
        """What a label of a step says (`Answers.label`): an action, or actions by response."""
        names, count = self.action_names(k), self.counts[k]
        if label == OPEN:
            return "undecided"
        choices = []
        for _ in range(count):
            choices.append(names[label % len(names)])
            label //= len(names)
        choices.reverse()
        if len(set(choices)) == 1:
            return choices[0]
        said = zip(self.histories(k), choices, strict=True)
        return ", ".join(f"{c} after {' and '.join(h)}" for h, c in said)


class Decider(Interface):
    """One reading of "the plan": says what is done in each case."""

    reading: str
    nodes: Nodes
    draws: ModelDraws

    def decide(self, cases: Cases) -> Answers:
        """What is done in every case."""
        ...


def joined(parts: Sequence[Answers]) -> Answers:
    """Answers of several portions of cases, one after the other."""
    return Answers(
        parts[0].nodes, np.concatenate([p.choice for p in parts]), np.concatenate([p.chance for p in parts]),
        np.concatenate([p.lower for p in parts]), np.concatenate([p.upper for p in parts]),
    )  # fmt: skip


def steps_in_order(protocol: Protocol) -> tuple[int, ...]:
    """The protocol's modes in order, once each: the steps that the paper looks at."""
    return tuple(range(len(protocol.modes)))


def believing(draws: ModelDraws, belief: Array) -> ModelDraws:
    """The draws with one initial belief for all of them."""
    return replace(draws, initial=np.tile(np.asarray(belief, dtype=np.float64), (draws.n_draws, 1)))
