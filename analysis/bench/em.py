"""Benchmark of learning: one EM iteration, a fit of 30 restarts, growth with people, and getting data in.

hmmlearn knows neither actions nor silent rounds. It is given the same sequences as a homogeneous hidden Markov
model over three symbols (help, no help, nothing), which is the smaller problem.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from analysis.bench.numpy_em import em_step
from analysis.bench.timing import Row, Target, Timing, cpu_time, in_turn, ranges, span
from analysis.event_files import read_events, write_events
from analysis.simulate import simulate_study1
from models.em_kernel import em
from models.events import EventLog
from models.histories import HistoryTree
from models.parameters import Layout

ABSENT = "hmmlearn is not installed: `make bench` has it"

NEVER = np.zeros(1, dtype=np.uint8)

CAP = 100
"""EM iterations of every restart in the 30-restart fits, for both sides: a fixed amount of work."""


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` uses fewer repeats and stops at 54,000 people."""
    say = progress or (lambda _: None)
    log = simulate_study1()
    repeats = 3 if quick else 7
    peer = _hmmlearn()
    for states in (2, 3, 4, 5):
        say(f"one iteration, {states} states")
        yield from _iteration(log, states, repeats, peer)
    for states in (4,) if quick else (2, 3, 4, 5):
        say(f"30 restarts, {states} states")
        yield _fit(log, states, peer)
    say("growth with people")
    yield from _growth((540, 54_000) if quick else (540, 54_000, 5_400_000), repeats, say)


def _theta(layout: Layout, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.dirichlet(np.ones(r.stop - r.start)) for r in layout.rows])


def _maps(tree: HistoryTree, layout: Layout, theta: np.ndarray, maps: int) -> None:
    zeros, free = np.zeros(layout.size), np.ones(layout.size, dtype=bool)
    em(theta, tree.arrays, layout.sizes, layout.emission_index, zeros, free, maps, -np.inf, 1, False, NEVER)


def _iteration(log: EventLog, states: int, repeats: int, peer: Any) -> Iterator[Row]:
    layout, tree = Layout(log.protocol, states), log.tree()
    theta = _theta(layout, 1)
    inner = 2000

    def ours() -> None:
        _maps(tree, layout, theta, inner)

    shape = (log.n_runs, -1)
    action, response = (a.astype(np.int64).reshape(shape) for a in (log.action, log.response))
    tables = layout.unpack(theta)

    def plain() -> None:
        for _ in range(20):
            em_step(action, response, *tables, layout.emission_index)

    a, b = in_turn(ours, plain, repeats)
    yield Row(
        f"one EM iteration, {states} states, 540 people", a.median / inner * 1e6, b.median / 20 * 1e6,
        (b.median / 20) / (a.median / inner), "us CPU", "plain numpy",
        note=f"ours {span(a, 1e6 / inner, 'us')}, peer {span(b, 1e6 / 20, 'us')}",
        **ranges(a, 1e6 / inner, b, 1e6 / 20),
    )  # fmt: skip
    goal = Target(">=", 100.0) if states == 4 else None
    if peer is None:
        yield Row(
            f"one EM iteration, {states} states, 540 people", a.median / inner * 1e6, None, None, "us CPU",
            "hmmlearn scaling", ">= 100x" if goal else "", note=ABSENT, goal=goal, **ranges(a, 1e6 / inner),
        )  # fmt: skip
        return
    symbols, lengths = _symbols(log)

    def theirs() -> None:
        peer(states, 10, 1).fit(symbols, lengths)

    a, b = in_turn(ours, theirs, repeats)
    ratio = (b.median / 10) / (a.median / inner)
    yield Row(
        f"one EM iteration, {states} states, 540 people", a.median / inner * 1e6, b.median / 10 * 1e6, ratio,
        "us CPU", "hmmlearn scaling", ">= 100x" if goal else "", goal.holds(ratio) if goal else None,
        f"ours {span(a, 1e6 / inner, 'us')}, peer {span(b, 1e6 / 10, 'us')}", goal,
        **ranges(a, 1e6 / inner, b, 1e6 / 10),
    )  # fmt: skip


