"""Benchmark of planning under doubt: the study under many draws, caution, and every draw without horizon.

Draws are those of the bundled study's posterior with four states, sampled here. The reference solver, where its
`pomdpsol` is on the PATH, gets single draws as problem files.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from analysis.bench.planning import PEER, PRECISION, RESOLUTION, peer
from analysis.bench.timing import Row, Target, cpu_time, ranges
from models.model_draws import ModelDraws
from models.planning.batch import BatchSolution, solve_draws
from models.planning.exact import solve_schedule
from models.planning.formats import write_problem
from models.planning.latent import LatentBatch
from models.planning.mode_process import alternating
from models.planning.schedule import Schedule
from models.robust.contested import contested
from models.robust.frontier import LEVELS, frontier
from models.robust.own_plans import own_plans

SCHEDULE = "HRHRHRHRH"
STATES, DRAWS = 4, 4_000
TREE_SECONDS, FRONTIER_SECONDS, BATCH_SECONDS = 1.0, 10.0, 40.0
LINEAR = 1.25
"""A draw among the most may cost so many times what it costs among `DRAWS`."""

MOST = 100_000
PEER_DRAWS, PEER_SECONDS = 8, 4.0


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` takes a tenth of the draws."""
    say = progress or (lambda _: None)
    say("posterior of the bundled study")
    draws = bundled_draws(DRAWS // 10 if quick else DRAWS)
    n = draws.n_draws
    study = Schedule.of(draws, SCHEDULE)
    say("over the schedule")
    tree = cpu_time(lambda: solve_schedule(study))
    yield Row(
        f"Bayes-adaptive optimum, {n} draws", tree.median, None, None, "s CPU", target=f"<= {TREE_SECONDS:g} s",
        met=tree.median <= TREE_SECONDS, note=f"{tree.low:.3g} to {tree.high:.3g}; {SCHEDULE}, {STATES} states",
        goal=Target("<=", TREE_SECONDS, "ours"), **ranges(tree, 1.0),
    )  # fmt: skip
    own = cpu_time(lambda: own_plans(study))
    yield Row(f"optimum of every draw, {n} draws", own.median, None, None, "s CPU",
              note=f"{1e6 * own.median / n:.3g} us a draw", **ranges(own, 1.0))  # fmt: skip
    flipped, _ = contested(study)
    for name, setting in (("published costs", study), ("contested costs", flipped)):
        found = frontier(setting)
        line = cpu_time(lambda setting=setting: frontier(setting), repeats=3, warm=False)  # type: ignore[misc]
        gap = max(p.gap for p in found.plans)
        sure = all(p.certified for p in found.plans)
        yield Row(
            f"frontier of {len(LEVELS)} levels, {n} draws, {name}", line.median, None, None, "s CPU",
            target=f"<= {FRONTIER_SECONDS:g} s, all certified", met=line.median <= FRONTIER_SECONDS and sure,
            note=f"largest gap {gap:.2g}, {sum(p.iterations for p in found.plans)} Bayes trees",
            goal=Target("<=", FRONTIER_SECONDS, "ours", also="all certified"), **ranges(line, 1.0),
        )  # fmt: skip
    say("many draws")
    times = MOST // 10 // n if quick else MOST // n
    more = Schedule.of(repeated(draws, times), SCHEDULE)
    large = cpu_time(lambda: solve_schedule(more), repeats=3)
    ratio = (large.median / times) / tree.median
    yield Row(
        f"Bayes-adaptive optimum, {times * n} draws", large.median, None, None, "s CPU",
        target=f"<= {LINEAR:g}x a draw", met=ratio <= LINEAR, note=f"{ratio:.3g}x a draw of the {n}",
        goal=Target("<=", LINEAR, f"cost of a draw beside one of {n}", ratio), **ranges(large, 1.0),
    )  # fmt: skip
    say("without horizon")
    yield from endless(draws)


def bundled_draws(count: int) -> ModelDraws:
    """Draws of the posterior of the bundled (simulated) study."""
    from analysis.datasets import load
    from models.bayesian_fit import fit
    from models.nuts import NutsSettings

    log = load("simulated_study1").log
    return fit(log, STATES, sampler=NutsSettings(seed=1)).draws().thin(count)


def repeated(draws: ModelDraws, times: int) -> ModelDraws:
    """The same draws several times over."""
    return replace(
        draws, initial=np.tile(draws.initial, (times, 1)), transition=np.tile(draws.transition, (times, 1, 1, 1)),
        emission=np.tile(draws.emission, (times, 1, 1, 1)), weight=np.tile(draws.weight, times) / times,
    )  # fmt: skip


def endless(draws: ModelDraws) -> Iterator[Row]:
    """Every draw certified without horizon, and single draws by the reference solver."""
    batch = LatentBatch(draws, alternating(draws.protocol))
    solve_draws(LatentBatch(draws.thin(2), batch.process))
    start = time.process_time()
    solution = solve_draws(batch, PRECISION)
    seconds = time.process_time() - start
    certified = int(solution.certified.sum())
    # The target is for 4,000 draws; fewer have their share of it.
    wanted = BATCH_SECONDS * len(batch) / DRAWS
    yield Row(
        f"{len(batch)} draws certified to {PRECISION:g}", seconds, None, None, "s CPU",
        target=f"<= {wanted:g} s, all certified", met=seconds <= wanted and certified == len(batch),
        note=f"{certified} certified, largest relative gap {solution.relative_gap.max():.3g}; "
        f"{1e3 * seconds / len(batch):.3g} ms a draw",
        goal=Target("<=", wanted, "ours", also="all certified"), ours_range=(seconds, seconds), repeats=1,
    )  # fmt: skip
    program = shutil.which(PEER)
    if program is None:
        yield Row(f"{PEER} a draw", 1e3 * seconds / len(batch), None, None, "ms CPU", PEER,
                  note=f"{PEER} is not on the PATH")  # fmt: skip
        return
    yield _single(program, solution, seconds / len(batch))


def _single(program: str, solution: BatchSolution, ours: float) -> Row:
    batch = solution.batch
    chosen = np.linspace(0, len(batch) - 1, PEER_DRAWS).astype(int)
    times, solved = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for d in chosen:
            path = Path(folder) / "draw.pomdpx"
            write_problem(batch.problem(int(d)), path)
            wanted = PRECISION * max(abs(solution.lower[d]), abs(solution.upper[d]))
            reached = peer(program, path, PEER_SECONDS, wanted)
            own = reached.time_to(wanted)
            solved += bool(np.isfinite(own))
            times.append(max(min(own, PEER_SECONDS), RESOLUTION))
    mean = float(np.mean(times))
    return Row(
        f"a draw, {len(chosen)} by {PEER}", 1e3 * ours, 1e3 * mean, mean / ours, "ms CPU", PEER,
        note=f"the peer certified {solved} of {len(chosen)}; the others count as its {PEER_SECONDS:g} s",
        peer_range=(1e3 * min(times), 1e3 * max(times)), repeats=len(batch), peer_repeats=len(times),
    )  # fmt: skip
