"""Who takes part: consent, where to go on after a closed tab, and withdrawal, as JSON lines next to the log.

A person is known by a random token that only their browser has; the file holds its digest. Lines are forced to disk
as they are written.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from analysis.play.event_rows import flush
from analysis.play.log_lock import LogLock
from models.errors import located
from models.model_files import write_bytes

FILE = "people.jsonl"

UNTRAPPED, TOO_LATE = "nobody trapped", "too late"
"""Rounds in which what was to happen did not: nobody got trapped, or there was no time left to help."""


@dataclass(frozen=True)
class Member:
    """One person who agreed.

    Attributes
    ----------
    participant : int
    token : str
        SHA-256 of the token in the person's browser.
    condition : str
        Name of the policy.
    setup : dict
        `analysis.play.settings.PlaySettings.setup` at the time, with what was promised.
    """

    participant: int
    token: str
    condition: str
    setup: dict[str, Any]


class Journal:
    """The file of people. Not safe from several threads at once: its owner serialises.

    Parameters
    ----------
    lock : LogLock
        Holds the folder that the file is in; whoever took it lets it go.

    Attributes
    ----------
    members : dict of str to Member
        By digest of the token.
    withdrawn : dict of int to str
        Rule that was promised to people who withdrew: whether their rounds are deleted or kept.
    finished : set of int
    odd_rounds : dict of str to set of (int, int)
        Participant and k of rounds that were `UNTRAPPED` or `TOO_LATE`.

    Raises
    ------
    InputError
        If a line is none of this file's.
    """

    def __init__(self, lock: LogLock) -> None:
        self.folder = lock.folder
        self.path = self.folder / FILE
        self.members: dict[str, Member] = {}
        self.withdrawn: dict[int, str] = {}
        self.finished: set[int] = set()
        self.odd_rounds: dict[str, set[tuple[int, int]]] = {UNTRAPPED: set(), TOO_LATE: set()}
        if self.path.exists():
            self._read()

    def _read(self) -> None:
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            write_bytes(self.path, whole)
        for number, line in enumerate(whole.decode("utf-8", errors="replace").splitlines(), start=1):
            place = f"{self.path}, line {number}"
            try:
                entry = json.loads(line)
                event, person = entry["event"], int(entry["participant"])
                if event == "consent":
                    fields = {name: entry[name] for name in Member.__dataclass_fields__}
                    member = Member(**fields)
                    self.members[member.token] = member
                elif event == "withdrawn":
                    self.withdrawn[person] = str(entry["rule"])
                elif event == "finished":
                    self.finished.add(person)
                elif event in self.odd_rounds:
                    self.odd_rounds[event].add((person, int(entry["k"])))
            except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
                raise located(place, line, "a line as this server writes it") from None
        for person in self.withdrawn:
            self._forget_token(person)

    # -- people ------------------------------------------------------------------------------------
    def agree(self, participant: int, condition: str, setup: dict[str, Any]) -> str:
        """Note consent; returns the new person's token."""
        token = secrets.token_urlsafe(24)
        member = Member(participant, digest(token), condition, setup)
        self._write({"event": "consent", **asdict(member)})
        self.members[member.token] = member
        return token

    def member(self, token: str) -> Member | None:
        """Who has a token."""
        return self.members.get(digest(token))

    def note(self, event: str, participant: int, **details: Any) -> None:
        """Write that something happened to a person's study: ``interrupted``, ``finished`` and the like."""
        self._write({"event": event, "participant": participant, **details})
        if event == "finished":
            self.finished.add(participant)
        elif event in self.odd_rounds:
            self.odd_rounds[event].add((participant, details["k"]))

    def withdraw(self, participant: int, rounds: int, rule: str) -> None:
        """Remember that somebody withdrew after some rounds; their number is not given away again."""
        self._write({"event": "withdrawn", "participant": participant, "rounds": rounds, "rule": rule})
        self.withdrawn[participant] = rule
        self._forget_token(participant)

    def delete(self, participant: int) -> None:
        """Remove all lines of a person but the one that says that they withdrew, which loses its time."""
        kept = []
        for line in self.path.read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            if entry["participant"] != participant:
                kept.append(line)
            elif entry["event"] == "withdrawn":
                entry.pop("time", None)
                kept.append(json.dumps(entry))
        write_bytes(self.path, "".join(f"{line}\n" for line in kept).encode())
        flush(self.path)
        flush(self.folder)
        self.finished.discard(participant)
        for rounds in self.odd_rounds.values():
            rounds.difference_update([entry for entry in rounds if entry[0] == participant])
        self._forget_token(participant)

    @property
    def numbers(self) -> set[int]:
        """Numbers that were given away."""
        return {m.participant for m in self.members.values()} | set(self.withdrawn)

    def _forget_token(self, participant: int) -> None:
        self.members = {t: m for t, m in self.members.items() if m.participant != participant}

    def _write(self, entry: dict[str, Any]) -> None:
        stamped = {**entry, "time": datetime.now(UTC).isoformat(timespec="seconds")}
        new = not self.path.exists()
        with self.path.open("ab", buffering=0) as stream:
            stream.write((json.dumps(stamped) + "\n").encode())
            os.fsync(stream.fileno())
        if new:
            flush(self.folder)


def digest(token: str) -> str:
    """What the file knows of a token: it has 192 random bits, so that its digest gives nothing away."""
    return hashlib.sha256(token.encode()).hexdigest()
