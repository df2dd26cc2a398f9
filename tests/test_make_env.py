"""What `make env` says when it is done, read from a dry run."""

import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def dry_run(goal):
    # Not as a part of the make that may have started the tests.
    own = {name: value for name, value in os.environ.items() if name not in ("MAKELEVEL", "MAKEFLAGS", "MFLAGS")}
    ran = subprocess.run(["make", "-n", goal], cwd=ROOT, env=own, capture_output=True, check=True, text=True)
    return ran.stdout.strip().splitlines()


def test_it_ends_by_saying_that_it_is_ready_and_what_comes_next():
    made, said = dry_run("env")
    assert made == "sh .ci/environment .venv requirements.lock"
    assert said.startswith('echo ".venv is ready. Next: .venv/bin/prosocial ')
    assert "make report" in said
    assert dry_run("report")[0] == made


def test_other_chores_do_not_say_it():
    assert not [line for goal in ("lint", "test", "report", "warm") for line in dry_run(goal) if "ready" in line]
