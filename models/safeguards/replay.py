"""Replaying a log: every decision is made again from what the log says, and compared with what it says was done.

The start entry holds the policy itself, so a log is checked with nothing else at hand. What replay adds to the hash
chain (`models.safeguards.audit`): a decision that the policy would not have made is found even where somebody
recomputed all hashes. Numbers are compared within rounding, everything else exactly; where two actions are worth
the same to the last digit, another version of numpy may prefer the other one, so the log says which it was.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import InputError, Phrase, located
from models.notebook_view import NotebookView
from models.runtime_course import Course
from models.safeguards.audit import Chain, Finding, check_last_hash, read_chain
from models.safeguards.consent import Consent

ROUNDING = 1e-9
"""Relative difference up to which numbers count as the same."""

_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z")


@dataclass(frozen=True)
class Audit(NotebookView):
    """What a check of a log found.

    Attributes
    ----------
    entries : int
        Whole lines.
    decisions : int
    chain_ok : bool
        Whether no whole line was changed, moved, doubled or removed from the middle.
    replay_ok : bool
        Whether every decision is the one that the policy makes.
    findings : tuple of Finding
        Empty: nothing is wrong.
    last_hash : str or None
        To be kept where the log's owner cannot change it.
    end_known : bool
        Whether a last hash was given and agrees: only then is it known that no end was cut off.
    consent : str
        `given`, `withdrawn` or `never`; empty if the log cannot be read.
    numpy : str
        Version that the log was written with; empty if it does not say.
    cautions : tuple of str
        Those of the policy in the log (`models.cautions`).
    """

    entries: int
    decisions: int
    chain_ok: bool
    replay_ok: bool
    findings: tuple[Finding, ...]
    last_hash: str | None
    end_known: bool
    consent: str
    numpy: str = ""
    cautions: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        size = f"{_counted(self.entries, 'entry', 'entries')}, {_counted(self.decisions, 'decision', 'decisions')}"
        if not self.ok:
            n = len(self.findings)
            told = f"{size}: {n} problem{'s' * (n != 1)}."
            if not self.replay_ok and self.numpy not in ("", np.__version__):
                told += f" Written with numpy {self.numpy}, replayed with {np.__version__}: ties may differ."
            return told
        end = (
            "its end is the one of the given hash" if self.end_known
            else "whether its end was cut off only the last hash can tell, kept elsewhere"
        )  # fmt: skip
        return f"{size}: the chain holds and every decision is the policy's own; {end}."

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        return {
            "entries": self.entries, "decisions": self.decisions, "chain_ok": self.chain_ok,
            "replay_ok": self.replay_ok, "problems": [f.to_dict() for f in self.findings],
            "last_hash": self.last_hash, "end_known": self.end_known, "consent": self.consent,
            "numpy": self.numpy, "cautions": list(self.cautions),
        }  # fmt: skip


def verify(log: str | Path | bytes, last_hash: str | None = None) -> Audit:
    """Check a log: its chain, its decisions, and its end if the last hash is known.

    Parameters
    ----------
    log : path or bytes
    last_hash : str, optional
        As it was when the log was last seen whole.

    Raises
    ------
    InputError
        If the file cannot be read, or `last_hash` is no hash. What is wrong with the log is in the result.
    """
    chain = read_chain(log if isinstance(log, bytes) else _content(Path(log)))
    end = None if last_hash is None else check_last_hash(chain, last_hash)
    course, wrong = replay(chain)
    findings = (*chain.findings, *wrong, *(() if end is None else (end,)))
    findings = tuple(sorted(findings, key=lambda f: math.inf if f.line is None else f.line))
    decisions = sum(e is not None and e.get("event") == "decide" for e in chain.entries)
    return Audit(
        len(chain.entries), decisions, chain.ok and bool(chain.entries), not wrong, findings, chain.last_hash,
        last_hash is not None and end is None, "" if course is None else course.consent.value,
        str(chain.entries[0].get("numpy", "")) if chain.entries and chain.entries[0] is not None else "",
        () if course is None else course.cautions,
    )  # fmt: skip


def replay(chain: Chain) -> tuple[Course | None, list[Finding]]:
    """Make every decision of a log again.

    Returns
    -------
    course : Course or None
        Where the session stood at the end; None if its start cannot be read.
    findings : list of Finding
        What differs. After an entry that cannot follow the one before it nothing more is compared.
    """
    if not chain.entries or chain.entries[0] is None:
        return None, [Finding(1, "replay", "has no start entry, so nothing can be replayed")]
    findings = []
    try:
        check_time(chain.entries[0])
        course = Course.from_start(chain.entries[0], "start")
        _same_start(course, chain.entries[0])
    except InputError as error:
        return None, [Finding(1, "replay", str(error))]
    closed = False
    for n, entry in enumerate(chain.entries[1:], start=2):
        try:
            if entry is None:
                raise located("entry", None, "one that can be read")
            closed = follow(course, entry, closed)
        except Differs as error:
            findings.append(Finding(n, "replay", str(error)))
        except InputError as error:
            findings.append(Finding(n, "replay", f"{error}; nothing after it was replayed"))
            break
    return course, findings


def course_after(chain: Chain, place: str) -> Course:
    """Where the session of an unbroken chain stands.

    Every decision is made again and compared; but once consent was withdrawn nothing about the person is worked out
    again, and the chain alone vouches for the time before.

    Raises
    ------
    InputError
        At the first entry that differs.
    """
    entries = [e for e in chain.entries if e is not None]
    events = [e.get("event") for e in entries]
    forgotten = events.index("withdraw") if "withdraw" in events else 0
    closed, n = False, 0
    try:
        course = Course.from_start(entries[0], "start", believes=not forgotten)
        if forgotten:
            course.withdraw()
        for n, entry in enumerate(entries[1:], start=1):
            if n <= forgotten:
                course.skip(entry)
            else:
                closed = follow(course, entry, closed)
    except InputError as error:
        raise InputError(f"{place}, line {n + 1}: {error} (see: audit verify)") from None
    return course


class Differs(InputError):
    """An entry says something else than what happens; the replay can go on."""


def follow(course: Course, entry: Mapping[str, Any], closed: bool = False) -> bool:
    """Take one step of a log.

    Parameters
    ----------
    course : Course
        Moves on.
    entry : mapping
        Any but the first.
    closed : bool
        Whether the entry before closed the log.

    Returns
    -------
    bool
        Whether this entry closed the log.

    Raises
    ------
    Differs
        If it says something else than what happens here.
    InputError
        If it cannot follow what was before it.
    """
    closed = _step(course, entry, closed)
    # The step is taken all the same, so that what follows is compared.
    check_time(entry)
    return closed


def _step(course: Course, entry: Mapping[str, Any], closed: bool) -> bool:
    event = entry.get("event")
    if closed and event != "restore":
        raise located("event", event, "restore: the log was closed")
    if event == "decide":
        if course.pending is not None:
            raise located("event", event, "observe: the outcome of the decision before")
        step = course.decide(course.words.mode(_text(entry, "mode")))
        course.decided(step)
        _compare(entry, course.decide_entry(step.decision))
    elif event == "observe":
        if course.pending is None:
            raise located("event", event, "decide: there is nothing to observe")
        outcome = course.outcome(_text(entry, "response", True), _text(entry, "performed", True))
        wanted = course.observe_entry(outcome)
        course.observed(outcome)
        _compare(entry, wanted)
    elif event == "withdraw":
        if course.consent is not Consent.GIVEN:
            raise located("event", event, f"something else: consent was {course.consent.value} already")
        course.withdraw()
        _compare(entry, {"event": event})
    elif event == "restore":
        cut = entry.get("cut")
        if not isinstance(cut, int) or isinstance(cut, bool) or cut < 0:
            raise located("cut", cut, "a number of bytes")
        _compare(entry, {"event": event, "cut": cut})
    else:
        if event != "close":
            raise located("event", event, "decide, observe, withdraw, restore or close")
        _compare(entry, {"event": event})
    return event == "close"


def check_time(entry: Mapping[str, Any]) -> None:
    """Refuse a time that is none in UTC.

    Raises
    ------
    InputError
    """
    time = entry.get("time")
    if not isinstance(time, str) or not _TIME.fullmatch(time) or not _exists(time):
        raise Differs(str(located("time", time, "a time in UTC such as 2026-01-31T12:00:00.000Z")))


def _exists(time: str) -> bool:
    """Whether there is such a day and hour. Clocks are set back now and then, so no order is asked for."""
    try:
        datetime.fromisoformat(time)
    except ValueError:
        return False
    return True


def _same_start(course: Course, entry: Mapping[str, Any]) -> None:
    wanted = course.start_entry({})
    extra = set(entry) ^ {"n", "time", *wanted}
    if extra:
        raise located("keys of the start entry", Phrase(", ".join(sorted(extra))), "those of a start entry")


def _compare(entry: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Refuse an entry with other content than what happened."""
    for key in [*wanted, *(k for k in entry if k not in wanted and k not in ("n", "time"))]:
        if key not in entry or key not in wanted or not _same(entry[key], wanted[key]):
            place, found, meant = _where(key, entry.get(key, _NOTHING), wanted.get(key, _NOTHING))
            raise Differs(str(located(place, found, str(meant))))


_NOTHING = Phrase("nothing of that name")


def _where(place: str, found: Any, wanted: Any) -> tuple[str, Any, Any]:
    """The first entry of two unequal things that differs, with its place."""
    if isinstance(found, Mapping) and isinstance(wanted, Mapping):
        for key in [*wanted, *(k for k in found if k not in wanted)]:
            one, other = found.get(key, _NOTHING), wanted.get(key, _NOTHING)
            if not _same(one, other):
                return _where(f"{place}, {key}", one, other)
    return place, found, wanted


def _same(one: Any, other: Any) -> bool:
    """Equal content, numbers within rounding."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    if type(one) is float and type(other) is float:
        return math.isclose(one, other, rel_tol=ROUNDING, abs_tol=ROUNDING)
    return type(one) is type(other) and bool(one == other)


def _text(entry: Mapping[str, Any], key: str, optional: bool = False) -> Any:
    value = entry.get(key)
    if not isinstance(value, str) and not (optional and value is None):
        raise located(key, value, "a name")
    return value


def _counted(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
