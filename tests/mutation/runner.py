"""Tests run once for every mutant, each in a forked process that changes the function's code in place.

Compiled kernels are plain functions while the compiler is off (``NUMBA_DISABLE_JIT=1``), so a mutant is a function
whose ``__code__`` is another: whoever imported it has the mutant at once. Tests are imported and collected once,
before any fork; nothing that a mutant does outlives its process.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import signal
import sys
import time
import traceback
import types
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from _pytest.runner import runtestprotocol

from tests.mutation.operators import Mutant

PATIENCE = 4.0
"""How many times the time that a test takes on the unchanged file it is given on a mutant."""

GRACE = 2.0
"""Seconds of CPU on top of that."""

SPARE_MEMORY = 2 * 1024**3
"""Bytes that a mutant may take beyond what is taken already."""

KILLED, SURVIVED, TIMED_OUT = "killed", "survived", "timed out"


@dataclass
class Verdict:
    """What became of a mutant, and the test that noticed."""

    mutant: Mutant
    outcome: str
    test: str = ""


@dataclass
class Campaign:
    """A pytest plugin that runs the collected tests once unchanged and once for every mutant.

    Attributes
    ----------
    path : Path
        The file that is changed.
    mutants : list of Mutant
    examples : int
        How many examples each property test is given, unless it says so itself.
    told : callable
        Given every verdict as it comes.
    verdicts : list of Verdict
    broken : str
        Why nothing was run: tests that fail on the unchanged file.
    """

    path: Path
    mutants: list[Mutant]
    examples: int
    told: Callable[[Verdict], None] = lambda verdict: None
    verdicts: list[Verdict] = field(default_factory=list)
    broken: str = ""
    times: dict[str, float] = field(default_factory=dict)
    tests: int = 0

    def pytest_configure(self) -> None:
        """Fewer examples, none made smaller: that an example fails is enough."""
        hypothesis.settings.register_profile(
            "mutation", hypothesis.settings.get_profile("workbench"), max_examples=self.examples,
            phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate),
            suppress_health_check=list(hypothesis.HealthCheck),
        )  # fmt: skip
        hypothesis.settings.load_profile("mutation")

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Instead of running the tests: run them for every mutant."""
        if session.testsfailed:
            self.broken = "tests could not be collected"
            return True
        # What interpreted kernels say of floating point, compiled ones do not.
        np.seterr(all="ignore")
        warnings.filterwarnings("ignore", message=".*fork.*", category=DeprecationWarning)
        order, self.tests = list(session.items), len(session.items)
        found = _forked(lambda tell: _run(order, None, tell), False)
        times = dict(found.lines)
        failed = [name for name, seconds in found.lines if seconds < 0]
        if failed or len(times) < len(order):
            self.broken = f"fails on the unchanged file: {failed or 'the process ended early'}"
            return True
        self.times = times
        kills = dict.fromkeys(times, 0)
        for mutant in self.mutants:
            found = _forked(lambda tell, m=mutant: self._changed(m, order, times, tell), True)
            caught = [name for name, seconds in found.lines if seconds < 0]
            last = len(found.lines) == len(order)
            outcome = KILLED if caught else SURVIVED if last else TIMED_OUT if found.late else KILLED
            name = caught[0] if caught else "" if last else order[len(found.lines)].nodeid
            self.verdicts.append(Verdict(mutant, outcome, name))
            self.told(self.verdicts[-1])
            if name:
                kills[name] += 1
                # The tests that notice most for their time come first; those of a file stay together.
                worth = {i.nodeid: (kills[i.nodeid] + 0.1) / (times[i.nodeid] + 0.05) for i in order}
                files: dict[str, float] = {}
                for item in order:
                    file = item.nodeid.split("::")[0]
                    files[file] = max(files.get(file, 0.0), worth[item.nodeid])
                order.sort(
                    key=lambda i: (-files[i.nodeid.split("::")[0]], i.nodeid.split("::")[0], -worth[i.nodeid])
                )
        return True

    def _changed(
        self, mutant: Mutant, items: list[Any], times: dict[str, float], tell: Callable[..., None]
    ) -> None:
        codes = mutant.codes(str(self.path))
        changed = 0
        for function in gc.get_objects():
            if isinstance(function, types.FunctionType) and function.__code__.co_filename == str(self.path):
                code = codes.get(function.__code__.co_qualname)
                if code is not None and code.co_freevars == function.__code__.co_freevars:
                    function.__code__ = code
                    changed += 1
        if not changed:
            raise LookupError(f"{mutant.function} is not there to be changed: is the compiler off?")
        _run(items, times, tell)


def _run(items: list[Any], times: dict[str, float] | None, tell: Callable[[str, float], None]) -> None:
    """Run tests up to the first that fails, and tell the seconds that each took, negative for that one."""
    for i, item in enumerate(items):
        if times is not None:
            signal.setitimer(signal.ITIMER_PROF, PATIENCE * times[item.nodeid] + GRACE)
        begin = time.process_time()
        reports = runtestprotocol(item, log=False, nextitem=items[i + 1] if i + 1 < len(items) else None)
        taken = time.process_time() - begin
        if any(report.failed for report in reports):
            tell(item.nodeid, -1.0)
            if times is not None:
                return
        else:
            tell(item.nodeid, taken)


@dataclass
class _Told:
    lines: list[tuple[str, float]]
    late: bool


def _forked(work: Callable[[Callable[[str, float], None]], None], guarded: bool) -> _Told:
    """Do something in a process of its own; what it told, and whether its time was up."""
    reading, writing = os.pipe()
    sys.stdout.flush()
    process = os.fork()
    if process == 0:
        try:
            os.close(reading)
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.environ.get("MUTATION_DEBUG") or os.dup2(quiet, 2)
            if guarded:
                taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
                resource.setrlimit(resource.RLIMIT_AS, (taken + SPARE_MEMORY,) * 2)
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            work(lambda name, taken: os.write(writing, (json.dumps([name, taken]) + "\n").encode()) and None)
        except BaseException:  # a process of its own: nobody above would hear of it
            traceback.print_exc(file=sys.__stderr__)
            os._exit(1)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as lines:
        told = [tuple(json.loads(line)) for line in lines]
    _, status = os.waitpid(process, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status):
        raise RuntimeError("a mutant could not be run; set MUTATION_DEBUG to see why")
    return _Told(told, os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF)


def run(
    path: Path, mutants: Iterable[Mutant], tests: list[str], examples: int, told: Callable[..., None]
) -> Campaign:
    """Run tests for every mutant of a file."""
    campaign = Campaign(path, list(mutants), examples, told)
    options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", "ignore", "-m", "not slow", "--no-header"]
    pytest.main([*options, *tests], plugins=[campaign])
    if not campaign.broken and len(campaign.verdicts) < len(campaign.mutants):
        campaign.broken = "ended early"
    return campaign
