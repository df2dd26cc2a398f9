"""The commands ``session`` and ``audit verify``: at a pipe, at a terminal, killed, and what they refuse."""

import io
import json
import os
import pty
import signal
import subprocess
import sys

import pytest
import typer

from analysis.cli_audit import audit
from analysis.cli_session import session_command
from models.errors import InputError
from models.planning.baselines import always
from models.planning.policy_files import write_policy
from models.protocol import PUBLISHED
from models.safeguards.replay import verify
from tests.models.session_cases import make
from tests.models.test_runtime import CORRIDOR

SIGNAL, REASON = (
    "signal: always looks at the mode robot_needs_help only.",
    "the declared fallback looks at the mode",
)


def main(words):
    app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    app.command("session")(session_command)
    app.add_typer(audit, name="audit")
    try:
        app(args=words, prog_name="prosocial")
    except InputError as error:
        print(f"prosocial: {error}", file=sys.stderr)
        sys.exit(2)


ALONE = [sys.executable, "-c", "import sys; from tests.analysis.test_cli_session import main; main(sys.argv[1:])"]


@pytest.fixture
def policy_file(tmp_path):
    path = tmp_path / "policy.json"
    write_policy(always(PUBLISHED), path)
    return path


@pytest.fixture
def command(capsys, monkeypatch):
    """Run a command on some lines; returns status, lines of standard output, standard error."""

    def run(*words, lines=()):
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        try:
            main([str(w) for w in words])
            status = 0
        except SystemExit as stop:
            status = stop.code or 0
        said = capsys.readouterr()
        return status, said.out.splitlines(), said.err

    return run


# -- at a pipe -------------------------------------------------------------------------------------
def test_one_line_for_each(command, policy_file, tmp_path):
    log = tmp_path / "log"
    lines = ["H", "help", "robot_needs_help", "missing", "r", "H", "no_help performed no_signal", "undo", "hash"]
    status, out, err = command("session", policy_file, "--log", log, lines=["# a comment", "", *lines])
    assert (status, err) == (0, "")
    assert len(out) == len(lines) + 1
    assert out[:4] == [SIGNAL, "noted", SIGNAL, "noted"]
    assert out[4].startswith("help: ")
    assert out[5:8] == [SIGNAL, "noted: no_signal was done", out[7]]
    assert out[7].startswith("undo is not possible")
    entries = [json.loads(line) for line in log.read_text().splitlines()]
    assert out[8] == entries[-2]["hash"]
    assert entries[-1]["hash"] in out[9]
    assert [e.get("response") for e in entries if e["event"] == "observe"] == ["help", None, "none", "no_help"]
    assert verify(log).ok


def test_lines_that_cannot_be_used_change_nothing(command, policy_file, tmp_path):
    lines = [
        "kitchen",
        "help",
        "H",
        "H",
        "hug",
        "help performed",
        "help help",
        "help",
        "performed help",
        "R",
        "help",
    ]
    status, out, err = command("session", policy_file, "--log", tmp_path / "log", lines=lines)
    assert status == 2
    assert err == "prosocial: 8 lines could not be used\n"
    wanted = {
        0: "mode: found 'kitchen', wanted one of", 1: "mode: found 'help'", 3: "response: found 'H'",
        4: "response: found 'hug', wanted one of no_help, help, missing", 5: "[RESPONSE] performed ACTION",
        6: "one response", 8: "found no decision to observe",
        10: "wanted none: that mode shows no response",
    }  # fmt: skip
    for n, line in enumerate(out[: len(lines)]):
        assert line.startswith("refused: ") == (n in wanted), line
        assert wanted.get(n, "") in line
    assert verify(tmp_path / "log").decisions == 2


def test_a_mode_that_cannot_follow_leaves_the_event_open(command, tmp_path):
    """After a mode that shows nothing the next mode ends the event, unless it is refused."""
    write_policy(make("plan"), tmp_path / "policy.json")
    words = ("session", tmp_path / "policy.json", "--log", tmp_path / "log")
    lines = ["H", "help", "R", "R", "performed help", "H"]
    status, out, _ = command(*words, lines=lines)
    assert status == 2
    assert out[3].startswith("refused: policy exact plan, event 3, mode: found 'human_needs_help'")
    assert out[4] == "noted: help was done"
    assert out[5].split(":")[0] in ("signal", "no_signal")
    entries = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [e["event"] for e in entries] == ["start", *["decide", "observe"] * 2, "decide", "close"]
    assert verify(tmp_path / "log").ok


