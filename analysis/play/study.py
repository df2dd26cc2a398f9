"""A study while it is collected: who plays, with which policy, which round is next, where everything is written.

Nothing here knows of the network. Calls are to be made from one thread at a time.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.play.event_rows import EventRows, Row, flush
from analysis.play.journal import TOO_LATE, UNTRAPPED, Journal, Member
from analysis.play.live_round import LiveRound
from analysis.play.log_lock import LogLock
from analysis.play.robot_mind import Decision, RobotMind
from analysis.play.settings import DELETE, MODES, PlaySettings
from analysis.play.study_setup import SetupFile
from models.game.record import record, write_records
from models.game.round import Round
from models.protocol import PUBLISHED

SEQUENCE = 0
"""Everybody plays once."""


@dataclass
class Person:
    """One person in the study.

    Attributes
    ----------
    member : Member
    mind : RobotMind
        The robot's policy beside this person.
    live : LiveRound or None
        The round in play, kept while the person is away.
    """

    member: Member
    mind: RobotMind
    live: LiveRound | None = None

    @property
    def participant(self) -> int:
        """Number of the person."""
        return self.member.participant


class Study:
    """A study that is being played.

    Parameters
    ----------
    settings : PlaySettings
    out : path
        The event log. Next to it a folder with the people and a record of every round
        (`analysis.play.log_lock.folder_of`).
    lock : LogLock, optional
        Of that log, where it was taken before; the study lets it go.

    Attributes
    ----------
    played : int
        Rounds that were finished since the server started.

    Raises
    ------
    InputError
        If the files belong to something else, another server writes them, or people agreed to something else
        (`analysis.play.study_setup.SetupFile.check`).
    """

    def __init__(self, settings: PlaySettings, out: str | Path, lock: LogLock | None = None) -> None:
        self.settings, self.out = settings, Path(out)
        self._lock = LogLock(out) if lock is None else lock
        self.folder, self.played = self._lock.folder, 0
        try:
            self.journal = Journal(self._lock)
            self.log = EventRows(out, settings.study)
            self.setup = SetupFile(self.folder)
            self.setup.check(settings, self.journal)
        except BaseException:
            self._lock.close()
            raise
        self._people: dict[int, Person] = {}
        # A server that was killed while it deleted somebody's rounds finishes that first.
        for participant, rule in self.journal.withdrawn.items():
            if rule == DELETE and (participant in self.log.rows or self._records(participant).exists()):
                self._delete(participant)

    def close(self) -> None:
        """Let another server go on with the files."""
        self._lock.close()

    # -- people ------------------------------------------------------------------------------------
    def agree(self) -> tuple[str, Person]:
        """Somebody has agreed: give them a number, a policy and a token."""
        taken = self.journal.numbers | set(self.log.rows)
        s = self.settings
        participant = s.first_participant
        while participant in taken:
            participant += 1
        condition = s.assigned(len(self.journal.numbers))
        # The text before the consent: a consent says that the text is there.
        self.setup.keep(s)
        token = self.journal.agree(participant, condition, s.setup(condition))
        person = self.find(token)
        assert person is not None
        return token, person

    def find(self, token: str) -> Person | None:
        """The person who has a token, as far as this study can go on with them."""
        member = self.journal.member(token)
        if member is None:
            return None
        if member.participant not in self._people:
            s = self.settings
            if member.condition not in s.policy_names or member.setup != s.setup(member.condition):
                return None
            past = [Decision(row.action, row.observation) for row in self.log.rows.get(member.participant, [])]
            self._people[member.participant] = Person(member, RobotMind(s.policy(member.condition), s.modes, past))
        return self._people[member.participant]

    def rows(self, person: Person) -> list[Row]:
        """Finished rounds of a person."""
        return self.log.rows.get(person.participant, [])

    def finished(self, person: Person) -> bool:
        """Whether a person has played all rounds."""
        return len(self.rows(person)) >= self.settings.n_rounds

    # -- rounds ------------------------------------------------------------------------------------
    def begin(self, person: Person) -> LiveRound:
        """The round that was left, or the next one; the same again if the server was killed during it."""
        if person.live is None:
            s, k = self.settings, len(self.rows(person))
            mode = s.modes[k]
            action = person.mind.act(s.policy_rng(person.participant, k))
            acts = action != PUBLISHED.mode(mode).null_action
            seed = s.round_seed(person.participant, k)
            person.live = LiveRound(Round(s.layout, s.parameters, MODES[mode], acts, seed), k, action)
        person.live.release()
        return person.live

    def leave(self, person: Person) -> None:
        """The person is gone in the middle of a round, which waits for them."""
        if person.live is not None and not person.live.paused and person.live.game.tick:
            person.live.paused = True
            self.journal.note("left", person.participant, k=person.live.k, tick=person.live.game.tick)

    def finish(self, person: Person) -> Row:
        """Write a round that is over, and let the robot learn from it."""
        live, s = person.live, self.settings
        assert live is not None
        assert live.done
        collected = live.game.collected
        row = Row(
            s.study, person.participant, person.member.condition, SEQUENCE, live.k, s.modes[live.k], live.shown,
            live.observation, sum(collected.values()), collected["human"], collected["robot"],
        )  # fmt: skip
        folder = self._records(person.participant)
        folder.mkdir(exist_ok=True)
        # The record before the row: a row says that all of the round is there.
        path = folder / f"round-{live.k}.jsonl"
        write_records([record(live.game)], path)
        flush(path)
        flush(folder)
        self.log.append(row)
        self.played += 1
        person.live = None
        person.mind.observe(Decision(row.action, row.observation))
        if live.odd:
            self.journal.note(live.odd, person.participant, k=live.k, chosen=live.action)
        if live.k in person.mind.ignored:
            self.journal.note("response ignored", person.participant, k=live.k)
        if person.mind.gave_up:
            self.journal.note("policy gave up", person.participant, k=live.k, why=person.mind.gave_up)
        if self.finished(person):
            self.journal.note("finished", person.participant)
        return row

    def withdraw(self, person: Person) -> str:
        """The person withdraws: the robot forgets them, and their rounds are deleted where that was promised.

        Returns
        -------
        str
            The rule that was promised to this person.
        """
        rule = str(person.member.setup["withdrawal"])
        self.journal.withdraw(person.participant, len(self.rows(person)), rule)
        held = self._people.pop(person.participant, None)
        if held is not None:
            held.mind.policy.forget()
        person.live = None
        if rule == DELETE:
            self._delete(person.participant)
        return rule

    def _delete(self, participant: int) -> None:
        shutil.rmtree(self._records(participant), ignore_errors=True)
        self.log.delete(participant)
        self.journal.delete(participant)

    def _records(self, participant: int) -> Path:
        return self.folder / f"participant-{participant}"

    # -- in numbers --------------------------------------------------------------------------------
    @property
    def summary(self) -> dict[str, Any]:
        """What stands in the files."""
        rows = self.log.rows
        return {
            "log": str(self.out), "records": str(self.folder), "people": len(rows),
            "rounds": sum(map(len, rows.values())), "finished": len(self.journal.finished),
            "withdrawn": len(self.journal.withdrawn), "untrapped": len(self.journal.odd_rounds[UNTRAPPED]),
            "too_late": len(self.journal.odd_rounds[TOO_LATE]),
        }  # fmt: skip
