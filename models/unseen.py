"""Actions without evidence: what a fit says about them is its prior, so plans leave them out unless asked for.

The data say how the state moves after an action only if some event of it is followed by another one, and what
people do under an action only if a response to it was recorded.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.design_facts import Study
from models.errors import Phrase, located
from models.events import EventLog
from models.histories import UNSEEN, HistoryTree
from models.model_draws import ModelDraws
from models.protocol import Protocol

EVIDENCE = "evidence_of_actions"
"""Where the settings of a fit say what `evidence_of_actions` says of its data, if they do."""


def evidence_of_actions(log: Study, pins: Collection[str] = ()) -> dict[str, int]:
    """How many events of a log tell about each action, by name: those followed by another one.

    None do where the mode shows responses and none was recorded under the action. Of actions whose transition table
    is held fixed every event counts, for what follows is not learned.

    Parameters
    ----------
    log : EventLog, or CompressedLog
    pins : collection of str
        Actions whose transition table is held fixed.
    """
    p = log.protocol
    index = np.asarray(p.emission_index)
    shows = index >= 0
    held = np.isin(np.arange(p.n_actions), [p.action(a) for a in pins])
    if isinstance(log, EventLog):
        followed = np.append(log.run_of_event[1:] == log.run_of_event[:-1], False)
        events = np.bincount(log.action[followed | held[log.action]], minlength=p.n_actions)
        responses = np.bincount(log.action[log.response != UNSEEN], minlength=p.n_actions)
    else:
        every, before_another = _events_of(log.tree())
        events = np.where(held, every, before_another)
        responses = np.where(shows, log.emission_weights[index], 0)
    return dict(zip(p.action_names, np.where(shows & (responses == 0), 0, events).tolist(), strict=True))


def _events_of(tree: HistoryTree) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Events of each action, and how many of them another one followed."""
    through = tree.arrays.ends.copy()
    # Nodes lie by depth: what passes through them is known once all that follow are.
    level = np.searchsorted(tree.depth, np.arange(int(tree.depth[-1]) + 2))
    for depth in range(len(level) - 2, 0, -1):
        own = slice(level[depth], level[depth + 1])
        np.add.at(through, tree.parent[own], through[own])
    action = tree.arrays.action[1:]
    counts = (np.bincount(action, n[1:], tree.n_actions) for n in (through, through - tree.arrays.ends))
    every, before_another = (np.rint(n).astype(np.int64) for n in counts)
    return every, before_another


def unseen_actions(evidence: Mapping[str, int], protocol: Protocol) -> tuple[str, ...]:
    """Actions without evidence, in the protocol's order; one that is not named has none."""
    return tuple(a for a in protocol.action_names if evidence.get(a, 0) == 0)


def recorded_evidence(settings: Mapping[str, Any], protocol: Protocol) -> dict[str, int] | None:
    """What the settings of a fit say of the evidence on its actions; None if they do not.

    Raises
    ------
    InputError
        If what they say is no count of this protocol's actions.
    """
    found = settings.get(EVIDENCE)
    if found is None:
        return None
    good = isinstance(found, Mapping) and all(
        name in protocol.action_names and isinstance(n, int) and n >= 0 for name, n in found.items()
    )
    if not good:
        raise located(f"settings, {EVIDENCE}", found, "a count for each action")
    return dict(found)


def without_actions(draws: ModelDraws, names: Sequence[str]) -> ModelDraws:
    """The draws of a robot that does not have some actions.

    Parameters
    ----------
    draws : ModelDraws
    names : sequence of str

    Raises
    ------
    InputError
        On an unknown action, or a null action: nothing could be compared with leaving people alone.
    """
    p = draws.protocol
    gone = {p.action(name) for name in names}
    if not gone:
        return draws
    for mode in p.modes:
        if mode.null_action in names:
            found = Phrase(f"{mode.null_action}, the null action of {mode.name}")
            raise located("actions to leave out", found, "actions other than the null action of their mode")
    modes = tuple(replace(m, actions=tuple(a for a in m.actions if a.name not in names)) for m in p.modes)
    smaller = replace(p, name=f"{p.name} without {', '.join(names)}", modes=modes)
    kept = [a for a in range(p.n_actions) if a not in gone]
    rows = [p.emission_index[a] for a in kept if p.emission_index[a] >= 0]
    reward = draws.reward
    if reward is not None:
        reward = replace(reward, costs={a: c for a, c in reward.costs.items() if a not in names})
    return replace(
        draws, protocol=smaller, transition=np.ascontiguousarray(draws.transition[:, kept]),
        emission=np.ascontiguousarray(draws.emission[:, rows]), reward=reward,
    )  # fmt: skip
