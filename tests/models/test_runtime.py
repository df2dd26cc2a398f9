"""Sessions: what they decide and remember, wrong use, consent, restarts."""

import gc
import json
import subprocess
import sys
import weakref
from datetime import datetime

import numpy as np
import pytest

from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.planning.baselines import Reciprocal, always, myopic, never, uniformly_random
from models.planning.belief_policy import BeliefMemory
from models.planning.policies import Policy
from models.planning.policy_files import policy_from_dict, policy_to_dict, write_policy
from models.planning.product_policy import ProductMemory
from models.protocol import PUBLISHED, Action, Mode, Protocol, Response
from models.runtime import Session
from models.runtime_content import pack, unpack
from models.runtime_setting import responses_of
from models.safeguards.budget import CostBudget
from models.safeguards.consent import Consent, fallback_of
from models.safeguards.guarded import Guarded, decide
from models.safeguards.replay import verify
from tests.models.planning.policy_cases import policy
from tests.models.session_cases import (
    HUMAN,
    KEPT_TO_A_PLAN,
    KINDS,
    ROBOT,
    Clock,
    make,
    modes_of,
    response_to,
    run,
    written,
)
from tests.planning_cases import modal_problem

CORRIDOR = Protocol(
    "corridor",
    (
        Mode("stuck", "S", (Action("wait"), Action("ask", 5.0)), "wait", True),
        Mode("person", "P", (Action("assist", 15.0), Action("pass_by")), "pass_by", False),
    ),
    (Response("ignored", 0.0), Response("helped", 1.0)),
)


def same(one, other):
    """Equal memories, arrays compared by their bytes."""
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dict__") and not isinstance(one, Consent):
        return type(one) is type(other) and all(same(v, getattr(other, k)) for k, v in vars(one).items())
    return one == other


def by_hand(chosen, modes, outcomes, seed):
    """Decisions and last memory of a policy, followed with nothing but its own interface."""
    memory, decided = None, []
    for k, mode in enumerate(modes):
        m = chosen.vocabulary.mode(mode)
        if memory is None:
            memory = chosen.begin(m)
        else:
            response, choice = outcomes[k - 1]
            seen = 0 if modes[k - 1] == HUMAN else chosen.vocabulary.observation(response)
            memory = chosen.observe(memory, choice, seen, m)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(k,)))
        decided.append(decide(chosen, memory, rng))
    return decided, memory


# -- what is decided -------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("logged", [True, False])
def test_a_session_does_what_its_policy_does(kind, logged, tmp_path):
    rng, chosen = np.random.default_rng(5), make(kind)
    for seed in range(4):
        modes = modes_of(chosen, 8, rng)
        outcomes, session = [], Session(chosen, tmp_path / f"{seed}.log" if logged else None, seed=seed)
        decided = []
        with session:
            for k, mode in enumerate(modes):
                decided.append(session.act(mode))
                assert session.pending == decided[-1]
                outcomes.append((response_to(mode, rng, kind not in KEPT_TO_A_PLAN), decided[-1].choice))
                if k + 1 < len(modes):
                    session.observe(outcomes[-1][0])
            wanted, memory = by_hand(chosen, modes, outcomes, seed)
            assert decided == wanted
            assert same(session.memory, memory)
        for decision, mode in zip(decided, modes, strict=True):
            assert decision.action in chosen.vocabulary.actions[chosen.vocabulary.mode(mode)]
            assert decision.explanation.startswith(decision.action)
            assert decision.explanation.endswith(".")


def test_a_policy_is_told_what_was_really_done(tmp_path):
    with Session(policy("tracked"), tmp_path / "log") as session:
        first = session.act(HUMAN)
        other = {"help": "no_help", "no_help": "help"}[first.action]
        session.observe(performed=other)
        session.act(ROBOT)
        told = session.memory
        words = session.policy.vocabulary
    memory = policy("tracked").begin(0)
    assert same(told, policy("tracked").observe(memory, words.choice(0, other), 0, 1))
    assert not same(told, policy("tracked").observe(memory, words.choice(0, first.action), 0, 1))
    assert json.loads((tmp_path / "log").read_text().splitlines()[2])["performed"] == other
    assert verify(tmp_path / "log").ok


