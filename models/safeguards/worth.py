r"""What each action is worth in each draw, with the committed policy going on after it: what safeguards judge by.

A source of worth follows a run beside the policy. It needs no more than numpy while a robot runs; whatever takes
time (following the policy through what is left of a schedule) is done when a step is observed, not when an action
is asked for.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.errors import InputError, Phrase, located
from models.lspomdp import default_state_names
from models.planning.alpha_policy import AlphaPolicy
from models.planning.belief_policy import BeliefMemory, BeliefPolicy
from models.planning.policies import Array, Policy
from models.planning.product_policy import ProductMemory, ProductPolicy

EQUAL = 1e-12
"""Worths that differ by no more than that share of their size are equal: they are sums, rounded in their last
digits."""


@dataclass(frozen=True, eq=False)
class Worth:
    r"""What the actions of a mode are worth where a run stands.

    Attributes
    ----------
    values : float64[d, c]
        :math:`Q_d(a)`: expected reward from here on in draw `d`, given what was seen, if the action is taken now
        and the committed policy goes on; in the unit of the reward. NaN: the action is not possible.
    weight : float64[d]
        Probability of each draw given what was seen.
    belief : float64[d, s]
        Belief about the person in each draw.
    """

    values: Array
    weight: Array
    belief: Array

    @property
    def mean(self) -> Array:
        """Worth of each action over the draws, shape ``[c]``."""
        return np.asarray(self.weight @ self.values)

    @property
    def state(self) -> Array:
        """Belief about the person over the draws, shape ``[s]``."""
        return np.asarray(self.weight @ self.belief)


def rounding(*worths: Any) -> Any:
    """How much of the difference of worths may be rounding; entry by entry."""
    sizes = [np.abs(w) for w in worths]
    return EQUAL * np.maximum(1.0, np.maximum.reduce(sizes))


class WorthSource(ABC):
    """Follows a run beside a policy and says what actions are worth.

    Its states are immutable and hashable, like memories of policies.

    Attributes
    ----------
    states : tuple of str
        Names of the hidden states.
    n_draws : int
    """

    states: tuple[str, ...]
    n_draws: int

    def begin(self, memory: Any) -> Any:
        """State before anything has happened; `memory` is the policy's."""
        return None

    @abstractmethod
    def worth(self, state: Any, memory: Any) -> Worth | None:
        """What actions are worth now; None if nobody can say, as after the end of a schedule."""

    def observe(self, state: Any, mode: int, choice: int, observation: int | None, memory: Any) -> Any:
        """State after a step in a mode; `memory` is the policy's after that step."""
        return None

    def forget(self) -> None:  # noqa: B027 - most sources keep nothing
        """Forget what was worked out along the way: it tells of the histories it was worked out for."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Plain content, for files."""


class OwnWorth(WorthSource):
    """What a policy on beliefs says its actions are worth by its own model, which is the only draw.

    For alpha vectors that is one step, and the best vector afterwards (a lower bound on the optimum).

    Parameters
    ----------
    policy : BeliefPolicy

    Raises
    ------
    InputError
        If the policy has no belief, or its modes differ in their hidden states.
    """

    def __init__(self, policy: Policy) -> None:
        if not isinstance(policy, BeliefPolicy):
            raise located(f"worth by policy {policy.name}", Phrase(type(policy).__name__), "a policy on beliefs")
        self.policy = policy
        if len(set(policy.model.states)) > 1:
            raise located(f"worth by policy {policy.name}, hidden states", Phrase("others by mode"), "the same")
        self.states, self.n_draws = policy.model.states[0], 1

    def worth(self, state: Any, memory: BeliefMemory) -> Worth:
        """The policy's own values."""
        belief = self.policy.belief_of(memory)[None]
        return Worth(self.policy.action_values_many(belief, memory.mode), np.ones(1), belief)

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        return {"kind": "own"}


class VectorWorth(WorthSource):
    """From a policy whose vectors say what every action is worth in each draw (`schedule_vectors`).

    Parameters
    ----------
    policy : ProductPolicy

    Raises
    ------
    InputError
        If the policy has no such vectors.
    """

    def __init__(self, policy: Policy) -> None:
        if not isinstance(policy, ProductPolicy):
            wanted = "a policy whose vectors tell draws apart, as schedule_vectors makes them"
            raise located(f"worth by policy {policy.name}", Phrase(type(policy).__name__), wanted)
        self.policy, self.n_draws = policy, policy.n_draws
        draws = policy.beliefs.draws
        self.states = draws.state_names or default_state_names(draws.n_states)

    def worth(self, state: Any, memory: ProductMemory) -> Worth | None:
        """Read off the vectors; None once the schedule is over."""
        policy = self.policy
        try:
            values = policy.draw_action_values(memory)
        except InputError:
            return None
        return Worth(values, policy.weights_of(memory), policy.draw_beliefs(memory))

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        return {"kind": "vectors"}


def own_worth(policy: Policy) -> WorthSource | None:
    """The source of worth that a policy brings along; None if it brings none."""
    if isinstance(policy, ProductPolicy):
        return VectorWorth(policy)
    same = isinstance(policy, AlphaPolicy) and len(set(policy.model.states)) == 1
    return OwnWorth(policy) if same else None
