"""Benchmark of starting up: help of the commands, imports and the first decision, each in fresh processes.

CPU time is what is judged: on a machine with other work to do the clock says more about that work.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from analysis.bench.timing import Row, Target, Timing, by_the_clock, load, ranges

STARTS, QUICK_STARTS = 20, 10
HELP_SECONDS, DECISION_SECONDS = 0.4, 0.5

RUN = "import sys; from analysis.cli import main; main()"
"""What the installed command does."""


@dataclass(frozen=True)
class Started:
    """CPU and wall seconds of whole processes."""

    cpu: Timing
    wall: Timing


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` starts half as many processes of each kind."""
    say = progress or (lambda _: None)
    times = QUICK_STARTS if quick else STARTS
    python = [sys.executable, "-c"]
    cases: dict[str, tuple[list[str], float | None]] = {
        "prosocial --help": ([*python, RUN, "--help"], HELP_SECONDS),
        "prosocial em --help": ([*python, RUN, "em", "--help"], HELP_SECONDS),
        "import models": ([*python, "import models"], None),
        "import numpy": ([*python, "import numpy"], None),
        "Python itself": ([*python, "pass"], None),
    }
    for name, (command, wanted) in cases.items():
        say(name)
        yield from rows(name, started(command, times), wanted)
    say("first decision")
    with tempfile.TemporaryDirectory() as folder:
        yield from rows("first decision of a session", first_decision(Path(folder), times), DECISION_SECONDS)


def started(command: list[str], times: int, environment: Mapping[str, str] | None = None) -> Started:
    """Start a process several times, after once that counts for nothing.

    Raises
    ------
    subprocess.CalledProcessError
        If it fails.
    """
    cpus, walls = [], []
    for i in range(times + 1):
        cpu, wall = once(command, environment)
        if i:
            cpus.append(cpu)
            walls.append(wall)
    return Started(Timing.of(cpus), Timing.of(walls))


def once(command: list[str], environment: Mapping[str, str] | None = None) -> tuple[float, float]:
    """CPU seconds, user and system, and wall seconds of one process from start to end.

    Raises
    ------
    subprocess.CalledProcessError
        If it fails.
    """
    before, start = _children(), time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env=None if environment is None else dict(environment))
    wall = time.perf_counter() - start
    return _children() - before, wall


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def first_decision(folder: Path, times: int) -> Started:
    """Import, policy file, log and first decision, with all that Python itself takes."""
    from analysis.bench.runtime import FIRST, _policies
    from models.planning.policy_files import write_policy

    policy = folder / "policy.json"
    write_policy(_policies()["alpha vectors"], policy)
    cpus, walls = [], []
    for i in range(times + 1):
        cpu, wall = once([sys.executable, "-c", FIRST, str(policy), str(folder / f"session-{i}.log")])
        if i:
            cpus.append(cpu)
            walls.append(wall)
    return Started(Timing.of(cpus), Timing.of(walls))


def rows(name: str, found: Started, wanted: float | None) -> Iterator[Row]:
    """CPU and wall; the clock is judged only where it could have been met or the machine was free."""
    goal = None if wanted is None else Target("<=", wanted, "ours")
    words = "" if wanted is None else f"<= {wanted:g} s"
    yield Row(
        f"{name}, CPU", found.cpu.median, None, None, "s CPU", target=words,
        met=goal.holds(found.cpu.median) if goal else None, note="fresh processes, user and system time",
        goal=goal, **ranges(found.cpu, 1.0),
    )  # fmt: skip
    met, more = by_the_clock(goal, found.wall.median) if goal else (None, "")
    yield Row(
        f"{name}, by the clock", found.wall.median, None, None, "s wall", target=words, met=met,
        note=f"fresh processes, load {load():.2f}{more}", goal=goal, **ranges(found.wall, 1.0),
    )  # fmt: skip
