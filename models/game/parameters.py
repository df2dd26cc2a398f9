"""What the paper leaves open about the token game, and what it prints, as checked whole numbers.

Printed: the robot walks two cells a second, the trap comes 20 s into the round, a helping robot sets off 5 s after
it. Not printed, so chosen here and free to change: how long a round is, how fast and attentive people are, and
whether the other player's tokens leave a room with somebody trapped in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.errors import located

TICKS_A_SECOND = 10
"""A tick is a tenth of a second; everything happens at whole ticks, so that a replay is exact."""

CHANCE_BITS = 53
"""Chances are compared with this many random bits."""


class Setting(NamedTuple):
    """Places of the parameters in the array that kernels read."""

    round_ticks: int = 0
    human_step_ticks: int = 1
    robot_step_ticks: int = 2
    trap_tick: int = 3
    robot_help_delay: int = 4
    clear_trapped_room: int = 5
    human_wander: int = 6
    human_lapse: int = 7
    human_lapse_ticks: int = 8
    human_notice_ticks: int = 9
    human_notice_spread: int = 10
    signal_notice_share: int = 11


SETTING = Setting()


_WHOLE = 1 << CHANCE_BITS


@kernel(_nrt=False)
def share_of(value, share):  # type: ignore[no-untyped-def]
    """Whole part of a share of `value`; the share is a number of `CHANCE_BITS` bits, as many as a float holds."""
    return np.int64(np.floor(value * (share / _WHOLE)))


@dataclass(frozen=True)
class GameParameters:
    """Parameters of a round; times are ticks of a tenth of a second. Numbers of numpy become plain ones.

    Attributes
    ----------
    round_ticks : int
        Length of a round. Unprinted; the default is calibrated (`analysis.game_calibration`).
    human_step_ticks : int
        A person takes a step at most every so many ticks. Unprinted.
    robot_step_ticks : int
        Printed: two cells a second.
    trap_tick : int
        Printed: 20 s. The first room that the named player enters from then on, with the other neither in it nor
        on one of its doors, becomes the trap: doors change colour when somebody enters, and at no other time.
    robot_help_delay : int
        Printed: a helping robot sets off 5 s after the trap.
    clear_trapped_room : bool
        Whether the other player's tokens leave a room when it becomes a trap, and none appear in it while somebody
        is trapped: who enters for tokens cannot be told from who helps. Without it simulated players who do
        not help leave such tokens alone, and wait.
    human_wander : float
        Chance that a simulated person goes for any token left of the group instead of the nearest, whenever it
        chooses one. Unprinted.
    human_lapse : float
        Chance that attention lapses before a step; unprinted. Nobody's attention lapses on the way to help.
    human_lapse_ticks : int
        How long a lapse lasts.
    human_notice_ticks, human_notice_spread : int
        A willing person sets off so many ticks after the trap: the first number and between 0 and `spread` more,
        all equally likely. Unprinted, bounded so that help comes before the round ends.
    signal_notice_share : float
        A signalling robot is noticed in this share of the time, between 0 and 1. Unprinted.

    Raises
    ------
    InputError
        Naming the parameter, its value and what it may be.
    """

    round_ticks: int = 1730
    human_step_ticks: int = 5
    robot_step_ticks: int = 5
    trap_tick: int = 200
    robot_help_delay: int = 50
    clear_trapped_room: bool = True
    human_wander: float = 0.1
    human_lapse: float = 0.45
    human_lapse_ticks: int = 10
    human_notice_ticks: int = 15
    human_notice_spread: int = 30
    signal_notice_share: float = 0.5

    def __post_init__(self) -> None:
        for entry in fields(self):
            kind = str(entry.type)
            value = _plain(entry.name, kind, getattr(self, entry.name), "game parameters")
            object.__setattr__(self, entry.name, value)

    @property
    def seconds(self) -> float:
        """Length of a round in seconds."""
        return self.round_ticks / TICKS_A_SECOND

    @cached_property
    def settings(self) -> NDArray[np.int64]:
        """As kernels read them, by `SETTING`; chances and shares as numbers of `CHANCE_BITS` bits."""
        out = np.zeros(len(SETTING), dtype=np.int64)
        for entry in fields(self):
            value = getattr(self, entry.name)
            whole = round(value * 2**CHANCE_BITS) if entry.type == "float" else int(value)
            out[getattr(SETTING, entry.name)] = whole
        out.flags.writeable = False
        return out

    def to_dict(self) -> dict[str, Any]:
        """Plain mapping that `from_dict` reads back."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: object, place: str = "game parameters") -> GameParameters:
        """Read parameters; absent ones take their defaults.

        Raises
        ------
        InputError
            On unknown names or unusable values.
        """
        if not isinstance(content, Mapping):
            raise located(place, content, "an object with parameter names")
        known = {entry.name: str(entry.type) for entry in fields(cls)}
        for name, value in content.items():
            if name not in known:
                raise located(f"{place}, parameter", name, f"one of {', '.join(known)}")
            _plain(name, known[name], value, place)
        return cls(**content)


_AT_LEAST_ONE = ("round_ticks", "human_step_ticks", "robot_step_ticks", "human_lapse_ticks")
_MOST_TICKS = 1_000_000


def _plain(name: str, kind: str, value: Any, place: str) -> bool | int | float:
    """Return a value as a plain number of its kind, numpy's included; what is none is refused, naming `place`."""
    where = f"{place}, {name}"
    truth = isinstance(value, bool | np.bool_)
    if kind == "bool":
        if not truth:
            raise located(where, value, "true or false")
        return bool(value)
    if kind == "int":
        least = 1 if name in _AT_LEAST_ONE else 0
        if truth or not isinstance(value, int | np.integer) or not least <= value <= _MOST_TICKS:
            raise located(where, value, f"a whole number of ticks from {least} to {_MOST_TICKS}")
        return int(value)
    if truth or not isinstance(value, int | float | np.integer | np.floating) or not 0 <= value <= 1:
        raise located(where, value, "a number from 0 to 1")
    if name == "human_lapse" and value > 0.9:
        # A person whose attention always lapses never moves; rounds would say nothing.
        raise located(where, value, "at most 0.9")
    return float(value)
