"""What a study's design can say about the tables, whoever answered how: which action followed, who met what.

All that learning and its report of what is identified take from a log beside its tree. It fits into a few small
tables of actions by actions, so logs that are too large to be held have it too (`models.compressed_log`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, runtime_checkable
from typing import Protocol as Structural

import numpy as np
from numpy.typing import NDArray

from models.histories import UNSEEN, HistoryTree
from models.protocol import Protocol


class DesignFacts(NamedTuple):
    """Facts of a design.

    Attributes
    ----------
    followed : bool[a]
        Whether the action was ever followed by another event of its run.
    alternating : bool
        Modes never repeat within a run, although responses are seen on both sides of a silent event.
    met : bool[a, a]
        Whether one person met both actions.
    responded : bool[a, a]
        Whether one person has a recorded response under both actions.
    responded_and_met : bool[a, a]
        Whether one person has a recorded response under the first and met the second.
    """

    followed: NDArray[np.bool_]
    alternating: bool
    met: NDArray[np.bool_]
    responded: NDArray[np.bool_]
    responded_and_met: NDArray[np.bool_]


@runtime_checkable
class Study(Structural):
    """What a learner of tables needs of a study: an `EventLog`, or a `CompressedLog`."""

    @property
    def protocol(self) -> Protocol:
        """Modes, actions and responses."""

    @property
    def study(self) -> str:
        """Name of the study."""

    @property
    def conditions(self) -> Sequence[str]:
        """Names, sorted."""

    @property
    def n_events(self) -> int:
        """Number of events."""

    @property
    def n_runs(self) -> int:
        """Number of runs."""

    @property
    def n_participants(self) -> int:
        """Number of people."""

    @property
    def n_responses_recorded(self) -> int:
        """Number of recorded responses."""

    @property
    def n_missing(self) -> int:
        """Responses that could have been seen but were not recorded."""

    @property
    def emission_weights(self) -> NDArray[np.float64]:
        """Recorded responses under each action that shows one."""

    @property
    def design(self) -> DesignFacts:
        """Facts of the design."""

    def tree(self) -> HistoryTree:
        """Distinct histories with counts."""


def facts_of_events(
    protocol: Protocol, offsets: NDArray[np.int64], participant: NDArray[np.int64], action: NDArray[np.int8],
    response: NDArray[np.int8],
) -> DesignFacts:  # fmt: skip
    """Facts of coded runs (`EventLog` documents the arrays)."""
    followed = np.ones(len(action), dtype=bool)
    followed[offsets[1:] - 1] = False
    run = np.repeat(np.arange(len(participant)), np.diff(offsets))
    mode = np.asarray(protocol.mode_of_action)[action]
    shows = np.asarray(protocol.emission_index)[action] >= 0
    inside = run[1:] == run[:-1]
    around = run[2:] == run[:-2]
    alternating = not np.any(inside & (mode[1:] == mode[:-1])) and bool(
        np.any(around & shows[2:] & ~shows[1:-1] & shows[:-2])
    )
    person = np.unique(participant, return_inverse=True)[1][run]
    n_people = int(person.max()) + 1
    met = np.zeros((n_people, protocol.n_actions), dtype=bool)
    met[person, action] = True
    responded = np.zeros_like(met)
    recorded = response != UNSEEN
    responded[person[recorded], action[recorded]] = True
    return DesignFacts(
        np.bincount(action[followed], minlength=protocol.n_actions) > 0, alternating,
        _pairs(met, met), _pairs(responded, responded), _pairs(responded, met),
    )  # fmt: skip


def facts_of_tree(tree: HistoryTree, protocol: Protocol) -> tuple[NDArray[np.bool_], bool]:
    """What a tree says of its design: which actions were followed, and whether modes alternate strictly."""
    action, parent = tree.arrays.action, tree.parent
    followed = np.bincount(action[1:][tree.arrays.n_children[1:] > 0], minlength=protocol.n_actions) > 0
    mode = np.asarray(protocol.mode_of_action)
    shows = np.asarray(protocol.emission_index) >= 0
    node = np.flatnonzero(parent > 0)
    before = parent[node]
    if np.any(mode[action[node]] == mode[action[before]]):
        return followed, False
    third = parent[before] > 0
    node, before = node[third], before[third]
    around = shows[action[node]] & ~shows[action[before]] & shows[action[parent[before]]]
    return followed, bool(np.any(around))


def _pairs(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.stack([other[one[:, a]].any(axis=0) for a in range(one.shape[1])])
