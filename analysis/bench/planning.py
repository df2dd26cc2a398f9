"""Benchmark of the planner: against the reference SARSOP where its `pomdpsol` is on the PATH, and over many models.

Both solvers get the same problem file. The peer's times are its own (reading left out, initialisation in); ours are
CPU seconds without reading and without loading kernels. The standard files are not part of the project: put them
into a folder and name it in ``PROSOCIAL_POMDP``. Rock sample and tag are written by the workbench itself.
"""

from __future__ import annotations

import os
import re
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from analysis.bench.timing import Row, Target, Timing, ranges
from models.errors import Phrase, located
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.batch import BatchSolution, solve_draws
from models.planning.formats import read_problem, write_problem
from models.planning.latent import LatentBatch
from models.planning.mode_process import alternating
from models.planning.problem import Problem
from models.planning.problems import problem as standard
from models.planning.solution import Solution, TracePoint
from models.planning.solver import solve

FOLDER = "PROSOCIAL_POMDP"
PEER = "pomdpsol"
STANDARD = ("rock_sample_4_4", "tag")

PRECISION = 1e-3
SECONDS = 10.0
"""CPU seconds for a problem that is not solved before."""

BUSY = 20.0
"""Times as long as that it may take at most, where the machine has other work to do."""

RESOLUTION = 0.01
"""The peer's clock: times below are not told apart."""

FASTER = 3.0
MEDIAN_MS, MEAN_MS, TRIVIAL_MS = 5.0, 20.0, 1.0
SPEED_UP = 1.8

_LINE = re.compile(r"^\s*([\d.]+)\s+\d+\s+\d+\s+(\S+)\s+(\S+)\s+\S+\s+\d+\s+\d+\s*$")


