"""What the README shows is run as it stands: its commands word for word, in its order, in one folder."""

from __future__ import annotations

import io
import os
import re
import shlex
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from analysis import fits
from analysis.cli import command_line, main
from tests.readme_files import SAID, bring

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
LINES = [
    line.split(" # ")[0].strip()
    for block in re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)
    for line in block.splitlines()
    if line.strip()
]
PROSE = re.sub(r"```.*?```", "", README, flags=re.DOTALL)
IN_TEXT = [" ".join(text.split()) for text in re.findall(r"`(prosocial [^`]+)`", PROSE)]
"""Commands within sentences, whose code may go over a line's end."""

MENTIONS = ("prosocial data import", "prosocial em", "prosocial play")
"""Commands that a sentence speaks of without their words."""

COMMANDS = list(
    dict.fromkeys(
        [line for line in LINES if line.startswith("prosocial")] + [c for c in IN_TEXT if c not in MENTIONS]
    )
)

SMALL = {
    "em simulated_study1": "--states 2 --restarts 2",
    "em study.csv": "--states 1 --restarts 1",
    "bayes": "--states 2 --draws 50 --tune 50 --chains 2",
    "glmm": "",
    "power mixed-model": "--studies 4 --people 60",
    "plan": "",
    "robust": "--force --draws 10 --schedule HR",
    "solve-draws": "--force --draws 5 --precision 0.1",
    "sensitivity": "--reading two-step",
    "safeguard": "--force --draws 5 --schedule HRH",
    "calibrate": "--replicates 2 --participants 20",
    "recover": "--replicates 2 --participants 30 --states 1",
    "coverage": "--studies 4 --participants 60",
    "simulate study1 --game": "--participants 8",
    "replicate game": "--studies 2 --tried 0 --participants 30",
}  # fmt: skip
"""What takes longer than some seconds is run with the README's words and these after them, by its first words."""

ONLY_READ = (
    "calibrate --people-differ",
    "power contraction",
    "compare",
    "replicate plans",
    "replicate study2",
    "study2",
    "play",
    "report",
    "bench",
)
"""Run by the slow test alone; every other test run sees that their words can be read."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The one folder of all commands, with what a reader brings; a store of its own, no data from elsewhere."""
    folder = tmp_path_factory.mktemp("reader")
    bring(folder)
    before = Path.cwd()
    with pytest.MonkeyPatch.context() as patch:
        for name in ("PROSOCIAL_DATA", "PROSOCIAL_CACHE"):
            patch.delenv(name, raising=False)
        patch.setattr(fits, "store_folder", lambda: folder / "store")
        patch.chdir(folder)
        yield folder
    os.chdir(before)


def words_of(command: str) -> list[str]:
    return shlex.split(command)[1:]


def starting_with(command: str, beginnings: Any) -> str | None:
    """The longest of some beginnings that a command has."""
    found = [b for b in beginnings if f"{command} ".startswith(f"prosocial {b} ")]
    found += [b for b in beginnings if len(b.split()) > 2 and set(b.split()) <= set(command.split())]
    return max(found, key=len, default=None)


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


def run_outside(folder: Path, *words: str, **more: Any) -> tuple[int, str, str]:
    """The same in a process of its own."""
    given = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", **more.pop("env", {})}
    done = subprocess.run(
        [sys.executable, "-c", "from analysis.cli import main; main()", *words],
        cwd=folder, capture_output=True, text=True, env=given, **more,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


# -- what is there ---------------------------------------------------------------------------------------------
def test_every_line_of_the_shell_blocks_is_a_command_that_is_tested() -> None:
    others = [line for line in LINES if not line.startswith("prosocial")]
    assert all(line.startswith(("make ", "echo ")) for line in others), others
    assert len(COMMANDS) > 40
    assert {c.split()[1] for c in COMMANDS} == set(command_line().commands)


def test_chores_of_the_readme_are_targets() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    named = {line.split()[1] for line in LINES if line.startswith("make ")}
    named |= set(re.findall(r"`make ([a-z-]+)", README))
    assert {"report", "test", "docs", "bench"} <= named <= targets


def test_the_python_block_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(PYTHON[0], "README.md", "exec"), {})
    out = capsys.readouterr().out
    assert "3 states: log-likelihood" in out
    assert "Within a person the robot's action in each mode never varied" in out


def test_every_linked_file_exists() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets
    missing = [t for t in targets if not (ROOT / t).exists()]
    assert not missing


