"""What the README shows is run as it stands."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

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
    "contraction", "glmm",
)  # fmt: skip
"""Commands with tests of their own, or that want a file of the reader's."""


def test_the_python_block_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(BLOCKS["python"], "README.md", "exec"), {})
    out = capsys.readouterr().out
    assert "3 states: log-likelihood" in out
    assert "Within a person the robot's action in each mode never varied" in out


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_exist_and_explain_themselves(command: str) -> None:
    words = command.split()[1:]
    depth = 2 if words[0] in ("data", "simulate", "fits", "power") else 1
    result = subprocess.run(
        [sys.executable, "-m", "analysis.cli", *words[:depth], "--help"], cwd=ROOT, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    assert "Example: prosocial" in result.stdout
    for option in [w for w in words if w.startswith("--")]:
        assert option in result.stdout


@pytest.mark.parametrize("command", [c for c in COMMANDS if not any(n in c for n in NEEDS_MORE)])
def test_quick_commands_run(command: str, tmp_path: Path) -> None:
    words = command.split()[1:]
    if "check" in words:
        words[-1] = str(ROOT / "data" / "simulated" / "simulated_study1.csv.gz")
    result = subprocess.run(
        [sys.executable, "-c", "from analysis.cli import main; main()", *words],
        cwd=tmp_path, capture_output=True, text=True, env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout


def test_every_linked_file_exists() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets
    missing = [t for t in targets if not (ROOT / t).exists()]
    assert not missing
