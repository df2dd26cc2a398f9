r"""What a policy does to people over a schedule, exactly: value, cost on every path, influence, and upon whom.

All histories are followed with the joint distribution of draw, first state and present state, so that influence can
be told apart by who somebody was at the start, by how they responded first, and by draw. It is the expected number
of times that a person ends up in another state than if left alone,

.. math:: I = \sum_k E\, TV\big(T(\cdot \mid s_k, a_k), T(\cdot \mid s_k, null)\big)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from models.errors import Phrase, located
from models.planning.policies import Array, Policy, Vocabulary
from models.planning.schedule import Schedule
from models.safeguards.guarded import Guarded
from models.safeguards.influence import influence_table

MOST_DECISIONS = 2_000_000
"""Decisions that are followed."""


@dataclass(frozen=True)
class GuardedRun:
    r"""What a policy does over a schedule, with or without safeguards; over draws, weighted means.

    Attributes
    ----------
    policy, safeguards : str
        Names; safeguards "none" where there are none.
    schedule : str
    value, help_rate : float
        As in `models.planning.evaluation.ScheduleValue`.
    cost, most_cost : float
        Expected sum of the charges, and the largest one of all paths.
    influence : float
        How many times a person is moved, on average.
    changed : float
        Share of the decisions in which something else was done than the policy proposed.
    changed_by : dict of str to float
        The same by safeguard; one may change what another has changed.
    withheld : float
        Share of the proposals other than the null action that were not carried out as proposed; 0 where there was
        none.
    values, influences : float64[d]
        Value and influence in each draw.
    weight : float64[d]
    by_state : float64[d, s]
        Influence upon people who start in a state; nan for states in which nobody starts.
    by_response : float64[d, o]
        Influence upon people by their first response; nan where it never comes.
    """

    policy: str
    safeguards: str
    schedule: str
    value: float
    cost: float
    most_cost: float
    help_rate: float
    influence: float
    changed: float
    changed_by: dict[str, float]
    withheld: float
    values: Array = field(repr=False)
    influences: Array = field(repr=False)
    weight: Array = field(repr=False)
    by_state: Array = field(repr=False)
    by_response: Array = field(repr=False)


def guarded_run(policy: Policy, truth: Schedule, charges: Array | None = None, safeguards: str = "") -> GuardedRun:
    """Follow all histories of a policy.

    Parameters
    ----------
    policy : Policy
        Guarded or not.
    truth : Schedule
        What people are like; its events and discount.
    charges : float64[a], optional
        What actions are charged; their costs by default.
    safeguards : str
        Name of the set of safeguards; by default those of the policy.

    Raises
    ------
    InputError
        On a policy of another protocol, or too many histories.
    """
    words = Vocabulary.of(truth.protocol)
    if policy.vocabulary != words:
        raise located(f"policy {policy.name}, modes, actions and observations", policy.vocabulary, str(words))
    walk = _Walk(policy, truth, truth.costs if charges is None else np.asarray(charges, dtype=np.float64))
    walk.follow()
    return walk.result(safeguards)


class _Walk:
    """Sums over histories, depth first: nothing is kept but the path to where the walk is."""

    def __init__(self, policy: Policy, s: Schedule, charges: Array) -> None:
        d, n, responses = s.draws.n_draws, s.n_states, s.protocol.n_responses
        self.policy, self.s, self.charges = policy, s, charges
        self.moved = influence_table(s.draws)
        self.scores = np.asarray(s.protocol.scores)
        self.null = {s.protocol.action(m.null_action) for m in s.protocol.modes}
        self.value, self.cost, self.score = np.zeros(d), np.zeros(d), np.zeros(d)
        self.by_state = np.zeros((d, n))
        self.by_response, self.reached = np.zeros((d, responses)), np.zeros((d, responses))
        self.most = self.changed = self.withheld = self.active = 0.0
        self.changed_by = {g.name: 0.0 for g in policy.safeguards} if isinstance(policy, Guarded) else {}
        self.seen = 0

    def follow(self) -> None:
        """Walk the whole tree."""
        s = self.s
        start = s.draws.weight[:, None, None] * s.draws.initial[:, :, None] * np.eye(s.n_states)
        self._event(_Place(0, self.policy.begin(s.modes[0]), 0.0), start, np.zeros(s.draws.initial.shape))

    def _event(self, at: _Place, joint: Array, moved: Array | None) -> None:
        """One event of one history.

        `joint`: probability of draw, first state and state ``[d, i, s]``; `moved` ``[d, s]``: influence so far,
        times the probability of being there now, None once the first response has come.
        """
        s = self.s
        if at.event == s.n_events:
            self.most = max(self.most, at.spent)
            if s.terminal is not None:
                self.value += s.discount**at.event * (joint.sum(axis=1) @ s.terminal)
            return
        self.seen += 1
        if self.seen > MOST_DECISIONS:
            found = Phrase(f"more than {MOST_DECISIONS:,} decisions")
            raise located(f"policy {self.policy.name}", found, "a shorter schedule, or one that randomises less")
        for c, share in enumerate(self._done(at, float(joint.sum())).tolist()):
            if share > 0:
                self._act(at, c, share * joint, None if moved is None else share * moved)

    def _done(self, at: _Place, mass: float) -> Array:
        """Probability of each choice; what safeguards changed is counted on the way."""
        policy, n = self.policy, self.s.n_events
        if not isinstance(policy, Guarded):
            share = policy.probabilities(at.memory)
            self.active += mass * float(share @ self._actives(at.event))
            return share
        share = policy.policy.probabilities(at.memory.policy)
        actives = self._actives(at.event)
        out = np.zeros(len(share))
        for c, p in enumerate(share.tolist()):
            if p <= 0:
                continue
            choice, said = policy.review(at.memory, c)
            out[choice] += p
            self.active += mass * p * actives[c]
            if choice != c:
                self.changed += mass * p / n
                self.withheld += mass * p * actives[c]
            for name, shown, verdict in said:
                if verdict.choice != shown:
                    self.changed_by[name] += mass * p / n
        return out

    def _actives(self, k: int) -> Array:
        first = self.s.first_action(k)
        return np.array([float(first + c not in self.null) for c in range(len(self.s.mode(k).actions))])

    def _act(self, at: _Place, choice: int, joint: Array, moved: Array | None) -> None:
        s, k = self.s, at.event
        a = s.first_action(k) + choice
        row = s.protocol.emission_index[a]
        now = joint.sum(axis=1)
        self.value += s.discount**k * (now @ s.reward[a])
        self.cost += now.sum(axis=1) * self.charges[a]
        pushed = joint * self.moved[:, None, a]
        self.by_state += pushed.sum(axis=2)
        own = pushed.sum(axis=1)
        if moved is not None:
            moved = moved + own
        else:
            self.by_response[:, at.response] += own.sum(axis=1)
        if row >= 0:
            self.score += np.einsum("ds,dso,o->d", now, s.draws.emission[:, row], self.scores)
        for o in range(s.n_outcomes(k)):
            shown = np.ones((1, s.n_states)) if row < 0 else s.draws.emission[:, row, :, o]
            reached = np.matmul(joint * shown[:, None, :], s.draws.transition[:, a])
            if not reached.any():
                continue
            response, carried = at.response, moved
            if carried is not None and row >= 0:
                response = o
                self.reached[:, o] += reached.sum(axis=(1, 2))
                self.by_response[:, o] += (carried * shown).sum(axis=1)
                carried = None
            elif carried is not None:
                carried = np.matmul(carried[:, None, :], s.draws.transition[:, a])[:, 0, :]
            memory = None
            if k + 1 < s.n_events:
                memory = self.policy.observe(at.memory, choice, 0 if row < 0 else o + 1, s.modes[k + 1])
            self._event(_Place(k + 1, memory, at.spent + float(self.charges[a]), response), reached, carried)

    def result(self, safeguards: str) -> GuardedRun:
        s, policy = self.s, self.policy
        w = s.draws.weight
        chance = w[:, None] * s.draws.initial
        shown = sum(s.mode(k).shows_response for k in range(s.n_events))
        guards = (
            "none" if not isinstance(policy, Guarded) else " + ".join(g.name for g in policy.safeguards) or "none"
        )
        each = np.divide(self.by_state.sum(axis=1), w, out=np.zeros(len(w)), where=w > 0)
        values = np.divide(self.value, w, out=np.zeros(len(w)), where=w > 0)
        return GuardedRun(
            policy.policy.name if isinstance(policy, Guarded) else policy.name, safeguards or guards, s.letters,
            float(self.value.sum()), float(self.cost.sum()), self.most,
            float(self.score.sum() / shown) if shown else float("nan"), float(self.by_state.sum()), self.changed,
            dict(self.changed_by), self.withheld / self.active if self.active > 0 else 0.0, values, each, w,
            _ratio(self.by_state, chance), _ratio(self.by_response, self.reached),
        )  # fmt: skip


class _Place(NamedTuple):
    """Where a history stands: event, memory of the policy, charges so far, first response (-1: none yet)."""

    event: int
    memory: Any
    spent: float
    response: int = -1


def _ratio(total: Array, chance: Array) -> Array:
    return np.divide(total, chance, out=np.full(total.shape, np.nan), where=chance > 0)
