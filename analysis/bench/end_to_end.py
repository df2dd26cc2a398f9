"""Benchmark from end to end: the whole report in a temporary cache, first with nothing, then with stored fits."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from analysis.bench.startup import RUN, once
from analysis.bench.timing import Row, Timing, ranges
from models.compiled import cache_folder

REPEATS = 3


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` makes the quick report only, with kernels that are compiled already."""
    say = progress or (lambda _: None)
    compiled = cache_folder().parent
    if not quick:
        say("report --quick, nothing compiled")
        with tempfile.TemporaryDirectory() as folder:
            yield row("report --quick", "nothing compiled, no stored fits", [report(Path(folder), "--quick")])
    for options in (("--quick",),) if quick else (("--quick",), ()):
        name = " ".join(("report", *options))
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            compiled.mkdir(parents=True, exist_ok=True)
            (place / compiled.name).symlink_to(compiled, target_is_directory=True)
            say(f"{name}, no stored fits")
            yield row(name, "no stored fits", [report(place, *options)])
            say(f"{name}, stored fits")
            repeats = 1 if quick else REPEATS
            yield row(name, "stored fits", [report(place, *options) for _ in range(repeats)])


def report(cache: Path, *options: str) -> tuple[float, float]:
    """CPU and wall seconds of one report, with `cache` for what is kept between runs."""
    command = [sys.executable, "-c", RUN, "report", "--quiet", "--out", str(cache / "report"), *options]
    return once(command, os.environ | {"PROSOCIAL_CACHE": str(cache)})


def row(name: str, state: str, taken: list[tuple[float, float]]) -> Row:
    """CPU seconds of the whole process and those it started; the clock in the note."""
    cpus, walls = (list(column) for column in zip(*taken, strict=True))
    cpu, wall = Timing.of(cpus), Timing.of(walls)
    return Row(
        f"{name}, {state}", cpu.median, None, None, "s CPU",
        note=f"{wall.median:.3g} s by the clock ({wall.low:.3g} to {wall.high:.3g}); bundled simulated study",
        **ranges(cpu, 1.0),
    )  # fmt: skip
