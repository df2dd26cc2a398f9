"""Next studies as they are written on a command line: ``CONDITION:SCHEDULE:N``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.design import study1_design
from models.errors import InputError, Phrase, located

if TYPE_CHECKING:
    from collections.abc import Sequence

    from models.protocol import Protocol
    from models.robust.study_design import NextStudy

RANDOM = "random"
"""Condition in which every event draws its action anew."""

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
