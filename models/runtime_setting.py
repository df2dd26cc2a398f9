"""What a session has to know beside its policy: which responses a mode can show, and what acts without consent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from models.errors import Phrase, located
from models.planning.baselines import ModePolicy
from models.planning.belief_policy import BeliefPolicy
from models.planning.controller import FiniteStateController
from models.planning.mixed_policy import MixedPolicy
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Policy, Vocabulary
from models.planning.product_policy import ProductPolicy
from models.protocol import NO_RESPONSE, PUBLISHED, Protocol
from models.safeguards.consent import check_fallback, fallback_of
from models.safeguards.guarded import Guarded

Responses = tuple[tuple[int, ...] | None, ...]
"""By mode the observations that it can show, ``(0,)`` for `none`, the lack of a response; None: not known."""


def protocol_of(policy: Policy, protocol: Protocol | None = None) -> Protocol | None:
    """The protocol of a policy: the one given, the policy's own, or the published one where all names agree.

    Raises
    ------
    InputError
        If the one given has other modes, actions or responses than the policy.
    """
    words = policy.vocabulary
    if protocol is not None:
        if Vocabulary.of(protocol) != words:
            found = Phrase(str(Vocabulary.of(protocol)))
            raise located(f"protocol {protocol.name}", found, f"the names of the policy: {words}")
        return protocol
    inner: Any = policy
    while inner is not None:
        own = inner.beliefs.draws.protocol if isinstance(inner, ProductPolicy) else getattr(inner, "protocol", None)
        if isinstance(own, Protocol) and Vocabulary.of(own) == words:
            return own
        inner = getattr(inner, "policy", None)
    return PUBLISHED if Vocabulary.of(PUBLISHED) == words else None


def responses_of(policy: Policy, protocol: Protocol | None = None) -> Responses:
    """The observations that each mode can show, by the protocol or else as far as the policy knows.

    Examples
    --------
    >>> from models.planning.baselines import never
    >>> responses_of(never(PUBLISHED))
    ((0,), (1, 2))
    """
    found = protocol_of(policy, protocol)
    if found is not None:
        shown = tuple(range(1, found.n_responses + 1))
        return tuple(shown if mode.shows_response else (0,) for mode in found.modes)
    inner = policy
    while hasattr(inner, "policy"):
        inner = inner.policy
    n, seen = len(policy.vocabulary.modes), len(policy.vocabulary.observations)
    if isinstance(inner, BeliefPolicy) and len(inner.tracker.outcomes) == n:
        return tuple(
            tuple(sorted({z.observation for outcomes in offered for z in outcomes}))
            for offered in inner.tracker.outcomes
        )
    if isinstance(inner, PlanPolicy | MixedPolicy):
        outcomes = dict(zip(inner.modes, inner.outcomes, strict=True))
        return tuple(None if x not in outcomes else _shown(outcomes[x]) for x in range(n))
    if isinstance(inner, FiniteStateController):
        lead = [np.any(inner.follow[inner.mode == x] >= 0, axis=(0, 1)) for x in range(n)]
        return tuple(tuple(np.flatnonzero(o).tolist()) or None for o in lead if len(o) == seen)
    return (None,) * n


def silent(responses: Responses, words: Vocabulary, mode: int) -> bool:
    """Whether a mode shows no response for sure."""
    return responses[mode] == (0,) and words.observations[0] == NO_RESPONSE


def declared_fallback(
    policy: Policy, fallback: Policy | Mapping[str, str] | None, protocol: Protocol | None = None
) -> ModePolicy:
    """What acts without consent: the one given, that of a guarded policy, or the null action of every mode.

    Parameters
    ----------
    policy : Policy
    fallback : Policy, or mapping of str to str, optional
        Action by mode; the null action where nothing is said.
    protocol : Protocol, optional
        Says which actions are null; not needed where the policy knows, or has the published names.

    Raises
    ------
    InputError
        If it adapts, has other names than the policy, does not fit its safeguards (a budget wants free actions), or
        nothing says what the null actions are.
    """
    if isinstance(fallback, Policy):
        found = check_fallback(fallback)
    elif fallback is None and isinstance(policy, Guarded):
        found = policy.fallback
    else:
        known = protocol_of(policy, protocol)
        found = _by_names(policy.vocabulary, fallback or {}) if known is None else fallback_of(known, fallback)
    if found.vocabulary != policy.vocabulary:
        raise located(
            f"fallback {found.name}, modes, actions and observations", Phrase(str(found.vocabulary)),
            str(policy.vocabulary),
        )  # fmt: skip
    if isinstance(policy, Guarded):
        for guard in policy.safeguards:
            guard.fits(policy.worth_source, found)
    return found


def _by_names(words: Vocabulary, actions: Mapping[str, str]) -> ModePolicy:
    """One action for every mode, all of them named: nothing says which are null."""
    given = {words.mode(mode): words.choice(words.mode(mode), action) for mode, action in actions.items()}
    for x, name in enumerate(words.modes):
        if x not in given:
            wanted = "one declared: neither policy nor protocol says which action is null there"
            raise located(f"fallback without consent, mode {name}", None, wanted)
    shares = [np.eye(len(offered))[given[x]] for x, offered in enumerate(words.actions)]
    return ModePolicy(words, shares, "fallback")


def responses_to_dict(responses: Responses, words: Vocabulary) -> dict[str, Any]:
    """Plain content: names of the observations of each mode."""
    return {
        mode: None if shown is None else [words.observations[o] for o in shown]
        for mode, shown in zip(words.modes, responses, strict=True)
    }


def responses_from_dict(content: Any, words: Vocabulary, place: str) -> Responses:
    """Read what `responses_to_dict` wrote.

    Raises
    ------
    InputError
        On other modes or observations.
    """
    if not isinstance(content, Mapping) or tuple(content) != words.modes:
        raise located(place, content, f"observations by mode: {', '.join(words.modes)}")
    out: list[tuple[int, ...] | None] = []
    for shown in content.values():
        known = isinstance(shown, list) and all(o in words.observations for o in shown)
        if not known and shown is not None:
            raise located(place, shown, f"names among {', '.join(words.observations)}, or null")
        out.append(None if shown is None else tuple(words.observations.index(o) for o in shown))
    return tuple(out)


def _shown(outcomes: int) -> tuple[int, ...]:
    return (0,) if outcomes == 1 else tuple(range(1, outcomes + 1))
