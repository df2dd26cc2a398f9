"""The command ``play``: what it refuses, and how it says so."""

import socket
import subprocess
import sys

import pytest

from analysis import cli_play
from analysis.cli_play import play_command
from analysis.play import run
from models.errors import InputError
from tests.analysis.play.cases import ROOT


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
        ({"layout": "nowhere"}, "nowhere"),
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
    assert not (tmp_path / "log.csv").exists()


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
        with run.listen(host, 0) as taken:
            assert run.address_of(taken, host).startswith(begins)
            assert run.is_loopback(taken) == (host == "127.0.0.1")


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
