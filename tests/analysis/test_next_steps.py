"""The command without arguments: what to do next, with words that work."""

import shlex

from analysis.cli import command_line
from analysis.next_steps import STEPS, next_steps
from tests.analysis.command import run_captured


def test_without_arguments_the_next_steps_are_shown(capsys):
    status, out, err = run_captured(capsys)
    assert (status, err) == (0, "")
    assert out == next_steps() + "\n"
    assert max(map(len, out.splitlines())) <= 110


def test_every_command_named_exists_with_its_options():
    root = command_line()
    for _, commands in STEPS:
        for command, what in commands:
            assert what
            words = shlex.split(command)[1:]
            found = root
            while words and words[0] in getattr(found, "commands", {}):
                found = found.commands[words.pop(0)]
            assert not hasattr(found, "commands"), command
            known = {name for option in found.params for name in option.opts}
            assert {w for w in words if w.startswith("--")} <= known, command


def test_completion_can_be_shown(capsys):
    status, out, _ = run_captured(capsys, "--help")
    assert status == 0
    assert "--install-completion" in out
