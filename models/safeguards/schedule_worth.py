r"""What actions are worth over a known schedule, by following any policy through all that is left of it.

With the memory `m` of the policy before event `k`, in draw `d` and state `s`,

.. math:: V_k(m)_{ds} = \sum_a \pi(a \mid m) \Big[ R(s, a)
   + g \sum_{o, s'} O_d(o \mid s, a)\, T_d(s' \mid s, a)\, V_{k+1}(m'(m, a, o))_{ds'} \Big]

and an action is worth the bracket. Exact, and linear in the number of histories that the policy tells apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, located
from models.model_draws import ModelDraws
from models.planning.policies import Array, Policy, Vocabulary
from models.planning.schedule import Schedule
from models.safeguards.worth import Worth, WorthSource

Mask = NDArray[np.bool_]

MOST_REMEMBERED = 20_000_000
"""Numbers of value vectors that are kept for memories met again: 160 MB."""


History = tuple[tuple[int, int | None], ...]
"""Choice and observation of each event."""


@dataclass(frozen=True)
class ScheduleState:
    """What happened, and what it says of draws and states.

    Attributes
    ----------
    history : History
    joint : float64[d, s]
        Probability of draw and state given the history.
    """

    history: History
    joint: Array = field(compare=False, repr=False)


class ScheduleWorth(WorthSource):
    """Follows a policy over what is left of a schedule.

    A response that is impossible in every draw tells nothing: it is passed over.

    Parameters
    ----------
    policy : Policy
        The committed policy. It is asked what it would do after every action, also those it would not take.
    schedule : Schedule

    Raises
    ------
    InputError
        If modes, actions and observations are called otherwise.
    """

    def __init__(self, policy: Policy, schedule: Schedule) -> None:
        words = Vocabulary.of(schedule.protocol)
        if policy.vocabulary != words:
            place = f"worth by policy {policy.name}, modes, actions and observations"
            raise located(place, policy.vocabulary, str(words))
        self.policy, self.schedule = policy, schedule
        self.states: tuple[str, ...] = schedule.draws.model(0).state_names
        self.n_draws = schedule.draws.n_draws
        self._known: dict[Any, Array] = {}

    # -- the run -----------------------------------------------------------------------------------
    def begin(self, memory: Any) -> ScheduleState:
        """Nothing has happened."""
        return ScheduleState((), self.schedule.start())

    def observe(
        self, state: ScheduleState, mode: int, choice: int, observation: int | None, memory: Any
    ) -> ScheduleState:  # fmt: skip
        """The history with one more event, and what it says."""
        s, k = self.schedule, len(state.history)
        history = (*state.history, (int(choice), observation))
        if k >= s.n_events or s.modes[k] != mode:
            return ScheduleState(history, state.joint)
        a = s.first_action(k) + choice
        seen = observation - 1 if s.mode(k).shows_response and observation else None
        joint = s.after(state.joint, a, seen)
        if joint.sum() <= 0:
            joint = s.after(state.joint, a, None)
        return ScheduleState(history, joint / joint.sum())

    def worth(self, state: ScheduleState, memory: Any) -> Worth | None:
        """Follow the policy after each action; None where the schedule is over, or was not kept to."""
        s, k = self.schedule, len(state.history)
        if k >= s.n_events or s.modes[k] != self.policy.mode_of(memory):
            return None
        weight = state.joint.sum(axis=1)
        belief = np.divide(state.joint, weight[:, None], out=s.draws.initial.copy(), where=weight[:, None] > 0)
        # Rounding aside beliefs sum to one; draws that are ruled out keep theirs from the start.
        reached = state.joint > 0
        values = [
            (belief * self._action(state.history, memory, c, reached)[0]).sum(axis=1)
            for c in range(len(s.mode(k).actions))
        ]
        return Worth(np.stack(values, axis=1), weight / weight.sum(), belief)

    def forget(self) -> None:
        """Values of memories that were met, and what the policy keeps of them."""
        self._known.clear()
        self.policy.forget()

    # -- values ------------------------------------------------------------------------------------
    def _action(self, history: History, memory: Any, choice: int, reached: Mask) -> tuple[Array, bool]:
        """Worth of a choice by draw and state, shape ``[d, s]``, and whether it holds for other histories too."""
        s, k = self.schedule, len(history)
        a = s.first_action(k) + choice
        row = s.protocol.emission_index[a]
        moved = s.draws.transition[:, a]
        follows = np.zeros((self.n_draws, s.n_states))
        whole = True
        for o in range(s.n_outcomes(k)):
            shown = None if row < 0 else s.draws.emission[:, row, :, o]
            if shown is not None and not shown.any():
                continue
            possible = reached if shown is None else reached & (shown > 0)
            after = np.matmul(possible[:, None, :].astype(float), moved)[:, 0, :] > 0
            value, sound = self._after(history, memory, choice, 0 if row < 0 else o + 1, after)
            whole &= sound
            value = np.matmul(moved, value[:, :, None])[:, :, 0]
            follows += value if shown is None else shown * value
        return s.reward[a] + s.discount * follows, whole

    def _after(
        self, history: History, memory: Any, choice: int, observation: int, reached: Mask
    ) -> tuple[Array, bool]:  # fmt: skip
        """Worth of what follows a step."""
        s, k = self.schedule, len(history)
        if k + 1 == s.n_events:
            end = np.zeros(s.n_states) if s.terminal is None else s.terminal
            return np.broadcast_to(end, (self.n_draws, s.n_states)), True
        try:
            following = self.policy.observe(memory, choice, observation, s.modes[k + 1])
        except InputError:
            # The policy takes the response for impossible; that is no harm where it is so.
            if reached.any():
                raise
            return np.zeros((self.n_draws, s.n_states)), False
        return self._policy((*history, (choice, observation)), following, reached)

    def _policy(self, history: History, memory: Any, reached: Mask) -> tuple[Array, bool]:
        """Worth of going on with the policy, kept by memory, or by history where equal memories cannot be told."""
        same = type(memory).__eq__ is object.__eq__
        key = history if same else (len(history), memory)
        known = self._known.get(key)
        if known is not None:
            return known, True
        total = np.zeros((self.n_draws, self.schedule.n_states))
        whole = True
        for c, share in enumerate(self.policy.probabilities(memory).tolist()):
            if share > 0:
                value, sound = self._action(history, memory, c, reached)
                total += share * value
                whole &= sound
        if whole:
            if len(self._known) * total.size >= MOST_REMEMBERED:
                self._known.clear()
            self._known[key] = total
        return total, whole

    # -- files -------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Plain content: the schedule and its draws."""
        s = self.schedule
        return {
            "kind": "schedule", "modes": [s.mode(k).name for k in range(s.n_events)], "discount": s.discount,
            "terminal": None if s.terminal is None else s.terminal.tolist(), "models": draws_to_list(s.draws),
        }  # fmt: skip


def draws_to_list(draws: ModelDraws) -> list[dict[str, Any]]:
    """Draws as `ModelDraws.from_json` reads them: models, each with its weight."""
    from models.model_files import model_to_dict

    weights = draws.weight.tolist()
    return [{**model_to_dict(m), "weight": w} for m, w in zip(draws, weights, strict=True)]
