"""Which part of a data set is learned from, and how: command-line options filled up from the card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.datasets import DataSet
from analysis.em_study import parse_states
from models.errors import located
from models.events import EventLog
from models.notebook_view import NotebookView
from models.protocol import Protocol

ALL_CONDITIONS = "all"


@dataclass(frozen=True)
class Selection(NotebookView):
    """What a command learns from.

    Attributes
    ----------
    dataset : DataSet
        As loaded, all conditions.
    log : EventLog
        The selected conditions.
    conditions : tuple of str
    pins : tuple of str
        Actions whose transition table is held at the identity.
    states : tuple of int
    from_card : tuple of str
        Which of condition, pins and states were taken from the card's defaults.
    """

    dataset: DataSet
    log: EventLog
    conditions: tuple[str, ...]
    pins: tuple[str, ...]
    states: tuple[int, ...]
    from_card: tuple[str, ...]

    @property
    def kind(self) -> str:
        """What kind of data these are (`analysis.datasets.Card`)."""
        return self.dataset.card.kind

    @property
    def digest(self) -> str:
        """Digest of the whole data set."""
        return self.dataset.digest

    @property
    def sentence(self) -> str:
        """The selection in words, saying what was taken from the card."""
        some = len(self.conditions) < len(self.dataset.log.conditions)
        parts = [f"condition {', '.join(self.conditions)}" if some else "all conditions"]
        if self.pins:
            parts.append(f"transition table of {', '.join(self.pins)} held at the identity")
        parts.append(f"states {', '.join(map(str, self.states))}")
        text = "; ".join(parts)
        if self.from_card:
            text += f" ({', '.join(self.from_card)} by default of the data card)"
        return text


def select(
    dataset: DataSet,
    condition: Sequence[str] | None = None,
    states: str | None = None,
    pins: Sequence[str] | None = None,
    default_states: str = "2-5",
) -> Selection:
    """Fill options that were not given from the card's defaults, else from the workbench's.

    Parameters
    ----------
    dataset : DataSet
    condition : sequence of str, optional
        Condition names; ``["all"]`` for every condition.
    states : str, optional
        As `parse_states` reads it.
    pins : sequence of str, optional
        Actions; ``["none"]`` for no pin whatever the card says.

    Raises
    ------
    InputError
        On unknown conditions or actions, or states that cannot be read.
    """
    defaults = dataset.card.defaults
    taken = []
    if not condition and defaults.get("condition"):
        condition = _as_list(defaults["condition"])
        taken.append("condition")
    if not pins and defaults.get("pins"):
        pins = _as_list(defaults["pins"])
        taken.append("pins")
    if states is None and defaults.get("states"):
        states = ",".join(str(k) for k in _as_list(defaults["states"]))
        taken.append("states")
    log = dataset.log
    if condition and list(condition) != [ALL_CONDITIONS]:
        for name in condition:
            if name not in log.conditions:
                raise located("--condition", name, f"one of {', '.join(log.conditions)}, or {ALL_CONDITIONS}")
        log = log.select(conditions=condition)
    held = checked_pins(log.protocol, pins)
    wanted = parse_states(default_states if states is None else states)
    return Selection(dataset, log, log.conditions, held, wanted, tuple(taken))


def checked_pins(protocol: Protocol, pins: Sequence[str] | None) -> tuple[str, ...]:
    """Actions of ``--pin``, none for ``["none"]``.

    Raises
    ------
    InputError
        On an unknown action.
    """
    held = () if list(pins or []) == ["none"] else tuple(pins or [])
    for action in held:
        if action not in protocol.action_names:
            raise located("--pin", action, f"one of {', '.join(protocol.action_names)}, or none")
    return held


def _as_list(value: object) -> list[str]:
    return [str(v) for v in value] if isinstance(value, list | tuple) else [str(value)]