def test_withdrawal_and_quit(command, policy_file, tmp_path):
    lines = ["H", "withdraw", "H", "anything at all", "anything", "H", "withdraw", "quit", "H"]
    status, out, _ = command("session", policy_file, "--log", tmp_path / "log", "--json", "-", lines=lines)
    assert status == 2, "three words are no response"
    found = json.loads("\n".join(out))
    assert found["actions"] == {"signal": 1, "no_signal": 2}
    assert (found["consent"], found["refused"], found["events"]) == ("withdrawn", 1, 2)
    assert verify(tmp_path / "log", found["last_hash"]).ok
    assert b"anything" not in (tmp_path / "log").read_bytes()


def test_safeguards_around_a_plain_policy(command, policy_file, tmp_path):
    log = tmp_path / "log"
    words = ("session", policy_file, "--log", log, "--budget", 20, "--cost", "signal=8", "--json", tmp_path / "out")
    status, out, _ = command(*words, lines=["H", "help", "R", "H", "help", "R", "quit"])
    assert status == 0
    assert [line.split(":")[0] for line in out[:6]] == ["signal", "noted", "no_help", "signal", "noted", "no_help"]
    assert "help costs 15 and 12 of the budget of 20 is left (budget)" in out[2]
    found = json.loads((tmp_path / "out").read_text())
    assert found["changed"] == {"budget": 2}
    assert found["policy"] == "always, guarded"
    assert verify(log).ok
    status, out, _ = command(
        "session", policy_file, "--no-consent", "--fallback", "H=signal", lines=["H", "R"]
    )  # fmt: skip
    assert [line.split(":")[0] for line in out[:2]] == ["signal", "no_help"]
    assert REASON in out[0]


def test_a_budget_beside_other_safeguards(command, tmp_path):
    write_policy(make("guarded product"), tmp_path / "policy.json")
    status, _, err = command("session", tmp_path / "policy.json", "--budget", 15, lines=["H"])
    assert status == 2
    assert "budget once" in err


def test_restoring(command, policy_file, tmp_path):
    log = tmp_path / "log"
    command("session", policy_file, "--log", log, "--seed", 7, lines=["H", "help", "H"])
    status, out, err = command("session", "--restore", log, "--json", "-", lines=["no_help", "R"])
    assert status == 0
    assert "note: signal was decided, and nothing is known of what came of it" in err
    found = json.loads("\n".join(out))
    assert (found["seed"], found["events"], found["decisions"], found["restored"]) == (7, 2, 1, True)
    for more in ((policy_file,), ("--budget", 3), ("--no-consent",), ("--fallback", "H=signal")):
        status, _, err = command("session", *more, "--restore", log)
        assert status == 2
        assert "--restore: found options of a new session" in err
    assert verify(log, found["last_hash"]).ok


def test_other_protocols(command, tmp_path):
    import tomllib

    write_policy(always(CORRIDOR), tmp_path / "policy.json")
    words = ("session", tmp_path / "policy.json")
    status, _, err = command(*words, lines=["stuck"])
    assert status == 2
    assert "fallback without consent, mode stuck" in err
    status, _, err = command(*words, "--fallback", "stuck=wait", "--fallback", "person=pass_by", "--budget", 3)
    assert "--protocol FILE.toml with it" in err
    text = (
        'name = "corridor"\n[modes.stuck]\nletter = "S"\nactions = { wait = 0.0, ask = 5.0 }\n'
        'null_action = "wait"\nshows_response = true\n[modes.person]\n'
        'letter = "P"\nactions = { assist = 15.0, pass_by = 0.0 }\n'
        'null_action = "pass_by"\nshows_response = false\n[responses]\nignored = 0.0\nhelped = 1.0\n'
    )
    assert tomllib.loads(text)
    (tmp_path / "corridor.toml").write_text(text)
    status, out, err = command(
        *words, "--protocol", tmp_path / "corridor.toml", "--budget", 5, lines=["S", "helped", "P", "s", "ignored"]
    )  # fmt: skip
    assert (status, err) == (0, "")
    assert [line.split(":")[0] for line in out[:5]] == ["ask", "noted", "pass_by", "wait", "noted"]


