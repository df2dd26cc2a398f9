"""A policy with safeguards around it: itself a policy, for evaluation, simulation, the game and the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from models.errors import Phrase, located
from models.planning.baselines import ModeMemory, ModePolicy
from models.planning.policies import Array, Policy, Vocabulary
from models.safeguards.consent import Consent, check_fallback
from models.safeguards.safeguard import Proposal, Safeguard, Verdict
from models.safeguards.sentence import Decision, decide, decision_of, what_is_left, what_it_goes_by
from models.safeguards.worth import Worth, WorthSource, own_worth

__all__ = ["Decision", "Guarded", "GuardedMemory", "decide"]


@dataclass(frozen=True)
class GuardedMemory:
    """What is remembered of a run.

    Attributes
    ----------
    mode : int
    consent : Consent
    policy : object
        Memory of the policy; None without consent.
    states : tuple
        States of the safeguards; none without consent.
    source : object
        State of what worth comes from.
    event : int
        Events so far. No decision depends on it, so memories that differ in it only are equal.
    worth : Worth or None
        What actions are worth now; it follows from the rest.
    """

    mode: int
    consent: Consent
    policy: Any = None
    states: tuple[Any, ...] = ()
    source: Any = None
    event: int = field(default=0, compare=False)
    worth: Worth | None = field(default=None, compare=False, repr=False)


class Guarded(Policy):
    """A policy whose proposals are reviewed by safeguards before anything is done.

    Safeguards review in the order given, hard ones after all others; each is shown what the one before it left. The
    policy is told what was really done. Where a policy randomises, the probability of what it proposes moves to
    what the safeguards make of it.

    Parameters
    ----------
    policy : Policy
    safeguards : sequence of Safeguard
    fallback : ModePolicy
        What acts without consent; it looks at nothing but the mode.
    worth : WorthSource, optional
        What actions are worth; by default what the policy itself can say (`models.safeguards.worth.own_worth`).
    name : str, optional

    Raises
    ------
    InputError
        If the fallback adapts or spends what a budget could not stop, names differ, or a safeguard needs to know
        what actions are worth and nobody can say.

    Examples
    --------
    >>> from models.planning.baselines import always
    >>> from models.protocol import PUBLISHED
    >>> from models.safeguards.budget import CostBudget
    >>> from models.safeguards.consent import fallback_of
    >>> robot = Guarded(always(PUBLISHED), [CostBudget.of(PUBLISHED, 20)], fallback_of(PUBLISHED))
    >>> human, robot_needs_help = range(2)
    >>> memory = robot.observe(robot.begin(human), 1, 0, robot_needs_help)
    >>> decision = robot.decide(memory)
    >>> decision.action, decision.changed_by
    ('no_signal', ('budget',))
    >>> decision.explanation.split(";")[0]
    'no_signal instead of signal, because signal costs 15 and 5 of the budget of 20 is left (budget)'
    """

    def __init__(
        self, policy: Policy, safeguards: Sequence[Safeguard], fallback: Policy, worth: WorthSource | None = None,
        name: str = "",
    ) -> None:  # fmt: skip
        self.policy, self.name = policy, name or f"{policy.name}, guarded"
        self.vocabulary: Vocabulary = policy.vocabulary
        self.cautions = policy.cautions
        self.safeguards = tuple(sorted(safeguards, key=lambda s: s.hard))
        self.fallback: ModePolicy = check_fallback(fallback)
        self.worth_source = worth if worth is not None else own_worth(policy)
        self._check()

    def _check(self) -> None:
        place = f"policy {self.name}"
        if isinstance(self.policy, Guarded):
            raise located(place, Phrase("a guarded policy"), "one without safeguards; give all of them at once")
        for what, words in (("fallback", self.fallback.vocabulary), *((s.name, s.words) for s in self.safeguards)):
            if words != self.vocabulary:
                raise located(f"{place}, {what}, modes, actions and observations", words, str(self.vocabulary))
        names = [s.name for s in self.safeguards]
        for name in names:
            if names.count(name) > 1:
                raise located(f"{place}, safeguards", names, f"{name} once")
        if len({s.null for s in self.safeguards}) > 1:
            found = Phrase("others by safeguard")
            raise located(f"{place}, null actions", found, "the same for all")
        for s in self.safeguards:
            s.fits(self.worth_source, self.fallback)

    # -- what is done ------------------------------------------------------------------------------
    @property
    def randomised(self) -> bool:
        """Whether the policy or the fallback randomises."""
        return self.policy.randomised or self.fallback.randomised

    def review(self, memory: GuardedMemory, proposed: int) -> tuple[int, list[tuple[str, int, Verdict]]]:
        """What the safeguards make of a proposal: the choice, and by safeguard what it was shown and said."""
        choice, said = proposed, []
        for guard, state in zip(self.safeguards, memory.states, strict=True):
            proposal = Proposal(memory.mode, memory.event, choice, proposed, memory.worth)
            verdict = guard.review(state, proposal)
            said.append((guard.name, choice, verdict))
            choice = verdict.choice
        return choice, said

    def probabilities(self, memory: GuardedMemory) -> Array:
        """Probability of each choice after review."""
        if memory.consent is not Consent.GIVEN:
            return self.fallback.shares[memory.mode]
        share = self.policy.probabilities(memory.policy)
        out = np.zeros(len(share))
        for c, p in enumerate(share.tolist()):
            if p > 0:
                out[self.review(memory, c)[0]] += p
        return out

    def act(self, memory: GuardedMemory, rng: np.random.Generator | None = None) -> int:
        """What is done; with the same luck the same as `decide` says."""
        return self._proposed(memory, rng)[1]

    def _proposed(
        self, memory: GuardedMemory, rng: np.random.Generator | None
    ) -> tuple[int, int, list[tuple[str, int, Verdict]]]:
        """What is proposed, what is done, and what safeguards said."""
        if rng is None and self.randomised:
            raise located(f"policy {self.name}, rng", None, "a random generator: the policy randomises")
        if memory.consent is not Consent.GIVEN:
            choice = self.fallback.act(ModeMemory(memory.mode), rng)
            return choice, choice, []
        proposed = self.policy.act(memory.policy, rng)
        choice, said = self.review(memory, proposed)
        return proposed, choice, said

    def decide(self, memory: GuardedMemory, rng: np.random.Generator | None = None) -> Decision:
        """What is done, with its sentence.

        Parameters
        ----------
        memory : GuardedMemory
        rng : numpy.random.Generator, optional
            Needed where the policy or the fallback randomises.
        """
        proposed, choice, said = self._proposed(memory, rng)
        if memory.consent is not Consent.GIVEN:
            why = "never given" if memory.consent is Consent.NEVER else "withdrawn"
            goes_by = what_it_goes_by(self.fallback, ModeMemory(memory.mode))
            return decision_of(
                self.vocabulary, memory.mode, choice, proposed,
                place=f"consent was {why}, so {goes_by}, and nothing is believed",
            )  # fmt: skip
        share = float(self.policy.probabilities(memory.policy)[proposed]) if self.policy.randomised else 1.0
        source = self.worth_source
        return decision_of(
            self.vocabulary, memory.mode, choice, proposed, worth=memory.worth, verdicts=said, share=share,
            states=() if source is None else source.states,
            place=(what_it_goes_by if memory.worth is None else what_is_left)(self.policy, memory.policy),
        )  # fmt: skip

    def reason(self, memory: GuardedMemory) -> str:
        """What it does and why, in one sentence; for a policy that randomises, with its chances."""
        return super().reason(memory) if self.randomised else self.decide(memory).explanation

    # -- the interface -----------------------------------------------------------------------------
    def begin(self, mode: int, consent: Consent = Consent.GIVEN) -> GuardedMemory:
        """Memory before anything has happened."""
        m = self.vocabulary.mode(mode)
        if consent is not Consent.GIVEN:
            return GuardedMemory(m, consent)
        own = self.policy.begin(m)
        states = tuple(s.begin(m) for s in self.safeguards)
        source = None if self.worth_source is None else self.worth_source.begin(own)
        return self._remember(m, own, states, source, 0)

    def _remember(self, mode: int, own: Any, states: tuple[Any, ...], source: Any, event: int) -> GuardedMemory:
        worth = None if self.worth_source is None else self.worth_source.worth(source, own)
        return GuardedMemory(mode, Consent.GIVEN, own, states, source, event, worth)

    def mode_of(self, memory: GuardedMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def observe(
        self, memory: GuardedMemory, choice: int, observation: int | None, next_mode: int
    ) -> GuardedMemory:  # fmt: skip
        """Everybody is told what was really done; without consent nothing is kept but the mode."""
        self.check_step(memory, choice, observation, next_mode)
        if memory.consent is not Consent.GIVEN:
            return replace(memory, mode=int(next_mode))
        own = self.policy.observe(memory.policy, choice, observation, next_mode)
        states = tuple(
            guard.observe(state, memory.mode, choice, observation, next_mode)
            for guard, state in zip(self.safeguards, memory.states, strict=True)
        )
        source = memory.source
        if self.worth_source is not None:
            source = self.worth_source.observe(source, memory.mode, choice, observation, own)
        return self._remember(int(next_mode), own, states, source, memory.event + 1)

    # -- consent -----------------------------------------------------------------------------------
    def withdraw(self, memory: GuardedMemory) -> GuardedMemory:
        """The memory after consent was withdrawn: the mode, and nothing else."""
        self.forget()
        return GuardedMemory(memory.mode, Consent.WITHDRAWN)

    def forget(self) -> None:
        """Forget what was worked out along the way, values and plans: it tells of the histories it was for."""
        self.policy.forget()
        if self.worth_source is not None:
            self.worth_source.forget()

    def without_consent(self) -> ModePolicy:
        """What acts without consent; it believes nothing."""
        return self.fallback

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy."""
        from models.planning.policy_files import policy_to_dict

        source = self.worth_source
        return {
            "kind": "guarded", "name": self.name, "policy": policy_to_dict(self.policy),
            "safeguards": [s.to_dict() for s in self.safeguards], "fallback": policy_to_dict(self.fallback),
            "null": self._null(),
            "worth": None if source is None else source.to_dict(),
        }  # fmt: skip

    def _null(self) -> list[str] | None:
        """Null action of each mode, as the safeguards have it."""
        if not self.safeguards:
            return None
        return [a[c] for a, c in zip(self.vocabulary.actions, self.safeguards[0].null, strict=True)]
