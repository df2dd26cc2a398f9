"""Ctrl-C at any moment is one line and status 130, never a traceback."""

import subprocess
import sys
from pathlib import Path

import pytest

from analysis import cli

ROOT = Path(__file__).resolve().parents[2]

AT_IMPORT = """
import sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            raise KeyboardInterrupt
sys.meta_path.insert(0, Finder())
sys.argv = ["prosocial", "data", "list"]
from analysis.cli import main
main()
"""


def python(code):
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)


def test_the_module_imports_nothing_that_takes_time():
    code = "import sys; before = set(sys.modules); import analysis.cli; print(*sorted(set(sys.modules) - before))"
    assert set(python(code).stdout.split()) <= {"__future__", "analysis", "analysis.cli"}


@pytest.mark.parametrize("name", ["models.errors", "typer", "analysis.cli_data", "analysis.datasets", "pandas"])
def test_an_interruption_while_importing(name):
    ran = python(AT_IMPORT.format(name=name))
    assert (ran.returncode, ran.stdout) == (130, "")
    assert ran.stderr == "prosocial: interrupted\n"


def test_a_command_can_say_what_an_interruption_left(monkeypatch, capsys):
    def stop():
        raise KeyboardInterrupt("chains are kept")

    monkeypatch.setattr(cli, "command_line", stop)
    with pytest.raises(SystemExit) as caught:
        cli.main(["data", "list"])
    assert caught.value.code == 130
    assert capsys.readouterr().err == "prosocial: interrupted; chains are kept\n"


def test_other_exits_stay_as_they_are(capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["no-such-command"])
    assert caught.value.code == 2
    assert "interrupted" not in capsys.readouterr().err
