"""Consent: without it, or once it is withdrawn, a declared fallback acts, and what was believed is deleted."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from models.errors import Phrase, located
from models.planning.baselines import ModePolicy, never
from models.planning.policies import Policy, Vocabulary
from models.protocol import Protocol


class Consent(Enum):
    """Whether a person agreed that the robot adapts to them."""

    GIVEN = "given"
    WITHDRAWN = "withdrawn"
    NEVER = "never"


def fallback_of(protocol: Protocol, actions: Mapping[str, str] | None = None, name: str = "fallback") -> ModePolicy:
    """The declared fallback: one action a mode, whatever happens.

    Parameters
    ----------
    protocol : Protocol
    actions : mapping of str to str, optional
        Action by mode; the null action where nothing is said.

    Raises
    ------
    InputError
        On an unknown mode or action.
    """
    words, given = Vocabulary.of(protocol), dict(actions or {})
    for mode, action in given.items():
        words.choice(words.mode(mode), action)
    chosen = [given.get(m.name, m.null_action) for m in protocol.modes]
    shares = [[float(a.name == c) for a in m.actions] for m, c in zip(protocol.modes, chosen, strict=True)]
    return ModePolicy(words, shares, name) if given else never(protocol, name)


def check_fallback(fallback: Policy) -> ModePolicy:
    """Refuse a fallback that adapts.

    Raises
    ------
    InputError
        If its actions may depend on anything but the mode.
    """
    if not isinstance(fallback, ModePolicy):
        found = Phrase(f"{fallback.name} ({type(fallback).__name__}), which may adapt to the person")
        raise located("fallback without consent", found, "a policy by mode: its actions depend on nothing else")
    return fallback
