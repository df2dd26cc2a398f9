"""The published design of study 1: conditions, schedules, and the log of a study before anybody responds."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.events import EventLog
from models.histories import UNSEEN
from models.protocol import PUBLISHED

DATA_FOLDER = Path(__file__).resolve().parent.parent / "data"
"""The checkout's `data/`: cards, bundled files, printed numbers."""


@dataclass(frozen=True)
class Condition:
    """One arm: how many people it had, and the robot's action in each mode throughout (mode name to action)."""

    name: str
    participants: int
    actions: dict[str, str]


@dataclass(frozen=True)
class StudyDesign:
    """Conditions and schedules of a study in which the robot's action is constant within a person.

    Attributes
    ----------
    conditions : tuple of Condition
    schedules : tuple of str
        Letters as published (``H``: the human may help); `Protocol.modes_from_letters` converts them.
    """

    conditions: tuple[Condition, ...]
    schedules: tuple[str, ...]

    @property
    def participants(self) -> int:
        """People in the study as published."""
        return sum(c.participants for c in self.conditions)

    def allocation(self, participants: int) -> NDArray[np.int64]:
        """People a condition in the published proportions, by largest remainder; ties go to the first."""
        if participants < 1:
            raise located("participants", participants, "at least 1")
        share = np.array([c.participants for c in self.conditions], dtype=np.int64) * participants
        whole, remainder = share // self.participants, share % self.participants
        left = participants - int(whole.sum())
        whole[np.argsort(-remainder, kind="stable")[:left]] += 1
        return whole

    def draw(self, participants: int, study: str, rng: np.random.Generator) -> EventLog:
        """Assign people to conditions and schedules at random; the log's responses are placeholders.

        Conditions have fixed sizes (`allocation`) in random order, schedules are uniform for every person.
        Only `rng.random` is used, so a seed gives the same design with every version of numpy.

        Parameters
        ----------
        participants : int
        study : str
            Written into the log's study column.
        rng : numpy.random.Generator

        Returns
        -------
        EventLog
            Participants 1..n, one run each; the first response wherever one shows.
        """
        by_size = np.repeat(np.arange(len(self.conditions)), self.allocation(participants))
        uniform = rng.random((participants, 2))
        condition = by_size[np.argsort(uniform[:, 0], kind="stable")]
        schedule = np.minimum((uniform[:, 1] * len(self.schedules)).astype(np.int64), len(self.schedules) - 1)

        p = PUBLISHED
        rounds = np.array([len(letters) for letters in self.schedules])
        table = np.full((len(self.conditions), len(self.schedules), rounds.max()), -1, dtype=np.int8)
        for c, arm in enumerate(self.conditions):
            for s, letters in enumerate(self.schedules):
                actions = [p.action(arm.actions[m.name]) for m in p.modes_from_letters(letters)]
                table[c, s, : len(actions)] = actions
        by_person = table[condition, schedule]
        action = by_person[by_person >= 0]
        response = np.where(np.asarray(p.emission_index)[action] >= 0, 0, UNSEEN).astype(np.int8)
        names = tuple(sorted(c.name for c in self.conditions))
        rank = np.array([names.index(c.name) for c in self.conditions], dtype=np.int32)
        used = np.unique(rank[condition])
        compact = np.full(len(names), -1, dtype=np.int32)
        compact[used] = np.arange(len(used))
        return EventLog(
            p,
            study,
            np.append(0, np.cumsum(rounds[schedule])).astype(np.int64),
            np.arange(1, participants + 1),
            np.zeros(participants, dtype=np.int64),
            compact[rank[condition]],
            tuple(names[i] for i in used),
            action,
            response,
        )


@cache
def published() -> dict[str, Any]:
    """Every number the paper prints that this project compares itself with (`data/published.json`)."""
    content: dict[str, Any] = json.loads((DATA_FOLDER / "published.json").read_text(encoding="utf-8"))
    return content


@cache
def study1_design() -> StudyDesign:
    """Study 1: 540 people, five rounds, four conditions such as ``help+no-signal``, six schedules.

    Examples
    --------
    >>> [(c.name, c.participants) for c in study1_design().conditions][:2]
    [('help+no-signal', 177), ('help+signal', 164)]
    >>> study1_design().allocation(100)
    array([33, 30, 19, 18])
    """
    printed = published()["study1"]
    conditions = []
    for name, participants in printed["conditions"].items():
        helping, signalling = (part.replace("-", "_") for part in name.split("+"))
        actions = {"human_needs_help": helping, "robot_needs_help": signalling}
        conditions.append(Condition(name, participants, actions))
    return StudyDesign(tuple(conditions), tuple(printed["sequences"]))
