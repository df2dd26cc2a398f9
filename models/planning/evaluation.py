r"""What a policy does and is worth over a known schedule, exactly.

A policy that does not randomise meets at most one history for each sequence of responses, so sums over histories
are short. Histories that leave the policy with the same memory are joined, which keeps policies with little memory
cheap even where they randomise. The models that are true may be others than the robot's; many draws are evaluated
at once, because the policy meets the same histories in all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from models.errors import Phrase, located
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.planning.belief_policy import BeliefPolicy
from models.planning.policies import Array, Policy, Vocabulary
from models.planning.product_policy import ProductPolicy
from models.planning.schedule import Schedule
from models.reward import UNIT

MOST_HISTORIES = 1_000_000
"""Histories with a memory of their own that one event may have."""


@dataclass(frozen=True)
class ScheduleValue(NotebookView):
    r"""What a policy does and is worth over a schedule; over draws, weighted means.

    Attributes
    ----------
    policy, schedule : str
    discount : float
    value : float
        :math:`E \sum_k g^k R(s_k, a_k)` in `unit`.
    help_rate : float
        Mean over events that show a response of the expected score of the response (published: the probability
        that the human helps). NaN where no event shows one.
    costly_actions : float
        Expected number of actions other than the null action of their mode.
    cost : float
        Expected sum of the costs of the actions, not discounted, in `unit`.
    state_path : float64[k, s]
        :math:`P(s_k)` in truth, before event `k`; the last row after the last event.
    belief_path : float64[k, y] or None
        Mean of the belief the robot holds before each event, by its own model; None if it holds none.
    action_path : tuple of dict
        Probability of each action, by event.
    values, help_rates, costly : float64[d]
        `value`, `help_rate` and `costly_actions` in each draw.
    unit : str
        What values and costs are in: the word of the reward.
    cautions : tuple of str
        Those of what is taken for the truth (`models.cautions`).
    """

    policy: str
    schedule: str
    discount: float
    value: float
    help_rate: float
    costly_actions: float
    cost: float
    state_path: Array
    belief_path: Array | None
    action_path: tuple[dict[str, float], ...]
    values: Array = field(repr=False)
    help_rates: Array = field(repr=False)
    costly: Array = field(repr=False)
    unit: str = UNIT
    cautions: tuple[str, ...] = ()

    @property
    def table(self) -> Any:
        """The result as a data frame of one row."""
        import pandas as pd

        shown = ("policy", "value", "help_rate", "costly_actions", "cost")
        return pd.DataFrame([{key: getattr(self, key) for key in shown}])

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        helps = "" if np.isnan(self.help_rate) else f" people help in {self.help_rate:.1%} of the rounds they can,"
        return (
            f"{self.policy} over {self.schedule} (discount {self.discount:g}):{helps} {self.costly_actions:.2g} "
            f"costly actions, worth {self.value:.4g} {self.unit}."
        )


def evaluate_schedule(
    policy: Policy, truth: LatentStatePOMDP | ModelDraws | Schedule, schedule: str | Sequence[str] = "",
    discount: float = 1.0,
) -> ScheduleValue:  # fmt: skip
    """Evaluate a policy over a schedule by following all its histories.

    Parameters
    ----------
    policy : Policy
    truth : LatentStatePOMDP, ModelDraws or Schedule
        What is true; a `Schedule` brings its own events, discount and terminal reward.
    schedule : str or sequence of str
        Letters (H: the *human* may help) or names of modes.
    discount : float

    Raises
    ------
    InputError
        On a policy of another protocol, one that randomises into too many histories, or a response that is possible
        in truth and impossible by the robot's model.
    """
    s = truth if isinstance(truth, Schedule) else Schedule.of(truth, schedule, discount)
    words = Vocabulary.of(s.protocol)
    if policy.vocabulary != words:
        raise located(f"policy {policy.name}, modes, actions and observations", policy.vocabulary, str(words))
    draws = s.draws
    sums = _Sums(s, policy)
    place = f"policy {policy.name}"
    holds: dict[Any, Array] = {policy.begin(s.modes[0]): np.array(draws.initial)}
    for k in range(s.n_events):
        first, shows = s.first_action(k), s.mode(k).shows_response
        after: dict[Any, Array] = {}
        sums.enter(k, holds, policy)
        for memory, joint in holds.items():
            for c, share in enumerate(policy.probabilities(memory)):
                if share <= 0:
                    continue
                taken = share * joint
                sums.act(k, first + c, taken)
                for o in range(s.n_outcomes(k)):
                    reached = s.after(taken, first + c, o if shows else None)
                    if not reached.any():
                        continue
                    seen = o + 1 if shows else 0
                    last = k + 1 == s.n_events
                    key = None if last else policy.observe(memory, c, seen, s.modes[k + 1])
                    if key in after:
                        after[key] = after[key] + reached
                    else:
                        after[key] = reached
        if len(after) > MOST_HISTORIES:
            found = Phrase(f"{len(after)} histories after event {k + 1}")
            raise located(place, found, f"at most {MOST_HISTORIES}: simulate it instead")
        holds = after
    return sums.result(policy, holds)


@dataclass(frozen=True)
class Step:
    """One event of a run: what the robot did, what came, what was believed before it."""

    event: int
    mode: str
    action: str
    response: str | None
    probability: float
    belief: Array | None
    true_belief: Array


def follow_responses(
    policy: Policy, truth: LatentStatePOMDP | ModelDraws | Schedule, schedule: str | Sequence[str] = "",
    responses: Sequence[str] = (),
) -> tuple[Step, ...]:  # fmt: skip
    """Follow one run: the actions a policy takes and the beliefs along it.

    Parameters
    ----------
    policy : Policy
        One that does not randomise.
    truth : LatentStatePOMDP, ModelDraws or Schedule
    schedule : str or sequence of str
    responses : sequence of str
        One for each event that shows a response.

    Returns
    -------
    tuple of Step
        `belief` is the robot's by its own model (None if it holds none), `true_belief` that of the models that are
        true, `probability` that of the response in truth (1 where none shows).

    Raises
    ------
    InputError
        On too few or too many responses, an unknown one, or one of probability zero.
    """
    s = truth if isinstance(truth, Schedule) else Schedule.of(truth, schedule)
    shown = sum(s.mode(k).shows_response for k in range(s.n_events))
    if len(responses) != shown:
        raise located("responses", len(responses), f"{shown}, one for each event of {s.letters} that shows one")
    left, memory, joint = list(responses), policy.begin(s.modes[0]), s.start()
    out: list[Step] = []
    for k in range(s.n_events):
        mode, choice = s.mode(k), policy.act(memory)
        response = left.pop(0) if mode.shows_response else None
        seen = 0 if response is None else policy.vocabulary.observation(response)
        belief = policy.belief_of(memory) if isinstance(policy, BeliefPolicy | ProductPolicy) else None
        before = joint.sum(axis=0)
        history = [*((step.action, step.response) for step in out), (mode.actions[choice].name, response)]
        joint, _ = s.joint_after(history)
        chance = float(joint.sum() / before.sum())
        out.append(Step(k, mode.name, mode.actions[choice].name, response, chance, belief, before / before.sum()))
        if k + 1 < s.n_events:
            memory = policy.observe(memory, choice, seen, s.modes[k + 1])
    return tuple(out)


class _Sums:
    """What is summed while histories are followed, by draw."""

    def __init__(self, s: Schedule, policy: Policy) -> None:
        d, k = s.draws.n_draws, s.n_events
        self.s = s
        self.value, self.cost, self.costly, self.score = np.zeros(d), np.zeros(d), np.zeros(d), np.zeros(d)
        self.states = np.zeros((k + 1, s.n_states))
        self.beliefs = np.zeros((k, _believed_states(policy)))
        self.actions: list[dict[str, float]] = [{} for _ in range(k)]
        self.scores = np.asarray(s.protocol.scores)
        self.shown = sum(s.mode(j).shows_response for j in range(k))
        self.null = {s.protocol.action(m.null_action) for m in s.protocol.modes}

    def enter(self, k: int, holds: dict[Any, Array], policy: Policy) -> None:
        for memory, joint in holds.items():
            mean = self.s.draws.weight @ joint
            self.states[k] += mean
            if isinstance(policy, BeliefPolicy | ProductPolicy):
                self.beliefs[k] += mean.sum() * policy.belief_of(memory)

    def act(self, k: int, action: int, taken: Array) -> None:
        s = self.s
        chance = taken.sum(axis=1)
        self.value += s.discount**k * (taken @ s.reward[action])
        self.cost += chance * s.costs[action]
        if action not in self.null:
            self.costly += chance
        row = s.protocol.emission_index[action]
        if row >= 0:
            self.score += np.einsum("ds,dso,o->d", taken, s.draws.emission[:, row], self.scores)
        name = s.protocol.action_names[action]
        self.actions[k][name] = self.actions[k].get(name, 0.0) + float(s.draws.weight @ chance)

    def result(self, policy: Policy, holds: dict[Any, Array]) -> ScheduleValue:
        s = self.s
        for joint in holds.values():
            self.states[-1] += s.draws.weight @ joint
        if s.terminal is not None:
            for joint in holds.values():
                self.value += s.discount**s.n_events * (joint @ s.terminal)
        w = s.draws.weight
        rate = self.score / self.shown if self.shown else np.full(len(w), np.nan)
        beliefs = self.beliefs if isinstance(policy, BeliefPolicy | ProductPolicy) else None
        return ScheduleValue(
            policy.name, s.letters, s.discount, float(w @ self.value), float(w @ rate), float(w @ self.costly),
            float(w @ self.cost), self.states, beliefs, tuple(self.actions), self.value, rate, self.costly,
            unit=s.unit, cautions=s.cautions,
        )  # fmt: skip


def _believed_states(policy: Policy) -> int:
    """States that a policy's belief is about; 0 where it holds none."""
    if isinstance(policy, ProductPolicy):
        return len(policy.beliefs.state_names)
    return len(policy.model.states[0]) if isinstance(policy, BeliefPolicy) else 0
