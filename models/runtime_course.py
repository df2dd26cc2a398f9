"""Where a session stands: the same whether a robot is acting or its log is replayed.

A step is worked out first and taken afterwards, so that between the two it can be written down::

    step = course.decide(mode)              # nothing has changed yet
    ...                                     # write course.decide_entry(step.decision)
    course.decided(step)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from typing import Any, NamedTuple

import numpy as np

from models.errors import Phrase, located
from models.planning.baselines import ModePolicy
from models.planning.policies import Policy, Vocabulary
from models.planning.policy_files import policy_from_dict, policy_to_dict
from models.runtime_content import pack, unpack
from models.runtime_setting import (
    Responses,
    declared_fallback,
    responses_from_dict,
    responses_to_dict,
    silent,
)
from models.safeguards.consent import Consent
from models.safeguards.guarded import Decision, decide
from models.safeguards.sentence import decision_of

SCHEMA = "prosocial-session/1"


class Step(NamedTuple):
    """A decision, and the memory it was made from (None without consent)."""

    decision: Decision
    memory: Any


class Outcome(NamedTuple):
    """What came of a decision: what was done, and what was seen (None: not recorded)."""

    choice: int
    observation: int | None


class Course:
    """Where a session stands.

    Parameters
    ----------
    policy : Policy or None
        None where nothing of it is needed because there is no consent.
    fallback : ModePolicy
    responses : Responses
    seed : int
    consent : Consent

    Attributes
    ----------
    event : int
        Events that are over.
    memory : object or None
        The policy's memory at the last decision.
    held : Outcome or None
        Of the last event, until the next mode is known.
    pending : Decision or None
        The decision whose outcome is not known yet.
    cautions : tuple of str
        Why not to trust the policy that acts, or acted until consent was withdrawn: nothing about the person.
    """

    def __init__(
        self, policy: Policy | None, fallback: ModePolicy, responses: Responses, seed: int, consent: Consent
    ) -> None:  # fmt: skip
        if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
            raise located("session, seed", seed, "a whole number of at least 0")
        self.fallback, self.responses, self.seed, self.consent = fallback, responses, seed, consent
        self.policy = policy if consent is Consent.GIVEN else None
        self.cautions = () if self.policy is None else self.policy.cautions
        self.event = 0
        self.memory: Any = None
        self.held: Outcome | None = None
        self.pending: Decision | None = None

    @property
    def words(self) -> Vocabulary:
        """Names of what can be done and seen."""
        return self.fallback.vocabulary

    # -- a decision --------------------------------------------------------------------------------
    def decide(self, mode: int) -> Step:
        """What is done in a mode, from what happened before.

        Raises
        ------
        InputError
            If the policy takes what happened for impossible, or has nothing to say about this event.
        """
        acting = self.fallback if self.policy is None else self.policy
        rng = None
        if acting.randomised:
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(self.event,)))
        if self.policy is None:
            return Step(self._without(mode, rng), None)
        if self.held is None:
            memory = self.policy.begin(mode)
        else:
            memory = self.policy.observe(self.memory, self.held.choice, self.held.observation, mode)
        return Step(decide(self.policy, memory, rng), memory)

    def _without(self, mode: int, rng: np.random.Generator | None) -> Decision:
        choice = self.fallback.act(self.fallback.begin(mode), rng)
        why = "never given" if self.consent is Consent.NEVER else "withdrawn"
        told = f"consent was {why}, so the declared fallback looks at the mode only, and nothing is believed"
        return decision_of(self.words, mode, choice, choice, place=told)

    def decided(self, step: Step) -> None:
        """Take the step."""
        self.memory, self.held, self.pending = step.memory, None, step.decision

    def decide_entry(self, decision: Decision) -> dict[str, Any]:
        """What the log says of a decision."""
        offered = self.words.actions[decision.mode]
        return {
            "event": "decide", "k": self.event, "mode": self.words.modes[decision.mode],
            "action": decision.action, "proposed": offered[decision.proposed],
            "changed_by": list(decision.changed_by),
            "numbers": {key: float(v) if math.isfinite(v) else None for key, v in decision.numbers.items()},
            "explanation": decision.explanation,
        }  # fmt: skip

    # -- its outcome -------------------------------------------------------------------------------
    def outcome(self, response: str | None, performed: str | None) -> Outcome:
        """What came of the pending decision; without consent the response is not looked at.

        Raises
        ------
        InputError
            On an action that the mode does not offer, or a response that it cannot show.
        """
        decision = self.pending
        assert decision is not None, "nothing is pending"
        choice = decision.choice if performed is None else self.words.choice(decision.mode, performed)
        if self.policy is None:
            return Outcome(choice, None)
        return Outcome(choice, self._observation(decision.mode, response))

    def _observation(self, mode: int, response: str | None) -> int | None:
        quiet = silent(self.responses, self.words, mode)
        if response is None:
            return 0 if quiet else None
        place = f"session, event {self.event + 1}, response in mode {self.words.modes[mode]}"
        if response not in self.words.observations:
            raise located(place, response, f"one of {', '.join(self.words.observations)}")
        number, possible = self.words.observations.index(response), self.responses[mode]
        if possible is not None and number not in possible:
            names = ", ".join(self.words.observations[o] for o in possible)
            raise located(place, response, "none: that mode shows no response" if quiet else f"one of {names}")
        return number

    def check(self, outcome: Outcome, mode: int) -> None:
        """Refuse an outcome and the mode after it if the next decision would be refused; nothing changes.

        Raises
        ------
        InputError
        """
        trial = copy(self)
        trial.observed(outcome)
        trial.decide(mode)

    def observe_entry(self, outcome: Outcome) -> dict[str, Any]:
        """What the log says of an outcome: without consent nothing of the response."""
        decision = self.pending
        assert decision is not None, "nothing is pending"
        entry: dict[str, Any] = {"event": "observe", "k": self.event}
        if self.policy is not None:
            seen = outcome.observation
            entry["response"] = None if seen is None else self.words.observations[seen]
        if outcome.choice != decision.choice:
            entry["performed"] = self.words.actions[decision.mode][outcome.choice]
        return entry

    def observed(self, outcome: Outcome) -> None:
        """Take the outcome; it counts once the next mode is known."""
        self.held = None if self.policy is None else outcome
        self.pending = None
        self.event += 1

    # -- consent -----------------------------------------------------------------------------------
    def withdraw(self) -> None:
        """Forget everything about the person: memory, response, all but what is done of the pending decision.

        The policy goes too, and forgets the histories that it has worked on: somebody else may hold it.
        """
        self.consent = Consent.WITHDRAWN
        policy, self.policy = self.policy, None
        self.memory = self.held = None
        if self.pending is not None:
            done = self.pending
            self.pending = Decision(done.mode, done.choice, done.action, done.choice)
        if policy is not None:
            policy.forget()

    def skip(self, entry: Mapping[str, Any]) -> None:
        """Note an entry from before the withdrawal without working out anything about the person."""
        if entry.get("event") == "decide":
            mode = self.words.mode(entry.get("mode"))  # type: ignore[arg-type]  # it refuses what is none
            choice = self.words.choice(mode, entry.get("action"))  # type: ignore[arg-type]
            self.pending = Decision(mode, choice, self.words.actions[mode][choice], choice)
        elif entry.get("event") == "observe":
            self.pending, self.event = None, self.event + 1

    # -- files -------------------------------------------------------------------------------------
    def start_entry(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """What the log says first: all that a replay needs, `content` being that of the policy's file."""
        return {
            "event": "start", "schema": SCHEMA, "consent": self.consent is Consent.GIVEN, "seed": self.seed,
            "policy": pack(content), "fallback": pack(policy_to_dict(self.fallback)),
            "responses": responses_to_dict(self.responses, self.words), "numpy": np.__version__,
        }  # fmt: skip

    @classmethod
    def from_start(cls, entry: Mapping[str, Any], place: str, *, believes: bool = True) -> Course:
        """The course that a start entry begins.

        Parameters
        ----------
        entry : mapping
        place : str
            Named in error messages.
        believes : bool
            False: the policy is not needed and not read.

        Raises
        ------
        InputError
            If the entry is none.
        """
        if entry.get("event") != "start" or entry.get("schema") != SCHEMA:
            found = Phrase(f"{entry.get('event')!r} with schema {entry.get('schema')!r}")
            raise located(place, found, f"'start' with schema {SCHEMA!r}")
        given, seed = entry.get("consent"), entry.get("seed")
        if not isinstance(given, bool):
            raise located(f"{place}, consent", given, "true or false")
        if not isinstance(seed, int):
            raise located(f"{place}, seed", seed, "a whole number")
        fallback = policy_from_dict(unpack(entry.get("fallback"), f"{place}, fallback"), f"{place}, fallback")
        policy = None
        if given and believes:
            policy = policy_from_dict(unpack(entry.get("policy"), f"{place}, policy"), f"{place}, policy")
        fallback = declared_fallback(fallback if policy is None else policy, fallback)
        responses = responses_from_dict(entry.get("responses"), fallback.vocabulary, f"{place}, responses")
        return cls(policy, fallback, responses, seed, Consent.GIVEN if given else Consent.NEVER)