def test_seeds_decide_what_is_left_to_chance(tmp_path):
    chosen = uniformly_random(PUBLISHED)
    done = {}
    for seed in (1, 1, 2):
        session = Session(chosen, seed=seed)
        actions = [d.action for d in run(session, [ROBOT] * 40, np.random.default_rng(1))]
        assert done.setdefault(seed, actions) == actions
    assert done[1] != done[2]
    assert len(set(done[1])) == 2


def test_a_session_over_when_the_schedule_is(tmp_path):
    with Session(policy("plan"), tmp_path / "log") as session:
        run(session, modes_of(policy("plan"), 0, None), np.random.default_rng(1), missing=False)
        assert session.event == 5
        with pytest.raises(InputError, match="the schedule is over"):
            session.act(ROBOT)
        assert session.pending is None
    assert verify(tmp_path / "log").ok
    session = Session(policy("plan"))
    session.act(ROBOT)
    session.observe("help")
    with pytest.raises(InputError, match="human_needs_help, as the schedule has it"):
        session.act(ROBOT)
    assert session.act(HUMAN).action


def test_a_history_that_the_policy_takes_for_impossible(tmp_path):
    """Nobody in this world helps; the session can be gone on with by the fallback only."""
    model = LatentStatePOMDP([1.0], np.ones((4, 1, 1)), [[[1.0, 0.0]]] * 2)
    with Session(myopic(model), tmp_path / "log") as session:
        session.act(ROBOT)
        session.observe("help")
        for _ in range(2):
            with pytest.raises(InputError, match="has probability zero"):
                session.act(HUMAN)
        session.withdraw()
        assert session.act(HUMAN).action == "no_help"
    assert verify(tmp_path / "log").ok


# -- wrong use -------------------------------------------------------------------------------------
def test_wrong_use_is_told_and_changes_nothing(tmp_path):
    log = tmp_path / "log"
    session = Session(Reciprocal(PUBLISHED), log)
    with pytest.raises(InputError, match=r"session, observe: found no decision to observe, wanted act\(mode\)"):
        session.observe("help")
    with pytest.raises(InputError, match="mode: found 'kitchen', wanted one of human_needs_help, robot_needs_help"):
        session.act("kitchen")
    with pytest.raises(InputError, match="mode: found 2, wanted 0 to 1"):
        session.act(2)
    session.act(HUMAN)
    before = log.read_bytes()
    with pytest.raises(InputError, match=r"found a decision \(no_help\) whose outcome is not known"):
        session.act(ROBOT)
    with pytest.raises(InputError, match="event 1, response in mode human_needs_help: found 'help', wanted none"):
        session.observe("help")
    with pytest.raises(InputError, match="found 'dance', wanted one of no_help, help"):
        session.observe(performed="dance")
    with pytest.raises(InputError, match="found 'Help', wanted one of none, no_help, help"):
        session.observe("Help")
    with pytest.raises(InputError, match="found 1, wanted one of"):
        session.observe(1)
    assert log.read_bytes() == before
    session.observe("none")
    session.act(ROBOT)
    with pytest.raises(InputError, match="found 'none', wanted one of no_help, help"):
        session.observe("none")
    session.observe("no_help")
    session.close()
    session.close()
    for call in (lambda: session.act(HUMAN), lambda: session.observe()):
        with pytest.raises(InputError, match="found a closed session, wanted one that is open"):
            call()
    assert verify(log, session.last_hash).ok


