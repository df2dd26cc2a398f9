"""The log of a session while it is written: locks, full disks, files that others touch, kill -9."""

import errno
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import models.runtime_log as module
from models.errors import InputError
from models.planning.baselines import Reciprocal
from models.planning.policy_files import write_policy
from models.protocol import PUBLISHED
from models.runtime import Session
from models.runtime_log import LogWriter
from models.safeguards.audit import read_chain
from models.safeguards.consent import Consent
from models.safeguards.replay import verify
from tests.models.session_cases import HUMAN, ROBOT, make, modes_of, run
from tests.models.test_runtime import by_hand, same

RIVAL = """
import sys
from models.errors import InputError
from models.runtime import Session
try:
    Session.restore(sys.argv[1])
except InputError as error:
    print(error)
"""


def refusal(checkout, log):
    ran = subprocess.run([sys.executable, "-c", RIVAL, str(log)], cwd=checkout, capture_output=True, text=True)
    assert not ran.stderr
    return ran.stdout


# -- one process a log -----------------------------------------------------------------------------
def test_two_on_one_log_are_refused(checkout, tmp_path):
    log = tmp_path / "log"
    session = Session(Reciprocal(PUBLISHED), log)
    before = log.read_bytes()
    assert "another session is writing it" in refusal(checkout, log)
    for again in (lambda: Session.restore(log), lambda: Session(Reciprocal(PUBLISHED), log)):
        with pytest.raises(InputError, match="another session is writing it"):
            again()
    assert log.read_bytes() == before
    session.act(ROBOT)
    session.close()
    assert refusal(checkout, log) == ""
    with pytest.raises(InputError, match="found a file that holds something, wanted a new log"):
        Session(Reciprocal(PUBLISHED), log)
    assert verify(log).ok


