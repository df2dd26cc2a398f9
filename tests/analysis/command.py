"""Commands run in this process, as a user would: by their words."""

from __future__ import annotations

import json

from analysis.cli import main


def run(*words):
    """Exit status of a command."""
    try:
        main([str(w) for w in words])
    except SystemExit as stop:
        return stop.code or 0
    return 0


def run_captured(capsys, *words):
    """Exit status, standard output and standard error."""
    status = run(*words)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def result_of(capsys, *words):
    """What a command that succeeds writes as JSON."""
    status, out, err = run_captured(capsys, *words, "--json", "-")
    assert status == 0, err
    return json.loads(out)