def _fit(log: EventLog, states: int, peer: Any) -> Row:
    layout, tree = Layout(log.protocol, states), log.tree()
    starts = [_theta(layout, i) for i in range(30)]
    symbols, lengths = _symbols(log)

    def ours() -> None:
        for theta in starts:
            _maps(tree, layout, theta, CAP)

    def theirs() -> None:
        for i in range(30):
            peer(states, CAP, i).fit(symbols, lengths)

    a = cpu_time(ours, 3)
    if peer is None:
        return Row(
            f"30 restarts of {CAP} iterations, {states} states, 540 people", a.median, None, None, "s CPU",
            "hmmlearn scaling", note=ABSENT, **ranges(a, 1.0),
        )  # fmt: skip
    b = cpu_time(theirs, 1, warm=False)
    return Row(
        f"30 restarts of {CAP} iterations, {states} states, 540 people", a.median, b.median, b.median / a.median,
        "s CPU", "hmmlearn scaling", note=f"ours {span(a, 1, 's')}, peer once", **ranges(a, 1.0, b),
    )  # fmt: skip


def _growth(sizes: tuple[int, ...], repeats: int, say: Callable[[str], None]) -> Iterator[Row]:
    per_history: dict[int, float] = {}
    timings: dict[int, tuple[Timing, float]] = {}
    for people in sizes:
        say(f"{people:,} people")
        log = simulate_study1(participants=people)
        tree, layout = log.tree(), Layout(log.protocol, 4)
        theta = _theta(layout, 1)
        timing = cpu_time(partial(_maps, tree, layout, theta, 2000), repeats)
        per_history[people] = timing.median / 2000 / tree.n_histories * 1e9
        timings[people] = timing, 1e9 / 2000 / tree.n_histories
        first = timings[sizes[0]] if people != sizes[0] else ()
        before = per_history[sizes[0]] if people != sizes[0] else None
        ratio = None if before is None else per_history[people] / before
        yield Row(
            f"EM iteration per distinct history, {people:,} people ({tree.n_histories} histories), 4 states",
            per_history[people], before, ratio, "ns CPU", f"ours at {sizes[0]} people" if before else "",
            "<= 1.1x" if before else "", None if ratio is None else ratio <= 1.1,
            span(timing, 1e9 / 2000 / tree.n_histories, "ns"),
            Target("<=", 1.1) if before else None, **ranges(*timings[people], *first),
        )  # fmt: skip
        if people == 5_400_000 and 54_000 in per_history:
            same = per_history[people] / per_history[54_000]
            yield Row(
                "EM iteration per distinct history, 5,400,000 against 54,000 people", per_history[people],
                per_history[54_000], same, "ns CPU", "ours at 54,000 people", "within 1.1x either way",
                1 / 1.1 <= same <= 1.1, goal=Target("within", 1.1), **ranges(*timings[people], *timings[54_000]),
            )  # fmt: skip
    yield from _throughput(log, repeats, say)


def _throughput(log: EventLog, repeats: int, say: Callable[[str], None]) -> Iterator[Row]:
    n = log.n_events
    say("compression")
    timing = cpu_time(log.tree, min(repeats, 5))
    rate = n / timing.median / 1e6
    yield Row(
        f"compression of {n:,} coded, sorted events", rate, None, None, "million events/s CPU", "",
        ">= 15 million/s", rate >= 15, span(timing, 1, "s"), Target(">=", 15.0, "ours"), timing.rates(n / 1e6),
        repeats=timing.repeats,
    )  # fmt: skip
    part = log if n <= 5_000_000 else log.select(runs=np.arange(1_000_000))
    for suffix, target in (("parquet", 2.0), ("csv", 1.0)):
        say(f"reading {suffix}")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"events.{suffix}"
            write_events(part, path)
            timing = cpu_time(partial(_read_and_compress, path), 3)
        rate = part.n_events / timing.median / 1e6
        yield Row(
            f"{part.n_events:,} events from {suffix}: read, validated, compressed", rate, None, None,
            "million events/s CPU", "", f">= {target:g} million/s", rate >= target, span(timing, 1, "s"),
            Target(">=", target, "ours"), timing.rates(part.n_events / 1e6), repeats=timing.repeats,
        )  # fmt: skip


def _read_and_compress(path: Path) -> HistoryTree:
    return read_events(path).log.tree()


def _symbols(log: EventLog) -> tuple[np.ndarray, np.ndarray]:
    return (log.response.astype(int) + 1).reshape(-1, 1), np.diff(log.offsets)


def _hmmlearn() -> Any:
    try:
        from hmmlearn.hmm import CategoricalHMM
    except ImportError:
        return None

    def make(states: int, iterations: int, seed: int) -> Any:
        return CategoricalHMM(states, n_iter=iterations, tol=-np.inf, implementation="scaling", random_state=seed)

    return make