@pytest.mark.parametrize(("options", "words"), [
    ({"seed": -1}, "seed"), ({"seed": 1.5}, "seed"), ({"seed": True}, "seed"),
    ({"fallback": Reciprocal(PUBLISHED)}, "may adapt"), ({"fallback": never(CORRIDOR)}, "fallback never, modes"),
    ({"fallback": {"kitchen": "help"}}, "kitchen"), ({"fallback": {HUMAN: "signal"}}, "signal"),
    ({"protocol": CORRIDOR}, "protocol corridor"), ({"clock": lambda: datetime(2026, 1, 1)}, "with its zone"),
])  # fmt: skip
def test_unusable_options(options, words, tmp_path):
    with pytest.raises(InputError, match=words):
        Session(Reciprocal(PUBLISHED), tmp_path / "log", **options)
    assert not (tmp_path / "log").exists()


class Private(Policy):
    """No file can hold it."""

    name = "private"

    def __init__(self):
        self.vocabulary = never(PUBLISHED).vocabulary

    def begin(self, mode):
        return mode

    def mode_of(self, memory):
        return memory

    def probabilities(self, memory):
        return np.array([0.0, 1.0])

    def observe(self, memory, choice, observation, next_mode):
        return next_mode


def test_a_policy_that_no_file_holds_runs_without_a_log(tmp_path):
    with pytest.raises(InputError, match="can be written to a file"):
        Session(Private(), tmp_path / "log")
    session = Session(Private())
    assert session.act(ROBOT).action == "signal"
    assert session.last_hash is None
    session.close()


def test_other_protocols_need_to_be_told(tmp_path):
    chosen = always(CORRIDOR)
    with pytest.raises(InputError, match="mode stuck: found None, wanted one declared"):
        Session(chosen)
    assert responses_of(chosen) == (None, None)
    by_names = Session(chosen, tmp_path / "a.log", fallback={"stuck": "wait", "person": "pass_by"})
    assert by_names.possible_responses("stuck") is None
    told = Session(chosen, tmp_path / "b.log", protocol=CORRIDOR)
    assert (told.possible_responses("stuck"), told.possible_responses("person")) == (("ignored", "helped"), ())
    for session in (by_names, told):
        assert session.act("stuck").action == "ask"
        session.observe("helped")
        session.withdraw()
        assert session.act("person").action == "pass_by"
        session.close()
    assert verify(tmp_path / "a.log").ok
    assert verify(tmp_path / "b.log").ok
    assert responses_of(Reciprocal(CORRIDOR)) == ((1, 2), (0,))


def test_responses_as_policies_know_them():
    from models.planning.belief_model import BeliefModel
    from models.planning.belief_policy import Myopic

    model = BeliefModel.of_problem(modal_problem(2, (2, 2)))
    shown = responses_of(Myopic(model, np.zeros(2)))
    assert shown == tuple(
        tuple(sorted({z.observation for outcomes in offered for z in outcomes})) for offered in model.outcomes
    )
    for kind in KINDS:
        assert responses_of(make(kind)) == ((0,), (1, 2))


# -- consent ---------------------------------------------------------------------------------------
def reachable(root):
    """Everything that an object leads to, classes and modules left out."""
    seen, left = {}, [root]
    while left:
        one = left.pop()
        if id(one) in seen or isinstance(one, type | type(sys)) or (callable(one) and not hasattr(one, "__dict__")):
            continue
        seen[id(one)] = one
        left += [r for r in gc.get_referents(one) if not hasattr(r, "__globals__")]
        if isinstance(one, np.ndarray) and one.base is not None:
            left.append(one.base)
    return list(seen.values())


