"""The robot's side: what to do now and why, told what came of it, with safeguards, consent and a log.

::

    with Session(read_policy("policy.json"), "monday.log") as session:
        decision = session.act("robot_needs_help")      # decision.action, decision.explanation
        session.observe("help")                         # what the person did

Needs numpy only, from the policy's file to the last line of the log.

**The log** has a line for each decision before it is answered, for what came of it, for consent withdrawn, and for
every start, restart and end (`models.safeguards.audit` has the format and what its chain of hashes shows,
`models.safeguards.replay` the check of every decision). Its first line holds the policy, the declared fallback,
the seed and the responses that each mode can show; no line names the machine, its folders or its user. Times are in
UTC.

**Withdrawal** deletes the belief and everything else that was worked out about the person from memory (decisions
that the caller kept are the caller's); from then on the fallback acts, which looks at the mode only, and responses
are neither used nor logged. Lines written before it stay in the log, responses and beliefs included, since a chain
with lines taken out would vouch for nothing: whoever promised more deletes the file. A restored session works out
nothing from them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from models.errors import InputError, Phrase, located
from models.planning.baselines import ModePolicy
from models.planning.policies import Policy
from models.planning.policy_files import policy_from_dict, policy_to_dict
from models.protocol import Protocol
from models.runtime_course import Course
from models.runtime_log import LogWriter
from models.runtime_setting import declared_fallback, responses_of
from models.safeguards.consent import Consent
from models.safeguards.guarded import Decision
from models.safeguards.replay import course_after

__all__ = ["Decision", "Session"]


def utc_now() -> datetime:
    """The time, in UTC."""
    return datetime.now(UTC)


class Session:
    """One robot with one person. Not safe from several threads at once: its owner serialises.

    Parameters
    ----------
    policy : Policy
        Plain, or with safeguards (`models.safeguards.guarded.Guarded`). With a log, what runs is the policy as the
        log holds it, so that a replay is exact.
    log : path, optional
        A new file. None: nothing is kept.
    seed : int
        Policies that randomise draw from ``SeedSequence(seed, spawn_key=(event,))``.
    consent : bool
        False: the person did not agree, so only the fallback acts and responses are not looked at.
    fallback : ModePolicy, or mapping of str to str, optional
        What acts without consent, or actions by mode; the guarded policy's own, or null actions, by default.
    protocol : Protocol, optional
        Which modes show responses and which actions are null, where the policy does not know and its names are not
        the published ones.
    durable : bool
        Force every line to disk before it counts: survives a power cut too, and takes milliseconds.
    clock : callable
        The time, with its zone.

    Raises
    ------
    InputError
        If the log cannot be begun, the policy cannot be written to a file, or the fallback adapts.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from models.planning.baselines import Reciprocal
    >>> from models.protocol import PUBLISHED
    >>> folder = tempfile.TemporaryDirectory()
    >>> log = Path(folder.name) / "person-1.log"
    >>> session = Session(Reciprocal(PUBLISHED), log)
    >>> session.act("robot_needs_help").action
    'no_signal'
    >>> session.observe("help")
    >>> decision = session.act("human_needs_help")
    >>> decision.action
    'help'
    >>> decision.explanation
    'help; reactive answers the last response: the last response was to help.'

    The machine fails here; a new process goes on where the log ends:

    >>> del session
    >>> session = Session.restore(log)
    >>> session.pending.action
    'help'
    >>> session.observe(performed="no_help")        # somebody was in the way
    >>> session.withdraw()
    >>> session.act("robot_needs_help").action
    'no_signal'
    >>> session.close()

    >>> from models.safeguards.replay import verify
    >>> audit = verify(log, session.last_hash)
    >>> audit.ok, audit.entries, audit.decisions, audit.consent
    (True, 9, 3, 'withdrawn')
    >>> folder.cleanup()
    """

    def __init__(
        self, policy: Policy, log: str | Path | None = None, *, seed: int = 1, consent: bool = True,
        fallback: Policy | Mapping[str, str] | None = None, protocol: Protocol | None = None, durable: bool = False,
        clock: Callable[[], datetime] = utc_now,
    ) -> None:  # fmt: skip
        self._clock, self._log = clock, None
        acting = declared_fallback(policy, fallback, protocol)
        responses = responses_of(policy, protocol)
        content = None
        if log is not None:
            content = policy_to_dict(policy)
            policy = policy_from_dict(content, f"policy {policy.name}")
        self._begin(Course(policy, acting, responses, seed, Consent.GIVEN if consent else Consent.NEVER))
        if log is not None and content is not None:
            entry = {**self._course.start_entry(content), "time": self._time()}
            self._log = LogWriter(log, durable=durable)
            try:
                self._log.append(entry)
            except BaseException:
                self._log.close()
                raise

    def _begin(self, course: Course) -> None:
        self._course = course
        self._closed = self._half_done = self._unnoted = False

    @classmethod
    def restore(
        cls, log: str | Path, *, durable: bool = False, clock: Callable[[], datetime] = utc_now
    ) -> Session:  # fmt: skip
        """Go on with the session of a log: same memory, same pending decision, same chain.

        Every decision is made again and compared on the way; after a withdrawal nothing about the person is worked
        out. An unfinished last line (a cut write, on which no answer rested) is cut off, and the log says so. A
        closed session is open again.

        Raises
        ------
        InputError
            If another process has the log, it was changed, its decisions are not those of its policy, or it cannot
            be written.
        """
        self = cls.__new__(cls)
        self._clock = clock
        self._log, chain = LogWriter.reopen(log, durable=durable)
        try:
            self._begin(course_after(chain, str(log)))
            entry = {"event": "restore", "cut": chain.torn, "time": self._time()}
            self._log.cut(chain.torn)
            self._log.append(entry)
        except BaseException:
            self._log.close()
            raise
        return self

    # -- what is known -----------------------------------------------------------------------------
    @property
    def event(self) -> int:
        """Number of the current event; events that are over are below it."""
        return self._course.event

    @property
    def seed(self) -> int:
        """What policies that randomise draw from."""
        return self._course.seed

    @property
    def pending(self) -> Decision | None:
        """The decision whose outcome is not known yet."""
        return self._course.pending

    @property
    def consent(self) -> Consent:
        """Whether the person agrees that the robot adapts to them."""
        return self._course.consent

    @property
    def policy(self) -> Policy:
        """What acts: the policy, or the fallback without consent."""
        return self.fallback if self._course.policy is None else self._course.policy

    @property
    def fallback(self) -> ModePolicy:
        """What acts without consent."""
        return self._course.fallback

    @property
    def cautions(self) -> tuple[str, ...]:
        """Why not to trust the policy (`models.cautions`), consent withdrawn or not; none where it never acted."""
        return self._course.cautions

    @property
    def memory(self) -> Any:
        """The policy's memory at the last decision; None before the first, and without consent."""
        return self._course.memory

    @property
    def last_hash(self) -> str | None:
        """Hash of the log's last line, to be kept elsewhere; None without a log."""
        return None if self._log is None else self._log.last_hash

    @property
    def closed(self) -> bool:
        """Whether the session is over."""
        return self._closed

    def possible_responses(self, mode: int | str) -> tuple[str, ...] | None:
        """Names of what a mode can show, empty if it shows no response; None: not known.

        Raises
        ------
        InputError
            On an unknown mode.
        """
        words = self._course.words
        shown = self._course.responses[words.mode(mode)]
        return None if shown is None else tuple(words.observations[o] for o in shown if o or shown != (0,))

    # -- acting ------------------------------------------------------------------------------------
    def act(self, mode: int | str) -> Decision:
        """Decide. The decision is in the log before it is answered.

        Parameters
        ----------
        mode : str or int
            Who needs help: name or number of the mode.

        Raises
        ------
        InputError
            On an unknown mode, or one that the policy cannot be in now; on a history that it takes for impossible;
            before the outcome of the last decision; if the log cannot be written. Nothing has changed then, and the
            call may be repeated. A policy that has nothing more to say leaves `withdraw`, after which the fallback
            acts.
        """
        self._ready("act")
        if self._course.pending is not None:
            found = Phrase(f"a decision ({self._course.pending.action}) whose outcome is not known")
            raise located("session, act", found, "observe(...) first")
        step = self._course.decide(self._course.words.mode(mode))
        self._note(self._course.decide_entry(step.decision))
        self._course.decided(step)
        self._half_done = False
        return step.decision

    def observe(self, response: str | None = None, performed: str | None = None) -> None:
        """Tell what came of the last decision.

        Parameters
        ----------
        response : str, optional
            What the person did; None where the mode shows nothing, or it was not recorded. Without consent it is
            not looked at.
        performed : str, optional
            What was really done, if it was another action than decided; the policy is told so.

        Raises
        ------
        InputError
            If there is no decision to observe, the mode cannot show such a response or has no such action, or the
            log cannot be written. Nothing has changed then.
        """
        self._ready("observe")
        if self._course.pending is None:
            raise located("session, observe", Phrase("no decision to observe"), "act(mode) first")
        outcome = self._course.outcome(response, performed)
        self._note(self._course.observe_entry(outcome))
        self._course.observed(outcome)
        self._half_done = False

    def check(self, mode: int | str, response: str | None = None, performed: str | None = None) -> None:
        """Refuse what `observe` and then `act` would refuse; nothing changes and nothing is logged.

        For whoever tells the outcome and the next mode at once, and wants both to count or neither.

        Parameters
        ----------
        mode : str or int
        response, performed : str, optional
            As in `observe`.

        Raises
        ------
        InputError
            As `observe` and `act` do, the log apart.
        """
        self._ready("check")
        if self._course.pending is None:
            raise located("session, check", Phrase("no decision to observe"), "act(mode) first")
        self._course.check(self._course.outcome(response, performed), self._course.words.mode(mode))

    def withdraw(self) -> None:
        """The person no longer agrees: forget them, and act by the fallback from now on.

        What is in memory is deleted at once, even if the log cannot note it; then the call has to be repeated
        before anything else. A second call does nothing; one without consent neither.

        Raises
        ------
        InputError
            If the log cannot be written, or is closed: then the restored session has to withdraw.
        """
        if self._course.consent is Consent.GIVEN:
            self._course.withdraw()
            self._unnoted = self._log is not None
        if self._unnoted:
            self._ready("withdraw", unnoted=True)
            self._note({"event": "withdraw"})
            self._unnoted = self._half_done = False

    def close(self) -> None:
        """End the session: the log says so, and is let go of. A second call does nothing.

        Raises
        ------
        InputError
            If the log cannot be written; it is let go of all the same.
        """
        if self._closed:
            return
        self._closed = True
        if self._log is None:
            return
        try:
            if not self._half_done and not self._unnoted:
                self._log.append({"event": "close", "time": self._time()})
        finally:
            self._log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- the log -----------------------------------------------------------------------------------
    def _ready(self, call: str, *, unnoted: bool = False) -> None:
        if self._closed:
            raise located(f"session, {call}", Phrase("a closed session"), "one that is open: Session.restore(log)")
        if self._half_done:
            # An interruption (Ctrl-C) came between the log and the memory; only the log is sure.
            raise located(f"session, {call}", Phrase("a call that was interrupted"), "Session.restore(log)")
        if self._unnoted and not unnoted:
            found = Phrase("a withdrawal that the log could not note")
            raise located(f"session, {call}", found, "withdraw() again")

    def _note(self, entry: dict[str, Any]) -> None:
        """Write an entry; the caller takes the step that it tells of and clears `_half_done`."""
        stamped = {**entry, "time": self._time()}
        self._half_done = self._log is not None
        if self._log is not None:
            try:
                self._log.append(stamped)
            except InputError:
                self._half_done = False
                raise

    def _time(self) -> str:
        now = self._clock()
        if now.tzinfo is None:
            raise located("session, clock", now, "a time with its zone")
        return now.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