def test_places_that_hold_no_log(tmp_path):
    for path, words in (
        (tmp_path, "no plain file"), (tmp_path / "none" / "log", "no folder"), ("/dev/full", "no plain file"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            Session(Reciprocal(PUBLISHED), path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="Permission denied"):
            Session(Reciprocal(PUBLISHED), tmp_path / "log")
    finally:
        tmp_path.chmod(0o700)


def test_an_empty_file_is_a_new_log(tmp_path):
    (tmp_path / "log").touch()
    with Session(Reciprocal(PUBLISHED), tmp_path / "log") as session:
        session.act(ROBOT)
    assert verify(tmp_path / "log").ok


# -- what cannot be written ------------------------------------------------------------------------
FULL = """
import resource, signal, sys
from models.errors import InputError
from models.planning.baselines import Reciprocal
from models.protocol import PUBLISHED
from models.runtime import Session
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
session = Session(Reciprocal(PUBLISHED), sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
done = 0
try:
    while True:
        session.act("robot_needs_help")
        done += 1
        session.observe("help")
except InputError as error:
    print(done, session.pending is not None, error)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
if session.pending is None:
    session.act("robot_needs_help")
session.observe("no_help")
session.close()
"""


@pytest.mark.parametrize("limit", [2900, 3001, 3102, 3203])
def test_a_full_disk_is_told_before_the_decision_is_answered(limit, checkout, tmp_path):
    """A file that may not grow further: the system writes what fits and refuses the rest."""
    log = tmp_path / "log"
    command = [sys.executable, "-c", FULL, str(log), str(limit)]
    ran = subprocess.run(command, cwd=checkout, capture_output=True, text=True)
    assert not ran.stderr
    done, pending, told = ran.stdout.split(" ", 2)
    assert "cannot be written: File too large; nothing was noted" in told
    assert verify(log).ok, "room was made, and the session went on"
    events = [e["event"] for e in read_chain(log.read_bytes()).entries]
    assert events.count("decide") == int(done) + (pending == "False")


def test_writes_that_fail_leave_everything_as_it_was(tmp_path, monkeypatch):
    log = tmp_path / "log"
    session = Session(Reciprocal(PUBLISHED), log)
    session.act(ROBOT)
    session.observe("help")
    content, memory, last_hash = log.read_bytes(), session.memory, session.last_hash

    class Full:
        def __init__(self, file):
            self.file, self.room = file, 40

        def fileno(self):
            return self.file.fileno()

        def close(self):
            self.file.close()

        def write(self, line):
            if not self.room:
                raise OSError(errno.ENOSPC, "No space left on device")
            written, self.room = self.file.write(line[: self.room]), 0
            return written

    file = session._log._file
    session._log._file = Full(file)
    with pytest.raises(InputError, match="No space left on device; nothing was noted"):
        session.act(HUMAN)
    assert (log.read_bytes(), session.memory, session.last_hash) == (content, memory, last_hash)
    assert session.pending is None
    session._log._file = file
    assert session.act(HUMAN).action == "help"
    # Where not even the piece can be taken back, the log has to be restored.
    session._log._file = Full(file)
    monkeypatch.setattr(module.os, "ftruncate", lambda *_: (_ for _ in ()).throw(OSError(errno.EIO, "I/O error")))
    with pytest.raises(InputError, match="nothing was noted"):
        session.observe()
    monkeypatch.undo()
    session._log._file = file
    with pytest.raises(InputError, match="wanted the session restored"):
        session.observe()
    with pytest.raises(InputError, match="wanted the session restored"):
        session.close()
    session = Session.restore(log)
    assert session.pending.action == "help"
    session.observe()
    session.close()
    assert verify(log).ok


def test_a_disk_that_keeps_nothing(tmp_path, monkeypatch):
    forced = []
    monkeypatch.setattr(module.os, "fsync", lambda handle: forced.append(handle))
    session = Session(Reciprocal(PUBLISHED), tmp_path / "log", durable=True)
    assert len(forced) == 2, "the line, and the name of the new file"
    session.act(ROBOT)
    assert len(forced) == 3
    monkeypatch.setattr(module.os, "fsync", lambda _: (_ for _ in ()).throw(OSError(errno.EIO, "I/O error")))
    with pytest.raises(InputError, match=r"could not be forced to disk \(I/O error\)"):
        session.observe("help")
    assert session.pending is not None
    with pytest.raises(InputError, match="wanted the session restored"):
        session.observe("help")


def test_a_log_that_others_touch(tmp_path):
    for touch, words in (
        (lambda log: log.write_bytes(log.read_bytes() + b"x"), "somebody else changed the log"),
        (lambda log: log.write_bytes(log.read_bytes()[:-9]), "somebody else changed the log"),
        (lambda log: log.unlink(), "was deleted while the session ran"),
    ):
        log = tmp_path / "log"
        session = Session(Reciprocal(PUBLISHED), log)
        touch(log)
        with pytest.raises(InputError, match=words):
            session.act(ROBOT)
        assert session.pending is None
        log.unlink(missing_ok=True)


def test_a_withdrawal_that_cannot_be_noted_forgets_all_the_same(tmp_path, monkeypatch):
    log = tmp_path / "log"
    session = Session(make("tracked"), log)
    run(session, [ROBOT, HUMAN], np.random.default_rng(1))
    monkeypatch.setattr(LogWriter, "append", lambda *_: (_ for _ in ()).throw(InputError("no room")))
    with pytest.raises(InputError, match="no room"):
        session.withdraw()
    assert (session.memory, session.consent) == (None, Consent.WITHDRAWN)
    monkeypatch.undo()
    with pytest.raises(InputError, match=r"found a withdrawal that the log could not note, wanted withdraw\(\)"):
        session.act(ROBOT)
    session.withdraw()
    assert session.act(ROBOT).action == "no_signal"
    session.close()
    assert verify(log).consent == "withdrawn"


def test_a_closed_session_forgets_too(tmp_path):
    session = Session(make("tracked"), tmp_path / "log")
    run(session, [ROBOT, HUMAN], np.random.default_rng(1))
    session.close()
    with pytest.raises(InputError, match=r"closed session, wanted one that is open: Session.restore\(log\)"):
        session.withdraw()
    assert session.memory is None
    with Session.restore(tmp_path / "log") as again:
        assert again.consent is Consent.GIVEN, "the log was not told"
        again.withdraw()
    assert verify(tmp_path / "log").consent == "withdrawn"


@pytest.mark.parametrize("after", ["append", "decided"])
def test_an_interruption_between_log_and_answer(after, tmp_path, monkeypatch):
    log = tmp_path / "log"
    session = Session(Reciprocal(PUBLISHED), log)
    owner = LogWriter if after == "append" else type(session._course)
    own = getattr(owner, after)

    def interrupted(*arguments):
        own(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(owner, after, interrupted)
    with pytest.raises(KeyboardInterrupt):
        session.act(ROBOT)
    monkeypatch.undo()
    with pytest.raises(InputError, match="a call that was interrupted"):
        session.observe("help")
    session.close()
    session = Session.restore(log)
    assert session.pending.action == "no_signal"
    session.close()
    assert verify(log).ok


# -- kill -9 ---------------------------------------------------------------------------------------
CHILD = """
import os, sys
from models.planning.policy_files import read_policy
from models.runtime import Session
policy, log, seed, *modes = sys.argv[1:]
session = Session(read_policy(policy), log, seed=int(seed))
os.write(1, b"ready\\n")
chance = int(seed)
for mode in modes:
    decision = session.act(mode)
    os.write(1, f"decided {decision.action} {session.last_hash}\\n".encode())
    chance = (1103515245 * chance + 12345) % 2**31
    response = ("help", "no_help")[chance >> 16 & 1] if mode == "robot_needs_help" else None
    session.observe(response)
    os.write(1, f"observed {response} {session.last_hash}\\n".encode())
"""
KILLED = ("alpha", "tracked", "guarded", "random", "reactive", "mixture", "guarded product", "mixed")


def killed_and_restored(number, checkout, folder):
    """One session that is killed at a random point; returns how many decisions it had answered."""
    rng = np.random.default_rng(number)
    kind = KILLED[number % len(KILLED)]
    chosen, log = make(kind), folder / f"{number}.log"
    modes = modes_of(chosen, 400, rng)
    write_policy(chosen, folder / "policy.json")
    command = [sys.executable, "-c", CHILD, str(folder / "policy.json"), str(log), str(number), *modes]
    with subprocess.Popen(command, cwd=checkout, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout.readline() == b"ready\n", child.stderr.read().decode()
        # Some at once, some after a while: in both cases wherever the process happens to be.
        said = b"".join(child.stdout.readline() for _ in range(int(rng.integers(0, 12))))
        time.sleep(float(rng.exponential(0.004)))
        child.send_signal(signal.SIGKILL)
        said += child.stdout.read()
        errors = child.stderr.read()
    assert not errors
    told = [line.split() for line in said.decode().splitlines(keepends=True) if line.endswith("\n")]
    before, audit = log.read_bytes(), verify(log)
    assert audit.chain_ok
    assert audit.replay_ok
    assert {f.kind for f in audit.findings} <= {"torn"}
    chain = read_chain(before)
    for word, name, own in told:
        entry = chain.entries[chain.hashes.index(own)]
        assert entry["event"] == {"decided": "decide", "observed": "observe"}[word]
        if word == "decided":
            assert entry["action"] == name, "what was answered is in the log"

    session = Session.restore(log)
    decided = [e for e in chain.entries if e["event"] == "decide"]
    outcomes = [
        ((None if e["response"] == "none" else e["response"]), chosen.vocabulary.choice(
            chosen.vocabulary.mode(d["mode"]), d["action"]))
        for d, e in zip(decided, (e for e in chain.entries if e["event"] == "observe"), strict=False)
    ]  # fmt: skip
    assert session.event == len(outcomes)
    assert (session.pending is not None) == (len(decided) > len(outcomes))
    if decided:
        wanted, memory = by_hand(session.policy, [d["mode"] for d in decided], outcomes, number)
        assert same(session.memory, memory)
        assert session.pending in (None, wanted[-1])
    # What comes next is what would have come without the kill.
    rest = modes[len(decided) : len(decided) + 3]
    whole = Session(chosen, seed=number)
    for k, mode in enumerate(modes[: len(decided)]):
        whole.act(mode)
        if k < len(outcomes):
            whole.observe(outcomes[k][0])
    for mode in rest:
        for each in (session, whole):
            if each.pending is not None:
                each.observe("help" if each.pending.mode else None)
        assert session.act(mode) == whole.act(mode)
    session.close()
    assert verify(log, session.last_hash).ok
    assert log.read_bytes().startswith(before[: chain.size])
    return len(decided)


def test_killed_sessions_lose_nothing(checkout, tmp_path):
    assert len({killed_and_restored(n, checkout, tmp_path) for n in range(12)}) > 3


@pytest.mark.slow
def test_two_hundred_killed_sessions_lose_nothing(checkout, tmp_path):
    lengths = [killed_and_restored(n, checkout, tmp_path) for n in range(1000, 1200)]
    assert len(set(lengths)) > 20, "killed at many points"
