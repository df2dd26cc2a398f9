"""The protocol of a study: its modes, the actions of each, and the responses people can show.

Everything downstream (event files, likelihood kernel, learning, planning) asks a `Protocol` how many modes,
actions and responses there are and never assumes the published two, four and two.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from models.errors import InputError, located
from models.notebook_view import NotebookView, View, frame_rows
from models.text_files import toml_of

NO_RESPONSE = "none"
"""Written in the response column where the mode shows no response (the paper's empty observation)."""
MISSING = "missing"
"""Written where a response could have been seen but was not recorded."""
RESERVED = (NO_RESPONSE, MISSING)


@dataclass(frozen=True)
class Action:
    """One thing the robot can do. `cost` is in the unit of the reward (the published act of helping costs 15)."""

    name: str
    cost: float = 0.0


@dataclass(frozen=True)
class Mode:
    """Who needs help in a round, and so what the robot may do and whether the human's response shows.

    Attributes
    ----------
    name : str
        As written in the event log's `mode` column.
    letter : str
        The letter of this mode in a schedule such as ``HRHRH``.
    actions : tuple of Action
        The robot's choices, at least one.
    null_action : str
        The action that leaves the person alone: the reference of every comparison.
    shows_response : bool
        Whether the human's response is observable in this mode.
    """

    name: str
    letter: str
    actions: tuple[Action, ...]
    null_action: str
    shows_response: bool


@dataclass(frozen=True)
class Response:
    """An observable response; `score` orders the states (the published protocol: help 1, no help 0)."""

    name: str
    score: float


@dataclass(frozen=True)
class Protocol(NotebookView, plain=True):
    """Modes, actions and responses of a study, with the index of each.

    Action names are unique across modes, so an action alone tells its mode; arrays over actions
    use the order of declaration. Emission tables have rows for the actions of response-showing modes
    only (`emission_actions`).

    Raises
    ------
    InputError
        On duplicate or reserved names, an unknown null action, a letter of more than one character,
        fewer than two responses, or responses that all score the same (states could not be ordered).
    """

    name: str
    modes: tuple[Mode, ...]
    responses: tuple[Response, ...]

    def __post_init__(self) -> None:
        place = f"protocol {self.name!r}"
        if not self.modes:
            raise InputError(f"{place}: declares no mode")
        _unique(f"{place}, modes", [m.name for m in self.modes])
        _unique(f"{place}, letters", [m.letter for m in self.modes])
        _unique(f"{place}, actions", [a.name for m in self.modes for a in m.actions])
        _unique(f"{place}, responses", [r.name for r in self.responses])
        for mode in self.modes:
            where = f"{place}, mode {mode.name!r}"
            if len(mode.letter) != 1 or not mode.letter.isalpha():
                raise located(f"{where}, letter", mode.letter, "one letter")
            if not mode.actions:
                raise InputError(f"{where}: declares no action")
            if mode.null_action not in [a.name for a in mode.actions]:
                names = ", ".join(a.name for a in mode.actions)
                raise located(f"{where}, null_action", mode.null_action, f"one of its actions: {names}")
            for action in mode.actions:
                if not math.isfinite(action.cost):
                    raise located(f"{where}, cost of {action.name}", action.cost, "a finite number")
        if not any(m.shows_response for m in self.modes):
            raise InputError(f"{place}: no mode shows a response, so nothing can be learned")
        if len(self.responses) < 2:
            raise located(f"{place}, responses", len(self.responses), "at least two")
        for response in self.responses:
            if response.name in RESERVED:
                raise located(f"{place}, responses", response.name, f"a name other than {RESERVED}")
            if not math.isfinite(response.score):
                raise located(f"{place}, score of {response.name}", response.score, "a finite number")
        if len({r.score for r in self.responses}) < 2:
            raise InputError(f"{place}: all responses have the same score, so states cannot be ordered")

    # -- sizes and names ---------------------------------------------------------------------------
    @cached_property
    def action_names(self) -> tuple[str, ...]:
        """Names of all actions, in table order."""
        return tuple(a.name for m in self.modes for a in m.actions)

    @cached_property
    def mode_names(self) -> tuple[str, ...]:
        """Names of the modes."""
        return tuple(m.name for m in self.modes)

    @cached_property
    def response_names(self) -> tuple[str, ...]:
        """Names of the responses, in table order."""
        return tuple(r.name for r in self.responses)

    @property
    def n_actions(self) -> int:
        """Number of actions over all modes."""
        return len(self.action_names)

    @property
    def n_responses(self) -> int:
        """Number of observable responses."""
        return len(self.responses)

    # -- lookups -----------------------------------------------------------------------------------
    @cached_property
    def mode_of_action(self) -> tuple[int, ...]:
        """Mode index of each action."""
        return tuple(i for i, m in enumerate(self.modes) for _ in m.actions)

    @cached_property
    def emission_actions(self) -> tuple[str, ...]:
        """Actions under which a response can show: the rows of an emission table."""
        return tuple(a.name for m in self.modes if m.shows_response for a in m.actions)

    @cached_property
    def emission_index(self) -> tuple[int, ...]:
        """Row of each action in an emission table, -1 for actions of silent modes."""
        rows = {name: i for i, name in enumerate(self.emission_actions)}
        return tuple(rows.get(name, -1) for name in self.action_names)

    @cached_property
    def scores(self) -> tuple[float, ...]:
        """Score of each response."""
        return tuple(r.score for r in self.responses)

    @cached_property
    def costs(self) -> dict[str, float]:
        """Cost of each action, in the unit of the reward."""
        return {a.name: a.cost for m in self.modes for a in m.actions}

    def action(self, name: str) -> int:
        """Index of an action by name."""
        return _index(self.action_names, name, f"protocol {self.name!r}, action")

    def mode(self, name: str) -> Mode:
        """Mode by name."""
        return self.modes[_index(self.mode_names, name, f"protocol {self.name!r}, mode")]

    def modes_from_letters(self, schedule: str) -> tuple[Mode, ...]:
        """Turn a schedule such as ``HRHRH`` into its modes: the only converter of letters in the workbench.

        The paper: '"H" indicates a round in which the human had an opportunity to help the robot, and
        "R" indicates a round in which the robot had an opportunity to help the human.' So ``H`` is the
        mode `robot_needs_help` (the response shows) and ``R`` is `human_needs_help`: the letter names
        the helper, the mode the one in need.

        Raises
        ------
        InputError
            On an empty schedule or an unknown letter, with its position.

        Examples
        --------
        >>> [m.name for m in PUBLISHED.modes_from_letters("HR")]
        ['robot_needs_help', 'human_needs_help']
        """
        known = {m.letter: m for m in self.modes}
        if not schedule:
            raise located("schedule", schedule, f"letters from {', '.join(known)}")
        for position, letter in enumerate(schedule, start=1):
            if letter not in known:
                wanted = f"one of {', '.join(known)}"
                raise located(f"schedule {schedule!r}, letter {position}", letter, wanted)
        return tuple(known[letter] for letter in schedule)

    def letters_from_modes(self, modes: tuple[str, ...] | list[str]) -> str:
        """Inverse of `modes_from_letters`.

        Examples
        --------
        >>> PUBLISHED.letters_from_modes(["robot_needs_help", "human_needs_help"])
        'HR'
        """
        return "".join(self.mode(name).letter for name in modes)

    # -- files -------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Plain mapping with the same shape as the TOML file."""
        return {
            "name": self.name,
            "modes": {
                m.name: {
                    "letter": m.letter,
                    "actions": {a.name: a.cost for a in m.actions},
                    "null_action": m.null_action,
                    "shows_response": m.shows_response,
                }
                for m in self.modes
            },
            "responses": {r.name: r.score for r in self.responses},
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any], place: str = "protocol") -> Protocol:
        """Build a protocol from a mapping as in `to_dict`; `place` names the source in errors."""
        _typed(place, content, {"name": str, "modes": Mapping, "responses": Mapping})
        modes = []
        for name, entry in content["modes"].items():
            where = f"{place}, mode {name!r}"
            kinds = {"letter": str, "actions": Mapping, "null_action": str, "shows_response": bool}
            _typed(where, entry, kinds)
            actions = tuple(
                Action(a, _number(f"{where}, cost of {a}", cost)) for a, cost in entry["actions"].items()
            )
            modes.append(Mode(name, entry["letter"], actions, entry["null_action"], entry["shows_response"]))
        responses = tuple(
            Response(r, _number(f"{place}, score of {r}", score)) for r, score in content["responses"].items()
        )
        try:
            return cls(content["name"], tuple(modes), responses)
        except InputError as error:
            raise InputError(f"{place}: {error}") from None

    @classmethod
    def from_toml(cls, path: str | Path) -> Protocol:
        """Read a protocol file; errors name the file and, for broken TOML, the line."""
        return cls.from_dict(toml_of(path, "protocol file"), str(path))

    def to_toml(self) -> str:
        """Text of a protocol file that reads back as this protocol."""
        lines = [f"name = {_quoted(self.name)}", ""]
        for mode in self.modes:
            lines += [
                f"[modes.{_quoted(mode.name)}]",
                f"letter = {_quoted(mode.letter)}",
                f"null_action = {_quoted(mode.null_action)}",
                f"shows_response = {'true' if mode.shows_response else 'false'}",
                "actions = {" + ", ".join(f"{_quoted(a.name)} = {float(a.cost)!r}" for a in mode.actions) + "}",
                "",
            ]
        lines.append("[responses]")
        lines += [f"{_quoted(r.name)} = {float(r.score)!r}" for r in self.responses]
        return "\n".join(lines) + "\n"

    def _view(self) -> View:
        acts = [
            {"mode": m.name, "letter": m.letter, "action": a.name, "cost": a.cost,
             "leaves alone": a.name == m.null_action, "response shows": m.shows_response}
            for m in self.modes for a in m.actions
        ]  # fmt: skip
        seen = [{"response": r.name, "score": r.score} for r in self.responses]
        tables = (frame_rows(acts, ".modes", "actions"), frame_rows(seen, ".responses", "responses"))
        told = f"{len(self.modes)} modes, {self.n_actions} actions, {len(self.responses)} responses."
        return View(f"Protocol {self.name}", "", (), (), (told,), tables, {"cost": "reward units"})


