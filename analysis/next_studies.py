"""Next studies: written on a command line (``CONDITION:SCHEDULE:N``), the published ones, one's own arms again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.design import study1_design
from analysis.wording import counted
from models.errors import InputError, Phrase, located

if TYPE_CHECKING:
    from collections.abc import Sequence

    from models.events import EventLog
    from models.protocol import Protocol
    from models.robust.study_design import NextStudy

RANDOM = "random"
"""Condition in which every event draws its action anew."""

MOST_ROUNDS, FEW_HISTORIES = 6, 6_000
"""Of a next study that nobody named: rounds, and histories of the one with random actions."""

MOST = 99_999_999
"""Participants of a study at most."""

WANTED = (
    "CONDITION:SCHEDULE:N, with a published condition (help+signal), one action a mode (help+no_signal), one an "
    f"event (signal,help,no_signal) or {RANDOM}; such as help+signal:HRHRH:200"
)


@dataclass(frozen=True)
class Asked:
    """One study and the numbers of people it is asked for."""

    study: NextStudy
    sizes: tuple[int, ...]


def next_studies(options: Sequence[str], protocol: Protocol) -> tuple[Asked, ...]:
    """Studies from options; several sizes of one study are joined (``...:100,200`` or the option again).

    Parameters
    ----------
    options : sequence of str
    protocol : Protocol

    Raises
    ------
    InputError
        On an option that cannot be read: its text and what was wanted.
    """
    found: dict[str, tuple[NextStudy, list[int]]] = {}
    for option in options:
        parts = option.split(":")
        if len(parts) != 3 or not all(parts):
            raise located("--evsi", option, WANTED)
        condition, schedule, sizes = parts
        try:
            study = _study(option, condition, schedule, protocol)
        except InputError as error:
            text = str(error)
            raise InputError(text if text.startswith("--evsi") else f"--evsi {option}: {text}") from None
        numbers = found.setdefault(study.name, (study, []))[1]
        for text in sizes.split(","):
            number = text.strip()
            if not (number.isascii() and number.isdecimal() and len(number) < 9 and int(number) >= 1):
                wanted = f"a number of people, from 1 to {MOST:,}, after the last colon; {WANTED}"
                raise located("--evsi", option, wanted)
            if int(text) not in numbers:
                numbers.append(int(text))
    return tuple(Asked(study, tuple(sorted(sizes))) for study, sizes in found.values())


def published_studies(protocol: Protocol, schedule: str) -> tuple[NextStudy, ...]:
    """A study of each published condition, and one whose actions vary within every person.

    Conditions with an action that the protocol does not offer are left out.
    """
    from models.robust.study_design import Arm, NextStudy

    out = []
    for condition in study1_design().conditions:
        if set(condition.actions.values()) <= set(protocol.action_names):
            arm = Arm.constant(protocol, schedule, condition.actions)
            out.append(NextStudy.of_arms(f"{condition.name} over {schedule}", [arm]))
    out.append(NextStudy.of_arms(f"{RANDOM} actions over {schedule}", [Arm.random(protocol, schedule)]))
    return tuple(out)


def same_arms(log: EventLog, protocol: Protocol, schedule: str) -> NextStudy | None:
    """The arms of a study again, over a schedule: a next study for protocols of one's own.

    People of a condition whose actions never varied within a mode make one arm for each way of treating them; where
    actions varied within people, the condition is an arm that draws them as often as its people met them. Arms take
    their shares from the numbers of people. Modes that an arm never met get their null action.

    Parameters
    ----------
    log : EventLog
    protocol : Protocol
        That of the log, or a smaller one without some of its actions: arms that used those are left out.
    schedule : str
        Letters.

    Returns
    -------
    NextStudy or None
        None if no arm is left.
    """
    from models.robust.study_design import Arm, NextStudy

    own = log.protocol
    people = np.unique(log.participant, return_inverse=True)[1]
    met = np.zeros((int(people.max()) + 1, own.n_actions), dtype=np.int64)
    np.add.at(met, (people[log.run_of_event], log.action), 1)
    condition = np.zeros(len(met), dtype=np.int64)
    condition[people] = log.condition
    size: dict[tuple[tuple[tuple[str, float], ...], ...], int] = {}
    for c in np.unique(condition):
        rows = met[condition == c]
        constant = all((rows[:, _actions_of(own, m)] > 0).sum(axis=1).max() <= 1 for m in range(len(own.modes)))
        for row in rows if constant else [rows.sum(axis=0)]:
            treated = tuple(_treatment(own, row, m) for m in range(len(own.modes)))
            size[treated] = size.get(treated, 0) + (1 if constant else len(rows))
    arms: list[Arm] = []
    shares: list[int] = []
    for treated, number in size.items():
        chances = {name: p for mode in treated for name, p in mode}
        if set(chances) <= set(protocol.action_names):
            arms.append(Arm.random(protocol, schedule, chances))
            shares.append(number)
    if not arms:
        return None
    name = f"the same {counted(len(arms), 'arm')} over {schedule}"
    return NextStudy.of_arms(name, arms, shares)


def own_studies(log: EventLog, protocol: Protocol, schedule: str) -> tuple[NextStudy, ...]:
    """What `published_studies` is for the paper's protocol: one's own arms again, and random actions.

    Parameters
    ----------
    log, protocol, schedule
        As in `same_arms`.
    """
    from models.robust.study_design import Arm, NextStudy

    again = same_arms(log, protocol, schedule)
    varied = NextStudy.of_arms(f"{RANDOM} actions over {schedule}", [Arm.random(protocol, schedule)])
    return (varied,) if again is None else (again, varied)


def next_rounds(protocol: Protocol, schedule: str, most: int = MOST_ROUNDS, histories: int = FEW_HISTORIES) -> str:
    """The first rounds of a schedule that a next study can be valued over without much work.

    Parameters
    ----------
    protocol : Protocol
    schedule : str
        Letters.
    most, histories : int
        Rounds, and histories of a study with random actions, at most; one round remains whatever it takes.
    """
    from models.robust.study_design import Arm

    for n in range(min(most, len(schedule)), 1, -1):
        if Arm.random(protocol, schedule[:n]).n_histories <= histories:
            return schedule[:n]
    return schedule[:1]


def _actions_of(protocol: Protocol, mode: int) -> list[int]:
    return [a for a, m in enumerate(protocol.mode_of_action) if m == mode]


def _treatment(protocol: Protocol, count: NDArray[np.int64], mode: int) -> tuple[tuple[str, float], ...]:
    """Actions of a mode with how often they were met, as probabilities."""
    own = _actions_of(protocol, mode)
    total = int(count[own].sum())
    if not total:
        return ((protocol.modes[mode].null_action, 1.0),)
    return tuple((protocol.action_names[a], count[a] / total) for a in own if count[a])


def _study(option: str, condition: str, schedule: str, protocol: Protocol) -> NextStudy:
    from models.robust.study_design import Arm, NextStudy

    if condition == RANDOM:
        name, arm = f"{RANDOM} actions over {schedule}", Arm.random(protocol, schedule)
    elif "," in condition:
        actions = [a.strip() for a in condition.split(",")]
        name, arm = f"{', '.join(actions)} over {schedule}", Arm.listed(protocol, schedule, actions)
    else:
        name = f"{condition} over {schedule}"
        arm = Arm.constant(protocol, schedule, _by_mode(option, condition, protocol))
    return NextStudy.of_arms(name, [arm])


def _by_mode(option: str, condition: str, protocol: Protocol) -> dict[str, str]:
    published = {c.name: c.actions for c in study1_design().conditions}
    if condition in published:
        return {m: a for m, a in published[condition].items() if m in protocol.mode_names}
    out: dict[str, str] = {}
    for action in condition.split("+"):
        if action not in protocol.action_names:
            wanted = f"one of {', '.join(protocol.action_names)}, or a condition: {', '.join(published)}, {RANDOM}"
            raise located(f"--evsi {option}", Phrase(action), wanted)
        out[protocol.modes[protocol.mode_of_action[protocol.action(action)]].name] = action
    return out
