"""A robot's session by words: modes and what came of decisions in, actions with their reasons out.

One line in, one line out, whoever writes them: a person at a terminal or a program at a pipe. Where a word could
be both a response and a command, as `help`, it is the response while one is waited for, and from a program always;
with a colon (`:help`) it is the command.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from models.errors import InputError, located
from models.protocol import MISSING, NO_RESPONSE, Protocol
from models.runtime import Decision, Session
from models.safeguards.consent import Consent

PERFORMED = "performed"

COMMANDS = ("withdraw", "hash", "help", "quit")


@dataclass(frozen=True)
class Reply:
    """What is said to a line.

    Attributes
    ----------
    text : str
        One line; empty: nothing is said.
    refused : bool
        Whether the line could not be used; nothing has changed then.
    over : bool
        Whether the session is to end.
    """

    text: str
    refused: bool = False
    over: bool = False


class Talk:
    """The conversation about one session.

    Parameters
    ----------
    session : Session
    protocol : Protocol, optional
        For letters of modes; names alone without it.
    person : bool
        Whether a person writes the lines, not a program.

    Attributes
    ----------
    actions : Counter of str
        What was decided so far.
    changed : Counter of str
        Decisions that a safeguard changed, by safeguard.
    refused : int
        Lines that could not be used.
    """

    def __init__(self, session: Session, protocol: Protocol | None = None, *, person: bool = False) -> None:
        self.session, self.person = session, person
        modes = () if protocol is None else protocol.modes
        self.letters = {m.letter: m.name for m in modes}
        self.actions: Counter[str] = Counter()
        self.changed: Counter[str] = Counter()
        self.refused = 0

    # -- what is waited for ------------------------------------------------------------------------
    @property
    def modes(self) -> tuple[str, ...]:
        """Names of the modes."""
        return self.session.policy.vocabulary.modes

    @property
    def awaited(self) -> tuple[str, ...] | None:
        """Responses that are waited for; None: the next mode is (also after one that shows no response)."""
        decision = self.session.pending
        if decision is None or self.session.consent is not Consent.GIVEN:
            return None
        shown = self.session.possible_responses(decision.mode)
        if shown is None:
            return self.session.policy.vocabulary.observations
        return shown or None

    @property
    def prompt(self) -> str:
        """What to ask a person for."""
        awaited = self.awaited
        if awaited is not None:
            return f"response ({', '.join(awaited)}, {MISSING})> "
        letters = {name: letter for letter, name in self.letters.items()}
        return f"mode ({', '.join(letters.get(name, name) for name in self.modes)})> "

    @property
    def introduction(self) -> str:
        """What a person should know first."""
        letters = {name: letter for letter, name in self.letters.items()}
        modes = ", ".join(f"{letters[m]} {m}" if m in letters else m for m in self.modes)
        return (
            f"modes: {modes}. After a decision say how the person responded; 'performed ACTION' if something else "
            f"was done. Also: {', '.join(COMMANDS)}."
        )  # fmt: skip

    # -- answers -----------------------------------------------------------------------------------
    def answer(self, line: str) -> Reply:
        """Take one line; empty ones and those that start with # are passed over."""
        words = line.split()
        if not words or words[0].startswith("#"):
            return Reply("")
        try:
            return self._command(words) or self._step(words)
        except InputError as error:
            self.refused += 1
            return Reply(f"refused: {error}", refused=True)

    def _command(self, words: list[str]) -> Reply | None:
        word = words[0].removeprefix(":")
        names = (self.awaited or ()) if self.person else self.session.policy.vocabulary.observations
        meant = words[0].startswith(":") or word not in (*names, *self.modes)
        if len(words) > 1 or not meant:
            return None
        if word in ("help", "?"):
            return Reply(self.introduction)
        if word in ("quit", "exit"):
            return Reply("", over=True)
        if word == "undo":
            return Reply("undo is not possible: what happened stays as it is; withdraw ends its use")
        if word == "hash":
            return Reply(self.session.last_hash or "there is no log")
        if word == "withdraw":
            self.session.withdraw()
            return Reply("withdrawn: what was believed is deleted, and the declared fallback acts from now on")
        return None

    def _step(self, words: list[str]) -> Reply:
        awaited, pending = self.awaited, self.session.pending
        mode = self.letters.get(words[0].upper(), words[0])
        if awaited is None and mode in self.modes and len(words) == 1:
            if pending is not None:
                # The last mode showed nothing, so there was nothing to say about it. Unless the next mode can be
                # used the event is not over: what was really done can still be told.
                self.session.check(mode)
                self.session.observe()
            return self._decided(self.session.act(mode))
        if pending is None and PERFORMED not in words:
            raise located("mode", " ".join(words), f"one of {', '.join([*self.letters, *self.modes])}")
        response, performed = self._outcome(words)
        if response is not None and awaited is not None and response not in awaited:
            raise located("response", response, f"one of {', '.join((*awaited, MISSING))}")
        self.session.observe(response, performed)
        return Reply("noted" if performed is None else f"noted: {performed} was done")

    def _outcome(self, words: list[str]) -> tuple[str | None, str | None]:
        """Response and action of ``[RESPONSE] [performed ACTION]``."""
        performed = None
        if PERFORMED in words:
            at = words.index(PERFORMED)
            if len(words) != at + 2:
                raise located("line", " ".join(words), f"[RESPONSE] {PERFORMED} ACTION")
            words, performed = words[:at], words[at + 1]
        if len(words) > 1:
            raise located("line", " ".join(words), f"one response, then perhaps: {PERFORMED} ACTION")
        response = words[0] if words else None
        quiet = self.awaited is None or NO_RESPONSE not in self.awaited
        if response == MISSING or (response == NO_RESPONSE and quiet):
            response = None
        return response, performed

    def _decided(self, decision: Decision) -> Reply:
        self.actions[decision.action] += 1
        self.changed.update(decision.changed_by)
        reason = decision.explanation.removeprefix(decision.action).lstrip("; ").rstrip()
        return Reply(f"{decision.action}: {reason}")