@dataclass(frozen=True)
class Reached:
    """Bounds over time: seconds, lower, upper."""

    points: tuple[tuple[float, float, float], ...]

    def gap_at(self, seconds: float) -> float:
        """Smallest gap by then; infinite before the first bounds."""
        return min((u - low for t, low, u in self.points if t <= seconds), default=np.inf)

    def time_to(self, gap: float) -> float:
        """Seconds to the first gap as small as that; infinite if never."""
        return next((t for t, low, u in self.points if u - low <= gap * (1 + 1e-9)), np.inf)


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` takes a tenth of the models and of the time."""
    say = progress or (lambda _: None)
    count = 100 if quick else 1000
    for name, models in (("sticky", sticky_models(count)), ("trivial", trivial_models(count))):
        say(f"{count} {name} models")
        yield from many_models(name, models)
    seconds = SECONDS / 10 if quick else SECONDS
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for path in problem_files(Path(folder)):
            say(path.name)
            rows, ratio = against_peer(path, seconds)
            ratios += [ratio] if ratio is not None else []
            yield from rows
    if ratios:
        mean = statistics.geometric_mean(ratios)
        yield Row(
            f"time to equal gap, geometric mean over {len(ratios)} problems", mean, None, None, "times faster",
            target=f">= {FASTER:g}x", met=mean >= FASTER,
            note=f"slowest problem {min(ratios):.3g}x; times below {RESOLUTION:g} s count as {RESOLUTION:g} s",
            goal=Target(">=", FASTER, "ours"), ours_range=(min(ratios), max(ratios)), repeats=len(ratios),
        )  # fmt: skip


def sticky_models(count: int, states: int = 4) -> list[LatentStatePOMDP]:
    """Random models whose states last: rows of T from Dirichlet(.5 + 6 on staying), help more likely upwards."""
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(0,)))
    prior = 0.5 + 6 * np.eye(states)
    return [_model(np.stack([[rng.dirichlet(row) for row in prior] for _ in range(4)]), rng) for _ in range(count)]


def trivial_models(count: int, states: int = 4) -> list[LatentStatePOMDP]:
    """Random models with rows from Dirichlet(1), where hardly anything can be learned about a person."""
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(1,)))
    return [_model(rng.dirichlet(np.ones(states), size=(4, states)), rng) for _ in range(count)]


def _model(transition: np.ndarray, rng: np.random.Generator) -> LatentStatePOMDP:
    states = transition.shape[1]
    helps = np.sort(rng.random((2, states)), axis=1)
    return LatentStatePOMDP(np.full(states, 1 / states), transition, np.stack([1 - helps, helps], axis=-1))


def many_models(name: str, models: list[LatentStatePOMDP]) -> Iterator[Row]:
    """Time a model on one thread, how many are certified, and what a second thread brings."""
    batch = LatentBatch(ModelDraws.from_models(models), alternating(models[0].protocol))
    solve_draws(LatentBatch(ModelDraws.from_models(models[:2]), batch.process))
    one, one_cpu = _timed(batch, 1)
    ms = 1e3 * one.draw_seconds
    certified = int(one.certified.sum())
    note = f"median {np.median(ms):.3g}, 90% below {np.quantile(ms, 0.9):.3g}, longest {ms.max():.3g} ms (CPU)"
    yield Row(
        f"{len(models)} {name} models certified to {PRECISION:g}", certified, None, None, "models",
        target="all", met=certified == len(models), note=f"largest relative gap {one.relative_gap.max():.3g}",
        goal=Target(">=", len(models), "ours"),
    )  # fmt: skip
    mean, spread = 1e3 * one_cpu / len(models), (float(ms.min()), float(ms.max()))
    wanted = MEAN_MS if name == "sticky" else TRIVIAL_MS
    yield Row(f"a {name} model, mean", mean, None, None, "ms CPU", target=f"<= {wanted:g} ms", met=mean <= wanted,
              note=note, goal=Target("<=", wanted, "ours"), ours_range=spread, repeats=len(models))  # fmt: skip
    if name == "sticky":
        median = float(np.median(ms))
        yield Row(f"a {name} model, median", median, None, None, "ms CPU", target=f"<= {MEDIAN_MS:g} ms",
                  met=median <= MEDIAN_MS, note=note, goal=Target("<=", MEDIAN_MS, "ours"), ours_range=spread,
                  repeats=len(models))  # fmt: skip
        two, two_cpu = _timed(batch, 2)
        ratio = one.seconds / two.seconds
        processors = two_cpu / two.seconds
        # A processor that other work takes half of says nothing about threads.
        free = processors > SPEED_UP and one_cpu / one.seconds > 0.95
        yield Row(
            f"{len(models)} {name} models in two threads", two.seconds, one.seconds, ratio, "s wall", "one thread",
            f">= {SPEED_UP:g}x", ratio >= SPEED_UP if free or ratio >= SPEED_UP else None,
            f"processors got {one_cpu / one.seconds:.2f} and {processors:.2f}"
            + ("" if free or ratio >= SPEED_UP else ": not measurable, the machine is busy"),
            Target(">=", SPEED_UP), **ranges(Timing.of([two.seconds]), 1.0, Timing.of([one.seconds])),
        )  # fmt: skip


def _timed(batch: LatentBatch, threads: int) -> tuple[BatchSolution, float]:
    start = time.process_time()
    solution = solve_draws(batch, PRECISION, threads=threads)
    return solution, time.process_time() - start


def problem_files(folder: Path) -> Iterator[Path]:
    """The standard files, if somebody has them, and problems written into a folder."""
    named = os.environ.get(FOLDER)
    if named is not None:
        if not Path(named).is_dir():
            raise located(FOLDER, Phrase(named), "a folder with .pomdp or .pomdpx files")
        yield from sorted(p for p in Path(named).iterdir() if p.suffix in (".pomdp", ".pomdpx"))
    for name in STANDARD:
        path = folder / f"{name}.pomdpx"
        write_problem(standard(name), path)
        yield path


def against_peer(path: Path, seconds: float) -> tuple[list[Row], float | None]:
    """Gap after equal time and time to an equal gap; the latter's ratio."""
    problem = read_problem(path)
    solve(problem, time_limit=0.01)  # kernels are compiled and loaded before anything is timed
    solution, mine = ours(problem, seconds)
    bounds = f"[{solution.lower:.6g}, {solution.upper:.6g}] {solution.status}"
    wanted = PRECISION * max(abs(solution.lower), abs(solution.upper))
    program = shutil.which(PEER)
    if program is None:
        row = Row(f"{path.name}: relative gap", solution.relative_gap, None, None, "of the value", PEER,
                  note=f"{bounds} in {mine.points[-1][0]:.3g} s CPU; {PEER} is not on the PATH")  # fmt: skip
        return [row], None
    theirs = peer(program, path, seconds, wanted)
    gap, other = mine.gap_at(seconds), theirs.gap_at(seconds)
    low, high = theirs.points[-1][1:] if theirs.points else (np.nan, np.nan)
    rows = [
        Row(
            f"{path.name}: gap after {seconds:g} s", gap, other, max(other, wanted) / max(gap, wanted), "gap", PEER,
            "not behind", bool(gap <= max(other, wanted) * (1 + 1e-6)),
            f"ours {bounds}, peer [{low:.6g}, {high:.6g}]; gaps below {wanted:.3g} count as that",
            Target(">=", 1.0, "the peer's gap over ours, up to rounding", max(other, wanted) * (1 + 1e-6) / gap),
        )
    ]  # fmt: skip
    goal = max(other, wanted)
    mine_time, their_time = max(mine.time_to(goal), RESOLUTION), max(theirs.time_to(goal), RESOLUTION)
    ratio = their_time / mine_time if np.isfinite(mine_time) else 0.0
    rows.append(
        Row(
            f"{path.name}: time to a gap of {goal:.3g}", mine_time, their_time, ratio, "s CPU", PEER, "not behind",
            ratio >= 1.0, f"times below {RESOLUTION:g} s count as {RESOLUTION:g} s", Target(">=", 1.0),
            **ranges(Timing.of([mine_time]), 1.0, Timing.of([their_time])),
        )
    )  # fmt: skip
    return rows, ratio


def ours(problem: Problem, seconds: float) -> tuple[Solution, Reached]:
    """Solve, and the bounds by CPU second: other work on the machine takes nothing from either solver."""
    points: list[tuple[float, float, float]] = []
    start = time.process_time()

    def note(point: TracePoint) -> None:
        points.append((time.process_time() - start, point.lower, point.upper))
        if points[-1][0] >= seconds:
            raise KeyboardInterrupt  # which returns the best so far

    solution = solve(problem, PRECISION, time_limit=BUSY * seconds, progress=note)
    if solution.status == "interrupted":
        solution = replace(solution, status="time limit")
    return solution, Reached(tuple(points))


def peer(program: str, path: Path, seconds: float, precision: float) -> Reached:
    """Bounds by second as the reference solver prints them; it looks at its limit only now and then."""
    command = [program, str(path), "--timeout", f"{seconds:g}", "-p", f"{precision:g}"]
    with tempfile.TemporaryDirectory() as folder:
        try:
            printed = subprocess.run(
                [*command, "-o", f"{folder}/policy"], capture_output=True, check=False, timeout=BUSY * seconds + 60
            ).stdout
        except subprocess.TimeoutExpired as late:
            printed = late.stdout or b""
    found = [_LINE.match(line) for line in printed.decode(errors="replace").splitlines()]
    return Reached(tuple((float(m[1]), float(m[2]), float(m[3])) for m in found if m))
