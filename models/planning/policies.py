"""What a policy is: one small interface for plans, alpha vectors, controllers and baselines.

A policy starts in a mode, says what to do, and is told what came of it::

    memory = policy.begin(mode)
    choice = policy.act(memory)
    memory = policy.observe(memory, choice, observation, next_mode)

Everything it knows is in its memory (a belief, the last response, the place in a plan), which it never changes in
place, so that many histories can be followed at once. Modes, choices (the actions of a mode) and observations are
numbers; `Vocabulary` has their names. A response that was not recorded is `None`.

This module and those of the policies need numpy only: they also run on the robot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.protocol import NO_RESPONSE, Protocol

if TYPE_CHECKING:
    from models.planning.problem import Problem

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Vocabulary:
    """Names of what can be done and seen.

    Attributes
    ----------
    modes : tuple of str
    actions : tuple of tuple of str
        Actions of each mode.
    observations : tuple of str
    """

    modes: tuple[str, ...]
    actions: tuple[tuple[str, ...], ...]
    observations: tuple[str, ...]

    @classmethod
    def of(cls, source: Problem | Protocol) -> Vocabulary:
        """Names of a problem or of a protocol; a protocol's observations are `none` and its responses."""
        if isinstance(source, Protocol):
            actions = tuple(tuple(a.name for a in m.actions) for m in source.modes)
            return cls(source.mode_names, actions, (NO_RESPONSE, *source.response_names))
        return cls(source.modes, tuple(tuple(c.action for c in offered) for offered in source.choices),
                   source.observations)  # fmt: skip

    def mode(self, mode: int | str) -> int:
        """Number of a mode, from its number or name.

        Raises
        ------
        InputError
            If there is no such mode.
        """
        return _number("mode", mode, self.modes)

    def choice(self, mode: int, action: int | str) -> int:
        """Number of an action among those of a mode, from its number or name."""
        return _number(f"action in mode {self.modes[mode]}", action, self.actions[mode])

    def observation(self, observation: int | str | None) -> int | None:
        """Number of an observation, from its number or name; None stays: it was not recorded."""
        return None if observation is None else _number("observation", observation, self.observations)

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the vocabulary, for files."""
        return {
            "modes": list(self.modes), "actions": [list(a) for a in self.actions],
            "observations": list(self.observations),
        }  # fmt: skip


class Policy(ABC):
    """What the robot does, given what it remembers.

    Attributes
    ----------
    name : str
    vocabulary : Vocabulary
    cautions : tuple of str
        Why not to trust what the policy was made from (`models.cautions`); its file keeps them.
    """

    name: str
    vocabulary: Vocabulary
    cautions: tuple[str, ...] = ()

    @abstractmethod
    def begin(self, mode: int) -> Any:
        """Memory before anything has happened, in the first mode.

        Raises
        ------
        InputError
            If the policy cannot start in this mode.
        """

    @abstractmethod
    def mode_of(self, memory: Any) -> int:
        """The mode that a memory is about."""

    @abstractmethod
    def probabilities(self, memory: Any) -> Array:
        """Probability of each choice; all but one are zero unless the policy randomises."""

    @abstractmethod
    def observe(self, memory: Any, choice: int, observation: int | None, next_mode: int) -> Any:
        """Memory after a step: what was done (not always what the policy chose), seen, and the mode reached.

        Raises
        ------
        InputError
            On a choice, observation or mode that is none, or that the policy takes for impossible.
        """

    @property
    def randomised(self) -> bool:
        """Whether equal memories may lead to different actions."""
        return False

    def act(self, memory: Any, rng: np.random.Generator | None = None) -> int:
        """Choose an action.

        Parameters
        ----------
        memory : object
        rng : numpy.random.Generator, optional
            Needed by policies that randomise.
        """
        share = self.probabilities(memory)
        if not self.randomised:
            return int(np.argmax(share))
        if rng is None:
            raise located(f"policy {self.name}, rng", None, "a random generator: the policy randomises")
        place = int(np.searchsorted(np.cumsum(share), rng.random(), side="right"))
        return min(place, int(np.flatnonzero(share)[-1]))

    def reason(self, memory: Any) -> str:
        """What it does and why, in one sentence."""
        mode = self.mode_of(memory)
        words, share = self.vocabulary, self.probabilities(memory)
        does = [
            f"{words.actions[mode][c]}" + ("" if p == 1 else f" with probability {p:.3g}")
            for c, p in enumerate(share)
            if p > 0
        ]
        return f"{self.name} in mode {words.modes[mode]}: {' or '.join(does)}."

    def check_step(self, memory: Any, choice: int, observation: int | None, next_mode: int) -> None:
        """Refuse numbers that are out of range."""
        self.vocabulary.choice(self.mode_of(memory), choice)
        self.vocabulary.observation(observation)
        self.vocabulary.mode(next_mode)

    def forget(self) -> None:  # noqa: B027 - most policies keep nothing
        """Let go of histories worked out before; what it does stays the same."""

    # -- many runs at once -------------------------------------------------------------------------
    # By default each memory is worked on once, however many runs have it; beliefs are worked on as arrays.
    def begin_many(self, modes: Index) -> Any:
        """Memories of many runs."""
        kinds, which = np.unique(modes, return_inverse=True)
        return [self.begin(int(m)) for m in kinds], which

    def probabilities_many(self, memories: Any) -> Array:
        """Probability of each choice in many runs, shape ``[run, choice]``, zero beyond the choices of a mode."""
        kinds, which = memories
        out = np.zeros((len(kinds), max(map(len, self.vocabulary.actions))))
        for i, memory in enumerate(kinds):
            share = self.probabilities(memory)
            out[i, : len(share)] = share
        return out[which]

    def observe_many(self, memories: Any, choices: Index, observations: Index, next_modes: Index) -> Any:
        """Memories of many runs after a step."""
        kinds, which = memories
        numbers: dict[Any, int] = {}
        after = np.empty_like(which)
        for i, c, o, x, runs in grouped(which, choices, observations, next_modes):
            after[runs] = numbers.setdefault(self.observe(kinds[i], c, o, x), len(numbers))
        return list(numbers), after

    # -- files -------------------------------------------------------------------------------------
    def to_dict(self) -> Mapping[str, Any]:
        """Plain content of the policy for `models.planning.policy_files`."""
        raise located(f"policy {self.name}", type(self).__name__, "a kind of policy that can be written to a file")


def certain(choice: int, n: int) -> Array:
    """Probabilities of a policy that is certain of its choice."""
    out = np.zeros(n)
    out[choice] = 1.0
    return out


def grouped(*keys: Index) -> Iterator[tuple[Any, ...]]:
    """Runs by equal keys: the keys, then the numbers of the runs that have them."""
    code = np.zeros(len(keys[0]), dtype=np.int64)
    for key in keys:
        code = code * (int(key.max()) + 1) + key
    order = np.argsort(code, kind="stable")
    edges = np.flatnonzero(np.diff(code[order])) + 1
    for runs in np.split(order, edges):
        yield (*(int(key[runs[0]]) for key in keys), runs)


def _number(place: str, value: int | str, names: Sequence[str]) -> int:
    if isinstance(value, str):
        if value not in names:
            raise located(place, value, f"one of {', '.join(names[:20])}")
        return names.index(value)
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value < len(names):
        raise located(place, value, f"0 to {len(names) - 1} ({', '.join(names[:20])})")
    return int(value)
