r"""How the mode moves: alternating, by chance, by any table, or by a known schedule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.errors import located
from models.lspomdp import check_rows
from models.planning.belief_check import real_array
from models.protocol import Protocol


@dataclass(frozen=True)
class ModeProcess:
    r"""A Markov chain of modes, :math:`P(M' \mid M)`, seen by everybody.

    Attributes
    ----------
    table : float64[m, m']
        Rows are probabilities; modes in the protocol's order.
    start : float64[m]
        Distribution of the first mode.
    words : str
        The process in words.

    Raises
    ------
    InputError
        On anything but numbers, shapes that do not fit, or rows that are no probabilities (sum within 1e-9).
    """

    table: NDArray[np.float64]
    start: NDArray[np.float64]
    words: str

    def __post_init__(self) -> None:
        for field, wanted in (("table", "rows of probabilities"), ("start", "probabilities, one a mode")):
            value = np.array(real_array(f"mode process, {field}", getattr(self, field), wanted))
            value.setflags(write=False)
            object.__setattr__(self, field, value)
        if self.start.ndim != 1:
            raise located("mode process, shape of the start", self.start.shape, "one probability a mode")
        n = len(self.start)
        if self.table.shape != (n, n):
            raise located("mode process, shape of the table", self.table.shape, f"({n}, {n})")
        check_rows("mode process", self.table, [(f"mode {m}",) for m in range(n)])
        check_rows("mode process, start", self.start[None], [()])


def alternating(protocol: Protocol, start: str | None = None) -> ModeProcess:
    """Modes take turns in the protocol's order.

    Parameters
    ----------
    protocol : Protocol
    start : str, optional
        Name or letter of the first mode; the protocol's first by default.

    Raises
    ------
    InputError
        On a name that is none of the modes'.
    """
    n = len(protocol.modes)
    first = _start(protocol, start)
    words = f"modes alternate, starting with {protocol.modes[int(first.argmax())].name}"
    return ModeProcess(np.roll(np.eye(n), 1, axis=1), first, words)


def bernoulli(protocol: Protocol, probability: float, start: str | None = None) -> ModeProcess:
    """Each round draws its mode anew: the protocol's first with `probability`, the second otherwise.

    Raises
    ------
    InputError
        If the probability is none, or the protocol has not two modes.
    """
    if len(protocol.modes) != 2:
        raise located("bernoulli modes, modes of the protocol", len(protocol.modes), "2")
    if isinstance(probability, str) or not 0 <= probability <= 1:
        raise located("bernoulli modes, probability", probability, "a number from 0 to 1")
    row = np.array([probability, 1 - probability])
    first = row if start is None else _start(protocol, start)
    name = protocol.modes[0].name
    words = f"each round is {name} with probability {probability:g}"
    if start is not None:
        words += f", the first {protocol.modes[int(first.argmax())].name}"
    return ModeProcess(np.stack([row, row]), first, words)


def mode_table(protocol: Protocol, table: ArrayLike, start: str | None = None) -> ModeProcess:
    """Any table of probabilities between the protocol's modes.

    Parameters
    ----------
    protocol : Protocol
    table : float64[m, m']
        From each mode to the next, in the protocol's order.
    start : str, optional
        Name or letter of the first mode; the protocol's first by default.

    Raises
    ------
    InputError
        On what is no table of probabilities between that many modes, or no mode.
    """
    first = _start(protocol, start)
    name = protocol.modes[int(first.argmax())].name
    rows = real_array("mode process, table", table, "rows of probabilities")
    return ModeProcess(rows, first, f"modes move by a table of probabilities, from {name}")


def _start(protocol: Protocol, start: str | None) -> NDArray[np.float64]:
    names = [m.name for m in protocol.modes]
    letters = [m.letter for m in protocol.modes]
    if start is None:
        index = 0
    elif start in names:
        index = names.index(start)
    elif start in letters:
        index = letters.index(start)
    else:
        raise located("first mode", start, f"one of {', '.join([*names, *letters])}")
    return np.eye(len(names))[index]


def schedule_modes(protocol: Protocol, schedule: str | Sequence[str]) -> tuple[int, ...]:
    """Mode of each event of a schedule, as indices.

    Parameters
    ----------
    protocol : Protocol
    schedule : str or sequence of str
        Letters such as ``HRHRH`` (H: the *human* may help), or names of modes.

    Raises
    ------
    InputError
        On a letter or name that is none of the modes', or no event.
    """
    if isinstance(schedule, str):
        names = [m.name for m in protocol.modes_from_letters(schedule)]
    else:
        names = [protocol.mode(name).name for name in schedule]
    if not names:
        raise located("schedule", "", "at least one event")
    return tuple([m.name for m in protocol.modes].index(name) for name in names)
