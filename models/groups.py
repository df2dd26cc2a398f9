"""Groups of people whose tables may differ: by condition, or by something known about each person.

A grouped model is the plain one under a larger alphabet: action `a` of group `g` is coded ``g * actions + a``, so
that the tree of histories separates the groups and every kernel works unchanged. Tables that the groups share are
tied: `GroupedLayout` holds each of them once.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, Phrase, located
from models.event_rules import one_of
from models.events import EventLog
from models.histories import UNSEEN, HistoryTree
from models.parameters import Array, Layout

TABLES = ("initial", "transition", "emission")

FEW_PEOPLE = 10
"""People below which a group is called small."""

MANY_GROUPS = 10
"""Groups above which a covariate is probably no category."""


class GroupWarning(UserWarning):
    """Groups whose own tables will hardly be learned."""


class EmptyGroupWarning(GroupWarning):
    """Nobody of a group has a recorded response: its tables are their prior."""


class SmallGroupWarning(GroupWarning):
    """A group has few people: its tables are mostly their prior."""


class ManyGroupsWarning(GroupWarning):
    """So many groups that the covariate is probably a number, of which every value became a group."""


@dataclass(frozen=True)
class Groups:
    """Which group each run belongs to, and which tables differ between groups.

    Attributes
    ----------
    by : str
        What the groups are made of, for people: ``condition``, or the name of the covariate.
    labels : tuple of str
    run_group : int64[runs]
        Index into `labels`, in the order of the log's runs.
    differ : tuple of str
        Some, not all, of ``initial``, ``transition``, ``emission``; the others are shared.
    """

    by: str
    labels: tuple[str, ...]
    run_group: NDArray[np.int64]
    differ: tuple[str, ...] = ("initial",)

    def __post_init__(self) -> None:
        for name in self.differ:
            if name not in TABLES:
                raise located("tables that differ by group", name, one_of(TABLES))
        if not self.differ:
            raise located("tables that differ by group", Phrase("none"), "at least one")
        if set(self.differ) == set(TABLES):
            raise located(
                "tables that differ by group", Phrase("all of them"),
                "one shared at least: groups that share nothing, not even what their states mean, are fitted "
                "separately",
            )  # fmt: skip
        if len(self.labels) < 2:
            raise located(f"groups by {self.by}", list(self.labels), "at least two groups")
        if len(set(self.labels)) != len(self.labels):
            raise located(f"groups by {self.by}, labels", list(self.labels), "labels that differ")
        outside = (self.run_group < 0) | (self.run_group >= len(self.labels))
        if np.any(outside):
            raise located(f"groups by {self.by}", int(self.run_group[outside][0]), f"0..{len(self.labels) - 1}")
        used = np.bincount(self.run_group, minlength=len(self.labels))
        if np.any(used == 0):
            empty = self.labels[int(np.flatnonzero(used == 0)[0])]
            raise located(f"groups by {self.by}, runs in group {empty}", 0, "at least one")

    @classmethod
    def by_condition(cls, log: EventLog, differ: Sequence[str] = ("initial",)) -> Groups:
        """One group a condition."""
        return cls("condition", tuple(log.conditions), log.condition.astype(np.int64), tuple(differ))

    @classmethod
    def by_person(
        cls, log: EventLog, value: Mapping[int, object], name: str, differ: Sequence[str] = ("initial",)
    ) -> Groups:
        """One group a value of a covariate.

        Parameters
        ----------
        log : EventLog
        value : mapping
            Participant id to the covariate's value; every participant of the log must have one.
        name : str
            Name of the covariate.
        differ : sequence of str

        Raises
        ------
        InputError
            On a participant without a value, or fewer than two values.
        """
        people = np.unique(log.participant)
        absent = [int(p) for p in people if _nothing(value.get(int(p)))]
        if absent:
            raise InputError(
                f"groups by {name}: participant {absent[0]} has no value"
                + (f" (nor have {len(absent) - 1} others)" if len(absent) > 1 else "")
                + "; every participant of the log needs one"
            )
        texts = {int(p): str(value[int(p)]) for p in people}
        labels = tuple(sorted(set(texts.values())))
        number = {label: i for i, label in enumerate(labels)}
        runs = np.array([number[texts[int(p)]] for p in log.participant], dtype=np.int64)
        return cls(name, labels, runs, tuple(differ))

    @property
    def n(self) -> int:
        """Number of groups."""
        return len(self.labels)

    def tree(self, log: EventLog) -> HistoryTree:
        """Distinct histories with counts, actions coded by group.

        Raises
        ------
        InputError
            If the groups were made for another log.
        """
        if len(self.run_group) != log.n_runs:
            raise located(f"groups by {self.by}, runs", len(self.run_group), f"{log.n_runs}, as in the log")
        actions = log.protocol.n_actions
        coded = log.action + actions * np.repeat(self.run_group, np.diff(log.offsets))
        return HistoryTree.build(
            log.offsets, coded.astype(np.int16), log.response, self.n * actions, log.protocol.n_responses
        )

    def emission_weights(self, log: EventLog) -> Array:
        """Recorded responses under each response-showing action of each group, ``[g * e]``."""
        tables = len(log.protocol.emission_actions)
        seen = log.response != UNSEEN
        index = np.asarray(log.protocol.emission_index)[log.action] + tables * self.run_group[log.run_of_event]
        return np.bincount(index[seen], minlength=self.n * tables).astype(np.float64)

    def warn_of_thin_ones(self, log: EventLog) -> None:
        """Warn, by name, of groups without responses, of small ones, and of very many.

        Warns
        -----
        EmptyGroupWarning, SmallGroupWarning, ManyGroupsWarning
        """
        place = f"groups by {self.by}"
        if self.n > MANY_GROUPS:
            warnings.warn(
                f"{place}: {self.n} groups, more than {MANY_GROUPS}; covariates are categories: a number, such as "
                "an age, has to be cut into a few classes first",
                ManyGroupsWarning, stacklevel=3,
            )  # fmt: skip
        seen = self.run_group[log.run_of_event[log.response != UNSEEN]]
        responses = np.bincount(seen, minlength=self.n)
        empty = [label for label, count in zip(self.labels, responses, strict=True) if count == 0]
        if empty:
            warnings.warn(
                f"{place}: nobody in {_named(empty)} has a recorded response; what differs by group is its prior "
                "there",
                EmptyGroupWarning, stacklevel=3,
            )  # fmt: skip
        people = [len(np.unique(log.participant[self.run_group == g])) for g in range(self.n)]
        small = [f"{label} ({n})" for label, n in zip(self.labels, people, strict=True) if n < FEW_PEOPLE]
        if small:
            warnings.warn(
                f"{place}: fewer than {FEW_PEOPLE} people in {_named(small)}; what differs by group is mostly its "
                "prior there",
                SmallGroupWarning, stacklevel=3,
            )  # fmt: skip

    def to_dict(self) -> dict[str, object]:
        """What identifies the groups, for settings and keys of stored fits."""
        members = hashlib.sha256(self.run_group.astype("<i8").tobytes()).hexdigest()[:16]
        return {"by": self.by, "labels": list(self.labels), "differ": list(self.differ), "members": members}


@dataclass(frozen=True)
class GroupedLayout(Layout):
    """The parameter vector of a grouped model: each shared table once, each differing one once a group.

    `sizes`, `emission_index` and `index` describe the full vector that kernels read, ``[initial[g, s],
    transition[g * a, s, s'], emission[g * e, s, o]]``; `rows` and `size` the vector that is learned.
    """

    labels: tuple[str, ...] = ()
    differ: tuple[str, ...] = field(default=())

    @property
    def n_groups(self) -> int:
        """Number of groups."""
        return len(self.labels)

    @cached_property
    def sizes(self) -> tuple[int, int, int, int]:
        """States, actions and emission tables over all groups, responses."""
        s, a, e, o = self.base.sizes
        return s, self.n_groups * a, self.n_groups * e, o

    @cached_property
    def base(self) -> Layout:
        """Layout of one group."""
        return Layout(self.protocol, self.n_states)

    @cached_property
    def emission_index(self) -> NDArray[np.int64]:
        """Emission table of each coded action, -1 for silent modes."""
        one = np.asarray(self.protocol.emission_index, dtype=np.int64)
        tables = len(self.protocol.emission_actions)
        return np.concatenate([np.where(one < 0, -1, one + g * tables) for g in range(self.n_groups)])

    @cached_property
    def _origin(self) -> tuple[list[tuple[str, int, int]], NDArray[np.int64]]:
        """Kind, group and width of each learned row, and the learned row of each full row."""
        s, a, e, o = self.base.sizes
        found: dict[tuple[str, int, int], int] = {}
        rows: list[tuple[str, int, int]] = []
        full = []
        for kind, per_group, width in (("initial", 1, s), ("transition", a * s, s), ("emission", e * s, o)):
            for g in range(self.n_groups):
                for i in range(per_group):
                    key = (kind, g if kind in self.differ else 0, i)
                    if key not in found:
                        found[key] = len(rows)
                        rows.append((kind, key[1], width))
                    full.append(found[key])
        return rows, np.array(full, dtype=np.int64)

    @cached_property
    def rows(self) -> list[slice]:
        """Slice of every learned row."""
        ends = np.cumsum([width for _, _, width in self._origin[0]])
        return [slice(int(b - w), int(b)) for (_, _, w), b in zip(self._origin[0], ends, strict=True)]

    @cached_property
    def row_kinds(self) -> list[str]:
        """Table of every learned row."""
        return [kind for kind, _, _ in self._origin[0]]

    @cached_property
    def index(self) -> NDArray[np.int64]:
        """Place in the learned vector of every entry of the full one."""
        return np.concatenate([np.arange(self.rows[r].start, self.rows[r].stop) for r in self._origin[1]])

    def unpack(self, theta: Array) -> tuple[Array, Array, Array]:
        """Learned vectors ``[..., p]`` to the tables of every group, as `sizes` says."""
        s, a, e, o = self.sizes
        full = theta[..., self.index]
        lead = theta.shape[:-1]
        first, second = self.n_groups * s, self.n_groups * s + a * s * s
        return (
            full[..., :first].reshape(*lead, self.n_groups, s),
            full[..., first:second].reshape(*lead, a, s, s),
            full[..., second:].reshape(*lead, e, s, o),
        )

    def tied(self, one: NDArray) -> NDArray:
        """A vector in the layout of one group, repeated for all of them and tied."""
        initial, transition, emission = self.base.unpack(one)
        n = self.n_groups
        full = np.concatenate([np.tile(initial, n), np.tile(transition.ravel(), n), np.tile(emission.ravel(), n)])
        out = np.empty(self.size, dtype=full.dtype)
        out[self.index] = full
        return out

    def free_entries(self, pins: Mapping[str, Array]) -> NDArray[np.bool_]:
        """Which learned entries may move when the transition tables of `pins` are held in every group."""
        return self.tied(self.base.free_entries(pins)).astype(bool)


def _nothing(value: object) -> bool:
    """Whether a covariate has no value: None, not a number, or empty text."""
    return value is None or value != value or not str(value).strip()


def _named(labels: list[str], most: int = 5) -> str:
    rest = len(labels) - most
    return ", ".join(labels[:most]) + (f" and {rest} more" if rest > 0 else "")
