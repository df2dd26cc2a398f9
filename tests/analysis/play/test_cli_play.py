"""The command ``play``: what it refuses, and how it says so."""

import socket
import subprocess
import sys
from dataclasses import replace

import pytest

from analysis import cli_play
from analysis.cli_play import play_command
from analysis.play import robot_mind, run
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.model_files import write_model
from tests.analysis.play.cases import ROOT


def test_a_restart_with_another_robot_or_rule_is_refused(tmp_path, monkeypatch):
    """What the setup holds is asked before anything is served."""
    monkeypatch.chdir(tmp_path)
    truth = calibrated_truth()
    write_model(truth, tmp_path / "one.json")
    write_model(replace(truth, initial=truth.initial[::-1]), tmp_path / "other.json")
    monkeypatch.setattr(run, "serve", lambda study, taken, *_: (study.agree(), study.close(), taken.close()))
    options = {"port": 0, "quiet": True, "policy": ["myopic", "always"], "schedule": "HR", "out": "log.csv"}
    play_command(**options, learned="one.json")
    play_command(**options, learned="one.json")
    monkeypatch.setattr(run, "serve", lambda *_: pytest.fail("served"))
    with pytest.raises(InputError, match=r"condition myopic: found other\.json .* wanted one\.json"):
        play_command(**options, learned="other.json")
    with pytest.raises(InputError, match="withdrawal: found 'keep', wanted 'delete', which was promised"):
        play_command(**options, learned="one.json", withdrawal="keep")
    (tmp_path / "text.txt").write_text("Another text.")
    with pytest.raises(InputError, match="consent text: found another one now"):
        play_command(**options, learned="one.json", consent="text.txt")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"policy": ["maybe"]}, "policy: found 'maybe'"),
        ({"policy": ["never", "never"]}, "never twice"),
        ({"schedule": "HXH"}, "letter 2"),
        ({"schedule": "RRHHH"}, "modes that take turns"),
        ({"withdrawal": "sometimes"}, "withdrawal: found 'sometimes'"),
        ({"out": "log.parquet"}, "ends in .csv"),
        ({"consent": "nowhere.txt"}, "--consent nowhere.txt: cannot be read"),
        ({"parameters": "nowhere.json"}, "nowhere.json: no such file"),
        ({"layout": "nowhere"}, "--map: found 'nowhere', wanted a file with a map, or one of four_rooms"),
        ({"schedule": ""}, "schedule: found '', wanted letters from"),
        ({"schedule": "", "policy": ["always"]}, "schedule: found '', wanted letters from"),
        ({"learned": "nowhere.json"}, "nowhere.json"),
        ({"site": "ftp://x"}, "--site: found 'ftp://x'"),
        ({"site": "https://x/path"}, "--site"),
        ({"host": "no.such.host.invalid"}, "--host"),
    ],
)
def test_refused_before_anything_is_served(tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "serve", lambda *_: pytest.fail("served"))
    with pytest.raises(InputError, match=words):
        play_command(port=0, quiet=True, **{"policy": None, "schedule": "HRH", "out": "log.csv", **options})
    assert not {"log.csv", "log_rounds"} & {path.name for path in tmp_path.iterdir()}


def test_a_taken_port_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"--port: found 127.0.0.1, port {port}"):
            play_command(port=port, out="log.csv")


def test_addresses():
    for host, begins in (("127.0.0.1", "http://127.0.0.1:"), ("0.0.0.0", "http://127.0.0.1:")):
        with run.reserve(host, 0) as taken:
            assert run.address_of(taken, host).startswith(begins)
            assert run.is_loopback(taken) == (host == "127.0.0.1")


def reachable(port):
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5):
            return True
    except ConnectionRefusedError:
        return False


def test_a_reserved_port_answers_when_it_is_opened():
    with run.reserve("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        assert not reachable(port)
        run.open_port(taken)
        assert reachable(port)
        # Systems let two servers reserve a port as long as neither answers there, or refuse the second at once.
        with pytest.raises(InputError, match=f"--port: found 127.0.0.1, port {port}: .*, wanted a free port"):
            run.reserve("127.0.0.1", port)


def test_of_two_that_reserved_a_port_one_is_told(tmp_path):
    with run.reserve("127.0.0.1", 0) as one:
        port = one.getsockname()[1]
        try:
            other = run.reserve("127.0.0.1", port)
        except InputError:
            return  # this system told at once
        with other:
            run.open_port(one)
            with pytest.raises(InputError, match=f"--port: found 127.0.0.1, port {port}"):
                run.open_port(other)


def test_first_the_lock_then_a_word_and_the_port_last(tmp_path, monkeypatch, capsys):
    """What is seen while the policies are still being solved, which may take minutes."""
    monkeypatch.chdir(tmp_path)
    with run.reserve("127.0.0.1", 0) as free:
        port = free.getsockname()[1]
    seen = []

    def solve(*_):
        seen.append(capsys.readouterr().out)
        assert not reachable(port)
        with pytest.raises(InputError, match="log_rounds: another server is writing there"):
            play_command(port=0, policy=["never"], schedule="HR", out="log.csv")
        assert capsys.readouterr().out == "", "told before anything is prepared"
        raise InputError("enough")

    monkeypatch.setattr(robot_mind, "policy_by_name", solve)
    with pytest.raises(InputError, match="enough"):
        play_command(port=port, policy=["never"], schedule="HR", out="log.csv")
    assert seen == [f"{cli_play.PREPARING}\n"]
    assert not any(tmp_path.iterdir()), "nothing is left of a study that did not start"
    with run.reserve("127.0.0.1", port):
        pass  # let go again


def test_a_mistyped_folder_is_not_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"nowhere/log\.csv: found no folder nowhere"):
        play_command(port=0, policy=["never"], schedule="HR", out="nowhere/log.csv")
    assert not any(tmp_path.iterdir())


def test_parameters_with_a_number_that_nobody_can_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "big.json").write_text('{"round_ticks": ' + "1" * 5000 + "}")
    with pytest.raises(InputError, match=r"big\.json: holds a number of more digits than can be read"):
        play_command(port=0, policy=["never"], schedule="HR", out="log.csv", parameters="big.json")


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.setattr(run, "NEEDED", ("starlette", "no_such_package_at_all"))
    with pytest.raises(InputError, match=r"no_such_package_at_all not installed; wanted the optional extra game"):
        run.check_installed()


def test_the_command_line_does_not_need_the_extra():
    """Where starlette and uvicorn are absent, other commands work."""
    code = (
        "import sys; sys.modules.update(starlette=None, uvicorn=None, websockets=None)\n"
        "import analysis.cli_play; print('fine')"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert ran.stdout == "fine\n", ran.stderr
    assert cli_play.DEFAULT_LOG.endswith(".csv")


def test_an_empty_consent_text_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.txt").write_text(" \n")
    with pytest.raises(InputError, match="found nothing, wanted a text"):
        play_command(port=0, consent="empty.txt", out="log.csv")
