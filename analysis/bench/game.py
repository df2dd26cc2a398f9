"""Benchmark of the token game: whole rounds, single ticks from Python, and routes beside networkx."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np

from analysis.bench.timing import Row, Target, Timing, by_the_clock, cpu_time, in_turn, ranges
from models.game.human import HumanPlayer
from models.game.layout import Layout, packaged
from models.game.parameters import GameParameters
from models.game.robot import RobotPlayer
from models.game.round import Round
from models.game.rounds import play_rounds
from models.game.route import find_route, route_scratch
from models.game.state import ROBOT

ROUNDS, ROUNDS_A_SECOND = 20_000, 5_000
THREADS = 2
PEER = "networkx"
REPEATS = 5


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` plays a tenth of the rounds."""
    say = progress or (lambda _: None)
    layout, parameters = packaged(), GameParameters()
    n = ROUNDS // 10 if quick else ROUNDS
    rng = np.random.default_rng(1)
    given = (
        rng.integers(0, 2, n), rng.random(n) < 0.5, rng.random(n) < 0.7, rng.integers(0, 2**64, n, dtype=np.uint64)
    )  # fmt: skip

    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    say("rounds")
    play_rounds(layout, parameters, *given, threads=THREADS)
    walls, used = [], []
    for _ in range(REPEATS):
        wall, cpu = time.perf_counter(), time.process_time()
        play_rounds(layout, parameters, *given, threads=THREADS)
        walls.append(time.perf_counter() - wall)
        used.append(time.process_time() - cpu)
    rate, each = n / float(np.median(walls)), 1e6 * np.array(used) / n
    middle = float(np.median(each))
    goal = Target(">=", ROUNDS_A_SECOND, "ours")
    met, more = by_the_clock(goal, rate)
    yield Row(
        f"whole rounds a second by the clock, {THREADS} threads", rate, None, None, "rounds/s",
        target=f">= {ROUNDS_A_SECOND}", met=met,
        note=f"{n / max(walls):,.0f} to {n / min(walls):,.0f}; {n:,} rounds of {parameters.seconds:g} s, nothing "
        f"drawn; {sum(used) / sum(walls):.2f} processors used of {os.cpu_count()}, load at the start {load:.2f}"
        f"{more}",
        goal=goal, ours_range=Timing.of(walls).rates(n), repeats=REPEATS,
    )  # fmt: skip
    yield Row(
        "whole rounds a second of processor time", 1e6 / middle, None, None, "rounds/s",
        note=f"the same rounds: what a processor plays that nobody else uses; {middle:.3g} us a round "
        f"({each.min():.3g} to {each.max():.3g}), {1e3 * middle / parameters.round_ticks:.3g} ns a tick, both "
        "players and their routes counted", ours_range=Timing.of(used).rates(n), repeats=REPEATS,
    )  # fmt: skip

    say("ticks from Python")
    one = cpu_time(lambda: _by_hand(layout, parameters), repeats=3)
    median, low, high = (1e6 * seconds / parameters.round_ticks for seconds in (one.median, one.low, one.high))
    yield Row("a tick from Python, both players", median, None, None, "us CPU",
              note=f"{low:.3g} to {high:.3g}; for environments and pages",
              **ranges(one, 1e6 / parameters.round_ticks))  # fmt: skip

    say("routes")
    yield from _routes(layout, parameters, 200 if quick else 2_000)


def _by_hand(layout: Layout, parameters: GameParameters) -> None:
    game, human, robot = Round(layout, parameters), HumanPlayer(), RobotPlayer()
    while not game.done:
        game.step(human.move(game), robot.move(game))


def _routes(layout: Layout, parameters: GameParameters, count: int) -> Iterator[Row]:
    """Routes of the robot from its start to cells of the corridor and of rooms that are open to it."""
    game = Round(layout, parameters)
    goals = [layout.number(cell) for room in range(1, layout.n_rooms + 1) for cell in layout.inside(room)]
    goals = [goals[i % len(goals)] for i in range(count)]
    goal, path = np.zeros(1, dtype=np.int64), np.zeros(len(layout.cells), dtype=np.int32)
    scratch = route_scratch(layout)
    lengths = np.zeros(count, dtype=np.int64)

    def ours() -> None:
        for i, cell in enumerate(goals):
            goal[0] = cell
            lengths[i] = find_route(game.array, layout.cells, ROBOT, goal, 1, -1, path, scratch)

    if find_spec(PEER) is None:
        alone = cpu_time(ours)
        yield Row("a route by A*, called from Python", 1e6 * alone.median / count, None, None, "us CPU", PEER,
                  note=f"{PEER} is not installed", **ranges(alone, 1e6 / count))  # fmt: skip
        return
    import networkx  # type: ignore[import-untyped,unused-ignore]

    graph = networkx.Graph()
    closed = {layout.number(cell) for cell, colour in game.doors if colour != "blue"}
    for cell, row in enumerate(layout.cells[:, 1:5].tolist()):
        graph.add_edges_from((cell, there) for there in row if there >= 0 and not {cell, there} & closed)
    start = layout.starts[ROBOT]
    found: list[Any] = [None] * count

    def estimate(a: int, b: int) -> int:
        (row, column), (to_row, to_column) = layout.cell(a), layout.cell(b)
        return abs(row - to_row) + abs(column - to_column)

    def peer() -> None:
        for i, cell in enumerate(goals):
            found[i] = networkx.astar_path(graph, start, cell, estimate)

    mine, theirs = in_turn(ours, peer, 3)
    same = all(len(route) - 1 == length for route, length in zip(found, lengths, strict=True))
    yield Row(
        "a route by A*, called from Python", 1e6 * mine.median / count, 1e6 * theirs.median / count,
        theirs.median / mine.median, "us CPU", PEER,
        note=f"{count} routes, {'all' if same else 'NOT all'} of the same length as the peer's",
        **ranges(mine, 1e6 / count, theirs, 1e6 / count),
    )  # fmt: skip
