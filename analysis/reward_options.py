"""The reward as options of a command change it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.errors import InputError, Phrase, located
from models.protocol import Protocol
from models.reward import Reward


def reward_asked(reward: Reward, protocol: Protocol, r: float | None, costs: Mapping[str, float | None]) -> Reward:
    """The reward with another steepness and other costs, as far as options say.

    Raises
    ------
    InputError
        On an action that the protocol does not have, or rewards too large for a number.
    """
    asked = {name: value for name, value in costs.items() if value is not None}
    for name in asked:
        if name not in protocol.action_names:
            wanted = f"one of {', '.join(protocol.action_names)}"
            raise located(f"cost of {name}", Phrase(f"action {name}"), wanted)
    changed = replace(reward, costs={**reward.costs, **asked})
    if r is None:
        return changed
    try:
        return replace(changed, r=r)
    except InputError:
        wanted = f"a steepness at which exp(r x) is a finite number, x up to {max(reward.x):g}"
        raise located("--r", r, wanted) from None
