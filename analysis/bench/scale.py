"""Benchmark of scale: ten million events read in parts, checked and compressed; long runs.

Every file is read in a process of its own, so that peak memory is that of the work; how much of it was there before
(interpreter, libraries, compiled kernels) is said beside.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from analysis.bench.em import NEVER
from analysis.bench.timing import Row, Target, Timing, in_turn, load, ranges
from analysis.event_files import csv_bytes, log_table
from analysis.simulate import simulate_study1
from models.em_kernel import em
from models.events import EventLog
from models.histories import UNSEEN, HistoryTree
from models.parameters import Layout
from models.protocol import PUBLISHED

EVENTS, QUICK_EVENTS = 10_000_000, 300_000
MOST_MEMORY = 2 << 30
"""Peak memory aimed at, everything included."""

PART = 100_000
"""People simulated at a time."""

_ROOT = Path(__file__).resolve().parents[2]

_CHILD = """
import json, resource, sys, time
from pathlib import Path

def peak_memory():
    # ru_maxrss begins with the memory of the process that started this one; the kernel's own mark does not.
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    marks = [line.split()[1] for line in lines if line.startswith("VmHWM")]
    return int(marks[0]) if marks else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

from analysis.event_stream import compress_events
from models.protocol import PUBLISHED
path, warm, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
compress_events(warm)
libraries = peak_memory()
wall, cpu = time.perf_counter(), time.process_time()
found = compress_events(path, **options)
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
peak = peak_memory()
log = found.log
print(json.dumps({"events": log.whole[0], "people": log.whole[1], "histories": log.tree().n_histories, "wall": wall,
    "cpu": cpu, "peak": peak * 1024, "libraries": libraries * 1024, "resorted": found.resorted,
    "digest": log.digest}))
"""


def write_large(path: str | Path, events: int, seed: int = 1, *, shuffled: bool = False) -> int:
    """Write simulated studies one after the other until there are so many events; returns how many there are.

    Parameters
    ----------
    path : path
        Ends in ``.csv`` or ``.parquet``.
    events : int
        At least so many; the last study is complete.
    seed : int
    shuffled : bool
        Put the rows of each portion out of order, and the later portions first.
    """
    path = Path(path)
    written = people = index = 0
    writer = None
    rng = np.random.default_rng(seed)
    with path.open("wb") as out:
        while written < events:
            left = max(1, -(-(events - written) // 5))
            log = simulate_study1(participants=min(PART, left), seed=seed + index)
            shift = people if not shuffled else 10**9 - people
            log = EventLog(
                log.protocol, log.study, log.offsets, log.participant + shift, log.sequence, log.condition,
                log.conditions, log.action, log.response,
            )  # fmt: skip
            if path.suffix == ".csv":
                content = csv_bytes(log)
                out.write(content if index == 0 else content.split(b"\n", 1)[1])
            else:
                table = log_table(log)
                if shuffled:
                    table = table.take(pa.array(rng.permutation(len(table))))
                if writer is None:
                    writer = pyarrow.parquet.ParquetWriter(out, table.schema, compression="zstd")
                writer.write_table(table)
            written, people, index = written + log.n_events, people + log.n_participants, index + 1
        if writer is not None:
            writer.close()
    return written


def measured(path: str | Path, warm: str | Path, **options: Any) -> dict[str, Any]:
    """Compress a file in a process of its own: seconds, peak memory in bytes, what was found."""
    command = [sys.executable, "-c", _CHILD, str(path), str(warm), json.dumps(options)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=_ROOT)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` takes 300,000 events instead of ten million."""
    say = progress or (lambda _: None)
    events = QUICK_EVENTS if quick else EVENTS
    repeats = 1 if quick else 3
    with tempfile.TemporaryDirectory(prefix="prosocial-scale-") as folder:
        warm = Path(folder) / "warm.parquet"
        write_large(warm, 1_000, shuffled=True)
        digests = {}
        for name, suffix, shuffled, goal in (
            ("sorted Parquet", "parquet", False, Target(">=", 2.0, "ours")),
            ("sorted CSV", "csv", False, Target(">=", 1.0, "ours")),
            ("Parquet out of order", "parquet", True, None),
        ):
            path = Path(folder) / f"events.{suffix}"
            say(f"writing {events:,} events, {name}")
            n = write_large(path, events, shuffled=shuffled)
            say(f"reading {n:,} events, {name}")
            found = [measured(path, warm) for _ in range(repeats)]
            digests[name] = found[0]["digest"]
            yield from _rows(name, n, path.stat().st_size, found, goal)
            path.unlink()
        same = digests["sorted Parquet"] == digests["sorted CSV"]
        yield Row(
            "the Parquet and the CSV file have one digest", float(same), None, None, "(1: yes)", target="yes",
            met=same, goal=Target(">=", 1.0, "ours"),
        )  # fmt: skip
    say("long runs")
    yield _long_runs((200, 2_000) if quick else (200, 20_000), max(3, repeats))


