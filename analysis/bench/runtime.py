"""Benchmark of the robot's runtime: from a cold start to the first decision, and decisions with their log."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from analysis.bench.timing import Row, Target, by_the_clock
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Policy
from models.planning.policy_files import write_policy
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from models.planning.solver import solve
from models.protocol import PUBLISHED
from models.runtime import Session
from models.safeguards.budget import CostBudget
from models.safeguards.confidence import Confidence
from models.safeguards.consent import fallback_of
from models.safeguards.guarded import Guarded
from models.safeguards.replay import verify

STARTS, SESSIONS, LONG = 15, 200, 1_000
SECONDS, MICROSECONDS = 0.5, 1_000.0
SCHEDULE = "HRHRHRHRH"
DRAWS, STATES = 200, 4

FIRST = """
import time
wall, cpu = time.perf_counter(), time.process_time()
import sys
from models.planning.policy_files import read_policy
from models.runtime import Session
session = Session(read_policy(sys.argv[1]), sys.argv[2])
session.act("robot_needs_help")
print(time.perf_counter() - wall, time.process_time() - cpu)
"""


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` repeats a fifth as often."""
    say = progress or (lambda _: None)
    share = 5 if quick else 1
    say("policies")
    kinds = _policies()
    with tempfile.TemporaryDirectory() as folder:
        say("cold starts")
        yield from _first(kinds["alpha vectors"], Path(folder), max(3, STARTS // share))
        for name, policy in kinds.items():
            say(name)
            yield from _decisions(name, policy, Path(folder), max(4, SESSIONS // share))
        say("durable")
        yield from _decisions(
            "alpha vectors, forced to disk", kinds["alpha vectors"], Path(folder), max(4, SESSIONS // share // 5),
            durable=True,
        )  # fmt: skip
        say("restoring")
        yield from _restoring(kinds["alpha vectors"], Path(folder), LONG // share)


def _policies() -> dict[str, Policy]:
    rng = np.random.default_rng(1)
    draws = ModelDraws.from_models([_person(rng) for _ in range(DRAWS)])
    alpha = solve(latent_problem(_person(rng), alternating(PUBLISHED, "H"), 0.95)).policy
    product = schedule_vectors(Schedule.of(draws, SCHEDULE))
    guards = [CostBudget.of(PUBLISHED, 45.0), Confidence.of(PUBLISHED, 0.9)]
    return {
        "alpha vectors": alpha,
        "exact plan": _plan(draws),
        f"{DRAWS} draws": product,
        f"{DRAWS} draws, two safeguards": Guarded(product, guards, fallback_of(PUBLISHED)),
    }


def _person(rng: np.random.Generator) -> LatentStatePOMDP:
    """A person whose states last, and who helps the likelier the higher the state."""
    transition = rng.dirichlet(np.ones(STATES), (PUBLISHED.n_actions, STATES)) + 6 * np.eye(STATES)
    helps = np.sort(rng.random((len(PUBLISHED.emission_actions), STATES)), axis=1)
    return LatentStatePOMDP(
        rng.dirichlet(np.ones(STATES)), transition / transition.sum(axis=-1, keepdims=True),
        np.stack([1 - helps, helps], axis=-1),
    )  # fmt: skip


def _plan(draws: ModelDraws) -> Policy:
    from models.planning.exact import solve_schedule

    return PlanPolicy.of(solve_schedule(Schedule.of(draws, SCHEDULE)))


def _first(policy: Policy, folder: Path, times: int) -> Iterator[Row]:
    """Import, policy file, log and first decision in a fresh process; and what the process itself takes."""
    write_policy(policy, folder / "policy.json")
    inside: list[list[float]] = []
    outside = []
    for i in range(times):
        command = [sys.executable, "-c", FIRST, str(folder / "policy.json"), str(folder / f"first-{i}.log")]
        start = time.perf_counter()
        ran = subprocess.run(command, capture_output=True, check=True, text=True)
        outside.append(time.perf_counter() - start)
        inside.append([float(word) for word in ran.stdout.split()])
    walls, cpus = (list(column) for column in zip(*inside, strict=True))
    wall = statistics.median(walls)
    goal = Target("<", SECONDS, "ours")
    met, more = by_the_clock(goal, wall)
    yield Row(
        "import and first decision, fresh process", wall, None, None, "s", target=f"< {SECONDS:g} s",
        met=met,
        note=f"by the clock, {times} processes, {min(walls):.3g} to {max(walls):.3g}; "
        f"CPU {statistics.median(cpus):.3g} s ({min(cpus):.3g} to {max(cpus):.3g}); with Python itself "
        f"{statistics.median(outside):.3g} s{more}",
        goal=goal, ours_range=(min(walls), max(walls)), repeats=times,
    )  # fmt: skip


def _decisions(name: str, policy: Policy, folder: Path, times: int, *, durable: bool = False) -> Iterator[Row]:
    """Decisions and outcomes of whole schedules, each with its line in the log."""
    rng = np.random.default_rng(1)
    took: dict[str, list[int]] = {"act": [], "observe": [], "cpu": []}
    letters = {m.letter: m for m in PUBLISHED.modes}
    for i in range(times):
        log = folder / "decisions.log"
        with Session(policy, log, seed=i, durable=durable) as session:
            for k, letter in enumerate(SCHEDULE):
                mode = letters[letter]
                start, cpu = time.perf_counter_ns(), time.thread_time_ns()
                session.act(mode.name)
                cpu, middle = time.thread_time_ns() - cpu, time.perf_counter_ns()
                response = PUBLISHED.response_names[int(rng.integers(2))] if mode.shows_response else None
                before = time.perf_counter_ns()
                session.observe(response)
                after = time.perf_counter_ns()
                # The first decision of a process finds nothing in the caches; it is in the row of cold starts.
                if i or k:
                    took["act"].append(middle - start)
                    took["cpu"].append(cpu)
                    took["observe"].append(after - before)
        log.unlink()
    act, observe, used = (np.array(took[key]) / 1000 for key in ("act", "observe", "cpu"))
    median, high = float(np.median(act)), float(np.quantile(act, 0.99))
    note = (
        f"{len(act)} decisions; CPU {np.median(used):.3g} us, 99th percentile {np.quantile(used, 0.99):.3g}; "
        f"observe {np.median(observe):.3g} us, 99th percentile {np.quantile(observe, 0.99):.3g}"
    )
    target: dict[str, Any] = {"ours_range": (float(act.min()), float(act.max())), "repeats": len(act)}
    yield Row(f"a decision in the log, median: {name}", median, None, None, "us", note=note, **target)
    if not durable:
        goal = Target("<", MICROSECONDS, "ours")
        met, more = by_the_clock(goal, high)
        target |= {"target": f"< {MICROSECONDS:g} us", "goal": goal, "met": met, "note": more.removeprefix("; ")}
    yield Row(f"a decision in the log, 99th percentile: {name}", high, None, None, "us", **target)


def _restoring(policy: Policy, folder: Path, events: int) -> Iterator[Row]:
    """A long session restored from its log, and its log checked."""
    log, rng = folder / "long.log", np.random.default_rng(1)
    modes = [next(m.name for m in PUBLISHED.modes if m.letter == letter) for letter in "HR"]
    with Session(policy, log) as session:
        for k in range(events):
            session.act(modes[k % 2])
            session.observe(PUBLISHED.response_names[int(rng.integers(2))] if k % 2 == 0 else None)
    for name, call in (
        (f"restoring a session of {events} events", lambda: Session.restore(log).close()),
        (f"checking a log of {events} events", lambda: verify(log)),
    ):
        walls = []
        for _ in range(5):
            start = time.perf_counter()
            call()
            walls.append(time.perf_counter() - start)
        yield Row(
            name, 1e3 * statistics.median(walls), None, None, "ms",
            note=f"{1e3 * min(walls):.3g} to {1e3 * max(walls):.3g}; {log.stat().st_size / 1e6:.2g} MB",
            ours_range=(1e3 * min(walls), 1e3 * max(walls)), repeats=len(walls),
        )  # fmt: skip
