"""A decision and its one sentence, for every kind of policy, in well under a millisecond.

The sentence says what is done, what it is worth beside the runner-up, the belief in one number, and which
safeguard changed what and why. How far a belief would have to move, which takes longer to find out, is what
`BeliefPolicy.why` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from models.planning.baselines import ModePolicy, Reciprocal
from models.planning.belief_policy import BeliefPolicy
from models.planning.controller import FiniteStateController
from models.planning.mixed_policy import MixedPolicy
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Array, Policy, Vocabulary
from models.planning.product_policy import ProductPolicy
from models.safeguards.safeguard import Verdict
from models.safeguards.worth import Worth, own_worth


@dataclass(frozen=True)
class Decision:
    """What is done now, and why.

    Attributes
    ----------
    mode, choice : int
        The choice by its place among the actions of the mode.
    action : str
    proposed : int
        What the policy itself proposed.
    changed_by : tuple of str
        Names of the safeguards that changed it, in the order in which they did.
    numbers : dict of str to float
        What the decision rests on: ``worth.ACTION``, ``belief.STATE``, ``SAFEGUARD.NUMBER``.
    explanation : str
        One sentence.
    """

    mode: int
    choice: int
    action: str
    proposed: int
    changed_by: tuple[str, ...] = ()
    numbers: dict[str, float] = field(default_factory=dict)
    explanation: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain content, for logs."""
        return {
            "mode": self.mode, "choice": self.choice, "action": self.action, "proposed": self.proposed,
            "changed_by": list(self.changed_by), "numbers": self.numbers, "explanation": self.explanation,
        }  # fmt: skip


def decision_of(
    words: Vocabulary, mode: int, choice: int, proposed: int, *, worth: Worth | None = None,
    states: Sequence[str] = (), verdicts: Sequence[tuple[str, int, Verdict]] = (), place: str = "",
    share: float = 1.0,
) -> Decision:  # fmt: skip
    """Put a decision into words and numbers.

    Parameters
    ----------
    words : Vocabulary
    mode, choice, proposed : int
    worth : Worth, optional
    states : sequence of str
        Names of the hidden states.
    verdicts : sequence of (str, int, Verdict)
        Name of the safeguard, what it was shown, what it said.
    place : str
        What the policy goes by, where actions have no worth; what is left of its budget.
    share : float
        Probability with which a policy that randomises proposes this action.
    """
    names = words.actions[mode]
    action = names[choice]
    numbers: dict[str, float] = {}
    parts: list[str] = []
    changed = []
    for name, shown, verdict in verdicts:
        numbers |= {f"{name}.{key}": value for key, value in verdict.numbers.items() if value == value}
        if verdict.choice != shown:
            changed.append(name)
            parts.append(f"{verdict.reason} ({name})")
    does = action if choice == proposed else f"{action} instead of {names[proposed]}"
    does += _chance(share, names[proposed], choice == proposed)
    if parts:
        does += f", because {', and '.join(parts)}"
    told = [does]
    if worth is not None:
        mean = worth.mean.tolist()
        numbers |= {f"worth.{a}": v for a, v in zip(names, mean, strict=True) if v == v}
        told += _worth_words(names, mean, choice)
        told += _belief_words(worth.state, states, numbers)
    if place:
        told.append(place)
    return Decision(mode, choice, action, proposed, tuple(changed), numbers, f"{'; '.join(told)}.")


def _chance(share: float, action: str, done: bool) -> str:
    if share >= 1:
        return ""
    return f" (drawn with probability {share:.3g})" if done else f" (which was drawn with probability {share:.3g})"


def _worth_words(names: Sequence[str], mean: list[float], choice: int) -> list[str]:
    """What is done is worth so much, the best of the others so much, and those without a worth are out of reach."""
    if mean[choice] != mean[choice]:
        return []
    others = [(v, c) for c, v in enumerate(mean) if c != choice and v == v]
    dear = [a for a, v in zip(names, mean, strict=True) if v != v]
    return _compared(names, mean, choice, others) + ([f"{' and '.join(dear)} cannot be paid for"] if dear else [])