@pytest.mark.parametrize(("words", "said"), [
    ((), "POLICY_FILE: found None"), (("none.json",), "none.json: no such file"),
    (("{policy}", "--log", "no/such/log"), "no folder"), (("{policy}", "--log", "{policy}"), "another file than"),
    (("--restore", "none.log"), "No such file or directory, wanted the log of a session"),
    (("{policy}", "--budget", "-1"), "--budget: found -1.0, wanted a finite number"),
    (("{policy}", "--budget", "inf"), "--budget: found inf, wanted a finite number"),
    (("{policy}", "--cost", "help=3"), "--budget with it"), (("{policy}", "--fallback", "H"), "MODE=ACTION"),
    (("{policy}", "--fallback", "H=help"), "action in mode robot_needs_help"),
    (("{policy}", "--fallback", "X=help"), "mode: found 'X'"),
    (("{policy}", "--fallback", "H=signal", "--fallback", "H=no_signal"), "one action for"),
])  # fmt: skip
def test_refusals(words, said, command, policy_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, _, err = command("session", *(w.format(policy=policy_file) for w in words))
    assert status == 2
    assert said in err
    assert "Traceback" not in err


# -- killed, and at a terminal ---------------------------------------------------------------------
def test_killed_at_a_pipe(checkout, policy_file, tmp_path):
    log = tmp_path / "log"
    command = [*ALONE, "session", str(policy_file), "--log", str(log)]
    with subprocess.Popen(
        command, cwd=checkout, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        said = []
        for line in ("H", "help", "H"):
            child.stdin.write(f"{line}\n")
            child.stdin.flush()
            said.append(child.stdout.readline().rstrip())
        child.send_signal(signal.SIGKILL)
    assert said == [SIGNAL, "noted", SIGNAL]
    ran = subprocess.run(
        [*ALONE, "session", "--restore", str(log), "--json", "-"], cwd=checkout, input="no_help\nR\n",
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(ran.stdout)
    assert (found["events"], found["decisions"]) == (2, 1)
    assert verify(log, found["last_hash"]).ok


def test_interrupted(checkout, policy_file, tmp_path):
    command = [*ALONE, "session", str(policy_file), "--log", str(tmp_path / "log")]
    with subprocess.Popen(
        command, cwd=checkout, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        child.stdin.write("H\n")
        child.stdin.flush()
        assert child.stdout.readline().rstrip() == SIGNAL
        child.send_signal(signal.SIGINT)
        child.wait(20)
        child.communicate()
    assert child.returncode != 0
    assert verify(tmp_path / "log").ok
    assert json.loads((tmp_path / "log").read_text().splitlines()[-1])["event"] == "close"


def test_a_person_at_a_terminal(checkout, policy_file, tmp_path):
    ours, theirs = pty.openpty()
    command = [*ALONE, "session", str(policy_file), "--log", str(tmp_path / "log")]
    with subprocess.Popen(command, cwd=checkout, stdin=theirs, stdout=subprocess.PIPE, text=True) as child:
        os.write(ours, b"help\nH\nhelp\nhelp\nR\nquit\n")
        said = child.stdout.read()
    os.close(ours)
    os.close(theirs)
    assert child.returncode == 0
    assert said.startswith("always, seed 1; log ")
    assert "undo" not in said, "what cannot be done is not offered"
    assert said.count("modes: R human_needs_help, H robot_needs_help") == 3, "help, where it can be no response"
    assert f"mode (R, H)> {SIGNAL}\nresponse (no_help, help, missing)> noted\n" in said
    assert verify(tmp_path / "log").decisions == 2


# -- policies that are not to be trusted -----------------------------------------------------------
DOUBT = ("the posterior failed its convergence gate", "few draws")
DOUBT_LINE = "CAUTION: the posterior failed its convergence gate and few draws; do not rely on these numbers."


@pytest.fixture
def doubtful_file(tmp_path):
    path = tmp_path / "doubtful.json"
    write_policy(always(PUBLISHED), path, DOUBT)
    return path


def test_the_caution_of_a_policy_is_said_once_and_stays_in_its_log(command, doubtful_file, tmp_path):
    log = tmp_path / "log"
    words = ("session", doubtful_file, "--log", log, "--quiet", "--json", "-")
    status, out, err = command(*words, lines=["H", "help", "H", "help"])
    assert (status, err) == (0, f"prosocial: {doubtful_file}: {DOUBT_LINE}\n")
    assert json.loads("\n".join(out))["cautions"] == list(DOUBT)
    status, out, err = command("session", "--restore", log, "--quiet", "--json", "-", lines=["H", "help"])
    assert (status, err) == (0, f"prosocial: {log}: {DOUBT_LINE}\n")
    assert json.loads("\n".join(out))["cautions"] == list(DOUBT)
    status, out, err = command("audit", "verify", log)
    assert (status, err) == (0, f"prosocial: {log}: {DOUBT_LINE}\n")
    assert "CAUTION" not in "".join(out), "once is enough"
    status, out, err = command("audit", "verify", log, "--json", "-")
    assert json.loads("\n".join(out))["cautions"] == list(DOUBT)
    audit = verify(log)
    assert audit.ok
    assert audit.cautions == DOUBT
    assert audit.sentence.endswith(DOUBT_LINE)


def test_the_caution_stays_with_a_budget_put_around_the_policy(command, tmp_path):
    for kind in ("by_mode", "guarded"):
        write_policy(make(kind), tmp_path / "policy.json", DOUBT)
        words = ("session", tmp_path / "policy.json", "--budget", 0, "--json", "-")
        if kind == "guarded":
            # It has a budget already, and keeps one of a kind: what is said against it is what counts here.
            content = json.loads((tmp_path / "policy.json").read_text())
            content |= {"safeguards": [], "null": None}
            (tmp_path / "policy.json").write_text(json.dumps(content))
        status, out, err = command(*words, lines=["H"])
        assert status == 0, err
        assert err.count(DOUBT_LINE) == 1
        assert json.loads("\n".join(out))["cautions"] == list(DOUBT)


def test_nothing_is_said_of_good_policies_or_where_only_the_fallback_acts(
    command, policy_file, doubtful_file, tmp_path
):
    for words in ((policy_file,), (doubtful_file, "--no-consent")):
        log = tmp_path / f"log{len(words)}"
        status, out, err = command("session", *words, "--log", log, "--quiet", "--json", "-", lines=["H"])
        assert (status, err, json.loads("\n".join(out))["cautions"]) == (0, "", [])
        status, _, err = command("audit", "verify", log)
        assert (status, err) == (0, "")


# -- audit verify ----------------------------------------------------------------------------------
def test_verify(command, policy_file, tmp_path):
    log = tmp_path / "log"
    command("session", policy_file, "--log", log, lines=["H", "help", "R", "H"])
    status, out, err = command("audit", "verify", log)
    assert (status, err) == (0, "")
    own = json.loads(log.read_text().splitlines()[-1])["hash"]
    assert "only the last hash can tell" in out[0]
    assert out[1] == f"last hash: {own}"
    status, out, err = command("audit", "verify", log, "--last-hash", own, "--json", "-")
    found = json.loads("\n".join(out))
    assert found["problems"] == []
    assert (found["entries"], found["chain_ok"], found["replay_ok"], found["end_known"]) == (7, True, True, True)
    content = log.read_bytes()
    log.write_bytes(content[:-20])
    status, out, err = command("audit", "verify", log, "--last-hash", own, "--json", "-")
    found = json.loads("\n".join(out))
    assert status == 2
    assert [p["kind"] for p in found["problems"]] == ["torn", "last hash"]
    assert "line 7: is unfinished" in err
    first = content.splitlines(keepends=True)[0]
    log.write_bytes(first)
    assert "1 entry, 0 decisions" in command("audit", "verify", log)[1][0]
    log.write_bytes(content.replace(b'"n":0', b'"n":1e999', 1))
    status, _, err = command("audit", "verify", log)
    assert (status, "Traceback" in err) == (2, False)
    assert "line 1: does not fit its hash" in err
    log.write_bytes(content.replace(b"signal", b"help", 1))
    status, _, err = command("audit", "verify", log)
    assert status == 2
    assert "line 1: does not fit its hash" in err
    status, _, err = command("audit", "verify", log, "--last-hash", "12")
    assert "64 hexadecimal digits" in err
    status, _, err = command("audit", "verify", tmp_path / "none.log")
    assert "No such file" in err


def test_many_problems_are_summed_up(command, policy_file, tmp_path):
    log = tmp_path / "log"
    log.write_bytes(b"nothing\n" * 50)
    status, _, err = command("audit", "verify", log)
    assert status == 2
    assert len(err.splitlines()) == 22
    assert err.splitlines()[-1] == "  and 31 more"