def _rows(name: str, n: int, size: int, found: list[dict[str, Any]], goal: Target | None) -> Iterator[Row]:
    timing = Timing.of([f["cpu"] for f in found])
    wall = Timing.of([f["wall"] for f in found]).rates(n / 1e6)
    rate = n / timing.median / 1e6
    yield Row(
        f"{n:,} events read in parts, checked and compressed: {name}", rate, None, None, "million events/s CPU",
        target=f">= {goal.number:g} million/s" if goal else "", met=goal.holds(rate) if goal else None,
        note=f"by the clock {wall[0]:.3g}..{wall[1]:.3g} million/s at load {load():.1f}; file of "
        f"{size / 2**20:.0f} MiB, {found[0]['histories']:,} distinct histories, {found[0]['people']:,} people",
        goal=goal, ours_range=timing.rates(n / 1e6), repeats=timing.repeats,
    )  # fmt: skip
    peak = Timing.of([f["peak"] / 2**20 for f in found])
    bound = Target("<=", MOST_MEMORY / 2**20, "ours")
    yield Row(
        f"peak memory, {n:,} events: {name}", peak.median, None, None, "MiB", target=f"<= {bound.number:g} MiB",
        met=bound.holds(peak.median), goal=bound, ours_range=(peak.low, peak.high), repeats=peak.repeats,
        note=f"{found[0]['libraries'] / 2**20:.0f} MiB of it were there before (interpreter, libraries, kernels)",
    )  # fmt: skip


def _long_runs(rounds: tuple[int, int], repeats: int) -> Row:
    """One EM map per node of the tree, where runs are long and hardly any history is shared."""
    nodes = 200_000 if rounds[1] < 20_000 else 1_000_000
    trees = [_unshared(nodes // length, length) for length in rounds]
    layout = Layout(PUBLISHED, 4)
    theta = np.concatenate([np.random.default_rng(1).dirichlet(np.ones(r.stop - r.start)) for r in layout.rows])
    zeros, free = np.zeros(layout.size), np.ones(layout.size, dtype=bool)

    def maps(tree: HistoryTree) -> None:
        em(theta, tree.arrays, layout.sizes, layout.emission_index, zeros, free, 3, -np.inf, 1, False, NEVER)

    short, long = in_turn(lambda: maps(trees[0]), lambda: maps(trees[1]), repeats)
    # Three maps are five evaluations: one before the first, one after the last.
    each = [1e9 / (tree.n_nodes * 5) for tree in trees]
    ours, peer = long.median * each[1], short.median * each[0]
    goal = Target("<=", 1.5, "rounds in proportion", ours / peer)
    return Row(
        f"likelihood and gradient per node, runs of {rounds[1]:,} rounds, 4 states", ours, peer, peer / ours,
        "ns CPU", f"ours, runs of {rounds[0]} rounds", "<= 1.5x", goal.holds(ours / peer),
        f"{trees[1].n_nodes:,} nodes", goal, **ranges(long, each[1], short, each[0]),
    )  # fmt: skip


def _unshared(runs: int, length: int) -> HistoryTree:
    rng = np.random.default_rng(2)
    action = rng.integers(PUBLISHED.n_actions, size=runs * length).astype(np.int8)
    shows = np.asarray(PUBLISHED.emission_index)[action] >= 0
    response = np.where(shows, rng.integers(PUBLISHED.n_responses, size=len(action)), UNSEEN).astype(np.int8)
    offsets = np.arange(runs + 1, dtype=np.int64) * length
    return HistoryTree.build(offsets, action, response, PUBLISHED.n_actions, PUBLISHED.n_responses)
