r"""Designs of a next study: who sees which modes and actions, and how probable each response history is.

A participant of an arm goes through its schedule while the robot acts as the arm says: always the same in a mode,
as in the published conditions, by a list, or at random with known probabilities. What a person does is a history;
there are few of them, so a data set is a table of counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import ArrayLike

from models.errors import InputError, Phrase, located
from models.event_rules import one_of
from models.model_draws import ModelDraws
from models.planning.history_kernel import TreeTables
from models.planning.mode_process import schedule_modes
from models.planning.schedule import Array
from models.protocol import Mode, Protocol
from models.robust.design_kernel import history_chances

MOST_HISTORIES = 1 << 17
"""Histories that a design may have: a table of them has a column for each."""


@dataclass(frozen=True)
class Arm:
    """One way of treating a participant.

    Attributes
    ----------
    protocol : Protocol
    modes : tuple of int
        Mode of each event.
    actions : tuple of tuple of float
        For each event the probability of each action of its mode.
    """

    protocol: Protocol
    modes: tuple[int, ...]
    actions: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        if not self.modes or len(self.modes) != len(self.actions):
            raise located(
                "arm, events", Phrase(f"{len(self.modes)} modes, {len(self.actions)} actions"), "one action a mode"
            )
        for k, (m, chance) in enumerate(zip(self.modes, self.actions, strict=True)):
            mode = self.protocol.modes[m]
            bad = len(chance) != len(mode.actions) or any(not c >= 0 for c in chance) or abs(sum(chance) - 1) > 1e-9
            if bad:
                wanted = f"{len(mode.actions)} probabilities that sum to 1"
                raise located(f"arm, event {k + 1} ({mode.name}), probabilities of actions", chance, wanted)

    @classmethod
    def constant(cls, protocol: Protocol, schedule: str | Sequence[str], actions: Mapping[str, str]) -> Arm:
        """The same action throughout a mode, as in the published conditions.

        Parameters
        ----------
        protocol : Protocol
        schedule : str or sequence of str
            Letters such as ``HRHRH``, or names of modes.
        actions : mapping of str to str
            Action by mode, as the `actions` of a published condition; modes outside the schedule may be left out.

        Raises
        ------
        InputError
            On an unknown mode or action, or a mode of the schedule without an action.

        Examples
        --------
        >>> from models.protocol import PUBLISHED
        >>> Arm.constant(PUBLISHED, "HR", {"robot_needs_help": "signal", "human_needs_help": "help"}).words
        'HR, signal help'
        """
        modes = schedule_modes(protocol, schedule)
        for name, action in actions.items():
            if name not in protocol.mode_names:
                raise located("arm, mode", name, one_of(protocol.mode_names))
            _number(protocol.mode(name), action, f"arm, action in mode {name}")
        missing = [protocol.modes[m].name for m in modes if protocol.modes[m].name not in actions]
        if missing:
            raise located("arm, modes with an action", Phrase(", ".join(actions) or "none"), f"{missing[0]} too")
        return cls.listed(protocol, schedule, [actions[protocol.modes[m].name] for m in modes])

    @classmethod
    def listed(cls, protocol: Protocol, schedule: str | Sequence[str], actions: Sequence[str]) -> Arm:
        """One action an event.

        Raises
        ------
        InputError
            On a list that does not fit the schedule, or an action that its event does not offer.
        """
        modes = schedule_modes(protocol, schedule)
        if len(actions) != len(modes):
            raise located("arm, actions", len(actions), f"{len(modes)}, one an event")
        chances = []
        for k, (m, action) in enumerate(zip(modes, actions, strict=True)):
            mode = protocol.modes[m]
            chosen = _number(mode, action, f"arm, event {k + 1}, action")
            chances.append(tuple(float(a == chosen) for a in range(len(mode.actions))))
        return cls(protocol, modes, tuple(chances))

    @classmethod
    def random(
        cls,
        protocol: Protocol,
        schedule: str | Sequence[str],
        probabilities: Mapping[str, float] | None = None,
    ) -> Arm:
        """Every event draws its action anew, whatever happened before.

        Parameters
        ----------
        protocol : Protocol
        schedule : str or sequence of str
        probabilities : mapping of str to float, optional
            By action, for the modes that are not to be uniform; they sum to one within a mode, and an action that
            is not named there has probability zero.

        Raises
        ------
        InputError
            On an unknown action, or probabilities that are none.
        """
        given = dict(probabilities or {})
        for name in given:
            if name not in protocol.action_names:
                raise located("arm, action", name, one_of(protocol.action_names))
        modes = schedule_modes(protocol, schedule)
        chances = []
        for m in modes:
            names = [a.name for a in protocol.modes[m].actions]
            if any(n in given for n in names):
                chances.append(tuple(float(given.get(n, 0.0)) for n in names))
            else:
                chances.append(tuple(1.0 / len(names) for _ in names))
        return cls(protocol, modes, tuple(chances))

    @property
    def events(self) -> int:
        """Events up to the last one that shows a response: what comes after it tells nothing."""
        shown = [k for k, m in enumerate(self.modes) if self.protocol.modes[m].shows_response]
        return shown[-1] + 1 if shown else 0

    @property
    def n_histories(self) -> int:
        """Distinct histories that a participant may show."""
        return prod(self._choices(k) * self._outcomes(k) for k in range(self.events))

    @property
    def words(self) -> str:
        """Schedule and actions in words."""
        letters = "".join(self.protocol.modes[m].letter for m in self.modes)
        by_mode: dict[int, set[tuple[float, ...]]] = {}
        for m, chance in zip(self.modes, self.actions, strict=True):
            by_mode.setdefault(m, set()).add(chance)
        if all(len(kinds) == 1 for kinds in by_mode.values()):
            parts = [_words(self.protocol.modes[m], next(iter(kinds))) for m, kinds in by_mode.items()]
        else:
            parts = [_words(self.protocol.modes[m], c) for m, c in zip(self.modes, self.actions, strict=True)]
        return f"{letters}, {' '.join(parts)}"

    def history_probabilities(self, draws: ModelDraws) -> Array:
        """Probability of every history in every draw, shape ``[d, h]``; one sure history if no response shows."""
        n = self.events
        if n == 0:
            return np.ones((draws.n_draws, 1))
        most = max(self._choices(k) for k in range(n))
        choice, chance = np.zeros((n, most), dtype=np.int64), np.zeros((n, most))
        for k in range(n):
            first = self.protocol.mode_of_action.index(self.modes[k])
            possible = [(first + a, c) for a, c in enumerate(self.actions[k]) if c > 0]
            for c, (action, p) in enumerate(possible):
                choice[k, c], chance[k, c] = action, p
        tables = TreeTables(
            np.ascontiguousarray(draws.initial.T),
            np.ascontiguousarray(np.moveaxis(draws.transition, 0, -1)),
            np.ascontiguousarray(np.moveaxis(draws.emission, 0, -1)),
            np.asarray(self.protocol.emission_index, dtype=np.int64),
            np.zeros((0, 0, 0)),
            np.zeros(n, dtype=np.int64),
            np.array([self._choices(k) for k in range(n)], dtype=np.int64),
            np.array([self._outcomes(k) for k in range(n)], dtype=np.int64),
        )
        out = np.empty((self.n_histories, draws.n_draws))
        history_chances(tables, choice, chance, out)
        return np.ascontiguousarray(out.T)

    def _choices(self, k: int) -> int:
        return sum(c > 0 for c in self.actions[k])

    def _outcomes(self, k: int) -> int:
        return self.protocol.n_responses if self.protocol.modes[self.modes[k]].shows_response else 1


@dataclass(frozen=True)
class NextStudy:
    """A study that might be run: arms, and how participants come to them.

    Attributes
    ----------
    name : str
        As it is called in tables and sentences.
    arms : tuple of Arm
    shares : tuple of float
        Probability that a participant is assigned to each arm.

    Raises
    ------
    InputError
        On shares that do not sum to one, arms of different protocols, or too many histories.
    """

    name: str
    arms: tuple[Arm, ...]
    shares: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        place = f"study {self.name!r}"
        if not self.name or not self.arms:
            raise InputError(f"{place}: a study has a name and at least one arm")
        if len(self.shares) != len(self.arms) or any(not s >= 0 for s in self.shares):
            raise located(f"{place}, shares", self.shares, f"{len(self.arms)} numbers of at least 0, one an arm")
        if abs(sum(self.shares) - 1) > 1e-9:
            raise located(f"{place}, sum of the shares", Phrase(f"{sum(self.shares):.10g}"), "1")
        if any(a.protocol != self.arms[0].protocol for a in self.arms):
            raise InputError(f"{place}: its arms have different protocols")
        if self.n_histories > MOST_HISTORIES:
            found = Phrase(f"{self.n_histories} histories")
            raise located(place, found, f"at most {MOST_HISTORIES}: fewer events, or fewer actions at random")

    @classmethod
    def of_arms(cls, name: str, arms: Sequence[Arm], people: ArrayLike | None = None) -> NextStudy:
        """A study whose participants are assigned in proportion to `people`, equally by default."""
        sizes = np.ones(len(arms)) if people is None else np.asarray(people, dtype=np.float64)
        if sizes.shape != (len(arms),) or np.any(~(sizes >= 0)) or not sizes.sum() > 0:
            raise located(f"study {name!r}, people by arm", sizes.tolist(), f"{len(arms)} numbers of at least 0")
        return cls(name, tuple(arms), tuple((sizes / sizes.sum()).tolist()))

    @property
    def protocol(self) -> Protocol:
        """Modes, actions and responses."""
        return self.arms[0].protocol

    @property
    def n_histories(self) -> int:
        """Distinct histories, those of all arms."""
        return sum(a.n_histories for a in self.arms)

    @property
    def tells_nothing(self) -> bool:
        """Whether no participant would show a response."""
        return all(a.events == 0 for a, share in zip(self.arms, self.shares, strict=True) if share > 0)

    @property
    def words(self) -> str:
        """The design in words."""
        return "; ".join(a.words for a in self.arms)

    def history_probabilities(self, draws: ModelDraws) -> Array:
        """Probability of every arm and history in every draw, shape ``[d, h]``; rows sum to one.

        Raises
        ------
        InputError
            If the draws have another protocol.
        """
        if draws.protocol != self.protocol:
            raise located(
                f"study {self.name!r}, protocol", self.protocol.name, f"that of the draws, {draws.protocol.name}"
            )
        parts = [s * a.history_probabilities(draws) for a, s in zip(self.arms, self.shares, strict=True)]
        return np.concatenate(parts, axis=1)


def _number(mode: Mode, action: str, place: str) -> int:
    names = [a.name for a in mode.actions]
    if action not in names:
        raise located(place, action, one_of(names))
    return names.index(action)


def _words(mode: Mode, chance: tuple[float, ...]) -> str:
    possible = [(a.name, c) for a, c in zip(mode.actions, chance, strict=True) if c > 0]
    if len(possible) == 1:
        return possible[0][0]
    if len({c for _, c in possible}) == 1 and len(possible) == len(mode.actions):
        return f"({' or '.join(name for name, _ in possible)})"
    return f"({' or '.join(f'{name} {c:g}' for name, c in possible)})"