def _compared(names: Sequence[str], mean: list[float], choice: int, others: list[tuple[float, int]]) -> list[str]:
    if not others:
        return [f"{names[choice]} is worth {mean[choice]:.4g}"]
    best, other = max(others, key=lambda x: x[0])
    one, two = _apart(mean[choice], best)
    if one == two:
        return [f"both {names[choice]} and {names[other]} are worth {one}"]
    return [f"{names[choice]} is worth {one}, {names[other]} {two}"]


def _apart(one: float, other: float) -> tuple[str, str]:
    """Two numbers with four digits, or as many as it takes to tell them apart; up to ten."""
    for digits in (4, 6, 8, 10):
        pair = f"{one:.{digits}g}", f"{other:.{digits}g}"
        if pair[0] != pair[1]:
            return pair
    return pair


def _belief_words(belief: Array, states: Sequence[str], numbers: dict[str, float]) -> list[str]:
    """The most probable state and its probability."""
    top = int(np.argmax(belief))
    state = states[top] if states else f"s{top}"
    chance = float(belief[top])
    numbers[f"belief.{state}"] = chance
    return [f"the person is most likely {state} ({chance:.0%})"]


def decide(policy: Policy, memory: Any, rng: np.random.Generator | None = None) -> Decision:
    """The decision of any policy with its sentence; a guarded one decides by itself.

    Parameters
    ----------
    policy : Policy
    memory : object
    rng : numpy.random.Generator, optional
        Needed by policies that randomise.
    """
    own = getattr(policy, "decide", None)
    if own is not None:
        found: Decision = own(memory, rng)
        return found
    mode, choice = policy.mode_of(memory), policy.act(memory, rng)
    worth, states = plain_worth(policy, memory)
    share = float(policy.probabilities(memory)[choice]) if policy.randomised else 1.0
    return decision_of(
        policy.vocabulary, mode, choice, choice, worth=worth, states=states, share=share,
        place=what_is_left(policy, memory) if worth is not None else what_it_goes_by(policy, memory),
    )  # fmt: skip


def what_is_left(policy: Policy, memory: Any) -> str:
    """What is left of the budget that a plan was made with; empty without one."""
    left = policy.left_of(memory) if isinstance(policy, ProductPolicy) else float("inf")
    return f"it can still spend {left:g} of its budget" if left < float("inf") else ""


def plain_worth(policy: Policy, memory: Any) -> tuple[Worth | None, tuple[str, ...]]:
    """What a policy itself says its actions are worth, and the names of the states it believes in."""
    if isinstance(policy, BeliefPolicy):
        belief = policy.belief_of(memory)[None]
        mode = policy.mode_of(memory)
        return Worth(policy.action_values_many(belief, mode), np.ones(1), belief), policy.model.states[mode]
    source = own_worth(policy)
    if source is not None:
        return source.worth(None, memory), source.states
    return None, ()


def what_it_goes_by(policy: Policy, memory: Any) -> str:
    """What decides, for policies that weigh no values."""
    words, mode = policy.vocabulary, policy.mode_of(memory)
    if isinstance(policy, ModePolicy):
        return f"{policy.name} looks at the mode {words.modes[mode]} only"
    if isinstance(policy, Reciprocal):
        last = {-1: "there is no response to answer", 0: "the last response was not to help"}
        return f"{policy.name} answers the last response: {last.get(memory.last, 'the last response was to help')}"
    if isinstance(policy, FiniteStateController):
        return f"{policy.name} is in node {memory.node} of {policy.n_nodes}"
    if isinstance(policy, PlanPolicy | MixedPolicy):
        seen = _responses(policy, memory)
        after = f" after {', '.join(seen)}" if seen else ""
        return f"{policy.name} has it so at event {memory.event + 1} of {len(policy.modes)}{after}"
    return f"{policy.name} has it so in mode {words.modes[mode]}"


def _responses(policy: PlanPolicy | MixedPolicy, memory: Any) -> list[str]:
    """Responses so far, from their number."""
    number, out = memory.responses, []
    for k in range(memory.event - 1, -1, -1):
        number, seen = divmod(number, policy.outcomes[k])
        if policy.outcomes[k] > 1:
            out.append(policy.vocabulary.observations[seen + 1])
    return out[::-1]