@pytest.mark.parametrize("kind", ["alpha", "tracked", "guarded", "plan", "product", "guarded product", "mixture"])
@pytest.mark.parametrize("pending", [True, False])
def test_withdrawal_deletes_what_was_believed(kind, pending, tmp_path):
    session = Session(make(kind), tmp_path / "log")
    modes = modes_of(make(kind), 4, np.random.default_rng(1))
    run(session, modes[:3], np.random.default_rng(1), missing=False)
    session.act(modes[3])
    if not pending:
        session.observe()
    of_the_policy = {id(x) for x in reachable(session.policy)}
    arrays = [x for x in reachable(session.memory) if isinstance(x, np.ndarray) and id(x) not in of_the_policy]
    assert bool(arrays) == (kind != "plan"), "the search finds beliefs where there are any"
    of_the_session = {id(x) for x in reachable(session)}
    assert all(id(x) in of_the_session for x in arrays)
    gone = [weakref.ref(x) for x in (session.policy, *arrays)]
    number = max(session.pending.numbers.values(), default=None) if pending else None
    del arrays
    session.withdraw()
    assert [ref() for ref in gone] == [None] * len(gone)
    left = reachable(session)
    assert not any(isinstance(x, BeliefMemory | ProductMemory) for x in left)
    assert number is None or not any(isinstance(x, float) and x == number for x in left)
    assert session.memory is None
    assert session.consent is Consent.WITHDRAWN
    session.close()


def test_a_pending_decision_after_withdrawal_is_that_of_the_restored_session(tmp_path):
    """What was proposed, and what a safeguard made of it, were worked out about the person."""
    chosen = Guarded(always(PUBLISHED), [CostBudget.of(PUBLISHED, 0.0)], fallback_of(PUBLISHED))
    session = Session(chosen, tmp_path / "log")
    assert session.act(ROBOT).changed_by == ("budget",)
    session.withdraw()
    left = session.pending
    assert (left.proposed, left.changed_by, left.numbers, left.explanation) == (left.choice, (), {}, "")
    session.close()
    assert Session.restore(tmp_path / "log").pending == left


def test_check_refuses_what_the_next_decision_would_and_changes_nothing(tmp_path):
    log = tmp_path / "log"
    session = Session(policy("plan"), log)
    with pytest.raises(InputError, match="session, check: found no decision to observe"):
        session.check(HUMAN)
    session.act(ROBOT)
    before = log.read_bytes()
    wrong_ones = {(ROBOT,): "as the schedule has it", (HUMAN, "Help"): "response", ("kitchen",): "mode"}
    for wrong, told in wrong_ones.items():
        with pytest.raises(InputError, match=told):
            session.check(*wrong)
    session.check(HUMAN, "help", "signal")
    assert (session.event, session.pending is not None, log.read_bytes()) == (0, True, before)
    session.observe("help")
    assert session.act(HUMAN).action
    session.close()
    assert verify(log).ok


def test_after_withdrawal_responses_are_neither_used_nor_logged(tmp_path):
    logs = []
    for responses in (["help"] * 6, ["no_help", None] * 3):
        log = tmp_path / f"{len(logs)}.log"
        with Session(policy("tracked"), log, clock=Clock()) as session:
            session.act(ROBOT)
            session.observe("help")
            session.act(HUMAN)
            session.withdraw()
            session.withdraw()
            session.observe("not even a name that there is")
            done = []
            for response in responses:
                done.append(session.act(ROBOT))
                session.observe(response, "signal" if len(done) == 3 else None)
            assert {d.action for d in done} == {"no_signal"}
            assert "consent was withdrawn" in done[0].explanation
        logs.append(log.read_bytes())
        assert verify(log).ok
        assert verify(log).consent == "withdrawn"
    assert logs[0] == logs[1]
    after = logs[0].split(b'"withdraw"')[1]
    assert after.count(b'"performed":"signal"') == 1
    assert b"response" not in after
    assert b"belief." not in after