def _typed(place: str, content: Mapping[str, Any], kinds: Mapping[str, type]) -> None:
    names = {str: "text", bool: "true or false", Mapping: "a table"}
    if not isinstance(content, Mapping):
        raise located(place, content, names[Mapping])
    for key, kind in kinds.items():
        if not isinstance(content.get(key), kind):
            raise located(f"{place}, key {key}", content.get(key), names[kind])


def _quoted(text: str) -> str:
    # JSON's escapes are TOML's, except that TOML also wants DEL escaped.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _number(place: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise located(place, value, "a number")
    try:
        return float(value)
    except OverflowError:
        raise located(place, value, "a number below 1e308") from None


def _unique(place: str, names: list[str]) -> None:
    for i, name in enumerate(names):
        if not name:
            raise InputError(f"{place}: an empty name")
        if name in names[:i]:
            raise InputError(f"{place}: {name!r} is declared twice; names must be unique")


def _index(names: tuple[str, ...], name: str, place: str) -> int:
    try:
        return names.index(name)
    except ValueError:
        raise located(place, name, f"one of {', '.join(names)}") from None


PUBLISHED = Protocol(
    name="published",
    modes=(
        Mode("human_needs_help", "R", (Action("no_help", 0.0), Action("help", 15.0)), "no_help", False),
        Mode("robot_needs_help", "H", (Action("no_signal", 0.0), Action("signal", 15.0)), "no_signal", True),
    ),
    responses=(Response("no_help", 0.0), Response("help", 1.0)),
)
"""Zahedi et al. (2026): two modes, four actions, two responses."""
