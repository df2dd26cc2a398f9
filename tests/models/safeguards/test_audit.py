"""The hash chain and the replay: whatever is done to a log is found, or is what only the last hash can tell."""

import hashlib
import json

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.safeguards.audit import ROOT, read_chain, sealed
from models.safeguards.replay import verify
from tests.models.session_cases import KINDS, written


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Logs of random sessions, one of each kind and some with a withdrawal."""
    folder = tmp_path_factory.mktemp("logs")
    kept = [written(kind, seed, folder).read_bytes() for seed, kind in enumerate(KINDS)]
    kept += [written(kind, 90, folder, withdraw=2).read_bytes() for kind in ("alpha", "guarded", "by_mode")]
    return [*kept, written("reactive", 91, folder, consent=False).read_bytes()]


def resealed(entries):
    """A chain made anew by somebody who knows how."""
    previous, lines = ROOT, []
    for n, entry in enumerate(entries):
        line, previous = sealed(previous, {**entry, "n": n})
        lines.append(line)
    return b"".join(lines)


def entries_of(content):
    return [{k: v for k, v in json.loads(line).items() if k != "hash"} for line in content.splitlines()]


def kinds(audit):
    return {f.kind for f in audit.findings}


# -- as it is --------------------------------------------------------------------------------------
def test_logs_as_written_are_in_order(logs):
    for content in logs:
        audit = verify(content)
        assert audit.ok, audit.findings
        assert audit.chain_ok
        assert audit.replay_ok
        assert audit.entries == content.count(b"\n")
        assert resealed(entries_of(content)) == content


def test_the_chain_is_what_the_page_says(logs):
    """Twenty lines that know nothing of the module but its formula."""
    for content in logs:
        previous = "0" * 64
        for line in content.split(b"\n")[:-1]:
            body, own = line[: -len(b',"hash":""}') - 64], json.loads(line)["hash"]
            assert line == body + b',"hash":"' + own.encode() + b'"}'
            assert hashlib.sha256(previous.encode() + body).hexdigest() == own
            previous = own
        assert verify(content).last_hash == previous


# -- whatever is done to it ------------------------------------------------------------------------
@settings(max_examples=200)
@given(st.data())
def test_any_changed_byte_is_found(logs, data):
    content = bytearray(data.draw(st.sampled_from(logs)))
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] = data.draw(st.integers(0, 255).filter(lambda b: b != content[at]))
    audit = verify(bytes(content))
    assert not audit.ok
    assert not audit.chain_ok


def test_every_changed_byte_of_one_log_is_found(logs):
    content = min(logs, key=len)
    for at in range(len(content)):
        for flip in (1, 32, 128):
            changed = bytearray(content)
            changed[at] ^= flip
            assert not read_chain(bytes(changed)).ok, at


@pytest.mark.parametrize("number", [b"1e999", b"-1e999", b"0.3322e7090190"])
def test_a_number_that_becomes_infinite_is_found(logs, number):
    """It reads as JSON, and is none that a log writes."""
    content = max(logs, key=len)
    at = content.index(b'"worth.')
    start = content.index(b":", at) + 1
    stop = min(content.index(b",", start), content.index(b"}", start))
    changed = content[:start] + number + content[stop:]
    chain = read_chain(changed)
    assert [f.line for f in chain.findings] == [content[:at].count(b"\n") + 1]
    assert "does not fit its hash" in chain.findings[0].message
    assert not verify(changed).ok
    lines = changed.splitlines(keepends=True)
    n = chain.findings[0].line - 1
    body = lines[n][: -len(b',"hash":""}\n') - 64]
    own = hashlib.sha256(json.loads(lines[n - 1])["hash"].encode() + body).hexdigest()
    lines[n] = body + b',"hash":"' + own.encode() + b'"}\n'
    assert "is no JSON object" in str(read_chain(b"".join(lines[: n + 1])).findings[0])


def test_a_number_that_differs_is_named(logs):
    entries = entries_of(next(content for content in logs if b'"worth.' in content))
    at = next(i for i, e in enumerate(entries) if e.get("numbers"))
    name = next(k for k in entries[at]["numbers"] if k.startswith("worth."))
    entries[at]["numbers"][name] += 1.0
    (found,) = verify(resealed(entries)).findings
    assert f"numbers, {name}: found {entries[at]['numbers'][name]!r}" in found.message
    del entries[at]["numbers"][name]
    (found,) = verify(resealed(entries)).findings
    assert f"numbers, {name}: found nothing of that name" in found.message


@pytest.mark.parametrize(
    "time", ["2020-13-41T99:00:00.000Z", "2021-02-29T12:00:00.000Z", "2020-01-01T24:61:00.000Z"]
)
def test_times_that_never_were_are_found(logs, time):
    entries = entries_of(logs[0])
    entries[2]["time"] = time
    assert [str(f)[:12] for f in verify(resealed(entries)).findings] == ["line 3: time"]


@settings(max_examples=200)
@given(st.data())
def test_inserted_and_removed_bytes_are_found(logs, data):
    content = data.draw(st.sampled_from(logs))
    at = data.draw(st.integers(0, len(content)))
    more = data.draw(st.binary(min_size=1, max_size=4))
    # Bytes after the end that hold no line feed look like a cut write, and are found as one.
    assert not verify(content[:at] + more + content[at:]).ok
    stop = data.draw(st.integers(at, len(content)))
    assume(at < stop < len(content) or (at < stop and content[at - 1 : at] != b"\n"))
    assert not verify(content[:at] + content[stop:]).ok


@settings(max_examples=200)
@given(st.data())
def test_lines_missing_in_the_middle_moved_or_doubled_are_found(logs, data):
    lines = data.draw(st.sampled_from(logs)).splitlines(keepends=True)
    i = data.draw(st.integers(0, len(lines) - 2))
    j = data.draw(st.integers(i + 1, len(lines) - 1))
    swapped = list(lines)
    swapped[i], swapped[j] = lines[j], lines[i]
    for changed in (
        lines[:i] + lines[i + 1 :], lines[:i] + lines[j:] if i < j else lines[1:], swapped,
        [*lines[:j], lines[i], *lines[j:]], lines[: j + 1] + lines[i:], [*lines, lines[i]],
    ):  # fmt: skip
        audit = verify(b"".join(changed))
        assert not audit.chain_ok, (i, j)
        assert any("does not fit its hash" in f.message for f in audit.findings)


def test_a_change_is_found_where_it_is(logs):
    lines = logs[0].splitlines(keepends=True)
    lines[4] = lines[4].replace(b'"k":', b'"k": ')
    (found,) = [f for f in verify(b"".join(lines)).findings if f.kind == "chain"]
    assert found.line == 5


@given(st.data())
def test_an_end_cut_off_is_found_with_the_last_hash_only(logs, data):
    content = data.draw(st.sampled_from(logs))
    lines = content.splitlines(keepends=True)
    kept = data.draw(st.integers(1, len(lines) - 1))
    cut, last_hash = b"".join(lines[:kept]), verify(content).last_hash
    assert verify(cut).ok, "no chain can show that"
    assert "only the last hash can tell" in verify(cut).sentence
    audit = verify(cut, last_hash)
    assert kinds(audit) == {"last hash"}
    assert "cut off" in audit.findings[-1].message
    assert audit.chain_ok
    assert not audit.end_known
    assert verify(content, last_hash).end_known
    later = verify(content, verify(cut).last_hash)
    assert f"line {kept}: {len(lines) - kept} line" in later.findings[-1].message


@given(st.data())
def test_a_cut_write_is_told_from_a_change(logs, data):
    content = data.draw(st.sampled_from(logs))
    start = content[:-1].rfind(b"\n") + 1
    cut = data.draw(st.integers(start + 1, len(content) - 1))
    audit = verify(content[:cut])
    assert kinds(audit) == {"torn"}
    assert audit.chain_ok
    assert audit.replay_ok
    assert audit.entries == content.count(b"\n") - 1


@given(st.binary(max_size=300))
def test_anything_may_be_checked(content):
    audit = verify(content)
    assert not audit.ok
    assert not audit.chain_ok or audit.entries == 0


def test_an_empty_log_and_no_file(tmp_path):
    audit = verify(b"")
    assert (audit.entries, audit.chain_ok, audit.replay_ok, audit.last_hash) == (0, False, False, None)
    with pytest.raises(InputError, match="cannot be read: No such file"):
        verify(tmp_path / "none.log")
    with pytest.raises(InputError, match="64 hexadecimal digits"):
        verify(b"", "abc")


@settings(max_examples=60)
@given(st.data())
def test_random_logs_and_random_edits(tmp_path_factory, data):
    """Sessions of any kind and length, some withdrawn, some restarted; one edit each."""
    kind, seed = data.draw(st.sampled_from(KINDS)), data.draw(st.integers(0, 2**32))
    events = data.draw(st.integers(1, 7))
    folder = tmp_path_factory.mktemp("log")
    log = written(
        kind, seed, folder, events=events, withdraw=data.draw(st.none() | st.integers(0, 6)),
        consent=data.draw(st.integers(0, 9)) > 0, restart=data.draw(st.none() | st.integers(0, 6)),
    )  # fmt: skip
    content = log.read_bytes()
    assert verify(content).ok, verify(content).findings
    lines, decided = content.splitlines(keepends=True), content.count(b'"event":"decide"')
    edit = data.draw(st.sampled_from(["byte", "less", "swap", "double", "forged"]))
    i, j = sorted(data.draw(st.lists(st.integers(0, len(lines) - 1), min_size=2, max_size=2, unique=True)))
    if edit == "byte":
        changed = bytearray(content)
        at = data.draw(st.integers(0, len(content) - 1))
        changed[at] ^= data.draw(st.integers(1, 255))
    elif edit == "less":
        changed = b"".join(lines[:i] + lines[j:])
    elif edit == "swap":
        lines[i], lines[j] = lines[j], lines[i]
        changed = b"".join(lines)
    elif edit == "double":
        changed = b"".join([*lines[:j], lines[i], *lines[j:]])
    else:
        entries = entries_of(content)
        forged = [e for e in entries if e["event"] == "decide"][data.draw(st.integers(0, decided - 1))]
        offered = {"help": "no_help", "no_help": "help", "signal": "no_signal", "no_signal": "signal"}
        forged["action"] = offered[forged["action"]]
        if data.draw(st.booleans()):
            # The forger sees to what the entry says elsewhere too.
            forged["proposed"] = forged["action"]
        changed = resealed(entries)
    audit = verify(bytes(changed))
    assert not audit.ok
    assert audit.chain_ok == (edit == "forged")
    assert not verify(bytes(changed), verify(content).last_hash).ok


# -- forgers who recompute the chain ---------------------------------------------------------------
@settings(max_examples=200)
@given(st.data())
def test_a_decision_that_differs_is_found_though_the_chain_was_recomputed(logs, data):
    entries = entries_of(data.draw(st.sampled_from(logs)))
    decisions = [n for n, entry in enumerate(entries) if entry["event"] == "decide"]
    forged = entries[data.draw(st.sampled_from(decisions))]
    others = {"help": "no_help", "no_help": "help", "signal": "no_signal", "no_signal": "signal"}
    how = data.draw(st.sampled_from(["action", "proposed", "changed_by", "explanation", "k", "more", "less"]))
    if how in ("action", "proposed"):
        forged[how] = others[forged[how]]
    elif how == "changed_by":
        forged[how] = [*forged[how], "somebody"]
    elif how == "explanation":
        forged[how] = forged[how].replace("; ", ", ", 1)
    elif how == "k":
        forged[how] += 1
    elif how == "more":
        forged["note"] = "agreed"
    else:
        del forged["numbers"]
    audit = verify(resealed(entries))
    assert audit.chain_ok
    assert not audit.replay_ok


@given(st.data())
def test_numbers_that_differ_are_found(logs, data):
    entries = entries_of(logs[KINDS.index("alpha")])
    forged = entries[data.draw(st.sampled_from([n for n, e in enumerate(entries) if e["event"] == "decide"]))]
    key = data.draw(st.sampled_from(sorted(forged["numbers"])))
    forged["numbers"][key] *= 1 + 1e-6
    audit = verify(resealed(entries))
    assert audit.chain_ok
    assert "numbers" in str(audit.findings[0])
    forged["numbers"][key] *= (1 + 1e-13) / (1 + 1e-6)
    assert verify(resealed(entries)).ok, "another machine may round otherwise"


def test_another_policy_seed_response_or_fallback_is_found(logs):
    def changed(kind, n, **fields):
        entries = entries_of(logs[KINDS.index(kind)])
        entries[n].update(fields)
        return verify(resealed(entries))

    others = entries_of(logs[KINDS.index("by_mode")])[0]["policy"]
    assert not changed("alpha", 0, policy=others).replay_ok
    assert not any(changed("random", 0, seed=seed).replay_ok for seed in (20, 21, 22))
    entries = entries_of(logs[KINDS.index("alpha")])
    seen = next(n for n, e in enumerate(entries) if e.get("response") not in (None, "none"))
    other = {"help": "no_help", "no_help": "help"}[entries[seen]["response"]]
    assert not changed("alpha", seen, response=other).replay_ok
    withdrawn = entries_of(logs[len(KINDS)])
    shares = withdrawn[0]["fallback"]["shares"]
    withdrawn[0]["fallback"]["shares"] = [s[::-1] for s in shares]
    assert not verify(resealed(withdrawn)).replay_ok


@pytest.mark.parametrize(("event", "fields", "words"), [
    ("observe", {"response": "hug"}, "found 'hug'"),
    ("observe", {"performed": "dance"}, "found 'dance'"),
    ("observe", {"response": 3}, "found 3, wanted a name"),
    ("decide", {"event": "observe"}, "nothing to observe"),
    ("observe", {"event": "decide"}, "wanted observe"),
    ("decide", {"mode": "nobody_needs_help"}, "found 'nobody_needs_help'"),
    ("decide", {"event": "dream"}, "found 'dream'"),
    ("observe", {"event": "close"}, "wanted nothing of that name"),
    ("observe", {"event": "restore"}, "number of bytes"),
    ("decide", {"time": "noon"}, "a time in UTC"),
    ("start", {"time": "2026-01-31T12:00:00.000+01:00"}, "a time in UTC"),
    ("start", {"seed": -1}, "at least 0"),
    ("start", {"seed": True}, "seed"),
    ("start", {"consent": "yes"}, "true or false"),
    ("start", {"schema": "other/1"}, "prosocial-session/1"),
    ("start", {"policy": None}, "a JSON object"),
    ("start", {"policy": {"zlib": "!", "bytes": 9}}, "9 bytes of JSON"),
    ("start", {"policy": {"zlib": "", "bytes": 1 << 40}}, "bytes"),
    ("start", {"host": "kitchen"}, "keys of the start entry"),
    ("start", {"responses": {}}, "observations by mode"),
])  # fmt: skip
def test_entries_that_cannot_be_are_told(logs, event, fields, words):
    entries = entries_of(logs[KINDS.index("reactive")])
    next(e for e in entries if e["event"] == event).update(fields)
    audit = verify(resealed(entries))
    assert audit.chain_ok
    assert not audit.replay_ok
    assert words in " ".join(str(f) for f in audit.findings)


def test_responses_after_a_withdrawal_are_found(logs):
    entries = entries_of(logs[len(KINDS)])
    after = [e["event"] for e in entries].index("withdraw")
    assert all("response" not in e for e in entries[after:])
    next(e for e in entries[after:] if e["event"] == "observe")["response"] = "help"
    audit = verify(resealed(entries))
    assert "wanted nothing of that name" in str(audit.findings[0])
    assert audit.consent == "withdrawn"


def test_a_withdrawal_taken_out_is_found(logs):
    entries = [e for e in entries_of(logs[len(KINDS)]) if e["event"] != "withdraw"]
    assert not verify(resealed(entries)).replay_ok
    doubled = entries_of(logs[len(KINDS)])
    at = [e["event"] for e in doubled].index("withdraw")
    assert "already" in str(verify(resealed([*doubled[: at + 1], *doubled[at:]])).findings[0])


@pytest.mark.parametrize("change", [
    lambda body: body.replace(b'"event":', b'"event": ', 1), lambda body: body.replace(b'"k":0', b'"k":0,"k":0'),
    lambda body: body.replace(b'"k":0', b'"k":0.0'), lambda body: body.replace(b'"n":1', b'"n":true'),
    lambda body: body.replace(b'"k":0', b'"k":NaN'), lambda body: b"[" * 5000, lambda body: b"[1",
    lambda body: body.replace(b'"k":0', b'"k":' + b"9" * 5000), lambda body: body.replace(b'"n":1', b'"n":2'),
    lambda body: body.replace(b"decide", b"\xff"), lambda body: body.replace(b"decide", b"d\\u0065cide"),
    lambda body: body + b',"hash":1',
])  # fmt: skip
def test_other_spellings_are_refused(logs, change):
    """A line whose hash is right and which could still be read in two ways, or not at all."""
    lines = logs[0].splitlines(keepends=True)
    previous, body = json.loads(lines[0])["hash"], lines[1][: -len(b',"hash":""}\n') - 64]
    body = change(body)
    own = hashlib.sha256(previous.encode() + body).hexdigest()
    assert verify(lines[0] + body + b',"hash":"' + own.encode() + b'"}\n').findings


def test_another_numpy_is_named_where_decisions_differ(logs):
    entries = entries_of(logs[0])
    entries[0]["numpy"] = "1.0"
    assert verify(resealed(entries)).ok
    entries[1]["action"] = {"help": "no_help", "no_help": "help"}.get(entries[1]["action"], "help")
    assert "Written with numpy 1.0, replayed with" in verify(resealed(entries)).sentence


def test_nothing_follows_a_closed_log_but_a_restart(logs):
    entries = entries_of(logs[0])
    assert entries[-1]["event"] == "close"
    for more in (entries[-1], {**entries[-1], "event": "withdraw"}, entries[1]):
        assert "the log was closed" in str(verify(resealed([*entries, more])).findings[0])
    restart = {"event": "restore", "cut": 0, "time": entries[-1]["time"]}
    assert verify(resealed([*entries, restart, {**entries[-1], "event": "withdraw"}])).ok