def test_without_consent_nothing_is_believed(tmp_path):
    with pytest.raises(InputError, match="fallback always beside a budget"):
        Session(make("guarded"), consent=False, fallback=always(PUBLISHED))
    with Session(policy("alpha"), tmp_path / "log", consent=False, fallback=always(PUBLISHED)) as session:
        assert session.consent is Consent.NEVER
        assert [d.action for d in run(session, [ROBOT, HUMAN], np.random.default_rng(1))] == ["signal", "help"]
        assert session.memory is None
        session.withdraw()
    audit = verify(tmp_path / "log")
    assert audit.ok
    assert audit.consent == "never"
    assert b'"response"' not in (tmp_path / "log").read_bytes()


@pytest.mark.parametrize("kind", ["tracked", "random"])
def test_a_withdrawn_session_stays_withdrawn(kind, tmp_path, monkeypatch):
    log, clock = tmp_path / "log", Clock()
    session = Session(make(kind), log, fallback=uniformly_random(PUBLISHED), clock=clock)
    run(session, [ROBOT, HUMAN], np.random.default_rng(1))
    session.act(ROBOT)
    session.withdraw()
    pending = session.pending
    del session

    def never_again(*_):
        raise AssertionError("a belief was worked out again")

    monkeypatch.setattr(type(make(kind)), "begin", never_again, raising=False)
    if kind == "random":
        monkeypatch.undo()
    session = Session.restore(log, clock=clock)
    assert session.consent is Consent.WITHDRAWN
    assert session.memory is None
    assert (session.event, session.pending.action, session.pending.numbers) == (2, pending.action, {})
    session.observe("help")
    session.act(ROBOT)
    session.close()
    monkeypatch.undo()
    assert verify(log).ok


# -- restarts --------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", KINDS)
def test_a_restored_session_is_the_same(kind, tmp_path):
    rng, chosen = np.random.default_rng(3), make(kind)
    for seed in range(3):
        log, clock = tmp_path / f"{seed}.log", Clock()
        whole = Session(chosen, seed=seed)
        session = Session(chosen, log, seed=seed, clock=clock)
        for k, mode in enumerate(modes_of(chosen, 6, rng)):
            if rng.random() < 0.5:
                before, memory, last_hash = session.pending, session.memory, session.last_hash
                if rng.random() < 0.5:
                    session.close()
                del session
                session = Session.restore(log, clock=clock)
                assert session.event == k
                assert session.pending == before
                assert same(session.memory, memory)
                assert json.loads(log.read_text().splitlines()[-1])["hash"] == session.last_hash != last_hash
            assert session.act(mode) == whole.act(mode)
            if rng.random() < 0.5:
                before = session.pending
                del session
                session = Session.restore(log, clock=clock)
                assert session.pending == before
            response = response_to(mode, rng, kind not in KEPT_TO_A_PLAN)
            for each in (session, whole):
                each.observe(response)
        session.close()
        assert verify(log, session.last_hash).ok


@pytest.mark.parametrize("kind", ["tracked", "guarded", "random"])
def test_a_cut_write_is_cut_off_and_said(kind, tmp_path):
    """However much of the last line is missing, everything that was answered before it is there."""
    content = written(kind, 4, tmp_path).read_bytes()
    lines = content.splitlines(keepends=True)
    lines = lines[: max(n for n, line in enumerate(lines) if b'"decide"' in line) + 1]
    whole = b"".join(lines)
    log = tmp_path / "cut.log"
    log.write_bytes(b"".join(lines[:-1]))
    reference = Session.restore(log, clock=Clock())
    for missing in range(1, len(lines[-1]), 7):
        log.unlink()
        log.write_bytes(whole[:-missing])
        assert {f.kind for f in verify(log).findings} == {"torn"}
        session = Session.restore(log, clock=Clock())
        assert session.pending is None
        assert session.event == reference.event
        assert same(session._course.held, reference._course.held)
        decision = session.act(json.loads(lines[-1])["mode"])
        assert decision.explanation == json.loads(lines[-1])["explanation"]
        session.close()
        assert verify(log).ok
        kept = log.read_bytes().splitlines(keepends=True)
        assert kept[: len(lines) - 1] == lines[:-1]
        assert json.loads(kept[len(lines) - 1])["cut"] == len(lines[-1]) - missing


