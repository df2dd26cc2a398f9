"""Policies that act on a belief, each with a model of its own for it."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.errors import located
from models.planning.belief_check import real_array
from models.planning.belief_model import BeliefModel
from models.planning.explanation import Explanation, explain
from models.planning.policies import Array, Index, Policy, Vocabulary, certain, grouped


@dataclass(frozen=True, eq=False)
class BeliefMemory:
    """Mode and belief over its hidden states ``[y]``."""

    mode: int
    belief: Array


@dataclass(frozen=True, eq=False)
class BeliefMemories:
    """Of many runs: mode ``[run]`` and belief ``[run, y]``, zero beyond the states of a mode."""

    mode: Index
    belief: Array


class BeliefPolicy(Policy):
    """A policy that acts on its belief.

    Attributes
    ----------
    model : BeliefModel
        What actions are judged by.
    tracker : BeliefModel
        What the belief is made with, `model` by default. Neither need be true.
    """

    model: BeliefModel

    @property
    def tracker(self) -> BeliefModel:
        """The model that the belief is made with."""
        return self.model

    @property
    def vocabulary(self) -> Vocabulary:  # type: ignore[override]
        """Names of what can be done and seen."""
        return self.model.vocabulary

    @abstractmethod
    def action_values_many(self, beliefs: Array, mode: int) -> Array:
        """What each action is worth by the policy's lights at beliefs ``[i, y]``, shape ``[i, choice]``."""

    # -- at a belief -------------------------------------------------------------------------------
    def choose_many(self, beliefs: Array, mode: int) -> Index:
        """Number of the choice at beliefs ``[i, y]``; the lowest of equals."""
        return np.asarray(np.argmax(self.action_values_many(beliefs, mode), axis=1))

    def action(self, belief: Any, mode: int | str) -> str:
        """Name of the action at a belief.

        Raises
        ------
        InputError
            On an unknown mode, or a belief that is no probability vector.
        """
        m = self.vocabulary.mode(mode)
        return self.vocabulary.actions[m][int(self.choose_many(self.model.check_belief(m, belief)[None], m)[0])]

    def action_values(self, belief: Any, mode: int | str) -> dict[str, float]:
        """What each action is worth at a belief, by name, in the unit of the reward.

        Raises
        ------
        InputError
            As `action` does.
        """
        m = self.vocabulary.mode(mode)
        values = self.action_values_many(self.model.check_belief(m, belief)[None], m)[0]
        return dict(zip(self.vocabulary.actions[m], values.tolist(), strict=True))

    def why(self, belief: Any, mode: int | str) -> Explanation:
        """Why the policy does what it does at a belief.

        Raises
        ------
        InputError
            As `action` does.
        """
        m = self.vocabulary.mode(mode)
        b = self.model.check_belief(m, belief)
        words = self.vocabulary
        return explain(
            lambda beliefs: self.action_values_many(beliefs, m), b, self.model.states[m], words.actions[m],
            words.modes[m],
        )  # fmt: skip

    def reason(self, memory: BeliefMemory) -> str:
        """What it does and why, in one sentence."""
        return self.why(memory.belief, memory.mode).sentence

    # -- the interface -----------------------------------------------------------------------------
    def begin(self, mode: int) -> BeliefMemory:
        """Memory before anything has happened: the model's initial belief."""
        m = self.vocabulary.mode(mode)
        return BeliefMemory(m, self.tracker.initial[m])

    def mode_of(self, memory: BeliefMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def belief_of(self, memory: BeliefMemory) -> Array:
        """The belief in a memory."""
        return memory.belief

    def probabilities(self, memory: BeliefMemory) -> Array:
        """One at the choice for the belief."""
        choice = int(self.choose_many(memory.belief[None], memory.mode)[0])
        return certain(choice, len(self.vocabulary.actions[memory.mode]))

    def observe(self, memory: BeliefMemory, choice: int, observation: int | None, next_mode: int) -> BeliefMemory:
        """The belief moves on."""
        self.check_step(memory, choice, observation, next_mode)
        return BeliefMemory(
            next_mode, self.tracker.update(memory.mode, memory.belief, choice, observation, next_mode)
        )

    # -- many runs at once -------------------------------------------------------------------------
    def begin_many(self, modes: Index) -> BeliefMemories:
        """The initial belief of every run."""
        width = max(map(len, self.model.states))
        belief = np.zeros((len(modes), width))
        for m in np.unique(modes):
            belief[modes == m, : len(self.model.states[m])] = self.tracker.initial[m]
        return BeliefMemories(np.array(modes), belief)

    def probabilities_many(self, memories: BeliefMemories) -> Array:
        """One at the choice of every run."""
        out = np.zeros((len(memories.mode), max(map(len, self.vocabulary.actions))))
        for m in np.unique(memories.mode):
            runs = np.flatnonzero(memories.mode == m)
            choices = self.choose_many(memories.belief[runs, : len(self.model.states[m])], int(m))
            out[runs, choices] = 1.0
        return out

    def observe_many(
        self, memories: BeliefMemories, choices: Index, observations: Index, next_modes: Index
    ) -> BeliefMemories:
        """Every belief moves on; runs whose step is impossible one by one, as `observe` treats them."""
        out = np.zeros_like(memories.belief)
        for m, c, o, x, runs in grouped(memories.mode, choices, observations, next_modes):
            n = len(self.model.states[x])
            before = memories.belief[runs, : len(self.model.states[m])]
            out[runs, :n] = self.tracker.update_many(m, before, c, o, x)
        return BeliefMemories(np.array(next_modes), out)


class Myopic(BeliefPolicy):
    r"""Looks one round ahead, as printed in the paper and without discount.

    .. math:: \arg\max_a \sum_s b(s) R(s, a) + \sum_{s, s'} b(s) T(s' \mid s, a) R_{prosocial}(s')

    Parameters
    ----------
    model : BeliefModel
    prosocial : float64[y]
        :math:`R_{prosocial}`, the part of the reward that depends on the state.
    name : str

    Raises
    ------
    InputError
        If there is not one finite number for each hidden state, or modes differ in their hidden states.
    """

    def __init__(self, model: BeliefModel, prosocial: Array, name: str = "myopic") -> None:
        self.model, self.name = model, name
        place = f"policy {name}, prosocial reward"
        self.prosocial = real_array(place, prosocial, "one number a hidden state")
        sizes = sorted({len(states) for states in model.states})
        if sizes != [len(np.atleast_1d(self.prosocial))] or self.prosocial.ndim != 1:
            wanted = f"({' or '.join(map(str, sizes))},), one number a hidden state, as many in every mode"
            raise located(f"{place}, shape", self.prosocial.shape, wanted)
        if not np.isfinite(self.prosocial).all():
            raise located(place, self.prosocial.tolist(), "finite numbers")

    def action_values_many(self, beliefs: Array, mode: int) -> Array:
        """Reward of this round and prosociality after it."""
        out = beliefs @ self.model.rewards[mode].T
        for c, outcomes in enumerate(self.model.outcomes[mode]):
            for z in outcomes:
                out[:, c] += z.reached(beliefs, len(self.prosocial)) @ self.prosocial
        return np.asarray(out)

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy."""
        return {
            "kind": "myopic", "name": self.name, "model": self.model.to_dict(), "prosocial": self.prosocial.tolist()
        }  # fmt: skip