# -- words -----------------------------------------------------------------------------------------------------
def parsed(words: list[str]) -> dict[str, Any]:
    """Options and arguments as the command would get them; an unknown word is refused as at a terminal."""
    command = command_line()
    while hasattr(command, "commands"):
        name, *words = words
        command = command.commands[name]
    return dict(command.make_context(name, list(words)).params)


@pytest.mark.parametrize("command", COMMANDS)
def test_words_can_be_read(command: str) -> None:
    assert parsed(words_of(command))


def test_a_wrong_word_would_be_seen() -> None:
    for wrong in ("em simulated_study1 --state 2-5", "plan", "solve tiger --precision small"):
        with pytest.raises(Exception, match=r"(?i)no such option|missing parameter|valid number"):
            parsed(shlex.split(wrong))


def test_every_command_takes_the_four_options() -> None:
    def commands(group: Any) -> Iterator[Any]:
        for one in group.commands.values():
            yield from commands(one) if hasattr(one, "commands") else [one]

    for one in commands(command_line()):
        have = {o for p in one.params for o in p.opts} | {"--help"}
        assert {"--help", "--json", "--seed", "--quiet"} <= have, one.name
        assert "Example: prosocial" in one.help, one.name


# -- run -------------------------------------------------------------------------------------------------------
RUN = [c for c in COMMANDS if not starting_with(c, ONLY_READ)]


@pytest.mark.parametrize("command", RUN)
def test_commands_run(
    command: str, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the README's order: files that one command makes serve the later ones."""
    own = starting_with(command, SMALL)
    monkeypatch.setattr(sys, "stdin", io.StringIO(SAID))
    status, out, err = run(capsys, *words_of(command), *shlex.split(SMALL[own] if own else ""))
    assert status == 0, err
    assert out
    for option in ("--out", "--log", "--policy"):
        words = words_of(command)
        if option in words and words[0] != "play":
            assert (desk / words[words.index(option) + 1]).exists()


@pytest.mark.parametrize("command", ["prosocial data list", "prosocial power printed"])
def test_a_process_of_its_own_says_the_same_from_any_folder(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command in COMMANDS
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PROSOCIAL_DATA", raising=False)
    for words in (words_of(command), [*words_of(command), "--help"]):
        assert run_outside(tmp_path, *words) == run(capsys, *words)


# -- all of them, as printed (hours) -----------------------------------------------------------------------------
@pytest.fixture(scope="module")
def long_desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("patient_reader")
    bring(folder)
    # A store of its own, so that everything is computed; compiled code is the checkout's.
    (folder / "cache").mkdir()
    (ROOT / ".cache" / "numba").mkdir(parents=True, exist_ok=True)
    (folder / "cache" / "numba").symlink_to(ROOT / ".cache" / "numba")
    return folder


ECHO = "echo "


@pytest.mark.slow
@pytest.mark.parametrize("line", [c for c in (*LINES, *IN_TEXT) if c in COMMANDS or c.startswith(ECHO)])
def test_commands_run_as_printed(line: str, long_desk: Path) -> None:
    """Each in a process of its own; a server is stopped once its page answers."""
    if line.startswith(ECHO):
        subprocess.run(["sh", "-c", line], cwd=long_desk, check=True)
        return
    words, store = words_of(line), {"PROSOCIAL_CACHE": str(long_desk / "cache")}
    if words[0] == "play":
        serves(words, long_desk, store)
        return
    if "frd2012" in words and words[0] == "report":
        given = os.environ.get("PROSOCIAL_DATA") or str(ROOT.parent / "shared" / "data" / "real")
        if not Path(given).is_dir():
            pytest.skip(f"{given} is absent, and tests fetch nothing")
        store["PROSOCIAL_DATA"] = given
    status, out, err = run_outside(long_desk, *words, input=SAID, env=store)
    assert status == 0, err
    assert out


def serves(words: list[str], folder: Path, env: dict[str, str]) -> None:
    """Start a server at a port of its own, look at its page, and stop it as Ctrl-C does."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from analysis.cli import main; main()", *words, "--port", "0"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "PYTHONUNBUFFERED": "1", **env},
    )  # fmt: skip
    said = ""
    try:
        assert process.stdout is not None
        for line in process.stdout:
            said += line
            found = re.search(r"(http://[\d.]+:\d+)/", line)
            if found:
                with urllib.request.urlopen(f"{found[1]}/", timeout=60) as page:
                    assert page.status == 200
                process.send_signal(signal.SIGINT)
                break
        rest = process.communicate(timeout=120)[0]
    finally:
        process.kill()
    assert process.returncode in (0, 130), said + rest