def test_what_cannot_be_restored(tmp_path):
    log = written("tracked", 4, tmp_path)
    content = log.read_bytes()
    lines = content.splitlines(keepends=True)
    for changed, words in (
        (content.replace(b'"k":1', b'"k":2', 1), "line 4: does not fit its hash"),
        (b"", "no session had begun"),
        (lines[0][:-5], "no session had begun"),
        (b"PK\x03\x04\n", "line 1: is changed"),
    ):
        log.write_bytes(changed)
        with pytest.raises(InputError, match=words):
            Session.restore(log)
        assert log.read_bytes() == changed
    with pytest.raises(InputError, match="No such file"):
        Session.restore(tmp_path / "none.log")
    assert not (tmp_path / "none.log").exists()


def test_a_forged_decision_is_not_gone_on_with(tmp_path):
    from tests.models.safeguards.test_audit import entries_of, resealed

    log = written("tracked", 4, tmp_path)
    entries = entries_of(log.read_bytes())
    entries[1]["action"] = {"help": "no_help", "no_help": "help", "signal": "no_signal", "no_signal": "signal"}[
        entries[1]["action"]
    ]
    log.write_bytes(resealed(entries))
    with pytest.raises(InputError, match=r"line 2: action: found .* \(see: audit verify\)"):
        Session.restore(log)


# -- what the log holds ----------------------------------------------------------------------------
def test_the_log_holds_the_policy_and_no_place(tmp_path):
    log = written("tracked", 4, tmp_path)
    start = json.loads(log.read_text().splitlines()[0])
    assert policy_to_dict(policy_from_dict(start["policy"])) == policy_to_dict(policy("tracked"))
    assert start["time"] == "2026-01-31T12:00:00.007Z"
    assert str(tmp_path) not in log.read_text()
    assert log.stat().st_mode & 0o077 == 0, "how a person responded is for the owner"


def test_large_policies_are_packed(tmp_path):
    content = {"alpha": np.random.default_rng(1).random((200, 40)).tolist()}
    packed = pack(content)
    assert unpack(packed, "policy") == content
    assert len(json.dumps(packed)) < 0.7 * len(json.dumps(content))
    with pytest.raises(InputError, match="bytes of JSON, compressed"):
        unpack({**packed, "bytes": packed["bytes"] - 1}, "policy")
    with pytest.raises(InputError, match="bytes of JSON, compressed"):
        unpack({**packed, "zlib": packed["zlib"][:-8]}, "policy")
    assert unpack({"kind": "plan"}, "policy") == {"kind": "plan"}


# -- on the robot ----------------------------------------------------------------------------------
ROBOT_CODE = """
import sys
from models.runtime import Session
from models.planning.policy_files import read_policy
session = Session(read_policy(sys.argv[1]), sys.argv[2])
for mode in sys.argv[3:]:
    decision = session.act(mode)
    assert decision.explanation
    session.observe("help" if mode == "robot_needs_help" else None)
session.close()
session = Session.restore(sys.argv[2])
session.withdraw()
session.act(sys.argv[3])
print([m for m in ("scipy", "numba", "pandas", "pymc", "matplotlib", "analysis") if m in sys.modules])
"""


@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_needs_numpy_only(kind, checkout, tmp_path):
    write_policy(make(kind), tmp_path / "policy.json")
    modes = modes_of(make(kind), 4, np.random.default_rng(1))[:4]
    command = [sys.executable, "-c", ROBOT_CODE, str(tmp_path / "policy.json"), str(tmp_path / "log"), *modes]
    ran = subprocess.run(command, cwd=checkout, capture_output=True, check=True, text=True)
    assert ran.stdout.strip() == "[]"
    assert verify(tmp_path / "log").ok
