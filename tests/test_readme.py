"""What the README shows is run as it stands."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from analysis.cli import main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"```(python|sh)\n(.*?)```", README, flags=re.DOTALL)[::-1])
COMMANDS = [
    line.split("#")[0].strip()
    for block in re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)
    for line in block.splitlines()
    if line.startswith("prosocial")
]
NEEDS_MORE = (
    "report", "bench", "import", "em ", "bayes", "compare", "calibrate", "recover", "anova", "mixed-model",
    "contraction", "glmm", "plan", "robust", "solve-draws", "coverage", "replicate", "play", "study2", "safeguard",
    "session", "audit", "sensitivity",
)  # fmt: skip
"""Commands with tests of their own, or that want a file of the reader's."""


def test_the_python_block_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(BLOCKS["python"], "README.md", "exec"), {})
    out = capsys.readouterr().out
    assert "3 states: log-likelihood" in out
    assert "Within a person the robot's action in each mode never varied" in out


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of a command, in this process."""
    status: object = 0
    try:
        main(list(words))
    except SystemExit as stop:
        status = stop.code or 0
    captured = capsys.readouterr()
    assert isinstance(status, int)
    return status, captured.out, captured.err


def run_outside(folder: Path, *words: str) -> tuple[int, str, str]:
    """The same in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", "from analysis.cli import main; main()", *words],
        cwd=folder, capture_output=True, text=True, env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_exist_and_explain_themselves(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = command.split()[1:]
    depth = 2 if words[0] in ("data", "simulate", "fits", "power", "replicate", "audit") else 1
    status, out, err = run(capsys, *words[:depth], "--help")
    assert status == 0, err
    assert "Example: prosocial" in out
    for option in [w for w in words if w.startswith("--")]:
        assert option in out


QUICK = [c for c in COMMANDS if not any(n in c for n in NEEDS_MORE)]


def quick_words(command: str) -> list[str]:
    words = command.split()[1:]
    if "check" in words:
        words[-1] = str(ROOT / "data" / "simulated" / "simulated_study1.csv.gz")
    return words


@pytest.mark.parametrize("command", QUICK)
def test_quick_commands_run(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("PROSOCIAL_DATA", "PROSOCIAL_CACHE"):
        monkeypatch.delenv(name, raising=False)
    status, out, err = run(capsys, *quick_words(command))
    assert status == 0, err
    assert out


@pytest.mark.parametrize("command", ["prosocial data list", "prosocial power printed"])
def test_a_process_of_its_own_says_the_same_from_any_folder(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command in QUICK
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PROSOCIAL_DATA", raising=False)
    for words in (quick_words(command), [*quick_words(command), "--help"]):
        assert run_outside(tmp_path, *words) == run(capsys, *words)


@pytest.mark.slow
@pytest.mark.parametrize("command", QUICK)
def test_quick_commands_run_in_a_process_of_their_own(command: str, tmp_path: Path) -> None:
    status, out, err = run_outside(tmp_path, *quick_words(command))
    assert status == 0, err
    assert out


def test_every_linked_file_exists() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets
    missing = [t for t in targets if not (ROOT / t).exists()]
    assert not missing
