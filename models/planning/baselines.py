"""The paper's baselines, and a uniformly random policy for reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from models.errors import Phrase, located
from models.planning.belief_model import BeliefModel, Impossible
from models.planning.belief_policy import Myopic
from models.planning.policies import Array, Policy, Vocabulary, certain
from models.protocol import Protocol

if TYPE_CHECKING:
    from models.lspomdp import LatentStatePOMDP


class ModeMemory(NamedTuple):
    """Nothing but the mode."""

    mode: int


class ModePolicy(Policy):
    """Looks at the mode only: always the same action in a mode, or by fixed chances.

    Parameters
    ----------
    vocabulary : Vocabulary
    shares : sequence of float64[choice]
        Probability of each action, one array a mode.
    name : str

    Raises
    ------
    InputError
        If the shares of a mode are no probabilities of its actions.
    """

    def __init__(self, vocabulary: Vocabulary, shares: Sequence[Any], name: str) -> None:
        self.vocabulary, self.name = vocabulary, name
        self.shares = tuple(np.asarray(s, dtype=np.float64) for s in shares)
        if len(self.shares) != len(vocabulary.modes):
            raise located(f"policy {name}, modes", len(self.shares), f"{len(vocabulary.modes)}")
        for mode, actions, share in zip(vocabulary.modes, vocabulary.actions, self.shares, strict=True):
            good = share.shape == (len(actions),) and np.all(share >= 0) and abs(share.sum() - 1) <= 1e-9
            if not good:
                wanted = f"{len(actions)} probabilities that sum to one"
                raise located(f"policy {name}, mode {mode}, shares", share.tolist(), wanted)

    @property
    def randomised(self) -> bool:
        """Whether some mode leaves the action to chance."""
        return any(np.count_nonzero(s) > 1 for s in self.shares)

    def begin(self, mode: int) -> ModeMemory:
        """Memory before anything has happened."""
        return ModeMemory(self.vocabulary.mode(mode))

    def mode_of(self, memory: ModeMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def probabilities(self, memory: ModeMemory) -> Array:
        """Probability of each choice in the mode."""
        return self.shares[memory.mode]

    def observe(self, memory: ModeMemory, choice: int, observation: int | None, next_mode: int) -> ModeMemory:
        """Only the mode is remembered."""
        self.check_step(memory, choice, observation, next_mode)
        return ModeMemory(int(next_mode))

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy."""
        return {
            "kind": "by_mode", "name": self.name, "vocabulary": self.vocabulary.to_dict(),
            "shares": [s.tolist() for s in self.shares],
        }  # fmt: skip


class ResponseMemory(NamedTuple):
    """The mode, and the last response: 1 with the highest score, 0 another one, -1 none."""

    mode: int
    last: int


class Reciprocal(Policy):
    """Helps iff the last observed response was help, and signals iff it was no-help; before any, neither.

    In a mode that shows no response the active action answers help; in one that shows it, the lack of help. A
    response is help if no other scores higher. The paper's words ("the previous interaction") leave open what an
    event without a response counts: here it is passed over.

    Parameters
    ----------
    protocol : Protocol
        Each mode offers its null action and at most one more.
    literal : bool
        Take "previous interaction" literally: any event is one, and after one without a response it does neither.

    Raises
    ------
    InputError
        If some mode offers more than two actions.
    """

    def __init__(self, protocol: Protocol, *, literal: bool = False, name: str = "reactive") -> None:
        self.protocol, self.literal, self.name = protocol, literal, name
        self.vocabulary = Vocabulary.of(protocol)
        for mode in protocol.modes:
            if len(mode.actions) > 2:
                found = Phrase(f"{len(mode.actions)} actions in mode {mode.name}")
                raise located(f"policy {name}", found, "the null action and at most one more")
        self._null = [[a.name for a in m.actions].index(m.null_action) for m in protocol.modes]
        self._help = int(np.argmax(protocol.scores)) + 1

    def begin(self, mode: int) -> ResponseMemory:
        """Memory before anything has happened."""
        return ResponseMemory(self.vocabulary.mode(mode), -1)

    def mode_of(self, memory: ResponseMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def probabilities(self, memory: ResponseMemory) -> Array:
        """Active iff the last response asks for it."""
        asks = 0 if self.protocol.modes[memory.mode].shows_response else 1
        null, offered = self._null[memory.mode], len(self.vocabulary.actions[memory.mode])
        return certain(1 - null if memory.last == asks and offered == 2 else null, offered)

    def reason(self, memory: ResponseMemory) -> str:
        """What it does and why, in one sentence."""
        if memory.last < 0:
            why = "the last event showed no response" if self.literal else "there is no response to answer yet"
        else:
            why = f"the last response was {'' if memory.last else 'not '}to help"
        return f"{super().reason(memory)[:-1]}, because {why}."

    def observe(
        self, memory: ResponseMemory, choice: int, observation: int | None, next_mode: int
    ) -> ResponseMemory:
        """Remember the response, if there was one."""
        self.check_step(memory, choice, observation, next_mode)
        if observation is None or observation == 0:
            return ResponseMemory(int(next_mode), -1 if self.literal else memory.last)
        return ResponseMemory(int(next_mode), int(observation == self._help))

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy."""
        return {
            "kind": "reciprocal", "name": self.name, "protocol": self.protocol.to_dict(), "literal": self.literal
        }  # fmt: skip


def never(protocol: Protocol, name: str = "never") -> ModePolicy:
    """Never help, never signal: the null action of every mode."""
    shares = [[float(a.name == m.null_action) for a in m.actions] for m in protocol.modes]
    return ModePolicy(Vocabulary.of(protocol), shares, name)


def always(protocol: Protocol, name: str = "always") -> ModePolicy:
    """Always help, always signal: the costliest action of every mode other than the null action."""
    shares = []
    for m in protocol.modes:
        active = [a for a in m.actions if a.name != m.null_action] or list(m.actions)
        best = max(active, key=lambda a: a.cost)
        shares.append([float(a is best) for a in m.actions])
    return ModePolicy(Vocabulary.of(protocol), shares, name)


def uniformly_random(source: Vocabulary | Protocol, name: str = "random") -> ModePolicy:
    """Every action of a mode equally often."""
    vocabulary = Vocabulary.of(source) if isinstance(source, Protocol) else source
    return ModePolicy(vocabulary, [np.full(len(a), 1.0 / len(a)) for a in vocabulary.actions], name)


def myopic(model: LatentStatePOMDP, name: str = "myopic", *, impossible: Impossible = "error") -> Myopic:
    """The paper's myopic policy, with its belief by this model."""
    return Myopic(BeliefModel.of_latent(model, impossible=impossible), model.reward.prosocial(), name)


def baselines(model: LatentStatePOMDP) -> tuple[Policy, ...]:
    """Always, never, myopic, reactive and random; the reactive one where no mode offers more than two actions."""
    protocol = model.protocol
    two = all(len(m.actions) <= 2 for m in protocol.modes)
    return (
        always(protocol), never(protocol), myopic(model), *((Reciprocal(protocol),) if two else ()),
        uniformly_random(protocol),
    )  # fmt: skip
